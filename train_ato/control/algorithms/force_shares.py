"""Mean over the power units, weighted by their shares of the total force."""

from __future__ import annotations

from collections.abc import Sequence
from operator import mul


def mean_over_units(share: Sequence[float], values: Sequence[float]) -> float:
    """Return sum share_i value_i; the shares sum to 1 (:attr:`train_ato.control.train_model.TrainModel.share`)."""
    total: float = sum(map(mul, share, values))
    return total
