"""What keeps an observer's estimate finite: unsound measurements are left out and the last estimate is held."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from train_ato.control.parts.guard import FARTHEST, FASTEST, STRONGEST, within
from train_ato.observe.contract import ObserverInput
from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.model import TrainModel


def sound(inputs: ObserverInput) -> bool:
    """Tell whether every number an observer may use is finite and physically possible."""
    return (
        within(inputs.velocity, FASTEST)
        and within(inputs.position, FARTHEST)
        and within(inputs.applied, STRONGEST)
        and within(inputs.coupler_force, STRONGEST)
        and within(inputs.shoe_force, STRONGEST)
        and -STRONGEST <= inputs.train_shoe_force <= STRONGEST
    )


class GuardedObserver:
    """Base of the observers here: ``estimate()`` works on sound measurements, this class on any."""

    def __init__(self, parameters: Any, model: TrainModel, period: float) -> None:
        self.parameters = parameters
        self.model = model
        self.period = period
        self.n = model.n_units
        self._held = [0.0] * self.n

    def estimate(self, inputs: ObserverInput) -> list[float]:
        """Return the disturbance force of every unit [N]; the inputs are sound."""
        raise TypeError(f"{type(self).__name__} has no estimate()")

    def forget(self) -> None:
        """Forget what was stored."""

    def missed(self) -> None:
        """Take note that one measurement was not usable: difference quotients must not bridge it."""

    def reset(self) -> None:
        """Forget everything, the last estimate included."""
        self.forget()
        self._held = [0.0] * self.n

    def step(self, inputs: ObserverInput) -> Array:
        """Return the disturbance force of every unit [N], finite."""
        if not sound(inputs):
            self.missed()
            return np.array(self._held)
        found = self.estimate(inputs)
        if all(map(isfinite, found)):
            self._held = [min(max(force, -STRONGEST), STRONGEST) for force in found]
        else:
            self.forget()
        return np.array(self._held)
