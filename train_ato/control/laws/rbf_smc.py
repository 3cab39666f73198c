"""Sliding mode with an RBF network for the error of the model, paper 000, eqs. (23)-(29), (35).

A small network learns the error of f_hat from the surface; its output is added to f_hat.

The law of :mod:`train_ato.control.laws.smc` with delta_hat added to f_hat::

    u = -m [f_hat + delta_hat + d_hat - v_d' + l1 e' + l2 e + xi |S|^alpha sgn S + zeta sgn S + ks S]      (35)
    delta_hat = W'h(chi),   chi = [e, e'],   h_j = exp(-|chi - c_j|²/(2 b²)),   c_j = .01 (-1 -.5 0 .5 1)  (25), (26)
    W' = +gamma S h                                                                                        (28)

Corrections and additions: network inputs are clipped to the outermost centres (``clip: false`` in the paper). With b =
0.005 the network has no response beyond 0.1 km/h, and independent centres give delta_hat a slope over e that excites
the loop. Weights are bounded (``weight_limit``). They do not change while the measurement is invalid or, with
``anti_windup``, while the force is at a limit. Without the linear reaching term ``ks`` the pair S, W is an undamped
oscillator of 55 s, and the network makes the tracking worse.

The observer of the paper has delta_hat in its known part, (30)-(34). Otherwise (35) would subtract the same force
twice. The node of the observer receives no delta_hat, so that d_hat contains it. ``ndo_omega``, the bandwidth of the
observer, removes it here. The observer is a linear filter, and the estimate of the paper is d_hat - m g with

    g_k = E g_{k-1} + (1 - E) delta_hat_{k-1},  E = exp(-ndo_omega Tc)

This holds up to rounding. By default `ndo_omega` is 0, and delta_hat stays in d_hat.

Gains of the model: the gains of `smc`, and centres up to .5 m and .5 m/s, so that the network has the same slope for
all errors of a run. The network integrates S with the factor 1.3 gamma, and S decays with the rate ks. gamma = ks²/16
is a third of the critical value.

Needs: the same as `smc`.
"""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp
from plant_sim.record import Records, quantity
from train_ato.control.algorithms.sliding import RBF_CENTERS, clamped
from train_ato.control.contract import flag, parameter
from train_ato.control.law import LawForm, LawNow, LawUnit
from train_ato.control.laws.smc import Smc, SmcConstants, SmcParameters, SmcUnit, equivalent, integral_surface, reaching
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array


@dataclass(frozen=True)
class RbfSmcParameters(SmcParameters):
    """Parameters of :class:`RbfSmc`: those of `smc` and of the network."""

    gamma: float = parameter(0.01, "1/s", 0.0, 100.0, "learning rate of the weights")
    spread: float = parameter(0.01, "m, m/s", 1e-6, 100.0, "outermost of the five centres")
    width: float = parameter(0.005, "m, m/s", 1e-6, 100.0, "b, width of the Gaussian functions")
    clip: bool = flag("clip the inputs to the outermost centres; false in the paper", default=True)
    ndo_omega: float = parameter(
        0.0, "1/s", 0.0, 1e6, "bandwidth of the observer if its known part has delta_hat, as in the paper"
    )
    weight_limit: float = parameter(1.0, "m/s²", 0.0, 1e3, "largest magnitude of a weight")


@dataclass(frozen=True)
class RbfSmcConstants(SmcConstants, RbfSmcParameters):
    """Constants of :func:`rbf_smc`: those of :func:`smc`, and of the network."""

    observer_decay: float = quantity("1", "part of the estimate of the observer that is left after a period")


@dataclass
class RbfSmcUnit(SmcUnit):
    """State of :func:`rbf_smc` for one unit."""

    weights: Array = quantity("m/s²", "weights of the network", len(RBF_CENTERS))
    observed: float = quantity("m/s²", "part of delta_hat in d_hat")
    found: float = quantity("m/s²", "delta_hat of the last step")


@compiled
def learnt_error(p: RbfSmcConstants, own: RbfSmcUnit, held: bool, error: float, rate: float, surface: float) -> float:
    """Return delta_hat of (25) [m/s²]; its weights learn by (28)."""
    if p.clip:
        error, rate = clamped(error, -p.spread, p.spread), clamped(rate, -p.spread, p.spread)
    scale, speed, found = -0.5 / (p.width * p.width), p.gamma * surface * p.period, 0.0
    for j in range(len(RBF_CENTERS)):
        c = p.spread * RBF_CENTERS[j]
        hidden = libm_exp(scale * ((error - c) * (error - c) + (rate - c) * (rate - c)))
        found += own.weights[j] * hidden
        if not held:
            own.weights[j] = clamped(own.weights[j] + speed * hidden, -p.weight_limit, p.weight_limit)
    return found


@compiled
def rbf_smc(p: RbfSmcConstants, state: Records[RbfSmcUnit], now: LawNow, units: Records[LawUnit]) -> None:
    """Compute the demand of sliding mode with a network for the error of the model: (35) [N]."""
    for u in range(units.size):
        x, own = units[u], state[u]
        error, rate = x.position - x.reference_position, x.velocity - x.reference_velocity
        held = x.saturated and p.anti_windup
        surface = integral_surface(p, own, error, rate, held)
        found = learnt_error(p, own, held, error, rate, surface)
        own.observed = p.observer_decay * own.observed + (1.0 - p.observer_decay) * own.found
        own.found = found
        pull = reaching(p, error, rate, surface) + (found - own.observed)
        x.wanted = equivalent(p, own.mass, now, x) - x.disturbance - own.mass * pull


class RbfSmc(Smc):
    """Sliding mode with a 2-5-1 RBF network for the error of the model (paper 000)."""

    Parameters: ClassVar[type] = RbfSmcParameters
    form = LawForm(rbf_smc, RbfSmcConstants, RbfSmcUnit)

    @classmethod
    def model_gains(cls, model: TrainModel, period: float) -> dict[str, Any]:
        """Return the parameters of `smc`, and those of a network that learns slower than its loop."""
        found = super().model_gains(model, period)
        return {**found, "gamma": found["ks"] ** 2 / 16.0, "spread": 0.5, "width": 0.25}

    def more_constants(self) -> dict[str, Any]:
        """Return the decay of the observer."""
        return {"observer_decay": math.exp(-self.parameters.ndo_omega * self.period)}
