"""Which places a journey calls at."""

from __future__ import annotations

from dataclasses import dataclass

from plant_sim.line import Line
from train_ato.plan.settings import PlanSettings

__all__ = ["Journey", "journey_of"]


@dataclass(frozen=True, slots=True)
class Journey:
    """Places of the front at every stop, first and last included [m], and the time at those between [s]."""

    places: tuple[float, ...]
    dwells: tuple[float, ...]

    def stretches(self, settings: PlanSettings) -> list[tuple[float, float, float, float]]:
        """Return begin, end and the speeds there of every run."""
        last = len(self.places) - 2
        return [
            (
                self.places[k],
                self.places[k + 1],
                settings.begin_speed if k == 0 else 0.0,
                settings.end_speed if k == last else 0.0,
            )
            for k in range(last + 1)
        ]


def journey_of(line: Line, settings: PlanSettings) -> Journey:
    """Return the journey that the settings ask for on a line.

    Without places it runs from the first to the last stop; on a line with one stop from its begin to the stop, on a
    line with none over all of it.

    Raises
    ------
    ValueError
        If a stop lies outside the line or the journey has no length.
    """
    stops = line.stops
    for stop in stops:
        if not line.begin - 1e-6 <= stop.at <= line.end + 1e-6:
            raise ValueError(
                f"stop '{stop.name}' at km {stop.at / 1000:.3f} lies beyond line '{line.name}' (km "
                f"{line.begin / 1000:.3f} ... {line.end / 1000:.3f}); move the stop or lengthen the line"
            )
    begin = settings.begin if settings.begin is not None else (stops[0].at if len(stops) > 1 else line.begin)
    end = settings.end if settings.end is not None else (stops[-1].at if stops else line.end)
    for name, place in (("begin", begin), ("end", end)):
        if not line.begin - 1e-6 <= place <= line.end + 1e-6:
            raise ValueError(
                f"{name} of the journey at km {place / 1000:.3f} lies beyond line '{line.name}' (km "
                f"{line.begin / 1000:.3f} ... {line.end / 1000:.3f}); choose a place on the line"
            )
    if end - begin < 0.1:
        raise ValueError(
            f"the journey from km {begin / 1000:.3f} to km {end / 1000:.3f} has no length; move its end on"
        )
    between = [stop for stop in stops if settings.calling and begin + 0.1 < stop.at < end - 0.1]
    dwells = tuple(stop.dwell if settings.dwell is None else settings.dwell for stop in between)
    return Journey((begin, *(stop.at for stop in between), end), dwells)
