"""Standstill: conditions for the holding brake and for its release.

The holding brake of the plant acts below the holding speed while no unit has a positive demand.
"""

from __future__ import annotations

from train_ato.control.compensation.rigid import ProfileLike
from train_ato.control.train_model import STANDSTILL_SPEED, TrainModel
from train_ato.messages.types import Measurement, Reference

RELEASE_FORCE = 1.0
"""Demand that releases the holding brake for a departure on a falling grade without traction [N]."""


def held_by_holding_brake(
    measurement: Measurement, reference: Reference, profile: ProfileLike, delay_to_effect: float
) -> bool:
    """Return True if train and profile are at rest now and after the command delay [s]."""
    if reference.velocity != 0.0 or reference.acceleration != 0.0:
        return False
    if not stands(measurement):
        return False
    return profile.at(measurement.stamp * 1e-9 + delay_to_effect)[1] == 0.0


def needs_release(
    demand: list[float], measurement: Measurement, profile: ProfileLike, delay_to_effect: float, model: TrainModel
) -> bool:
    """Return True if the holding brake must be released: a departure on a falling grade without positive demand."""
    if max(demand) > 0.0 or not stands(measurement) or model.reversing:
        return False
    position, velocity, acceleration, _ = profile.at(measurement.stamp * 1e-9 + delay_to_effect)
    return velocity > 0.0 and acceleration >= 0.0 and model.rigid_force(position, 0.0, acceleration) < 0.0


def stands(measurement: Measurement) -> bool:
    """Return True if all units are slower than :data:`STANDSTILL_SPEED`."""
    fastest: float = max(map(abs, measurement.velocity.tolist()))
    return fastest < STANDSTILL_SPEED
