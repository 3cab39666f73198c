"""Stops of a plan: places of the front and dwell times."""

from __future__ import annotations

from dataclasses import dataclass

from plant_sim.line import Line
from train_ato.profile.planner.settings import PlanSettings


@dataclass(frozen=True, slots=True)
class Stops:
    """Places of the front at all stops, first and last included [m]; dwell times at the intermediate ones [s]."""

    places: tuple[float, ...]
    dwells: tuple[float, ...]

    def sections(self, settings: PlanSettings) -> list[tuple[float, float, float, float]]:
        """Return begin, end [m] and the speeds at both [m/s] of every section between two stops."""
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


def stops_of(line: Line, settings: PlanSettings) -> Stops:
    """Return the stops of a plan on a line.

    Defaults: from the first to the last stop; on a line with one stop from its begin to the stop; on a line without
    stops over its whole length.

    Raises
    ------
    ValueError
        If a stop lies outside the line or the section between begin and end has no length.
    """
    listed = line.stops
    for stop in listed:
        if not line.begin - 1e-6 <= stop.at <= line.end + 1e-6:
            raise ValueError(
                f"stop '{stop.name}' at km {stop.at / 1000:.3f} lies beyond line '{line.name}' (km "
                f"{line.begin / 1000:.3f} ... {line.end / 1000:.3f}); move the stop or lengthen the line"
            )
    begin = settings.begin if settings.begin is not None else (listed[0].at if len(listed) > 1 else line.begin)
    end = settings.end if settings.end is not None else (listed[-1].at if listed else line.end)
    for name, place in (("begin", begin), ("end", end)):
        if not line.begin - 1e-6 <= place <= line.end + 1e-6:
            raise ValueError(
                f"{name} of the plan at km {place / 1000:.3f} lies beyond line '{line.name}' (km "
                f"{line.begin / 1000:.3f} ... {line.end / 1000:.3f}); choose a place on the line"
            )
    if end - begin < 0.1:
        raise ValueError(f"the plan from km {begin / 1000:.3f} to km {end / 1000:.3f} has no length; move its end on")
    between = [stop for stop in listed if settings.calling and begin + 0.1 < stop.at < end - 0.1]
    dwells = tuple(stop.dwell if settings.dwell is None else settings.dwell for stop in between)
    return Stops((begin, *(stop.at for stop in between), end), dwells)
