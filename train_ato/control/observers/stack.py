"""Observer with its copy of the brake policy, which gives the shoe forces of the balance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from train_ato.control.air_brake.shoes import ShoeForecast
from train_ato.control.algorithms.force_shares import total_of_units
from train_ato.control.algorithms.guard import is_valid_state
from train_ato.control.observers.contract import ObserverInput
from train_ato.messages.types import DisturbanceEstimate, Measurement

if TYPE_CHECKING:
    from train_ato.control.air_brake.record_policy import BrakePolicy
    from train_ato.control.train_model import TrainModel


class ObserverStack:
    """Computation of the estimate from a measurement.

    Parameters
    ----------
    model
        The nominal train.
    observer
        Any :class:`train_ato.control.observers.contract.Observer`.
    brake_policy
        Copy of the policy of the controller.
    """

    def __init__(self, model: TrainModel, observer: Any, brake_policy: BrakePolicy) -> None:
        self._observer = observer
        self._policy = brake_policy
        self._shoes = ShoeForecast(model)
        self._speed = 0.0
        self._no_shoes = self._shoes.at(0.0, 0.0)

    def step(self, measurement: Measurement) -> DisturbanceEstimate:
        """Return the estimate with the stamp of the measurement."""
        return DisturbanceEstimate(measurement.stamp, self._observer.step(self._inputs(measurement)))

    def _inputs(self, measurement: Measurement) -> ObserverInput:
        shoes = self._no_shoes
        if self._shoes.fitted:
            t = measurement.stamp * 1e-9
            if is_valid_state(measurement):
                self._speed = float(measurement.velocity[0])
                position, applied = float(measurement.position[0]), total_of_units(measurement.applied)
                self._shoes.demand(t, self._policy.step(t, position, self._speed, applied))
            shoes = self._shoes.at(t, self._speed)
        return ObserverInput.of(measurement, shoes.own, shoes.total)
