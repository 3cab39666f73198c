"""Windows of timing points as times of a journey: one window for every point, and the message of a lost one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from train_ato.profile.planner.time_windows import TimedPlace
from train_ato.profile.planner.timing_points import TimeWindow, TimingPoint

WINDOW_TOLERANCE = 0.05
"""Time by which a window may be missed because of rounding [s]."""


@dataclass(frozen=True, slots=True)
class Lateness:
    """A window that cannot be kept: label of the point, name of the window, its time and the earliest possible [s]."""

    label: str
    window: str
    latest: float
    possible: float

    def __str__(self) -> str:
        return (
            f"timing point {self.label}: latest {self.window} {self.latest:.1f} s cannot be kept, the earliest is "
            f"{self.possible:.1f} s; add {self.possible - self.latest:.1f} s"
        )


def timed_place(point: TimingPoint, final: TimingPoint) -> TimedPlace:
    """Return the single window of a timing point, that of its departure, of passing, or of the last arrival.

    Raises
    ------
    ValueError
        If dwell time and windows of a stop contradict each other.
    """
    if not point.stops and point is not final:
        window = point.passing or TimeWindow()
        return TimedPlace(point.at, window.earliest or 0.0, _or_never(window.latest))
    arrival, departure = point.arrival or TimeWindow(), point.departure or TimeWindow()
    if point is final:
        return TimedPlace(point.at, arrival.earliest or 0.0, _or_never(arrival.latest))
    dwell = point.dwell or 0.0
    after = departure.earliest or 0.0
    dwell = max(dwell, after - _or_never(arrival.latest))
    earliest = max(after, (arrival.earliest or 0.0) + dwell)
    latest = min(_or_never(departure.latest), _or_never(arrival.latest) + dwell)
    if earliest > latest + WINDOW_TOLERANCE:
        raise ValueError(
            f"timing point {point.label}: with a dwell time of {dwell:.1f} s the earliest departure is {earliest:.1f} "
            f"s, the latest {latest:.1f} s; widen its windows or reduce the dwell time"
        )
    return TimedPlace(point.at, earliest, latest, dwell, after)


def lateness_at(point: TimingPoint, place: TimedPlace, time: float, is_last: bool) -> Lateness:
    """Return the exceeded window of a point; of a stop its arrival, if that is the narrower one."""
    if not point.stops and not is_last:
        return Lateness(point.label, "passing", place.latest, time)
    departure = point.departure or TimeWindow()
    if not is_last and departure.latest is not None and departure.latest <= place.latest:
        return Lateness(point.label, "departure", place.latest, time)
    return Lateness(point.label, "arrival", place.latest - place.dwell, time - place.dwell)


def _or_never(time: float | None) -> float:
    return np.inf if time is None else time
