"""An observer with what it must know of the air brake: it follows the same brake policy on the same measurement."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from train_ato.brake.shoes import ShoeForecast
from train_ato.control.parts.guard import FARTHEST, FASTEST, within
from train_ato.observe.contract import ObserverInput
from train_ato.types import DisturbanceEstimate, Measurement

if TYPE_CHECKING:
    from train_ato.brake.policy import BrakePolicy
    from train_ato.model import TrainModel


class ObserverStack:
    """Turns measurements into estimates.

    Parameters
    ----------
    model
        The nominal train.
    observer
        Any :class:`train_ato.observe.contract.Observer`.
    brake_policy
        A policy of its own, equal to the controller's.
    """

    def __init__(self, model: TrainModel, observer: Any, brake_policy: BrakePolicy) -> None:
        self._observer = observer
        self._policy = brake_policy
        self._shoes = ShoeForecast(model)
        self._speed = 0.0
        self._nothing = self._shoes.at(0.0, 0.0)

    def step(self, measurement: Measurement) -> DisturbanceEstimate:
        """Return the estimate for the measurement's stamp."""
        return DisturbanceEstimate(measurement.stamp, self._observer.step(self._inputs(measurement)))

    def _inputs(self, measurement: Measurement) -> ObserverInput:
        shoes = self._nothing
        if self._shoes.fitted:
            t = measurement.stamp * 1e-9
            if within(measurement.position, FARTHEST) and within(measurement.velocity, FASTEST):
                self._speed = float(measurement.velocity[0])
                position, applied = float(measurement.position[0]), float(measurement.applied.sum())
                self._shoes.tell(t, self._policy.step(t, position, self._speed, applied))
            shoes = self._shoes.at(t, self._speed)
        return ObserverInput.of(measurement, shoes.own, shoes.total)
