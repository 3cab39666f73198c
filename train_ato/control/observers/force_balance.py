"""Force balance of an observer: of every unit's own vehicle, or of the whole train."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

from plant_sim.compiled import compiled
from plant_sim.elementary import plain_sum
from plant_sim.railway import fading_resistance
from plant_sim.record import Records, quantity, zeros
from train_ato.control.algorithms.couplers import UnitCouplers
from train_ato.control.contract import RefusedParameter, choice
from train_ato.control.guard import all_within
from train_ato.control.law import LawNow, LawUnit
from train_ato.control.observers.contract import ObserverInput
from train_ato.control.train_model import TrainModel
from train_ato.messages.validity import MAX_POSITION


def scope() -> Any:
    """Declare the parameter ``scope`` of an observer with a force balance."""
    meaning = "balance of every unit's vehicle, of the train, or vehicle if the coupler forces are available"
    return choice(meaning, "auto", "vehicle", "train")


class BalanceState(NamedTuple):
    """Speed of a body [m/s], and its driving and resisting force over its mass [m/s²]."""

    speed: float
    drive: float
    resistance: float


@dataclass(frozen=True)
class BalanceConstants:
    """Constants of a balance."""

    whole_train: bool = quantity("", "the train is one body")
    inertia: float = quantity("kg", "mass of the train with its rotating masses")
    running_0: float = quantity("N", "constant part of the running resistance of the train")
    running_1: float = quantity("N s/m", "linear part")
    running_2: float = quantity("N s²/m²", "quadratic part")
    model_factor: float = quantity("1", "factor on coupler and resistance forces of a vehicle")
    weight: float = quantity("1", "weight of the first driving force of a sample in its mean")
    period: float = quantity("s", "tick")


@compiled
def balanced(
    p: BalanceConstants, mass: float, index: int, now: LawNow, units: Records[LawUnit]
) -> tuple[float, float, float]:
    """Return speed [m/s], driving and resisting acceleration [m/s²] of a body by its number."""
    x = units[index]
    if not p.whole_train:
        against = x.coupler_force + x.resistance + x.shoe_force
        return x.velocity, x.applied / mass, against * p.model_factor / mass
    speed, applied = 0.0, 0.0
    for unit in units:
        speed += unit.share * unit.velocity
        applied += unit.applied
    running = fading_resistance(p.running_0, p.running_1, p.running_2, speed)
    return speed, applied / mass, (running + now.line_force + now.train_shoe_force) / mass


@compiled
def each_balanced(p: Any, mass: float, index: int, now: Any, units: Any) -> Any:
    """Return :func:`balanced` from arrays of records."""
    return balanced(p[0], mass, index, now[0], units)


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

    Attributes
    ----------
    whole_train : bool
        The train is one body.
    count : int
        Number of bodies.
    mass : list of float
        Inertia of every body [kg].
    couplers : UnitCouplers
        Couplers beside the units.
    constants, now, units : Records
        Constants, and inputs of a sample.

    Raises
    ------
    ValueError
        If the scope is ``vehicle`` and the force of a coupler is not available.
    """

    def __init__(self, model: TrainModel, scope: str, model_error: float, period: float) -> None:
        self._model = model
        self.couplers = UnitCouplers(model)
        if scope == "vehicle" and self.couplers.unknown:
            reason = f"scope: vehicle needs the force of {self.couplers.unknown_names()}"
            raise RefusedParameter(reason, "scope: train", self.couplers.sensors_text())
        self.whole_train = scope == "train" or bool(self.couplers.unknown)
        self.count = 1 if self.whole_train else model.n_units
        self.mass: list[float] = [model.inertia] if self.whole_train else model.unit_inertia.tolist()
        self._weight = lag_weight(period, model.lag)
        self.constants, self.now = zeros(BalanceConstants, 1), zeros(LawNow, 1)
        self.units = zeros(LawUnit, model.n_units)
        factor = 1.0 / (1.0 + model_error)
        self.constants[0] = (self.whole_train, model.inertia, *model.running, factor, self._weight, period)
        self.units["share"] = model.share

    def fill(self, inputs: ObserverInput) -> None:
        """Set the inputs of a sample; line, resistance and couplers only for possible positions."""
        units, line_force = self.units, 0.0
        units["position"], units["velocity"], units["applied"] = inputs.position, inputs.velocity, inputs.applied
        units["shoe_force"] = inputs.shoe_force
        if all_within(inputs.position, MAX_POSITION):
            if self.whole_train:
                line_force = self._model.line_force(self._model.front(inputs.position))
            else:
                self.couplers.write(inputs.coupler_force, units)
        sensed = plain_sum(map(abs, inputs.coupler_force.tolist())) if inputs.coupler_force.size else 0.0
        self.now[0] = (inputs.t, 0.0, 0.0, 0.0, line_force, inputs.train_shoe_force, sensed)

    def known(self, inputs: ObserverInput) -> list[BalanceState]:
        """Return the state of every body of the balance."""
        self.fill(inputs)
        return [
            BalanceState(*each_balanced(self.constants, mass, i, self.now, self.units))
            for i, mass in enumerate(self.mass)
        ]

    def known_rate(self, before: BalanceState, now: BalanceState) -> float:
        """Return the mean modelled acceleration over a tick [m/s²], exact for a first-order lag: :func:`lag_weight`."""
        drive = self._weight * before.drive + (1.0 - self._weight) * now.drive
        return drive - 0.5 * (before.resistance + now.resistance)

    def forces(self, accelerations: list[float]) -> list[float]:
        """Return the force of every unit for the accelerations that the model does not explain [N]."""
        forces = [mass * value for mass, value in zip(self.mass, accelerations, strict=True)]
        return [forces[0] * share for share in self._model.share.tolist()] if self.whole_train else forces


def lag_weight(period: float, lag: float) -> float:
    """Return the weight of the first force of a tick in its mean, for a lag with a constant demand over the tick.

    With E = exp(-period/lag) and g = (1 - E) lag/period the mean is w + (F0 - w) g, w = (F1 - F0 E)/(1 - E).
    """
    if lag <= 0.0:
        return 0.0
    left = -math.expm1(-period / lag)
    mean = left * lag / period
    return mean - (1.0 - left) * (1.0 - mean) / left
