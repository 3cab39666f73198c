"""No observer: an estimate of 0.

For laws with integral action, and as the reference for the benefit of an observer.

Needs: nothing.
"""

from typing import ClassVar

import numpy as np

from train_ato.control.contract import NoParameters
from train_ato.control.observers.contract import ObserverInput
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array


class NoObserver:
    """No observer: an estimate of 0."""

    Parameters: ClassVar[type] = NoParameters

    def __init__(self, parameters: NoParameters, model: TrainModel, period: float) -> None:
        self._zero = np.zeros(model.n_units)

    def reset(self) -> None:
        """Do nothing: there is no state."""

    def step(self, inputs: ObserverInput) -> Array:
        """Return 0 N for every unit."""
        return self._zero
