"""Front position, speed and acceleration from the two odometers, with their errors."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, nan
from typing import Any, NamedTuple, Protocol

from plant_sim.compiled import compiled
from plant_sim.odometry import OdometryReading
from plant_sim.record import Records, quantity, zeros
from train_ato.supervision.odometry import MotionEstimate, odometer_error, speed_measurement_error

ACCELERATION_TIME = 1.2
"""Time over which an acceleration is averaged [s]; vibrations of a long train are shorter."""
LONGEST = 1204
"""Number of kept speeds, more than there are steps of 1 ms in the time of the average."""


@dataclass
class PastSpeed:
    """Speed at an earlier step."""

    stamp: int = quantity("ns", "time")
    speed: float = quantity("m/s", "estimated speed")


def past_speeds() -> Any:
    """Return the records of the speeds of an average, used in turn."""
    return zeros(PastSpeed, LONGEST)


class Averaged(Protocol):
    """Record of the part of :class:`PastSpeed` records that an average has."""

    first: int
    count: int


@compiled
def add_speed(own: Averaged, past: Records[PastSpeed], stamp: int, speed: float) -> PastSpeed:
    """Add a speed [m/s] at a time [ns]; return the first one of the average, at most two or its time before."""
    if own.count == past.size:
        own.first, own.count = (own.first + 1) % past.size, own.count - 1
    newest = past[(own.first + own.count) % past.size]
    newest.stamp, newest.speed = stamp, speed
    own.count += 1
    while own.count > 2 and stamp - past[(own.first + 1) % past.size].stamp >= ACCELERATION_TIME * 1e9:
        own.first, own.count = (own.first + 1) % past.size, own.count - 1
    return past[own.first]


class TrainMotion(NamedTuple):
    """Estimated front position [m] and speed [m/s], with the other inputs of the supervision limits."""

    stamp: int
    front: float
    speed: float
    estimate: MotionEstimate


@dataclass
class MotionRecord:
    """Estimated motion, and the speeds of its averaged acceleration."""

    stamp: int = quantity("ns", "time")
    front: float = quantity("m", "estimated front position")
    speed: float = quantity("m/s", "estimated speed")
    acceleration: float = quantity("m/s²", "estimated acceleration")
    speed_error: float = quantity("m/s", "error of the speed")
    position_error: float = quantity("m", "error of the front position, ahead and behind")
    first: int = quantity("", "first speed of the averaged acceleration")
    count: int = quantity("", "number of its speeds")


@compiled
def estimate_motion(own: MotionRecord, past: Records[PastSpeed], odometry: OdometryReading) -> bool:
    """Estimate the motion from wheel odometer and radar; return False, without a change, if one is not finite.

    The larger one of each quantity counts. A sliding wheel counts too little and a slipping one too much, so the larger
    value is not below the true one as long as one of the two odometers keeps its error.
    """
    for index in range(2):
        if not (isfinite(odometry.position[index]) and isfinite(odometry.speed[index])):
            return False
        if not isfinite(odometry.since_balise[index]):
            return False
    wheel, radar = odometry.speed[0], odometry.speed[1]
    speed = radar if abs(radar) > abs(wheel) else wheel
    before = add_speed(own, past, odometry.stamp, speed)
    span = (odometry.stamp - before.stamp) * 1e-9
    own.acceleration = (speed - before.speed) / span if span > 0.0 else 0.0
    own.stamp, own.speed, own.front = odometry.stamp, speed, max(odometry.position[0], odometry.position[1])
    own.speed_error = speed_measurement_error(speed)
    own.position_error = odometer_error(max(odometry.since_balise[0], odometry.since_balise[1]))
    return True


@compiled
def motion_of(own: MotionRecord) -> MotionEstimate:
    """Return the input of the supervision limits."""
    return MotionEstimate(own.acceleration, own.speed_error, own.position_error, own.position_error, nan)
