"""Comparison of the measurement of the ATO with the odometry of the supervisor."""

from __future__ import annotations

import math

from train_ato.messages.types import Measurement, SupervisedSpeeds
from train_ato.supervision.odometry import speed_measurement_error
from train_ato.supervision.settings import SupervisionSpec


class MeasurementCheck:
    """Detects a frozen, biased or invalid measurement that every law would follow.

    Parameters
    ----------
    spec
        Largest differences beyond the errors of the odometry, and their duration.
    front_offset
        Distance of the front from the measured point of the first power unit [m].
    """

    def __init__(self, spec: SupervisionSpec, front_offset: float) -> None:
        self._spec, self._front_offset = spec, front_offset
        self._since: int | None = None

    def step(self, measurement: Measurement, speeds: SupervisedSpeeds) -> str:
        """Return the difference that has lasted for the time of confirmation as text, "" without one."""
        difference = self._difference(
            float(measurement.position[0]) + self._front_offset, float(measurement.velocity[0]), speeds
        )
        if not difference:
            self._since = None
            return ""
        if self._since is None:
            self._since = measurement.stamp
        return difference if measurement.stamp - self._since >= self._spec.confirmation * 1e9 else ""

    def _difference(self, front: float, speed: float, speeds: SupervisedSpeeds) -> str:
        """Return the implausible difference of front position [m] and speed [m/s] as text, "" without one."""
        if not (math.isfinite(front) and math.isfinite(speed)):
            return "the measurement is not finite"
        expected, estimate, foremost = float(speeds.speed[0]), float(speeds.position[0]), float(speeds.position[1])
        if abs(speed - expected) > self._spec.speed_difference + speed_measurement_error(expected):
            return f"measured {speed * 3.6:.1f} km/h, odometry {expected * 3.6:.1f} km/h"
        if abs(front - estimate) > self._spec.position_difference + foremost - estimate:
            return f"measured front at {front:.0f} m, odometry {estimate:.0f} m"
        return ""
