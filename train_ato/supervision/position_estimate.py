"""Front position, speed and acceleration from the two odometers, with their errors."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from plant_sim.states import Odometry
from train_ato.supervision.odometry import MotionEstimate, motion_estimate, odometer_error

ACCELERATION_TIME = 1.2
"""Time over which the acceleration is averaged [s]; vibrations of a long train are shorter."""
MOVING_SPEED = 0.1
"""Speed above which the counted distance changes [m/s]."""
STEP_TOLERANCE, STEP_SHARE = 1.0, 0.05
"""Largest difference of a counted distance from the speeds at its ends [m], and its part of the distance."""


@dataclass(frozen=True, slots=True)
class TrainMotion:
    """Estimated front position [m] and speed [m/s], with the other inputs of the supervision limits."""

    stamp: int
    front: float
    speed: float
    estimate: MotionEstimate


class PositionEstimator:
    """Estimate from wheel odometer and radar; the larger one of each quantity counts.

    A sliding wheel counts too little and a slipping one too much, so the larger value is not below the true one as
    long as one of the two odometers keeps its error.  An odometer whose distances do not follow from its speeds is not
    used: a frozen one repeats its distance while it has a speed.

    Attributes
    ----------
    problem : str
        Reason of a missing estimate, "" with one.
    """

    def __init__(self) -> None:
        self._past: deque[tuple[int, float]] = deque()
        self._last: Odometry | None = None
        self.problem = ""

    def step(self, odometry: Odometry) -> TrainMotion | None:
        """Return the estimate; None if no odometer has finite, plausible values."""
        problems = [_problem(odometry, self._last, index) for index in range(odometry.speed.size)]
        plausible = [index for index, problem in enumerate(problems) if not problem]
        self.problem = "" if plausible else problems[0]
        if not plausible:
            return None
        self._last = odometry
        speeds = odometry.speed[plausible]
        speed = float(speeds[int(np.argmax(np.abs(speeds)))])
        self._past.append((odometry.stamp, speed))
        while len(self._past) > 2 and odometry.stamp - self._past[1][0] >= ACCELERATION_TIME * 1e9:
            self._past.popleft()
        before, slower = self._past[0]
        span = (odometry.stamp - before) * 1e-9
        acceleration = (speed - slower) / span if span > 0.0 else 0.0
        distance = float(odometry.since_balise[plausible].max())
        return TrainMotion(
            odometry.stamp,
            float(odometry.position[plausible].max()),
            speed,
            motion_estimate(abs(speed), acceleration, distance),
        )


def _problem(odometry: Odometry, last: Odometry | None, index: int) -> str:
    """Return the problem of one odometer as text, "" for plausible values."""
    position, speed = float(odometry.position[index]), float(odometry.speed[index])
    since = float(odometry.since_balise[index])
    if not np.isfinite([position, speed, since]).all():
        return "the odometry is not finite"
    if last is None:
        return ""
    span = (odometry.stamp - last.stamp) * 1e-9
    ends = speed * span, float(last.speed[index]) * span
    before = float(last.since_balise[index])
    tolerance = STEP_TOLERANCE + STEP_SHARE * max(abs(ends[0]), abs(ends[1]))
    if since < before:
        tolerance += odometer_error(before)  # a balise has corrected the position
    moved = position - float(last.position[index])
    if not min(ends) - tolerance <= moved <= max(ends) + tolerance:
        return f"the odometry moved by {moved:.1f} m in {span:.1f} s at {speed * 3.6:.1f} km/h"
    if since == before and abs(speed) > MOVING_SPEED:
        return f"the odometry is frozen at {speed * 3.6:.1f} km/h"
    return ""
