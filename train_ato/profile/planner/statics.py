"""Steady-state figures of a train: balancing speed, steepest starting grade, force to hold a speed."""

from __future__ import annotations

import numpy as np

from plant_sim.consist import Consist
from train_ato.profile.planner.train_tables import MAX_TABLE_SPEED, TrainTables


def balancing_speed(consist: Consist, grade: float) -> float:
    """Return the balancing speed on a grade at full traction [m/s]; 0 if the train cannot start.

    Parameters
    ----------
    grade
        > 0 uphill, 1 per mille = 0.001.
    """
    train = TrainTables(consist, MAX_TABLE_SPEED)
    left = train.traction - train.resistance - train.mass * train.gravity * grade
    above = np.flatnonzero(left[:-1] > 0)
    if not above.size:
        return 0.0
    k = int(above[-1])
    return float(train.speed[k] + (train.speed[k + 1] - train.speed[k]) * left[k] / (left[k] - left[k + 1]))


def steepest_start(consist: Consist) -> float:
    """Return the steepest starting grade at full traction [1]."""
    train = TrainTables(consist)
    return float((train.traction[0] - train.resistance[0]) / (train.mass * train.gravity))


def holding_force(consist: Consist, speed: float, grade: float) -> float:
    """Return the force that keeps a speed [m/s] on a grade [N]; < 0: braking."""
    train = TrainTables(consist)
    resistance = float(train.resistance_at(np.array([speed]))[0])
    return resistance + train.mass * train.gravity * grade
