"""Odometry of the supervisor: a wheel odometer, a radar and balises as fixed points.

It is independent of the sensors of the ATO, so that a frozen or biased measurement of the ATO does not reach the
supervisor. Wheel and radar have a constant relative error each, drawn once per run from the seed; wheel slip and slide
of the first power unit act on the wheel odometer too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from plant_sim.plant_setup import OdometrySpec, WheelSlip
from plant_sim.states import Odometry
from plant_sim.streams import random_stream
from plant_sim.summation import plain_sum


class Odometers:
    """Wheel odometer and radar of a train, set to the location of every balise that the front passes.

    Parameters
    ----------
    spec
        Errors and balises.
    slips
        Wheel slips of the first power unit.
    front
        Front position at the start [m], known exactly.
    seed
        Seed of the run.
    """

    def __init__(self, spec: OdometrySpec, slips: Sequence[WheelSlip], front: float, seed: int) -> None:
        self._spacing = spec.balise_spacing
        wheel, radar = random_stream(seed, "odometry").uniform(-1.0, 1.0, 2).tolist()
        self._wheel, self._radar = 1.0 + wheel * spec.wheel_error, 1.0 + radar * spec.radar_error
        self._slips = tuple(slip for slip in slips if slip.unit == 0)
        self._front = self._origin = front
        self._counted = self._since = (0.0, 0.0)

    def move(self, stamp: int, front: float) -> None:
        """Count the distance to a true front position [m] with the slips at a time [ns]."""
        wheel, radar = self._factors(stamp)
        moved = front - self._front
        balise = self._spacing * math.floor(front / self._spacing)
        if moved > 0.0 and balise > self._front:
            self._origin = balise
            self._counted = self._since = (front - balise) * wheel, (front - balise) * radar
        else:
            (counted, other), (since, since_other) = self._counted, self._since
            self._counted = counted + moved * wheel, other + moved * radar
            self._since = since + abs(moved) * wheel, since_other + abs(moved) * radar
        self._front = front

    def observe(self, stamp: int, speed: float) -> Odometry:
        """Return the odometry at the present front position for a true speed [m/s] at a time [ns]."""
        wheel, radar = self._factors(stamp)
        position = self._origin + self._counted[0], self._origin + self._counted[1]
        return Odometry(stamp, np.array(position), np.array((speed * wheel, speed * radar)), np.array(self._since))

    def _factors(self, stamp: int) -> tuple[float, float]:
        """Return the ratios of counted to true distance at a time [ns]: wheel, with its slip, and radar."""
        if not self._slips:
            return self._wheel, self._radar
        time = stamp * 1e-9
        slip = plain_sum(slip.slip for slip in self._slips if slip.begin <= time < slip.end)
        return self._wheel * (1.0 + slip), self._radar
