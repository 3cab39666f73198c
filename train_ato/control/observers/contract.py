"""The contract between the loop and a disturbance observer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np

from train_ato.types import Array, Measurement

__all__ = ["Observer", "ObserverInput"]


@dataclass(frozen=True, slots=True)
class ObserverInput:
    """What an observer is given each tick. Arrays are over power units, front first.

    Attributes
    ----------
    t : float
        Simulation time of the measurement [s].
    position, velocity, applied : Array
        Measured position [m], speed [m/s], and the force that acts now, after delay, lag and limit [N].
    coupler_force : Array
        Couplers that carry a sensor [N], in the order of ``model.sensors``.
    shoe_force : Array
        Air-brake force on every unit's own vehicle as the model predicts it now [N], > 0 retards.
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
        """Return the input for a measurement; without an air brake the shoe forces are 0."""
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

    ``Parameters`` is a frozen dataclass whose fields were made by
    :func:`train_ato.control.contract.parameter`. The constructor takes the parameters, the model of the train and the
    tick [s]; it raises :class:`ValueError` with a reason when the observer makes no sense on that train.
    """

    Parameters: ClassVar[type]

    def __init__(self, parameters: Any, model: Any, period: float) -> None: ...

    def reset(self) -> None:
        """Forget everything."""

    def step(self, inputs: ObserverInput) -> Array:
        """Return the disturbance force per power unit [N], > 0 forward, shape (units,), always finite."""
