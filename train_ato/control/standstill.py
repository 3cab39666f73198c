"""The train that stands: when it is left to its holding brake, and when that has to be released.

The holding brake acts below the holding speed while no unit is asked to pull.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from train_ato.compensate.rigid import ProfileLike
from train_ato.types import Measurement, Reference

if TYPE_CHECKING:
    from train_ato.model import TrainModel

HOLDING_SPEED = 0.05
"""Below it a train whose profile stands is left to its holding brake [m/s]."""
RELEASING = 1.0
"""Demand that releases the holding brake where the profile departs and nothing has to pull, on a fall [N]."""


def left_to_holding_brake(measurement: Measurement, reference: Reference, profile: ProfileLike, lead: float) -> bool:
    """Tell whether train and profile stand, also ``lead`` seconds from now, when a command sent now will act."""
    if reference.velocity != 0.0 or reference.acceleration != 0.0:
        return False
    if float(np.abs(measurement.velocity).max()) >= HOLDING_SPEED:
        return False
    return profile.at(measurement.stamp * 1e-9 + lead)[1] == 0.0


def kept_from_departing(
    demand: list[float], measurement: Measurement, profile: ProfileLike, lead: float, model: TrainModel
) -> bool:
    """Tell whether the train is held although its profile departs, since on a fall no unit is asked to pull."""
    if max(demand) > 0.0 or float(np.abs(measurement.velocity).max()) >= HOLDING_SPEED or model.reversing:
        return False
    position, velocity, acceleration, _ = profile.at(measurement.stamp * 1e-9 + lead)
    return velocity > 0.0 and acceleration >= 0.0 and model.rigid_force(position, 0.0, acceleration) < 0.0
