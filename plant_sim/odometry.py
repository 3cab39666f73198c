"""Odometry of the supervisor: a wheel odometer, a radar and balises as fixed points.

It is independent of the sensors of the ATO, so that a frozen or biased measurement of the ATO does not reach the
supervisor. Wheel and radar have a constant relative error each, drawn once per run from the seed; wheel slip and slide
of the first power unit act on the wheel odometer too.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plant_sim.plant_setup import OdometrySpec, WheelSlip
from plant_sim.states import Odometry
from plant_sim.streams import random_stream


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
        draws = random_stream(seed, "odometry").uniform(-1.0, 1.0, 2)
        self._factors = 1.0 + draws * np.array([spec.wheel_error, spec.radar_error])
        self._slips = tuple(slip for slip in slips if slip.unit == 0)
        self._front = self._origin = front
        self._counted = np.zeros(2)
        self._since = np.zeros(2)

    def observe(self, stamp: int, front: float, speed: float) -> Odometry:
        """Return the odometry for a true front position [m] and speed [m/s].

        Parameters
        ----------
        stamp
            Time [ns]; the slips at this time act on the distance since the last call.
        front, speed
            True front position [m] and speed [m/s].
        """
        factors = self._factors * np.array([1.0 + self._slip(stamp * 1e-9), 1.0])
        moved = front - self._front
        balise = self._spacing * np.floor(front / self._spacing)
        if moved > 0.0 and balise > self._front:
            self._origin = float(balise)
            self._counted = (front - self._origin) * factors
            self._since = self._counted.copy()
        else:
            self._counted = self._counted + moved * factors
            self._since = self._since + abs(moved) * factors
        self._front = front
        return Odometry(stamp, self._origin + self._counted, speed * factors, self._since.copy())

    def _slip(self, time: float) -> float:
        """Return the slip at a time [s]."""
        return sum(slip.slip for slip in self._slips if slip.begin <= time < slip.end)
