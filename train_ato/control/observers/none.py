"""No observer: the disturbance is taken as 0.

For laws that bring their own integral action, and as the case that shows what an observer is worth.

Needs: nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from train_ato.observe.contract import ObserverInput
from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.model import TrainModel


@dataclass(frozen=True)
class NoParameters:
    """No parameters."""


class NoObserver:
    """No observer: an estimate of 0."""

    Parameters: ClassVar[type] = NoParameters

    def __init__(self, parameters: NoParameters, model: TrainModel, period: float) -> None:
        self._nothing = np.zeros(model.n_units)

    def reset(self) -> None:
        """Nothing to forget."""

    def step(self, inputs: ObserverInput) -> Array:
        """Return 0 N for every unit."""
        return self._nothing
