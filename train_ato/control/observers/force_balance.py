"""Balance of forces that an observer draws: over every unit's own vehicle, or over the whole train."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

from train_ato.control.contract import parameter
from train_ato.control.parts.couplers import UnitCouplers
from train_ato.control.parts.shares import mean_over_units
from train_ato.observe.contract import ObserverInput

if TYPE_CHECKING:
    from train_ato.model import TrainModel


def scope() -> Any:
    """Declare the parameter ``scope`` of an observer that draws a balance."""
    meaning = "balance over every unit's vehicle, over the train, or as the couplers allow"
    return parameter("auto", "", 0, 0, meaning, choices=("auto", "vehicle", "train"))


class State(NamedTuple):
    """Speed [m/s], and what pushes and what holds back, as accelerations [m/s²]."""

    speed: float
    push: float
    resisting: float


class Balance:
    """Speed and known acceleration of every unit's vehicle, or of the train as one mass.

    Parameters
    ----------
    model
        The nominal train.
    scope
        ``vehicle``, ``train``, or ``auto``: ``vehicle`` where the couplers beside all units have known forces.
    model_error
        What is known of couplers and resistance is taken as f/(1 + model_error), vehicle scope only.
    owner
        Name of the observer, for the refusal.
    period
        The tick [s].

    Raises
    ------
    ValueError
        If ``vehicle`` is asked for and a coupler's force is not known.
    """

    def __init__(self, model: TrainModel, scope: str, model_error: float, owner: str, period: float) -> None:
        self._model = model
        self._couplers = UnitCouplers(model)
        if scope == "vehicle" and self._couplers.missing:
            raise ValueError(
                f"scope vehicle needs the force measured at {self._couplers.refusal()}: "
                f"fit the sensors or set {owner}.scope: train"
            )
        self.lumped = scope == "train" or bool(self._couplers.missing)
        self.count = 1 if self.lumped else model.n_units
        self._trust = 1.0 / (1.0 + model_error)
        self._weight = lag_weight(period, model.lag)
        self._mass: list[float] = model.unit_inertia.tolist()
        self._share: list[float] = model.share.tolist()

    def known(self, inputs: ObserverInput) -> list[State]:
        """Return the state of everything the balance is drawn over."""
        return [self._train(inputs)] if self.lumped else self._vehicles(inputs)

    def mean_push(self, before: float, now: float) -> float:
        """Return the mean over a tick of an applied acceleration known at its ends.

        Exact for a first-order lag whose demand is held over the tick; without lag the force of the end acted from the
        beginning on.
        """
        return self._weight * before + (1.0 - self._weight) * now

    def known_rate(self, before: State, now: State) -> float:
        """Return the mean over a tick of the acceleration that the forces explain [m/s²]."""
        return self.mean_push(before.push, now.push) - 0.5 * (before.resisting + now.resisting)

    def forces(self, accelerations: list[float]) -> list[float]:
        """Return the force of every unit for unexplained accelerations [N]."""
        if self.lumped:
            total = accelerations[0] * self._model.inertia
            return [total * share for share in self._share]
        return [mass * value for mass, value in zip(self._mass, accelerations, strict=True)]

    def _vehicles(self, inputs: ObserverInput) -> list[State]:
        own = self._model.own_resistance(inputs.velocity, inputs.position).tolist()
        speeds, applied, shoes = inputs.velocity.tolist(), inputs.applied.tolist(), inputs.shoe_force.tolist()
        pulls = self._couplers.pull(inputs.position.tolist(), speeds, inputs.coupler_force.tolist())
        return [
            State(speed, force / mass, (pull + resisting + shoe) * self._trust / mass)
            for speed, force, pull, resisting, shoe, mass in zip(
                speeds, applied, pulls, own, shoes, self._mass, strict=True
            )
        ]

    def _train(self, inputs: ObserverInput) -> State:
        speeds = inputs.velocity.tolist()
        speed = mean_over_units(self._share, speeds)
        place = float(inputs.position[0] + self._model.offsets[0])
        resisting = self._model.running_resistance(speed) + self._model.line_force(place) + inputs.train_shoe_force
        inertia = self._model.inertia
        return State(speed, sum(inputs.applied.tolist()) / inertia, resisting / inertia)


def lag_weight(period: float, lag: float) -> float:
    """Return the weight of a tick's first force in its mean, for a lag whose demand is held over the tick.

    With E = exp(-period/lag) and g = (1 - E) lag/period the mean is w + (F0 - w) g, w = (F1 - F0 E)/(1 - E).
    """
    if lag <= 0.0:
        return 0.0
    left = -math.expm1(-period / lag)
    mean = left * lag / period
    return mean - (1.0 - left) * (1.0 - mean) / left
