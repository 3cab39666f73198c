"""What a train can do at a steady speed: balancing speeds, steepest start, forces to hold a speed."""

from __future__ import annotations

import numpy as np

from plant_sim.consist import Consist
from train_ato.plan.train_tables import HIGHEST, TrainTables

__all__ = ["balancing_speed", "holding_force", "steepest_start"]


def balancing_speed(consist: Consist, grade: float) -> float:
    """Return the highest steady speed on a grade at full traction [m/s]; 0 where it cannot move.

    Parameters
    ----------
    grade
        > 0 uphill, 1 per mille = 0.001.
    """
    train = TrainTables(consist, HIGHEST)
    left = train.traction - train.resistance - train.mass * train.gravity * grade
    above = np.flatnonzero(left[:-1] > 0)
    if not above.size:
        return 0.0
    k = int(above[-1])
    return float(train.speed[k] + (train.speed[k + 1] - train.speed[k]) * left[k] / (left[k] - left[k + 1]))


def steepest_start(consist: Consist) -> float:
    """Return the steepest grade on which full traction moves the train from rest."""
    train = TrainTables(consist)
    return float((train.traction[0] - train.resistance[0]) / (train.mass * train.gravity))


def holding_force(consist: Consist, speed: float, grade: float) -> float:
    """Return the force that holds a speed [m/s] on a grade [N]; < 0 brakes."""
    train = TrainTables(consist)
    resistance = float(train.resistance_at(np.array([speed]))[0])
    return resistance + train.mass * train.gravity * grade
