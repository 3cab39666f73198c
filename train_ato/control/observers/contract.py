"""Contract between the loop and a disturbance observer."""

from __future__ import annotations

from typing import Any, ClassVar, Protocol

import numpy as np

from plant_sim.elementary import total_of_units
from plant_sim.states import frozen_message
from train_ato.control.air_brake.record_policy import BrakePolicy
from train_ato.control.air_brake.shoes import ShoeForecast
from train_ato.control.guard import is_valid_state
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array, DisturbanceEstimate, Measurement


@frozen_message
class ObserverInput:
    """Inputs of an observer in one tick. Arrays have one entry per power unit, front first.

    Attributes
    ----------
    t : float
        Simulation time of the measurement [s].
    position, velocity, applied : Array
        Measured position [m], speed [m/s] and force after delay, lag and limit [N].
    coupler_force : Array
        Force of the couplers with a sensor [N], in the order of ``model.sensors``.
    shoe_force : Array
        Air-brake force on every unit's own vehicle, predicted by the model [N], > 0 retards.
    train_shoe_force : float
        The same on the whole train [N].
    """

    t: float
    position: Array
    velocity: Array
    applied: Array
    coupler_force: Array
    shoe_force: Array
    train_shoe_force: float = 0.0

    @classmethod
    def of(
        cls, measurement: Measurement, shoe_force: Array | None = None, train_shoe_force: float = 0.0
    ) -> ObserverInput:
        """Return the input for a measurement; the shoe forces are 0 by default."""
        return cls(
            t=measurement.stamp * 1e-9,
            position=measurement.position,
            velocity=measurement.velocity,
            applied=measurement.applied,
            coupler_force=measurement.force,
            shoe_force=np.zeros(measurement.velocity.size) if shoe_force is None else shoe_force,
            train_shoe_force=train_shoe_force,
        )


class Observer(Protocol):
    """A disturbance observer.

    ``Parameters`` is a frozen dataclass. :func:`train_ato.control.contract.parameter` declares its fields. The
    constructor takes the parameters, the model of the train and the tick [s]. It raises :class:`ValueError` with the
    reason if the observer cannot work on that train. The form with keyword parameters is the same as for a law
    (:mod:`train_ato.control.contract`, ``examples/my_observer.py``).

    The loop passes on every measurement, also an invalid one (NaN);
    :class:`train_ato.control.observers.record_observer.GuardedObserver` repeats the last estimate then.
    """

    Parameters: ClassVar[type]

    def __init__(self, parameters: Any, model: Any, period: float) -> None: ...

    def reset(self) -> None:
        """Clear all state."""

    def step(self, inputs: ObserverInput) -> Array:
        """Return the disturbance force per power unit [N], > 0 forward, shape (units,), always finite."""


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

    Attributes
    ----------
    observer, policy, shoes
        Observer, policy of the air brake, and forecast of the shoe forces.
    speed : float
        Last valid speed of the first unit [m/s].
    """

    def __init__(self, model: TrainModel, observer: Any, brake_policy: BrakePolicy) -> None:
        self.observer = observer
        self.policy = brake_policy
        self._model, self.shoes = model, ShoeForecast(model)
        self.speed = 0.0
        self._no_shoes = self.shoes.at(0.0, 0.0)

    def step(self, measurement: Measurement) -> DisturbanceEstimate:
        """Return the estimate with the stamp of the measurement."""
        shoes, t, seen = self._no_shoes, measurement.stamp * 1e-9, measurement.copy()
        if self.shoes.fitted:
            if is_valid_state(measurement):
                self.speed = float(measurement.velocity[0])
                position, applied = self._model.front(measurement.position), total_of_units(measurement.applied)
                self.shoes.demand(t, self.policy.step(t, position, self.speed, applied))
            shoes = self.shoes.at(t, self.speed)
        inputs = ObserverInput(t, seen.position, seen.velocity, seen.applied, seen.force, shoes.own.copy(), shoes.total)
        return DisturbanceEstimate(measurement.stamp, self.observer.step(inputs))
