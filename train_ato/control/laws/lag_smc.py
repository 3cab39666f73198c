"""Sliding mode on a surface with the lag of the actuator, for the trains of paper 002 with lag and delay.

The surfaces of the papers ignore lag and delay. This surface contains the acceleration of the actuator, so the command
changes only as fast as the actuator can follow. The law is not from a paper.

The law uses the state at the time of effect (compensation `predictor`). e is x - x_d, a is the acceleration by the
actuator, and a_net is the acceleration of the train. They are per unit or for the whole train::

    s3 = (a_net - v_d') + c1 e' + c0 e
    a_s = a + Ta [v_d'' - c1 (a_net - v_d') - c0 e' - k s3/(|s3| + phi) - k_i s3]
    a_net = a + (d_hat - couplers - resistance)/m

Ta is the lag of the model, exact for a constant command over the period Tc: Tc/(1 - exp(-Tc/lag)). ``command: common``
controls the mean of the train and adds a small differential damping between the units. On the freight train of paper
002 both kinds of loops stay stable with 0.75 to 1.25 of the modelled delay (table of msgs_docs/reproduction.md). With
less delay than modelled the separate loops have the larger errors. Coupler forces enter a_net if they are available.
The law does not cancel them through the delay, which would be negative damping. They act only through the derivative of
the surface.

Gains of the model: on s3 = 0 the loop is kp = c1, ki = c0. The rule is c1 = kp and c0 = kp²/4 with the kp of `pid` on
the same train. The acceleration reaches s3 = 0 within half of the dead time theta = delay + lag + period, with k_i =
2/theta, and in no less than a period, with k_i = 1/Tc at most. ``command: common`` is used, because the predicted
coupler forces of a long train are late. Its damping is kp at most: more of it excites the couplers between two units.
k is 0, because the linear term alone is sufficient and does not chatter.

Needs: the measured force, the lag of the model, and the state at the time of effect: compensation `predictor` (``train:
chain`` for units coupled by springs). Without the coupler forces beside the units the law controls the mean of the
train (``command: common``). It uses no feed-forward. Compensations that give only a feed-forward are rejected.
"""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from plant_sim.compiled import compiled
from plant_sim.record import Records, quantity
from train_ato.control.algorithms.couplers import UnitCouplers
from train_ato.control.algorithms.loop_gains import Complex, LoopGains, Response
from train_ato.control.contract import choice, parameter
from train_ato.control.gains import gains_choice
from train_ato.control.law import LawForm, LawNow, LawUnit, RecordLaw, TrainConstants, train_resistance
from train_ato.control.train_model import TrainModel

MAX_REACHING = 100.0
"""Largest linear reaching gain [1/s]."""


@dataclass(frozen=True)
class LagSmcParameters:
    """Parameters of :class:`LagSmc`."""

    gains: str = gains_choice()
    c1: float = parameter(1.0, "1/s", 0.0, 100.0, "weight of the speed error in the surface")
    c0: float = parameter(0.25, "1/s²", 0.0, 100.0, "weight of the position error")
    k: float = parameter(0.05, "m/s³", 0.0, 100.0, "gain of the smooth switching term")
    phi: float = parameter(0.1, "m/s²", 1e-6, 100.0, "width of the smooth switching term")
    k_i: float = parameter(0.4, "1/s", 0.0, MAX_REACHING, "linear reaching gain")
    command: str = choice("one loop per unit, or one for the train", "unit", "common")
    damping: float = parameter(
        0.2, "1/s", 0.0, 10.0, "differential damping between the units, only for a common command"
    )


@dataclass(frozen=True)
class LagSmcConstants(LagSmcParameters, TrainConstants):
    """Constants of :func:`lag_smc`: its parameters and the values computed from them."""

    common: bool = quantity("", "one loop for the train")
    lag: float = quantity("s", "Ta, lag of the actuators for a constant command over a period")


@dataclass
class LagSmcUnit:
    """Constants of :func:`lag_smc` for one unit."""

    mass: float = quantity("kg", "share of the train's inertia")


@compiled
def wanted_jerk(p: LagSmcConstants, now: LawNow, error: float, rate: float, net: float) -> float:
    """Return the wanted rate of the actuator acceleration [m/s³]."""
    off = net - now.acceleration_at_effect
    surface = off + p.c1 * rate + p.c0 * error
    switching = p.k * surface / (abs(surface) + p.phi)
    return now.jerk_at_effect - p.c1 * off - p.c0 * rate - switching - p.k_i * surface


@compiled
def common_command(p: LagSmcConstants, state: Records[LagSmcUnit], now: LawNow, units: Records[LawUnit]) -> None:
    """Compute the demand of one loop on the mean of the train, with differential damping between the units [N]."""
    error = mean = speed = total = estimate = 0.0
    for x in units:
        error += x.share * (x.position - x.reference_position)
        mean += x.share * (x.velocity - x.reference_velocity)
        speed += x.share * x.velocity
        total += x.applied
        estimate += x.disturbance
    net = (total + estimate - train_resistance(p, now, speed)) / p.inertia
    wanted = total + p.inertia * p.lag * wanted_jerk(p, now, error, mean, net)
    for u in range(units.size):
        x = units[u]
        x.wanted = x.share * wanted - state[u].mass * p.damping * (x.velocity - x.reference_velocity - mean)


@compiled
def lag_smc(p: LagSmcConstants, state: Records[LagSmcUnit], now: LawNow, units: Records[LawUnit]) -> None:
    """Compute the demand of sliding mode on a surface with the lag of the actuator [N]."""
    if p.common:
        common_command(p, state, now, units)
        return
    for u in range(units.size):
        x, mass = units[u], state[u].mass
        net = (x.applied + x.disturbance - x.coupler_force - x.resistance - x.shoe_force) / mass
        error, rate = x.position - x.reference_position, x.velocity - x.reference_velocity
        x.wanted = x.applied + mass * p.lag * wanted_jerk(p, now, error, rate, net)


class LagSmc(RecordLaw):
    """Sliding mode on a surface with the lag of the actuator."""

    Parameters: ClassVar[type] = LagSmcParameters
    form = LawForm(lag_smc, LagSmcConstants, LagSmcUnit)

    @classmethod
    def model_gains(cls, model: TrainModel, period: float) -> dict[str, Any]:
        """Return the parameters with the bandwidth of `pid` on the same train."""
        loop = LoopGains.of(model, period)
        return {
            "command": "common", "c1": loop.speed, "c0": loop.speed**2 / 4.0, "k": 0.0,
            "k_i": min(2.0 / loop.dead_time, 1.0 / period, MAX_REACHING), "damping": min(0.2, loop.speed),
        }  # fmt: skip

    uses_feedforward = False

    def response(self, predicted: bool) -> Response:
        """Return the response to the speed error near s3 = 0; a force that is not predicted is late, as the errors."""
        p, lag = self.parameters, self.model.lag or self.period
        reaching = p.k_i + p.k / p.phi

        def of(s: Complex, late: Complex) -> tuple[Complex, Complex]:
            force = s + p.c1 + reaching if predicted else s + (1.0 - late) / lag + (p.c1 + reaching) * late
            return ((p.c0 + reaching * p.c1) * s + reaching * p.c0) * late, s * force

        return of

    def __init__(self, parameters: LagSmcParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        couplers = UnitCouplers(model)
        common = parameters.command == "common" or bool(couplers.unknown)
        self.couplers = None if common else couplers
        self.state["mass"] = model.inertia * model.share
        lag = period / -math.expm1(-period / model.lag) if model.lag > 0.0 else period
        self.set_constants(common=common, lag=lag)
