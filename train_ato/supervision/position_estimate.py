"""Front position, speed and acceleration from the two odometers, with their errors."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from plant_sim.states import Odometry
from train_ato.supervision.odometry import MotionEstimate, motion_estimate

ACCELERATION_TIME = 1.2
"""Time over which the acceleration is averaged [s]; vibrations of a long train are shorter."""


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
    long as one of the two odometers keeps its error.
    """

    def __init__(self) -> None:
        self._past: deque[tuple[int, float]] = deque()

    def step(self, odometry: Odometry) -> TrainMotion | None:
        """Return the estimate; None if the odometry is not finite."""
        positions, speeds = odometry.position.tolist(), odometry.speed.tolist()
        distances = odometry.since_balise.tolist()
        if not all(map(math.isfinite, (*positions, *speeds, *distances))):
            return None
        speed = max(speeds, key=abs)
        self._past.append((odometry.stamp, speed))
        while len(self._past) > 2 and odometry.stamp - self._past[1][0] >= ACCELERATION_TIME * 1e9:
            self._past.popleft()
        before, slower = self._past[0]
        span = (odometry.stamp - before) * 1e-9
        acceleration = (speed - slower) / span if span > 0.0 else 0.0
        estimate = motion_estimate(abs(speed), acceleration, max(distances))
        return TrainMotion(odometry.stamp, max(positions), speed, estimate)
