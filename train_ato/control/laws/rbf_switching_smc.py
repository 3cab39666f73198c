"""Sliding mode with a switching term learnt by an RBF network, paper 001, eqs. (6)-(14).

A sliding mode switches by its full gain at every crossing of the surface, which causes chattering. Here a network
learns the switching term as a smooth function of the surface.

Each unit has e = x - x_d and s = c e + e' (7). All terms are accelerations, and M is the unit's share of the inertia of
the train::

    u = u_eq + M u_n - d_hat                                                                            (12)
    u_eq = u_ff - M c e'                                        u_ff: v_d', resistance, delay and lag    (9)
    u_n = sum w_j h_j,  h_j = exp(-(q - r_j)²/(2 d²)),  q = clip(s/phi, -1, 1),  r = (-1 -.5 0 .5 1)    (11), (12)
    w_j(0) = -0.9 k_w r_j;  dw_j = -eta Tc s (ds/du) h_j;  w(l) = w(l-1) + dw + alpha (w(l-1) - w(l-2))  (13)
    e''_hat = sum v_j b_j(u(l-1), e''(l-1), e''(l-2)),  dv_j = +eta_v (e'' - e''_hat) b_j                (14)

``switching: sign`` is (9), -k_w sgn(s); ``tanh`` is the smooth form -k_w tanh(s/phi).

Corrections:

* The paper uses measured derivatives and its own a_s' in u_eq. This is unstable, as ``derivatives: measured`` shows.
  That form has corrected coefficients of (5), and it adds the resistance, which (9) lacks. By default u_eq is the
  feed-forward that the compensation computes from the *reference* (`pade`: eq. (5) corrected; `preview`: exact).
* k = -269 is interpreted as kN on 192 t: k_w = 1.40 m/s².
* The printed equations lack the minus sign, h_j and b_j. They use E = e''²/2 as objective and e'' as input, which
  drifts by tens of metres. Here E is s²/2. ``objective: printed_acceleration`` is the printed form, to reproduce the
  drift.
* eta = 0.6 per sample is an integrator of 0.6/Tc; here eta is a rate, multiplied by Tc.
* Inputs and target of the networks are clipped (``clip``), because they would have no response to large errors. Weights
  are bounded, and held while the force is at a limit (``anti_windup``).
* The first input of the identification network is u_n. The paper uses u (``rbfi_input: command``), which contains the
  acceleration of the profile. e'' does not respond to this part.
* The identification network supplies only the sign of ds/du (``sensitivity``). With a delay its inputs and outputs do
  not correspond. Therefore its sign is used only while the network has explained e'' for some time. Otherwise the
  physical sign (+) is used.

Gains of the model: with the initial weights u_n is -2.07 k_w s/phi near s = 0, so that kp = c + 2.07 k_w/phi and ki = c
2.07 k_w/phi. Both parts are kp/2 with the kp of `pid` on the same train. This gives ki = kp²/4, with phi = 2 m/s. u_n
integrates s at the rate 1.77 eta, and s decays at kp/2. eta is a sixteenth of (kp/2)²/1.77. The weights may add half of
the strongest acceleration of the train. ``identify: false`` is used, because with a delay the sign of ds/du is not in
the samples.

Needs: any train; the feed-forward of a compensation (`preview`, `pade`, `twin` or `predictor` for lag and delay, none
for ``derivatives: measured``), inertia and shares. It needs no coupler sensor.
"""

from dataclasses import dataclass
from math import inf
from typing import Any, ClassVar

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp, libm_tanh, plain_sum
from plant_sim.railway import fading_resistance
from plant_sim.record import Records, quantity
from train_ato.control.algorithms.loop_gains import LoopGains
from train_ato.control.algorithms.sliding import RBF_CENTERS, clamped, move_weights, saturation, weighted
from train_ato.control.compensation.pade import pade_coefficients
from train_ato.control.contract import choice, flag, parameter
from train_ato.control.gains import gains_choice
from train_ato.control.law import LawForm, LawNow, LawUnit, RecordLaw, TrainConstants
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array

CENTRES = len(RBF_CENTERS)
"""Number of centres of both networks."""
IDENTIFIED_LIMIT = 10.0
"""Largest magnitude of a weight of RBFI."""
IDENTIFIED_WIDTH = 0.5
"""Width of the Gaussian functions of RBFI."""
MAX_UNEXPLAINED = 0.2
"""Mean unexplained part of e'' up to which the sign of RBFI is used."""
INITIAL_WEIGHT = -0.9
"""Initial weight w_j(0) over k_w r_j."""
START_SLOPE = 2.066
"""Slope of -u_n/k_w over s/phi at s = 0 with the initial weights and d = 0.5."""
START_RATE = 1.77
"""Sum of h_j² at s = 0 with d = 0.5: a rate eta of the weights is START_RATE eta of u_n."""


@dataclass(frozen=True)
class RbfSwitchingSmcParameters:
    """Parameters of :class:`RbfSwitchingSmc`."""

    gains: str = gains_choice()
    c: float = parameter(0.4, "1/s", 0.0, 100.0, "weight of the position error in the surface")
    k_w: float = parameter(1.40, "m/s²", 0.0, 100.0, "switching gain")
    phi: float = parameter(2.0, "m/s", 1e-6, 1e3, "surface from which the input of the network is clipped")
    switching: str = choice("switching term: learnt, smooth, or a relay", "rbf", "tanh", "sign")
    objective: str = choice("objective of the learning; printed_acceleration drifts", "surface", "printed_acceleration")
    width: float = parameter(0.5, "1", 1e-3, 100.0, "d, width of the Gaussian functions of RBFC")
    eta: float = parameter(0.05, "1/s²", 0.0, 1e3, "learning rate of RBFC; times Tc per sample")
    alpha: float = parameter(0.05, "1", 0.0, 0.99, "momentum of both networks")
    identify: bool = flag("take the sign of ds/du from RBFI", default=True)
    clip: bool = flag("clip inputs and target of the networks to +-1; false in the paper", default=True)
    anti_windup: bool = flag("hold the weights while the force is at a limit; false in the paper", default=True)
    sensitivity: str = choice("slope by RBFI in (13): its sign, or its value as in the paper", "sign", "value")
    derivatives: str = choice("derivatives in u_eq: of the profile, or measured as in the paper", "profile", "measured")
    rbfi_input: str = choice(
        "first input of RBFI: the switching term, or u(l-1) as in the paper", "switching", "command"
    )
    eta_v: float = parameter(0.05, "1", 0.0, 1.0, "learning rate of RBFI, per sample")
    weight_limit: float = parameter(3.0, "m/s²", 0.0, 1e3, "largest magnitude of a weight")


@dataclass(frozen=True)
class RbfSwitchingConstants(RbfSwitchingSmcParameters, TrainConstants):
    """Constants of :func:`rbf_switching_smc`: its parameters and the values computed from them."""

    relay: bool = quantity("", "the switching term is a relay")
    smooth: bool = quantity("", "the switching term is tanh")
    by_value: bool = quantity("", "the slope of RBFI by its value")
    of_acceleration: bool = quantity("", "the objective of the learning is the printed e''")
    of_command: bool = quantity("", "the first input of RBFI is the whole command")
    measured: bool = quantity("", "u_eq has the measured derivatives")
    reach: float = quantity("m/s²", "largest magnitude of inputs and target of RBFI")
    period: float = quantity("s", "control period")


@dataclass
class RbfSwitchingUnit:
    """State of :func:`rbf_switching_smc` for one unit."""

    mass: float = quantity("kg", "share of the train's inertia")
    pade: Array = quantity("s², s, s", "b1, b2, b3 of (5) for the delay of the unit", 3)
    weights: Array = quantity("m/s²", "w, weights of RBFC", CENTRES)
    moved: Array = quantity("m/s²", "last step of the weights of RBFC", CENTRES)
    identified: Array = quantity("m/s²", "v, weights of RBFI", CENTRES)
    identified_moved: Array = quantity("m/s²", "last step of the weights of RBFI", CENTRES)
    acceleration: float = quantity("m/s²", "e'' of the last step")
    acceleration_before: float = quantity("m/s²", "e'' of the step before")
    size: float = quantity("m²/s⁴", "mean square of e''")
    missing: float = quantity("m²/s⁴", "mean square of the part of e'' that RBFI does not explain")
    slope: float = quantity("1", "derivative of the prediction of RBFI by the command")
    pull: float = quantity("m/s²", "u_n of the last step")
    rate: float = quantity("m/s", "speed error of the last step")
    speed: float = quantity("m/s", "speed of the last step")
    sent: float = quantity("m/s²", "command before the last step")
    actuated: float = quantity("m/s²", "acceleration by the actuator in the last step")
    actuated_before: float = quantity("m/s²", "the same in the step before")
    samples: int = quantity("1", "number of speeds since a gap")
    known: bool = quantity("", "the speed error of the last step is known")


@compiled
def identified_sign(p: RbfSwitchingConstants, own: RbfSwitchingUnit, command: float, acceleration: float) -> float:
    """Return the sign of ds/du by RBFI: +1, or -1 if well established; its weights learn by (14).

    Parameters
    ----------
    p, own
        Constants, and state of the unit.
    command
        Last command [m/s²].
    acceleration
        e'' that followed it [m/s²].
    """
    x = clamped(command, -p.reach, p.reach)
    y, z = clamped(own.acceleration, -p.reach, p.reach), clamped(own.acceleration_before, -p.reach, p.reach)
    hidden, scale = np.empty(CENTRES), -0.5 / (IDENTIFIED_WIDTH * IDENTIFIED_WIDTH)
    for j in range(CENTRES):
        c = RBF_CENTERS[j]
        hidden[j] = libm_exp(scale * ((x - c) * (x - c) + (y - c) * (y - c) + (z - c) * (z - c)))
    miss = clamped(acceleration, -p.reach, p.reach) - weighted(own.identified, hidden)
    move_weights(own.identified, own.identified_moved, hidden, p.eta_v * miss, p.alpha, IDENTIFIED_LIMIT)
    own.acceleration_before, own.acceleration = own.acceleration, acceleration
    own.size += 0.01 * (acceleration * acceleration - own.size)
    own.missing += 0.01 * (miss * miss - own.missing)
    slope = 0.0
    for j in range(CENTRES):
        slope += own.identified[j] * hidden[j] * (RBF_CENTERS[j] - x)
    own.slope = slope / (IDENTIFIED_WIDTH * IDENTIFIED_WIDTH)
    return -1.0 if own.missing < MAX_UNEXPLAINED * MAX_UNEXPLAINED * own.size and slope < 0.0 else 1.0


@compiled
def switching_term(
    p: RbfSwitchingConstants, own: RbfSwitchingUnit, held: bool, surface: float, command: float, acceleration: float
) -> float:
    """Return u_n of (12) [m/s²], or a form without network; the weights learn by (13)."""
    if p.relay:
        return float(-p.k_w * saturation(surface, 0.0))
    if p.smooth:
        return float(-p.k_w * libm_tanh(surface / p.phi))
    gain = 1.0
    if p.identify:
        gain = identified_sign(p, own, command, acceleration)
        if p.by_value:
            gain = own.slope
    aim, push = surface / p.phi, surface
    if p.of_acceleration:
        aim, push = acceleration, acceleration
    if p.clip:
        aim = clamped(aim, -1.0, 1.0)
    hidden, scale = np.empty(CENTRES), -0.5 / (p.width * p.width)
    for j in range(CENTRES):
        hidden[j] = libm_exp(scale * (aim - RBF_CENTERS[j]) * (aim - RBF_CENTERS[j]))
    if not held:
        move_weights(own.weights, own.moved, hidden, -p.eta * p.period * push * gain, p.alpha, p.weight_limit)
    return float(weighted(own.weights, hidden))


@compiled
def measured_equivalent(p: RbfSwitchingConstants, own: RbfSwitchingUnit, x: LawUnit) -> float:
    """Return u_eq of (9) without the speed error [m/s²], from measured derivatives by backward differences.

    With y = v' + w the acceleration by the actuator, w the specific resistance of the nominal train, (5) solved for the
    command is a_s = y - b1 y'' - b2 y' - b3 a_s'; the first y has the acceleration of the profile.
    """
    h, resistance = p.period, fading_resistance(p.running_0, p.running_1, p.running_2, x.velocity) / p.inertia
    sent, found = x.force / own.mass, x.reference_acceleration + resistance
    y = (x.velocity - own.speed) / h + resistance
    own.samples = own.samples + 1 if own.known else 1
    if own.samples > 3:  # three accelerations need four speeds
        bend = y - 2.0 * own.actuated + own.actuated_before
        found = found - own.pade[0] * bend / (h * h) - own.pade[1] * (y - own.actuated) / h
        found = found - own.pade[2] * ((sent - own.sent) / h)
    own.speed, own.sent, own.actuated_before, own.actuated = x.velocity, sent, own.actuated, y
    return float(found)


@compiled
def rbf_switching_smc(
    p: RbfSwitchingConstants, state: Records[RbfSwitchingUnit], now: LawNow, units: Records[LawUnit]
) -> None:
    """Compute the demand of sliding mode with a learnt switching term: (12) [N]."""
    for u in range(units.size):
        x, own = units[u], state[u]
        error, rate = x.position - x.reference_position, x.velocity - x.reference_velocity
        acceleration = (rate - own.rate) / p.period if own.known else 0.0
        known = own.mass * measured_equivalent(p, own, x) if p.measured else x.feedforward
        command = x.force / own.mass if p.of_command else own.pull
        held = x.saturated and p.anti_windup
        own.pull = switching_term(p, own, held, p.c * error + rate, command, acceleration)
        own.known, own.rate = True, rate
        x.wanted = known - x.disturbance + own.mass * (own.pull - p.c * rate)


class RbfSwitchingSmc(RecordLaw):
    """Sliding mode with a switching term learnt by an RBF network (paper 001)."""

    Parameters: ClassVar[type] = RbfSwitchingSmcParameters
    form = LawForm(rbf_switching_smc, RbfSwitchingConstants, RbfSwitchingUnit)
    uses_effect = uses_train_forces = False

    @classmethod
    def model_gains(cls, model: TrainModel, period: float) -> dict[str, Any]:
        """Return the parameters with the bandwidth of `pid` on the same train."""
        kp, phi = LoopGains.of(model, period).speed, 2.0
        k_w = kp * phi / (2.0 * START_SLOPE)
        strongest = plain_sum(max(t.largest(), b.largest()) for t, b in zip(model.traction, model.brake, strict=True))
        return {
            "c": kp / 2.0, "k_w": k_w, "phi": phi, "eta": kp * kp / (64.0 * START_RATE), "identify": False,
            "weight_limit": k_w + 0.5 * strongest / model.inertia,
        }  # fmt: skip

    def __init__(self, parameters: RbfSwitchingSmcParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        p, state, centres = parameters, self.state, np.array(RBF_CENTERS)
        measured = p.derivatives == "measured"
        self.uses_feedforward, self.feedforward_hint = not measured, "derivatives: profile"
        state["mass"], state["slope"] = model.inertia * model.share, 1.0
        state["pade"] = [pade_coefficients(model.lag, delay) for delay in model.delay.tolist()]
        state["weights"], state["identified"] = INITIAL_WEIGHT * p.k_w * centres, 0.5 * centres
        self.set_constants(
            relay=p.switching == "sign",
            smooth=p.switching == "tanh",
            by_value=p.sensitivity == "value",
            of_acceleration=p.objective == "printed_acceleration",
            of_command=p.rbfi_input == "command",
            measured=measured,
            reach=1.0 if p.clip else inf,
        )

    def feedback(self) -> tuple[float, float] | None:
        """Return the gains on the errors of speed [1/s] and position [1/s²], None for a form without the rule."""
        p = self.parameters
        if p.derivatives == "measured" or p.switching == "sign" or p.width != 0.5:
            return None
        learnt = min(p.k_w, -p.weight_limit / INITIAL_WEIGHT) * START_SLOPE
        slope = (learnt if p.switching == "rbf" else p.k_w) / p.phi
        return p.c + slope, p.c * slope
