"""Sliding mode on a surface that includes the actuator's lag (ours; for the trains of paper 002 as they are).

Trains answer through a lag and a delay, which the papers' surfaces ignore. This one contains the acceleration that the
actuator gives, so that nothing is asked of it that it cannot do at once.

On the state at the time the command acts (compensation `predictor`), e = x - x_d, a the acceleration that the actuator
gives now and a_net the train's, everything per unit or for the train as a whole::

    s3 = (a_net - v_d') + c1 e' + c0 e
    a_s = a + tau [v_d'' - c1 (a_net - v_d') - c0 e' - k s3/(|s3| + phi) - k_i s3]
    a_net = a + (d_hat - couplers - resistance)/m

tau is the model's lag, exactly for a command held over the period Tc: Tc/(1 - exp(-Tc/lag)). ``command: common`` steers
the train by its mean and adds a little differential damping between the units: a true delay above the modelled one is
fatal to loops of each unit, not to this one. Coupler forces enter a_net where they are known; they are never cancelled
through the delay (that is anti-damping) but act through the derivative of the surface alone.

Needs: the measured force that acts, the model's lag, and the state at the acting time: compensation `predictor`
(``train: chain`` on sprung units). Where coupler forces beside the units are not known it steers the train by its mean
(``command: common``). No feed-forward: compensations that give only that are refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from train_ato.control.contract import LawInput, parameter
from train_ato.control.parts.couplers import UnitCouplers
from train_ato.control.parts.guard import GuardedLaw

if TYPE_CHECKING:
    from train_ato.model import TrainModel


@dataclass(frozen=True)
class LagSmcParameters:
    """Parameters of :class:`LagSmc`."""

    c1: float = parameter(1.0, "1/s", 0.0, 100.0, "weight of the speed error in the surface")
    c0: float = parameter(0.25, "1/s²", 0.0, 100.0, "weight of the position error")
    k: float = parameter(0.05, "m/s³", 0.0, 100.0, "gain of the smooth switching term")
    phi: float = parameter(0.1, "m/s²", 1e-6, 100.0, "width of the smooth switching term")
    k_i: float = parameter(0.4, "1/s", 0.0, 100.0, "linear reaching gain")
    command: str = parameter(
        "unit", "", 0, 0, "a loop for every unit, or one for the train", choices=("unit", "common")
    )
    damping: float = parameter(0.2, "1/s", 0.0, 10.0, "differential damping between units, common command only")


class LagSmc(GuardedLaw):
    """Sliding mode on a surface that includes the actuator's lag (ours)."""

    Parameters: ClassVar[type] = LagSmcParameters
    leaves_feedforward = "this law brings its own equivalent control: choose pid, rbf_switching_smc or smc for it"

    def __init__(self, parameters: LagSmcParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._lag = period / -math.expm1(-period / model.lag) if model.lag > 0.0 else period
        self._couplers = UnitCouplers(model)
        self._common = parameters.command == "common" or bool(self._couplers.missing)
        self._mass: list[float] = (model.inertia * model.share).tolist()

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force wanted [N]."""
        errors: list[float] = (inputs.position - inputs.reference_position).tolist()
        rates: list[float] = (inputs.velocity - inputs.reference_velocity).tolist()
        applied: list[float] = inputs.applied.tolist()
        if not self._common:
            nets = self._unit_nets(inputs, applied)
            return [
                force + mass * self._lag * self._push(error, rate, net, inputs)
                for force, mass, error, rate, net in zip(applied, self._mass, errors, rates, nets, strict=True)
            ]
        mean = self.mean(rates)
        total = sum(applied)
        net = self._train_net(inputs, total)
        wanted = total + self.model.inertia * self._lag * self._push(self.mean(errors), mean, net, inputs)
        damping = self.parameters.damping
        return [
            share * wanted - mass * damping * (rate - mean)
            for share, mass, rate in zip(self.share, self._mass, rates, strict=True)
        ]

    def _push(self, error: float, rate: float, net: float, inputs: LawInput) -> float:
        """Return the rate of the actuator's acceleration that is wanted [m/s³]."""
        p = self.parameters
        off = net - inputs.acting_acceleration
        surface = off + p.c1 * rate + p.c0 * error
        switching = p.k * surface / (abs(surface) + p.phi)
        return float(inputs.acting_jerk - p.c1 * off - p.c0 * rate - switching - p.k_i * surface)

    def _unit_nets(self, inputs: LawInput, applied: list[float]) -> list[float]:
        own = self.model.own_resistance(inputs.velocity, inputs.position).tolist()
        shoes, disturbance = inputs.shoe_force.tolist(), inputs.disturbance.tolist()
        pulls = self._couplers.pull(inputs.position.tolist(), inputs.velocity.tolist(), inputs.coupler_force.tolist())
        return [
            (force + extra - pull - resisting - shoe) / mass
            for force, extra, pull, resisting, shoe, mass in zip(
                applied, disturbance, pulls, own, shoes, self._mass, strict=True
            )
        ]

    def _train_net(self, inputs: LawInput, total: float) -> float:
        model = self.model
        speed = self.mean(inputs.velocity.tolist())
        place = float(inputs.position[0] + model.offsets[0])
        resisting = model.running_resistance(speed) + model.line_force(place) + inputs.train_shoe_force
        return float((total + sum(inputs.disturbance.tolist()) - resisting) / model.inertia)
