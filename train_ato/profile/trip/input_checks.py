"""Checks of line, train and settings before the search of a trip: ends, sections, reductions."""

from __future__ import annotations

from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.control.train_model import TrainModel
from train_ato.profile.trip.settings import TripSettings


def journey_ends(line: Line, settings: TripSettings, half: float) -> tuple[float, float]:
    """Return begin and stop of vehicle 0's centre [m].

    Raises
    ------
    ValueError
        If they are not on the line.
    """
    stops = [stop.at for stop in line.stops]
    end = settings.end if settings.end is not None else (stops[-1] if stops else line.end)
    begin = settings.begin - half if settings.begin is not None else line.begin
    if not line.begin <= begin < end - half - 1000.0 or end > line.end:
        raise ValueError(
            f"begin, end: km {(begin + half) / 1e3:.3f} to km {end / 1e3:.3f}: not 1 km or more on line '{line.name}' "
            f"(km {line.begin / 1e3:.3f} to km {line.end / 1e3:.3f}); correct them"
        )
    return begin, end - half


def check_final_part(model: TrainModel, begin: float, stop: float) -> None:
    """Check that the electric brake of every unit works in the last part of the braking.

    Parameters
    ----------
    model
        Nominal train on its line.
    begin, stop
        Places of vehicle 0's centre at the begin of the last part and at the stop [m].

    Raises
    ------
    ValueError
        With the key of the line and the place of the first section without electric brake.
    """
    line, vehicles = model.line, model.consist.vehicles
    for unit, offset in zip(model.units, model.offsets.tolist(), strict=True):
        for number, section in enumerate(line.neutral_sections):
            if section.electric_brake or vehicles[unit].independent_power:
                continue
            if section.begin < stop - offset and section.end > begin - offset:
                raise ValueError(
                    f"line '{line.name}': neutral_sections[{number}]: km {section.begin / 1e3:.3f} to km "
                    f"{section.end / 1e3:.3f}: the train brakes there to its stop, without electric brake; move end"
                )


def permitted_reductions(consist: Consist, settings: TripSettings) -> tuple[float, ...]:
    """Return the reductions of the brake pipe that a plan may use [Pa]; none without an air brake.

    Raises
    ------
    ValueError
        If one is beyond the table of the train.
    """
    brake = consist.air_brake
    if brake is None:
        return ()
    for reduction in settings.air_brake.reductions:
        if not 0.0 < reduction <= brake.reduction[-1]:
            raise ValueError(
                f"air_brake.reductions: {reduction / 1e3:g} kPa: not in the table of train '{consist.name}' (up to "
                f"{brake.reduction[-1] / 1e3:g} kPa); correct it"
            )
    return settings.air_brake.reductions or (brake.reduction[-1],)
