"""Comparison of the measurement of the ATO with the odometry of the supervisor."""

from dataclasses import dataclass
from math import isfinite

from plant_sim.compiled import compiled
from plant_sim.record import Records, fill, quantity, zeros
from train_ato.messages.types import Measurement, SupervisedSpeeds
from train_ato.supervision.odometry import speed_measurement_error
from train_ato.supervision.settings import SupervisionSpec

PLAUSIBLE, NOT_FINITE, OTHER_SPEED, OTHER_PLACE = range(4)
"""Results of :func:`difference`."""


@dataclass
class CheckConstants:
    """Largest differences, and the place of the measured point."""

    speed_difference: float = quantity("m/s", "largest difference of the speed beyond the error of the odometry")
    position_difference: float = quantity("m", "largest difference of the position beyond the error of the odometry")
    front_offset: float = quantity("m", "distance of the front from the measured point of the first power unit")


@compiled
def implausible_quantity(
    constants: Records[CheckConstants], position: float, speed: float, estimate: float, foremost: float, expected: float
) -> int:
    """Return the implausible quantity of a measured position [m] and speed [m/s].

    ``estimate`` and ``foremost`` are the estimated front and the max safe front [m], ``expected`` is the estimated
    speed [m/s].
    """
    p = constants[0]
    front = position + p.front_offset
    if not (isfinite(front) and isfinite(speed)):
        return NOT_FINITE
    if abs(speed - expected) > p.speed_difference + speed_measurement_error(expected):
        return OTHER_SPEED
    return OTHER_PLACE if abs(front - estimate) > p.position_difference + foremost - estimate else PLAUSIBLE


class MeasurementCheck:
    """Detects a frozen, biased or invalid measurement that every law would follow.

    Parameters
    ----------
    spec
        Largest differences beyond the errors of the odometry, and their duration.
    front_offset
        Distance of the front from the measured point of the first power unit [m].

    Attributes
    ----------
    constants : Array of :class:`CheckConstants`, shape (1,)
        Settings.
    since : int or None
        Begin of a difference [ns].
    """

    def __init__(self, spec: SupervisionSpec, front_offset: float) -> None:
        self._confirmation = spec.confirmation
        self.constants = zeros(CheckConstants, 1)
        fill(self.constants, spec, front_offset=front_offset)
        self.since: int | None = None

    def step(self, measurement: Measurement, speeds: SupervisedSpeeds) -> str:
        """Return the difference that has lasted for the time of confirmation as text, "" without one."""
        position, speed = measurement.position.item(0), measurement.velocity.item(0)
        estimate, foremost, expected = speeds.position.item(0), speeds.position.item(1), speeds.speed.item(0)
        found = implausible_quantity(self.constants, position, speed, estimate, foremost, expected)
        if found == PLAUSIBLE:
            self.since = None
            return ""
        if self.since is None:
            self.since = measurement.stamp
        if measurement.stamp - self.since < self._confirmation * 1e9:
            return ""
        if found == NOT_FINITE:
            return "the measurement is not finite"
        if found == OTHER_SPEED:
            return f"measured {speed * 3.6:.1f} km/h, odometry {expected * 3.6:.1f} km/h"
        front = position + self.constants["front_offset"].item(0)
        return f"measured front at {front:.0f} m, odometry {estimate:.0f} m"
