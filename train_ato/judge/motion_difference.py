"""Difference of two driven motions over time and place, at the stops, and of the energy."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant_sim.formats.fields import print_assumption
from plant_sim.line import Line
from train_ato.judge.metrics import front_of_train
from train_ato.judge.recording import Recording
from train_ato.judge.typed_result import StopOfRun, TypedResult
from train_ato.messages.types import Array

STOP_COLUMNS = ("km", "arrival_s", "second_arrival_s", "difference_arrival_s", "difference_stop_m")
MIN_STEP = 1e-3
"""Smallest distance of the places [m]; a smaller one has more of them than the memory."""
ENERGY = {"energy_traction_kwh": "traction energy", "energy_regenerated_kwh": "regenerated energy"}


@dataclass(frozen=True)
class DrivenMotion:
    """DrivenMotion of one run at its k ticks, with its metrics.

    Attributes
    ----------
    time, front, speed, force : Array, shape (k,)
        Time [s], place of the front [m], speed [km/h], force of all power units [kN].
    metrics : dict
        Metrics of the run.
    measured : bool
        The run was measured and has no targets.
    on : Line or None
        Line, for its posts.
    """

    time: Array
    front: Array
    speed: Array
    force: Array
    metrics: dict[str, Any]
    measured: bool = False
    on: Line | None = None

    @classmethod
    def of(cls, recording: Recording, metrics: dict[str, Any]) -> "DrivenMotion | None":
        """Return the motion of a recording; None without a tick or without the length of its first vehicle."""
        if recording.setup is None or not recording.time.size:
            return None
        front = front_of_train(recording.setup, recording)
        force = recording.applied.sum(axis=1) / 1e3
        speed, on = 3.6 * recording.front_velocity, recording.setup.line
        return cls(recording.time, front, speed, force, metrics, recording.measured_only, on)


@dataclass(frozen=True)
class MotionDifference:
    """Second motion minus first motion; arrays of the columns of ``RunDifference``."""

    time: Array
    over_time: dict[str, Array]
    place: Array
    over_place: dict[str, Array]
    stops: list[dict[str, float | None]]
    energy: dict[str, float | None]
    on: Line | None = None

    @property
    def line(self) -> str:
        """Largest differences in one line, and those of the energy."""
        speed, late = np.abs(self.over_place["speed_kmh"]), np.abs(self.over_place["time_s"])
        energy = [f"{ENERGY[key]} by {value:+.3g} kWh" for key, value in self.energy.items() if value is not None]
        text = "; ".join(
            [
                f"speed differs by up to {speed.max():.3g} km/h, at km {self.place[speed.argmax()] / 1e3:.3f}",
                f"time at a place by up to {late.max():.3g} s, at km {self.place[late.argmax()] / 1e3:.3f}",
                *energy,
            ]
        )
        return self.on.with_posts(text) if self.on else text

    @property
    def posts(self) -> list[str] | None:
        """Posts of the stops; None for a line without a chainage."""
        return (
            [self.on.post_at(1e3 * (row["km"] or 0.0)) for row in self.stops] if self.on and self.on.chainage else None
        )


def motion_difference(first: DrivenMotion, second: DrivenMotion, *, step: float = 1.0) -> MotionDifference:
    """Return the difference of two motions; see :func:`train_ato.difference`."""
    if not step >= MIN_STEP:
        raise ValueError(f"step {step:g}: out of range; give {MIN_STEP:g} m or more")
    time = first.time[(first.time >= second.time[0]) & (first.time <= second.time[-1])]
    begin, end = max(first.front.min(), second.front.min()), min(first.front.max(), second.front.max())
    if not time.size or begin > end:
        shared = "time" if not time.size else "place"
        raise ValueError(f"{first.metrics.get('scenario')}, {second.metrics.get('scenario')}: no common {shared}")
    names = [motion.on.name if motion.on else "" for motion in (first, second)]
    if names[0] != names[1]:
        print_assumption(f"runs on two lines, '{names[0]}' and '{names[1]}': compared at equal kilometres")
    place = np.arange(begin, end + step / 2, step)
    passed = [_first_passing(motion.front, motion.time, place) for motion in (first, second)]
    speeds = [np.interp(at, motion.time, motion.speed) for at, motion in zip(passed, (first, second), strict=True)]
    columns = {
        "speed_kmh": (first.speed, second.speed),
        "position_m": (first.front, second.front),
        "force_kn": (first.force, second.force),
    }
    over_time = {
        name: np.interp(time, second.time, b) - np.interp(time, first.time, a) for name, (a, b) in columns.items()
    }
    over_place = {"speed_kmh": speeds[1] - speeds[0], "time_s": passed[1] - passed[0]}
    energy = {key: _minus(second.metrics.get(key), first.metrics.get(key)) for key in ENERGY}
    return MotionDifference(time, over_time, place, over_place, _stops(first, second), energy, first.on)


def _first_passing(front: Array, time: Array, place: Array) -> Array:
    """Return the times at which the front of a train is first at each place [s]; it runs forward or back."""
    found = []
    for sign in (1.0, -1.0):
        farthest = np.maximum.accumulate(sign * front)
        new = np.diff(farthest, prepend=-np.inf) > 0
        found.append(np.interp(sign * place, farthest[new], time[new]))
    return np.where(place >= front[0], *found)


def _minus(second: float | None, first: float | None) -> float | None:
    """Return a difference; None without one of its values."""
    return None if second is None or first is None else second - first


NEAR_KM = 1e-3
"""Largest distance of the targets of one stop in two runs [km]."""
STANDS_M, STANDS_KMH = 50.0, 0.5
"""Largest distance from the target of another run, and largest speed, of a standstill without a target of its own."""


def _standstills(motion: DrivenMotion, others: Sequence[StopOfRun]) -> list[StopOfRun]:
    """Return the standstills of a measured motion at the targets of another run; nothing for a simulated one."""
    found = []
    begin = int(np.argmax(np.abs(motion.speed) > STANDS_KMH))  # the rest before the first motion is no stop
    for stop in others if motion.measured else ():
        beyond = motion.front - 1e3 * stop.km
        far = np.abs(beyond) > STANDS_M
        stands = begin + np.flatnonzero(~far[begin:] & (np.abs(motion.speed[begin:]) <= STANDS_KMH))
        if stands.size:
            away = np.cumsum(far)
            stands = stands[away[stands] == away[stands[0]]]  # up to the departure: a train can come back
            begin = int(stands[-1]) + 1
            arrival = float(motion.time[stands[0]])
            found.append(StopOfRun(stop.km, stop.planned_s, arrival, None, float(beyond[stands[-1]])))
    return found


def _stops(first: DrivenMotion, second: DrivenMotion) -> list[dict[str, float | None]]:
    """Return the stops of either run by place, with the differences of arrival and error."""
    own, other = TypedResult.of(first.metrics).stops, TypedResult.of(second.metrics).stops
    own, other = own or tuple(_standstills(first, other)), other or tuple(_standstills(second, own))
    left = list(other)
    pairs: list[tuple[StopOfRun | None, StopOfRun | None]] = []
    for one in own:  # a train that runs back stops twice at one place
        same = next((stop for stop in left if abs(one.km - stop.km) <= NEAR_KM), None)
        left = [stop for stop in left if stop is not same]
        pairs.append((one, same))
    rows = []
    for a, b in (*pairs, *((None, stop) for stop in left)):
        arrivals = [None if stop is None else stop.arrival_s for stop in (a, b)]
        errors = [None if stop is None else stop.beyond_m for stop in (a, b)]
        km = next(stop.km for stop in (a, b) if stop is not None)
        values = (km, *arrivals, _minus(arrivals[1], arrivals[0]), _minus(errors[1], errors[0]))
        rows.append(dict(zip(STOP_COLUMNS, values, strict=True)))
    return sorted(rows, key=lambda row: row["km"] or 0.0)
