"""Stops of a run: place, arrival and delay of every stop of the profile."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from train_ato.judge.recording import Recording
from train_ato.messages.types import Array
from train_ato.profile.profile import Profile
from train_ato.scenario.setup import RunSetup

STANDSTILL_SPEED = 0.01
"""Speed below which a train or a reference is at rest [m/s]."""
MIN_DWELL = 2.0
"""Minimum dwell time of a stop; a shorter rest of the reference is a change of direction [s]."""

EARLY_DEPARTURE = 1.0
"""Time before the departure of the reference at which a train must still be at rest [s]."""
MAX_OFF = 0.01
"""Largest distance from a stop at which a reference at rest is at the stop [m]."""
MAX_EARLY_DEPARTURE = 10.0
"""Time before the departure of the reference from which on a rest that ends is that at the stop [s]."""


@dataclass(frozen=True)
class PlannedStop:
    """Stop of a profile: position of vehicle 0's centre [m], arrival and departure [s]; the last departure is inf."""

    position: float
    arrival: float
    departure: float


@dataclass(frozen=True)
class StopResult:
    """Stop of a run.

    Attributes
    ----------
    front : float
        Target of the front [m].
    planned : float
        Arrival by the profile [s].
    error : float or None
        Front minus target at rest [m]; None without standstill.
    arrival : float or None
        Begin of the standstill [s]; None without standstill.
    direction : float
        1 for a run in the direction of the line, -1 against it.
    """

    front: float
    planned: float
    error: float | None
    arrival: float | None
    direction: float

    def as_row(self) -> dict[str, float | None]:
        """Return the row of ``stops`` in ``summary.json``; ``beyond_m`` is > 0 beyond the target."""
        return {
            "km": self.front / 1e3,
            "planned_s": self.planned,
            "arrival_s": self.arrival,
            "delay_s": None if self.arrival is None else self.arrival - self.planned,
            "beyond_m": None if self.error is None else self.direction * self.error,
        }


def planned_stops(profile: Profile) -> list[PlannedStop]:
    """Return the stops of a profile: rests of at least 2 s after a motion, and the end at rest."""
    resting = np.abs(profile.velocity) < STANDSTILL_SPEED
    edges = np.flatnonzero(np.diff(resting.astype(np.int8)))
    begins = [int(row) + 1 for row in edges if not resting[row]]
    found = []
    for begin in begins:
        later = edges[edges >= begin]
        ends = float(profile.time[later[0]]) if later.size else np.inf
        arrival = float(profile.time[begin])
        if ends - arrival >= MIN_DWELL:
            middle = (begin + int(later[0])) // 2 if later.size else -1
            found.append(PlannedStop(float(profile.position[middle]), arrival, ends))
    return found


def stops_of_run(setup: RunSetup, recording: Recording) -> list[StopResult]:
    """Return the stops with a planned arrival within the run, in their order."""
    return list(_results(setup, recording)) if recording.time.size else []


def _results(setup: RunSetup, recording: Recording) -> Iterator[StopResult]:
    time, speed = recording.time, np.abs(recording.front_velocity)
    half, end = setup.consist.vehicles[0].length / 2, float(time[-1]) + setup.tick
    for stop in planned_stops(setup.profile):
        if stop.arrival >= end:
            return
        before = setup.profile.at(stop.arrival - 1.0)[1]
        if setup.scenario.leader is not None and setup.scenario.leader.headway is not None:
            stop = _delayed(stop, recording)
        if stop.departure >= end:
            position, final_speed = recording.final
            rows = time.size
        else:
            rows = _rows_to_departure(time, speed, stop)
            position, final_speed = float(recording.front_position[rows - 1]), float(speed[rows - 1])
        at_rest = abs(final_speed) < STANDSTILL_SPEED
        yield StopResult(
            front=stop.position + half,
            planned=stop.arrival,
            error=position - stop.position if at_rest else None,
            arrival=_begin_of_rest(time, speed[:rows]) if at_rest else None,
            direction=-1.0 if before < 0 else 1.0,
        )


def _delayed(stop: PlannedStop, recording: Recording) -> PlannedStop:
    """Return a stop with the departure of the reference if it is later than planned, as behind a late train."""
    at_rest = np.abs(recording.reference_velocity) < STANDSTILL_SPEED
    at_rest &= np.abs(recording.reference_position - stop.position) < MAX_OFF
    rows = np.flatnonzero(at_rest & (recording.time >= stop.arrival))
    if not rows.size:
        return stop
    last = float(recording.time[rows[np.flatnonzero(np.diff(rows, append=rows[-1] + 2) > 1)[0]]])
    return replace(stop, departure=last) if last > stop.departure + EARLY_DEPARTURE else stop


def _rows_to_departure(time: Array, speed: Array, stop: PlannedStop) -> int:
    """Return the number of rows up to the departure of the train from a stop, without a rest there to the planned one.

    A law with a preview departs before the reference moves, and may halt once more within this time.
    """
    rows = max(int(np.searchsorted(time, stop.departure - EARLY_DEPARTURE, side="right")), 1)
    planned = int(np.searchsorted(time, stop.departure, side="right"))
    if left := _end_of_rest(time, speed[:planned], max(stop.arrival, stop.departure - MAX_EARLY_DEPARTURE)):
        return min(rows, left)
    return rows if speed[rows - 1] < STANDSTILL_SPEED else planned


def _end_of_rest(time: Array, speed: Array, earliest: float) -> int:
    """Return the row behind the last rest of at least 2 s that ends after a time [s]; 0 without one."""
    edges = np.flatnonzero(np.diff(speed < STANDSTILL_SPEED, prepend=False, append=False))
    begins, ends = edges[::2], edges[1::2]
    found = ends[(time[ends - 1] - time[begins] >= MIN_DWELL) & (time[ends - 1] >= earliest)]
    return int(found[-1]) if found.size else 0


def _begin_of_rest(time: Array, speed: Array) -> float:
    """Return the first time after the last motion [s]."""
    moving = np.flatnonzero(speed >= STANDSTILL_SPEED)
    return float(time[min(int(moving[-1]) + 1, time.size - 1)]) if moving.size else float(time[0])


def running_time(setup: RunSetup, recording: Recording, stops: list[StopResult]) -> float | None:
    """Return the time from the first motion of the train to the arrival at the last stop of the profile [s].

    None before the arrival, and without a stop at the end of the profile.
    """
    planned = planned_stops(setup.profile)
    moving = np.flatnonzero(np.abs(recording.front_velocity) > STANDSTILL_SPEED)
    if not moving.size or not planned or len(stops) < len(planned) or stops[-1].arrival is None:
        return None
    return stops[-1].arrival - float(recording.time[moving[0]])
