"""Confidence of position and speed: SUBSET-041, 5.3.1, as used in SUBSET-026, 3.13.9."""

from dataclasses import dataclass
from math import isfinite, nan
from typing import Any, NamedTuple

from plant_sim.compiled import also_compiled, compiled
from plant_sim.odometry import OdometryReading, write_reading
from plant_sim.record import Records, quantity, zeros
from plant_sim.states import Odometry
from plant_sim.units import KMH

# mypy: allow-untyped-decorators


POSITION_OFFSET, POSITION_SHARE = 5.0, 0.05
"""Position error [m], and its part of the distance since the last balise: SUBSET-041, 5.3.1.1."""
SPEED_ERROR, SPEED_KNEE, SPEED_ERROR_TOP, SPEED_TOP = 2.0, 30.0, 12.0, 500.0
"""Speed error up to the knee, and linear from there to the top speed [km/h]: SUBSET-041, 5.3.1.2."""


@also_compiled
def odometer_error(distance: float, balise_accuracy: float = 0.0) -> float:
    """Return the largest error of the position [m] at a distance since the last balise [m].

    Parameters
    ----------
    distance
        Distance since the last balise [m].
    balise_accuracy
        Accuracy of the location of the balise (Q_LOCACC) [m].
    """
    return balise_accuracy + POSITION_OFFSET + POSITION_SHARE * abs(distance)


@also_compiled
def speed_measurement_error(speed: float) -> float:
    """Return the largest error of a measured speed [m/s], function f41 of SUBSET-026."""
    slope = (SPEED_ERROR_TOP - SPEED_ERROR) / (SPEED_TOP - SPEED_KNEE)
    return (SPEED_ERROR + slope * max(abs(speed) * KMH - SPEED_KNEE, 0.0)) / KMH


class MotionEstimate(NamedTuple):
    """Estimate of the motion at one time, input of the supervision limits.

    Attributes
    ----------
    acceleration : float
        Estimated acceleration [m/s²]; the limits use it, if it is above 0, during the traction time (``A_est1``).
    speed_error : float
        Speed under-reading amount ``V_ura`` [m/s]; 0 if its compensation is inhibited.
    under_reading, over_reading : float
        Distance from the estimated front to the max safe front and to the min safe front [m].
    later_acceleration : float
        Acceleration after the traction time [m/s²] (``A_est2``), used from 0 to 0.4 m/s²; NaN: the same.
    """

    acceleration: float = 0.0
    speed_error: float = 0.0
    under_reading: float = 0.0
    over_reading: float = 0.0
    later_acceleration: float = nan


EXACT_MOTION = MotionEstimate()
"""Exact odometry and no acceleration."""


def motion_estimate(speed: float, acceleration: float, distance: float, balise_accuracy: float = 0.0) -> MotionEstimate:
    """Return the estimate with the largest errors permitted by SUBSET-041.

    Parameters
    ----------
    speed, acceleration
        Measured speed [m/s] and acceleration [m/s²].
    distance, balise_accuracy
        As in :func:`odometer_error`.
    """
    error = odometer_error(distance, balise_accuracy)
    return MotionEstimate(acceleration, speed_measurement_error(speed), error, error)


ACCELERATION_TIME = 1.2
"""Time over which an acceleration is averaged [s]; vibrations of a long train are shorter."""
MAX_SPEEDS = 1204
"""Number of kept speeds, more than there are steps of 1 ms in the time of the average."""


@dataclass
class PastSpeed:
    """Speed at an earlier step."""

    stamp: int = quantity("ns", "time")
    speed: float = quantity("m/s", "estimated speed")


def past_speeds() -> Any:
    """Return the records of the speeds of an average, used in turn."""
    return zeros(PastSpeed, MAX_SPEEDS)


@compiled
def add_speed(own: Any, past: Records[PastSpeed], stamp: int, speed: float) -> PastSpeed:
    """Add a speed [m/s] at a time [ns]; return the first one of the average, at most two or its time before.

    ``own.first`` and ``own.count`` are the part of the records that the average has.
    """
    if own.count == past.size:
        own.first, own.count = (own.first + 1) % past.size, own.count - 1
    newest = past[(own.first + own.count) % past.size]
    newest.stamp, newest.speed = stamp, speed
    own.count += 1
    while own.count > 2 and stamp - past[(own.first + 1) % past.size].stamp >= ACCELERATION_TIME * 1e9:
        own.first, own.count = (own.first + 1) % past.size, own.count - 1
    return past[own.first]


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


# mypy: no-warn-return-any


MOVING_SPEED = 0.1
"""Speed above which the counted distance changes [m/s]."""
STEP_TOLERANCE, STEP_SHARE = 1.0, 0.05
"""Largest difference of a counted distance from the speeds at its ends [m], and its part of the distance."""
PLAUSIBLE, MOVED, FROZEN = range(3)
"""Results of :func:`odometer_problem`."""


@compiled
def odometer_problem(now: OdometryReading, last: OdometryReading, index: int) -> int:
    """Return the problem of one odometer: a distance that its speeds do not give, or none at a speed."""
    span, speed = (now.stamp - last.stamp) * 1e-9, now.speed[index]
    since, before = now.since_balise[index], last.since_balise[index]
    end, begin = speed * span, last.speed[index] * span
    tolerance = STEP_TOLERANCE + STEP_SHARE * max(abs(end), abs(begin))
    if since < before:
        tolerance += odometer_error(before)  # a balise has corrected the position
    moved = now.position[index] - last.position[index]
    if not min(end, begin) - tolerance <= moved <= max(end, begin) + tolerance:
        return MOVED
    return FROZEN if since == before and abs(speed) > MOVING_SPEED else PLAUSIBLE


@compiled
def odometry_problem(now: OdometryReading, last: OdometryReading) -> int:
    """Return the problem of the wheel odometer if the radar has one too.

    One of the two odometers may be wrong, for example that of a sliding wheel: the larger value counts.
    """
    found = odometer_problem(now, last, 0)
    return found if odometer_problem(now, last, 1) != PLAUSIBLE else PLAUSIBLE


@compiled
def _problem(now: Any, last: Any) -> int:
    return odometry_problem(now[0], last[0])


class OdometryCheck:
    """Detects frozen and foreign odometry, from the last plausible one.

    Attributes
    ----------
    last : Array of :class:`plant_sim.odometry.OdometryReading`, shape (1,)
        Last plausible odometry; its stamp is negative before the first.
    """

    def __init__(self) -> None:
        self.last, self._now = zeros(OdometryReading, 1), zeros(OdometryReading, 1)
        self.last["stamp"] = -1

    def problem(self, odometry: Odometry) -> str:
        """Return the problem of an odometry as text, "" if one of its odometers is plausible."""
        write_reading(self._now, odometry)
        found = _problem(self._now, self.last) if self.last["stamp"][0] >= 0 else PLAUSIBLE
        if found == PLAUSIBLE:
            self.last[:] = self._now
            return ""
        now, last = self._now[0], self.last[0]
        speed = f"{now['speed'].item(0) * 3.6:.1f} km/h"
        if found == FROZEN:
            return f"frozen at {speed}"
        moved = now["position"].item(0) - last["position"].item(0)
        return f"moved by {moved:.1f} m in {(now['stamp'] - last['stamp']) * 1e-9:.1f} s at {speed}"
