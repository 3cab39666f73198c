"""Sliding mode with an adaptive reaching law, paper 000, eqs. (18)-(22).

The law drives the state to a surface of position error, its rate and its integral, on which the error decays. The
forces on the vehicle of the unit are measured and cancelled, which leaves a free mass to control.

Per unit, e = s - s_d, all terms but u in m/s²::

    S = e' + l1 e + l2 int e                                                                    (19)
    u = -m [f_hat + d_hat - v_d' + l1 e' + l2 e + xi |S|^alpha sgn S + zeta sgn S + ks S]       (22)
    zeta = kappa tanh(|e|/2)                                                                    (21)
    f_hat = -(FC + W + Fa)/m / (1 + model_error)

``m`` is the mass of the unit's own vehicle, FC the force of its couplers against the motion, W its resistance and Fa
its air brake. FC is measured, or computed from the states of both units for a linear spring between two units. Without
the force of the first coupler, (22) would have to balance 10 684 t with the mass of 184 t. ``d_hat`` is the force of
the observer over m.

Corrections and additions:

* ``model_error`` is the uncertainty of f of 1 % in the paper.
* zeta is 0 at e = 0 and |S|^5 is negligible near 0, so S has no restoring term: ``ks`` adds one (0 in the paper).
* The sign has a boundary layer ``phi`` [m/s] (0 in the paper).
* The integral of e is clamped (``integral_limit``), and held while the force is at a limit (``anti_windup``).
* ``equivalent: feedforward`` is for trains with lag and delay. It takes the equivalent control from
  ``LawInput.feedforward`` and uses the inertia of the train instead of that of the vehicle. With a sum T of lag and
  delay the law of the paper is unstable for T > m l1/(M l2). This is 0.17 s on the 10 684 t train. Under ``twin`` l1 =
  .07, l2 = .002, ks = .02, kappa = .01, phi = 1 work there. M (l1 + ks + kappa/phi) must be near the wave impedance of
  the couplers, 1e6 N s/m.

Gains of the model: near S = 0, (22) with ``equivalent: feedforward`` is the loop kp = l1 + ks, ki = l2 + ks l1 with an
integral of ks l2. The rule is ks = kp/4, l1 = 3 kp/4 and l2 = l1²/16 with the kp of `pid` on the same train. This gives
ki = .22 kp² (`pid`: .25 kp²) and an integral six times slower than the loop. The switching terms have kappa = .1 kp,
phi = 1 m/s and xi = .01 kp. kappa adds at most a tenth of kp, and xi a twentieth at S = 1 m/s. So the command does not
chatter.

Needs: with ``equivalent: measured`` the force of every coupler beside a power unit. It comes from a sensor or from a
linear spring without slack between two units. The error message names the missing couplers, and compensations that give
only a feed-forward are rejected. With ``equivalent: feedforward`` any train without sensors.
"""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_tanh
from plant_sim.record import Records, quantity
from train_ato.control.algorithms.couplers import UnitCouplers
from train_ato.control.algorithms.loop_gains import JUDGED_ERROR, Complex, LoopGains, Response
from train_ato.control.algorithms.sliding import clamped, saturation, sig
from train_ato.control.contract import RefusedParameter, choice, flag, parameter
from train_ato.control.gains import gains_choice
from train_ato.control.law import LawForm, LawNow, LawUnit, RecordLaw
from train_ato.control.train_model import TrainModel


@dataclass(frozen=True)
class SmcParameters:
    """Parameters of :class:`Smc`; the defaults are those of the paper, except ``ks``."""

    gains: str = gains_choice()
    l1: float = parameter(1.0, "1/s", 0.0, 100.0, "lambda_1, weight of the error in the surface")
    l2: float = parameter(0.1, "1/s²", 0.0, 100.0, "lambda_2, weight of the integral of the error")
    xi: float = parameter(0.005, "m/s²", 0.0, 1e3, "gain of the power reaching term")
    alpha: float = parameter(5.0, "1", 0.1, 10.0, "exponent of the power reaching term")
    kappa: float = parameter(0.05, "m/s²", 0.0, 1e3, "gain of the adaptive switching term")
    ks: float = parameter(0.5, "1/s", 0.0, 100.0, "linear reaching term; 0 in the paper")
    phi: float = parameter(0.0, "m/s", 0.0, 100.0, "boundary layer of the sign; 0 in the paper")
    model_error: float = parameter(0.01, "1", -0.5, 10.0, "f_hat = f/(1 + model_error)")
    integral_limit: float = parameter(
        100.0, "m s", 0.0, 1e12, "largest magnitude of the integral of the position error; no limit in the paper"
    )
    anti_windup: bool = flag("hold the integral while the force is at a limit; false in the paper", default=True)
    equivalent: str = choice(
        "equivalent control from the coupler sensors, or from the feed-forward", "measured", "feedforward"
    )


@dataclass(frozen=True)
class SmcConstants(SmcParameters):
    """Constants of :func:`smc`: its parameters and the values computed from them."""

    measured: bool = quantity("", "the equivalent control is that of the measured forces")
    period: float = quantity("s", "control period")


@dataclass
class SmcUnit:
    """State of :func:`smc` for one unit."""

    mass: float = quantity("kg", "mass of the unit's vehicle, or its share of the train's inertia")
    before: float = quantity("m", "error of the last step")
    integral: float = quantity("m s", "integral of the error")
    known: bool = quantity("", "the error of the last step is known")


@compiled
def integral_surface(p: SmcConstants, own: SmcUnit, error: float, rate: float, held: bool) -> float:
    """Return S [m/s] of (19); ``held`` freezes the integral."""
    if own.known and not held:
        total = own.integral + 0.5 * (error + own.before) * p.period
        own.integral = clamped(total, -p.integral_limit, p.integral_limit)
    own.known, own.before = True, error
    return rate + p.l1 * error + p.l2 * own.integral


@compiled
def reaching(p: SmcConstants, error: float, rate: float, surface: float) -> float:
    """Return l1 e' + l2 e and the reaching terms of (21) [m/s²]."""
    zeta = p.kappa * libm_tanh(abs(error) / 2.0)
    pull = p.l1 * rate + p.l2 * error + p.ks * surface + p.xi * sig(surface, p.alpha)
    return float(pull + zeta * saturation(surface, p.phi))


@compiled
def equivalent(p: SmcConstants, mass: float, now: LawNow, x: LawUnit) -> float:
    """Return m (v_d' - f_hat) of a unit [N], or the feed-forward in its place."""
    if not p.measured:
        return x.feedforward
    model_factor = 1.0 / (1.0 + p.model_error)
    return mass * now.acceleration_at_effect + (x.coupler_force + x.resistance + x.shoe_force) * model_factor


@compiled
def smc(p: SmcConstants, state: Records[SmcUnit], now: LawNow, units: Records[LawUnit]) -> None:
    """Compute the demand of sliding mode with integral surface (19) and adaptive reaching law (21): (22) [N]."""
    for u in range(units.size):
        x, own = units[u], state[u]
        error, rate = x.position - x.reference_position, x.velocity - x.reference_velocity
        surface = integral_surface(p, own, error, rate, x.saturated and p.anti_windup)
        pull = reaching(p, error, rate, surface)
        x.wanted = equivalent(p, own.mass, now, x) - x.disturbance - own.mass * pull


class Smc(RecordLaw):
    """Sliding mode with integral surface and adaptive reaching law (paper 000)."""

    Parameters: ClassVar[type] = SmcParameters
    form = LawForm(smc, SmcConstants, SmcUnit)
    uses_train_forces = False

    @classmethod
    def model_gains(cls, model: TrainModel, period: float) -> dict[str, Any]:
        """Return the parameters with the bandwidth of `pid` on the same train."""
        kp = LoopGains.of(model, period).speed
        ks, l1 = kp / 4.0, 3.0 * kp / 4.0
        return {
            "equivalent": "feedforward", "l1": l1, "l2": l1 * l1 / 16.0, "ks": ks, "xi": 0.01 * kp,
            "kappa": 0.1 * kp, "phi": 1.0,
        }  # fmt: skip

    def __init__(self, parameters: SmcParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        measured = parameters.equivalent == "measured"
        self.uses_effect = measured
        self.uses_feedforward, self.feedforward_hint = not measured, "equivalent: feedforward"
        self.couplers = UnitCouplers(model) if measured else None
        if self.couplers is not None and self.couplers.unknown:
            raise RefusedParameter(
                f"equivalent: measured needs the force of {self.couplers.unknown_names()}, or a unit of "
                f"{model.unit_mass[0] / 1e3:.0f} t would have to balance {model.mass / 1e3:.0f} t",
                "equivalent: feedforward",
                self.couplers.sensors_text(),
            )
        self.state["mass"] = model.unit_inertia if measured else model.inertia * model.share
        self.set_constants(measured=measured, **self.more_constants())

    def response(self, predicted: bool) -> Response | None:
        """Return the response at a position error of ``JUDGED_ERROR``, None for measured couplers."""
        p, lag = self.parameters, self.model.lag
        if p.equivalent == "measured":
            return None
        reach = p.ks + (p.kappa * math.tanh(JUDGED_ERROR / 2.0) / p.phi if p.phi > 0.0 else 0.0)

        def of(s: Complex, late: Complex) -> tuple[Complex, Complex]:
            pull = (p.l1 + reach) * s**2 + (p.l2 + reach * p.l1) * s + reach * p.l2
            return pull * late, s**2 * (1.0 + lag * s)

        return of

    def more_constants(self) -> dict[str, Any]:
        """Return the constants of a form with more of them."""
        return {}
