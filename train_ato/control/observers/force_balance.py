"""Force balance of an observer: of every unit's own vehicle, or of the whole train."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

from plant_sim.summation import plain_sum
from train_ato.control.algorithms.couplers import UnitCouplers
from train_ato.control.algorithms.force_shares import mean_over_units
from train_ato.control.contract import parameter
from train_ato.control.observers.contract import ObserverInput
from train_ato.control.parameters import RefusedParameter

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel


def scope() -> Any:
    """Declare the parameter ``scope`` of an observer with a force balance."""
    meaning = "balance of every unit's vehicle, of the train, or vehicle if the coupler forces are available"
    return parameter("auto", "", 0, 0, meaning, choices=("auto", "vehicle", "train"))


class BalanceState(NamedTuple):
    """Speed of a body [m/s], and its driving and resisting force over its mass [m/s²]."""

    speed: float
    drive: float
    resistance: float


class ForceBalance:
    """Speed and modelled acceleration of every unit's vehicle, or of the train as one mass.

    Parameters
    ----------
    model
        The nominal train.
    scope
        ``vehicle``, ``train``, or ``auto``: ``vehicle`` if the forces of all couplers beside units are available.
    model_error
        Coupler and resistance forces are divided by 1 + model_error, vehicle scope only.
    period
        Tick [s].

    Raises
    ------
    ValueError
        If the scope is ``vehicle`` and the force of a coupler is not available.
    """

    def __init__(self, model: TrainModel, scope: str, model_error: float, period: float) -> None:
        self._model = model
        self._couplers = UnitCouplers(model)
        if scope == "vehicle" and self._couplers.unknown:
            reason = f"scope: vehicle needs the force of {self._couplers.unknown_names()}"
            raise RefusedParameter(reason, "scope: train", self._couplers.sensors_text())
        self.whole_train = scope == "train" or bool(self._couplers.unknown)
        self.count = 1 if self.whole_train else model.n_units
        self._model_factor = 1.0 / (1.0 + model_error)
        self._weight = lag_weight(period, model.lag)
        self._mass: list[float] = model.unit_inertia.tolist()
        self._share: list[float] = model.share.tolist()

    def known(self, inputs: ObserverInput) -> list[BalanceState]:
        """Return the state of every body of the balance."""
        return [self._train(inputs)] if self.whole_train else self._vehicles(inputs)

    def mean_drive(self, before: float, now: float) -> float:
        """Return the mean of an applied acceleration over a tick from its values at both ends [m/s²].

        Exact for a first-order lag with a constant demand over the tick; without lag the value of the end acts over
        the whole tick.
        """
        return self._weight * before + (1.0 - self._weight) * now

    def known_rate(self, before: BalanceState, now: BalanceState) -> float:
        """Return the mean modelled acceleration over a tick [m/s²]."""
        return self.mean_drive(before.drive, now.drive) - 0.5 * (before.resistance + now.resistance)

    def forces(self, accelerations: list[float]) -> list[float]:
        """Return the force of every unit for the accelerations that the model does not explain [N]."""
        if self.whole_train:
            total = accelerations[0] * self._model.inertia
            return [total * share for share in self._share]
        return [mass * value for mass, value in zip(self._mass, accelerations, strict=True)]

    def _vehicles(self, inputs: ObserverInput) -> list[BalanceState]:
        speeds, applied = inputs.velocity.tolist(), inputs.applied.tolist()
        return [
            BalanceState(speed, force / mass, opposing.total * self._model_factor / mass)
            for speed, force, opposing, mass in zip(
                speeds, applied, self._couplers.opposing(inputs), self._mass, strict=True
            )
        ]

    def _train(self, inputs: ObserverInput) -> BalanceState:
        speeds = inputs.velocity.tolist()
        speed = mean_over_units(self._share, speeds)
        resisting = self._model.resisting_force(self._model.front(inputs.position), speed, inputs.train_shoe_force)
        inertia = self._model.inertia
        return BalanceState(speed, plain_sum(inputs.applied.tolist()) / inertia, resisting / inertia)


def lag_weight(period: float, lag: float) -> float:
    """Return the weight of the first force of a tick in its mean, for a lag with a constant demand over the tick.

    With E = exp(-period/lag) and g = (1 - E) lag/period the mean is w + (F0 - w) g, w = (F1 - F0 E)/(1 - E).
    """
    if lag <= 0.0:
        return 0.0
    left = -math.expm1(-period / lag)
    mean = left * lag / period
    return mean - (1.0 - left) * (1.0 - mean) / left
