"""Sum over the power units, and mean weighted by their shares of the total force."""

from __future__ import annotations

from collections.abc import Sequence

from plant_sim.compiled import compiled
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


@compiled
def numpy_total(values: Array) -> float:
    """Return the sum in the order of ``numpy.sum``: eight sums side by side, for more than 128 entries in two parts."""
    n = len(values)
    total: float = 0.0
    if n < PAIRWISE:
        for value in values:
            total += value
        return total
    if n > 128:
        half = n // 2 - n // 2 % 8
        return float(numpy_total(values[:half]) + numpy_total(values[half:]))
    sums = values[:8].copy()
    whole = n - n % 8
    for first in range(8, whole, 8):
        for j in range(8):
            sums[j] += values[first + j]
    total = ((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]))
    for i in range(whole, n):
        total += values[i]
    return float(total)
