"""Sum over the power units, and mean weighted by their shares of the total force."""

from __future__ import annotations

from collections.abc import Sequence

from plant_sim.summation import plain_dot
from train_ato.messages.types import Array

PAIRWISE = 8
"""Number of entries from which numpy adds in pairs."""


def total_of_units(values: Array) -> float:
    """Return ``values.sum()``, for few units without its 1.4 us: numpy adds less than eight entries in order, too."""
    if values.size >= PAIRWISE:
        return float(values.sum())
    total = 0.0
    for value in values.tolist():
        total += value
    return total


def mean_over_units(share: Sequence[float], values: Sequence[float]) -> float:
    """Return sum share_i value_i; the shares sum to 1 (:attr:`train_ato.control.train_model.TrainModel.share`)."""
    return plain_dot(share, values)
