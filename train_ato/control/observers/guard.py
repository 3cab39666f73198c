"""Guard of the observers: an invalid measurement is not used, and the last estimate is repeated."""

from __future__ import annotations

from math import copysign, isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from train_ato.control.algorithms.guard import all_within, is_valid_state
from train_ato.control.observers.contract import ObserverInput
from train_ato.messages.types import Array
from train_ato.messages.validity import MAX_FORCE

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel


def is_valid_observer_input(inputs: ObserverInput) -> bool:
    """Return True if all inputs of an observer are finite and physically possible."""
    return (
        is_valid_state(inputs)
        and all_within(inputs.coupler_force, MAX_FORCE)
        and all_within(inputs.shoe_force, MAX_FORCE)
        and -MAX_FORCE <= inputs.train_shoe_force <= MAX_FORCE
    )


class GuardedObserver:
    """Base of the observers: a subclass computes ``estimate()`` for valid inputs, this class handles the others.

    Parameters
    ----------
    parameters
        Parameters of the observer.
    model
        The nominal train.
    period
        Tick [s].
    """

    def __init__(self, parameters: Any, model: TrainModel, period: float) -> None:
        self.parameters = parameters
        GuardedObserver.bind(self, model, period)

    def bind(self, model: TrainModel, period: float) -> None:
        """Take the model of the train and the tick [s]; an observer with keyword parameters has no other start."""
        self.model = model
        self.period = period
        self.n = model.n_units
        self._last_estimate = [0.0] * self.n

    def estimate(self, inputs: ObserverInput) -> list[float]:
        """Return the disturbance force of every unit [N] for valid inputs."""
        raise TypeError(f"{type(self).__name__} has no estimate()")

    def clear_state(self) -> None:
        """Clear the state of the observer."""

    def on_missed_sample(self) -> None:
        """Handle a missed sample: difference quotients must not bridge it."""

    def reset(self) -> None:
        """Clear all state, including the last estimate."""
        self.clear_state()
        self._last_estimate = [0.0] * self.n

    def step(self, inputs: ObserverInput) -> Array:
        """Return the disturbance force of every unit [N], finite, > 0 forward."""
        if not is_valid_observer_input(inputs):
            self.on_missed_sample()
            return np.array(self._last_estimate)
        found = self.estimate(inputs)
        if all(map(isfinite, found)):
            self._last_estimate = [
                force if -MAX_FORCE <= force <= MAX_FORCE else copysign(MAX_FORCE, force) for force in found
            ]
        else:
            self.clear_state()
        return np.array(self._last_estimate)
