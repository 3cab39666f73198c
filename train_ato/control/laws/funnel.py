"""Dynamic-surface funnel control with input delay and saturation, paper 003, eqs. (6)-(28), for the whole train.

Boundaries (funnels) limit the errors of position and speed. They narrow with time, and they widen while the force is at
its limit. The gain rises towards the boundary. A delay state removes the input delay from the speed error, and a
network estimates the resistance.

m is the inertia of the train. s and v are its mean position and speed, weighted by the shares of the units. The force
is split over the units::

    e1 = s - s_d,  e2 = v - alpha1 - h,  alpha_bar = -k1 e1 + v_d                                (6), (12), (20)
    k_i = k_i0/(1 - e_i²/phi_i²)                                                                  (12), (23)
    h' = -lam_h h + (u(t-tau) - u)/m,  h(0) = 0                                                   (21)
    u = m (-k2 e2 + alpha1') - m lam_h h + f_hat - d_hat                                          (23), (26)
    phi1' = P1 phi2 - a1 phi1 + beta1 - P1 beta2/a2                                               (7)
    phi2' = -a2 phi2 + beta2 + phi2 kappa/max(|e2|, delta),  kappa = |u - sat u|/m                (8), (9)
    f_hat = m (W'Phi(v) + eps),  W' = -gamma_w e2 Phi,  eps' = -gamma_eps e2                      (24)-(28)

``variant: corrected``:

1. lam_h in 1/s: lambda = 5 inside (...)/m in the paper gives a leak of 24 hours, e1 -> h/k1, and Theorem 1 does not
   hold. Choose lam_h tau <= 0.5.
2. e²/phi² is clipped at 0.5: outside the funnel the printed k_i become negative, the cause of "kilometres of error".
3. beta2 = 1e-4 (3 cm/s): no sampled loop stays inside the funnel of 9e-5 m/s of the paper.
4. alpha1' = a_d - k1 (v - v_d) in place of the 5 ms filter (13), which converts 0.1 m of noise into MN/s.
5. kappa is the excess at the present time: |u - sat u(t - tau)| of (9) (``kappa: printed``) also widens the funnel
   when u changes within the delay, without any saturation.
6. h uses sat(u), here the force sent and the force measured. Learning (in m/s², with the minus sign that (27), (28)
   lack) is held while the force is at a limit.

``variant: printed`` has the equations of the paper: (13) with Mh' = gamma_M |z| (19), sigma(t) = .001 exp(-.001 t) +
.0001, the leak, k_i0 = 1 and beta2 = 3e-7. It uses the unlimited u for h, now and a delay ago, and learns at a limit.
The sign of (27), (28) is corrected. e²/phi² is clipped as well, unless ``outside_funnel: printed`` allows negative
gains. After a saturation its dynamic funnel equals fixed gains k1 = k2 = 1 to four digits (phi2 grows like e^t and does
not return). ``funnel: prescribed`` narrows without regard to saturation; it is the comparison of the paper. ``fixed``
keeps the boundaries constant.

``feedforward: true`` takes f and m v_d' from the feed-forward of the compensation, which leads the command by delay and
lag. The delay state, which compares command and force of one time, is then not used.

Gains of the model: ``feedforward: true`` without delay state is the loop kp = k1 + k2, ki = k1 k2. With the delay state
e2 would have no delay, but e1 would have the loop kp = k1 + lam_h, ki = k1 lam_h behind the delay, and the speed would
be late after every change of the acceleration. The gains are k10 = k20 = kp/2.2 with the kp of `pid` on the same train,
because with ``clip: 0.1`` the gains rise by a tenth. The bias is the integral of e2 at bias_rate = kp²/64, a sixteenth
of critical. The part of the network that depends on the speed has no use on a known train (gamma_w = 0).

Needs: any train; several units are controlled as one. Inertia and shares; for ``resistance: model`` also the nominal
resistance and line. The delay state replaces a predictor (with one, set ``delay_state: false``). Compensations that
give only a feed-forward are rejected unless ``feedforward: true``.
"""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp, libm_pow
from plant_sim.record import Records, quantity
from train_ato.control.algorithms.loop_gains import LoopGains
from train_ato.control.algorithms.sliding import clamped
from train_ato.control.contract import LawInput, choice, flag, parameter
from train_ato.control.gains import gains_choice
from train_ato.control.guard import is_valid
from train_ato.control.law import LawForm, LawNow, LawUnit, RecordLaw, TrainConstants, train_resistance
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array

P1, A1, A2, BETA1, PRINTED_BETA2 = 1.05, 0.0035, 0.0034, 6e-4, 3e-7
"""Constants of the funnels (7), (8): 1, 1/s, 1/s, m/s, m/s²; values of paper 003."""
IOTA, GAMMA_M, PRINTED_LEAK = 0.005, 0.5, 5.0
"""Time constant of the filter (13) [s], rate of its bound (19), and lambda of (21): values of paper 003."""
MAX_FUNNEL = 1e4
"""Largest width of the funnels [m, m/s]."""
FILTER_STEP = 1e-3
"""Step of the printed filter (13) within a sample [s]."""


@dataclass(frozen=True)
class FunnelParameters:
    """Parameters of :class:`Funnel`."""

    gains: str = gains_choice()
    variant: str = choice("corrected, or as printed in the paper", "corrected", "printed")
    funnel: str = choice(
        "funnels widen in saturation, narrow regardless, or are constant", "dynamic", "prescribed", "fixed"
    )
    resistance: str = choice("f from the network, from the model, or both", "network", "model", "both")
    feedforward: bool = flag(
        "take f and m v_d' from the feed-forward of the compensation, without the delay state", default=False
    )
    k10: float = parameter(0.3, "1/s", 0.0, 100.0, "gain on the position error; 1 in variant printed")
    k20: float = parameter(0.7, "1/s", 0.0, 100.0, "gain on the speed error; 1 in variant printed")
    lam_h: float = parameter(5.0, "1/s", 0.0, 1e3, "leak of the delay state; .5/tau for an uncertain delay")
    delay_state: bool = flag("use the delay state h; not needed with a predictor", default=True)
    beta2: float = parameter(1e-4, "m/s²", 0.0, 1.0, "floor of the speed funnel times a2, corrected variant")
    phi1: float = parameter(0.5, "m", 1e-6, MAX_FUNNEL, "initial position funnel")
    phi2: float = parameter(0.1, "m/s", 1e-6, MAX_FUNNEL, "initial speed funnel")
    outside_funnel: str = choice("outside the funnel: clip e²/phi², or negative k_i as printed", "clip", "printed")
    clip: float = parameter(0.5, "1", 0.0, 0.999, "largest e²/phi²")
    kappa: str = choice("excess of (8): |u - sat u|, or |u - sat u(t - tau)| as printed in (9)", "present", "printed")
    delta: float = parameter(1e-3, "m/s", 1e-9, 10.0, "smallest |e2| in (8)")
    gamma_w: float = parameter(0.05, "1/s²", 0.0, 100.0, "learning rate of the network")
    bias_rate: float = parameter(0.3, "1/s²", 0.0, 100.0, "gamma_eps, learning rate of the bias of the network")
    rbf_centers: int = parameter(11, "1", 1, 101, "number of centres of the network")
    max_speed: float = parameter(
        100.0, "m/s", 1.0, 200.0, "speed of the last centre; the width is the distance of the centres"
    )
    weight_limit: float = parameter(2.0, "m/s²", 0.0, 100.0, "largest magnitude of a weight")


@dataclass(frozen=True)
class FunnelConstants(FunnelParameters, TrainConstants):
    """Constants of :func:`funnel_control`: its parameters and the values computed from them."""

    printed: bool = quantity("", "leak, filter, gains and learning as printed")
    is_fixed: bool = quantity("", "the funnels are constant")
    is_dynamic: bool = quantity("", "the speed funnel widens in saturation")
    printed_excess: bool = quantity("", "kappa as printed in (9)")
    negative_gains: bool = quantity("", "k_i of (12), (23) outside the funnel as printed")
    uses_delay_state: bool = quantity("", "h of (21) is used")
    uses_model: bool = quantity("", "f has the resistance of the model")
    uses_network: bool = quantity("", "f has the output of the network")
    leak: float = quantity("1/s", "lam_h")
    decay: float = quantity("1", "part of h that is left after a period")
    charge: float = quantity("s", "h per difference of acceleration after a period")
    narrow: float = quantity("1", "part of phi2 above its floor that is left after a period")
    width: float = quantity("m/s", "width of the Gaussian functions, distance of the centres")
    filter_steps: int = quantity("1", "number of steps of the printed filter in a period")
    late: int = quantity("1", "number of periods in the delay")
    two: float = quantity("1", "2; for a number in the code the compiler calls no pow, with other last bits")
    period: float = quantity("s", "control period")


@dataclass
class FunnelState:
    """State of :func:`funnel_control`: that of the train in the first record; lists in as many records as they need."""

    weight: float = quantity("m/s²", "weight of the centre with the number of the record")
    excess: float = quantity("N", "u - sat u as many periods ago as the number of the record, of the oldest first")
    bias: float = quantity("m/s²", "bias of the network")
    phi1: float = quantity("m", "position funnel")
    phi2: float = quantity("m/s", "speed funnel")
    h: float = quantity("m/s", "delay state")
    wanted: float = quantity("N", "u of the last step")
    alpha: float = quantity("m/s", "output of the printed filter")
    bound: float = quantity("1", "Mh of (19)")
    t: float = quantity("s", "time of the printed filter")
    stored: int = quantity("1", "number of records with an excess")
    stepped: bool = quantity("", "there was a step")
    known: bool = quantity("", "the output of the printed filter is known")


@compiled
def funnel_gain(p: FunnelConstants, gain: float, error: float, boundary: float) -> float:
    """Return k_i of (12), (23) [1/s] for an error and its boundary."""
    inside = libm_pow(error / boundary, p.two)
    if p.negative_gains:
        return float(gain / (1.0 - inside) if abs(1.0 - inside) > 1e-9 else gain * 1e9)
    return float(gain / (1.0 - (p.clip if p.clip < inside else inside)))


@compiled
def advance_delay_state(p: FunnelConstants, state: Records[FunnelState], sent: float, acting: float) -> None:
    """Integrate h of (21) over the last sample, with the last command and the acting force of the train [N]."""
    own = state[0]
    if not (own.stepped and p.uses_delay_state):
        return
    if p.printed:
        if own.stored > p.late:
            for entry in range(p.late):
                state[entry].excess = state[entry + 1].excess
            own.stored = p.late
        state[own.stored].excess = own.wanted - sent
        own.stored += 1
        sent, acting = own.wanted, acting + own.excess
    own.h = p.decay * own.h + p.charge * ((acting - sent) / p.inertia)


@compiled
def surface_speed(p: FunnelConstants, own: FunnelState, aim: float, slope: float) -> tuple[float, float]:
    """Return alpha1 [m/s] and its derivative [m/s²]: those of the aim, or of the printed filter (13), (19).

    The filter is faster than most samples. Its derivative is the mean over the sample, because the filter settles
    within the sample. After a gap the filter starts settled, with the slope of the aim.
    """
    if not p.printed:
        return aim, slope
    fresh = not own.known
    if fresh:
        own.alpha, own.known = aim, True
    step, before = p.period / p.filter_steps, own.alpha
    for _ in range(p.filter_steps):
        z = own.alpha - aim
        sigma = 1e-3 * libm_exp(-1e-3 * own.t) + 1e-4
        root = math.sqrt(libm_pow(own.bound * z, p.two) + sigma * sigma)
        rate = -z / IOTA - libm_pow(own.bound, p.two) * z / root
        grown = own.bound + step * GAMMA_M * abs(z)
        own.bound = MAX_FUNNEL if grown > MAX_FUNNEL else grown
        own.alpha += step * rate
        own.t += step
    return own.alpha, slope if fresh else (own.alpha - before) / p.period


@compiled
def learnt_resistance(p: FunnelConstants, state: Records[FunnelState], held: bool, speed: float, error: float) -> float:
    """Return the output of the network (24) [m/s²]; weights and bias learn by (27), (28)."""
    own, scale, found = state[0], -0.5 / (p.width * p.width), 0.0
    for j in range(p.rbf_centers):
        found += state[j].weight * libm_exp(scale * (speed - j * p.width) * (speed - j * p.width))
    found += own.bias
    if not held:
        rate, limit = -p.gamma_w * error * p.period, p.weight_limit
        for j in range(p.rbf_centers):
            hidden = libm_exp(scale * (speed - j * p.width) * (speed - j * p.width))
            state[j].weight = clamped(state[j].weight + rate * hidden, -limit, limit)
        own.bias = clamped(own.bias - p.bias_rate * error * p.period, -limit, limit)
    return found


@compiled
def widen(p: FunnelConstants, own: FunnelState, wanted: float, possible: float, limited: bool, error: float) -> None:
    """Integrate the funnels (7), (8) over the next sample.

    Parameters
    ----------
    p, own
        Constants and state of the train.
    wanted, possible
        u, and the part of it that is possible [N].
    limited
        u is not possible.
    error
        e2 [m/s].
    """
    if p.is_fixed:
        return
    beta2 = PRINTED_BETA2 if p.printed else p.beta2
    before, rest = own.phi2, beta2 / A2
    wide = (before - rest) * p.narrow + rest
    if p.is_dynamic and limited:
        grow = abs(wanted - possible) / p.inertia / (p.delta if p.delta > abs(error) else abs(error))
        wide *= libm_exp(20.0 if grow * p.period > 20.0 else grow * p.period)
    own.phi2 = MAX_FUNNEL if wide > MAX_FUNNEL else wide
    slope = P1 * before - A1 * own.phi1 + BETA1 - P1 * beta2 / A2
    own.phi1 = clamped(own.phi1 + p.period * slope, BETA1 / A1, MAX_FUNNEL)


@compiled
def funnel_control(p: FunnelConstants, state: Records[FunnelState], now: LawNow, units: Records[LawUnit]) -> None:
    """Compute the demand of dynamic-surface funnel control, (6), (12), (20), (23): the part of every unit [N]."""
    own, k10, k20 = state[0], 1.0 if p.printed else p.k10, 1.0 if p.printed else p.k20
    off = speed = target = pull = sent = acting = known = estimate = low = high = 0.0
    held = False
    for x in units:
        off += x.share * (x.position - x.reference_position)
        speed += x.share * x.velocity
        target += x.share * x.reference_velocity
        pull += x.share * x.reference_acceleration
        sent += x.force
        acting += x.applied
        known += x.feedforward
        estimate += x.disturbance
        low += x.force_min
        high += x.force_max
        held = held or x.saturated
    if p.feedforward:
        pull = 0.0
    advance_delay_state(p, state, sent, acting)
    k1 = funnel_gain(p, k10, off, own.phi1)
    alpha, rate = surface_speed(p, own, target - k1 * off, pull - k1 * (speed - target))
    error = speed - alpha - own.h
    k2 = funnel_gain(p, k20, error, own.phi2)
    resistance = known if p.feedforward else train_resistance(p, now, speed) if p.uses_model else 0.0
    if p.uses_network:
        resistance += p.inertia * learnt_resistance(p, state, held and not p.printed, speed, error)
    wanted = p.inertia * (rate - k2 * error - p.leak * own.h) + resistance
    wanted -= estimate
    limited = p.printed_excess or not low <= wanted <= high
    widen(p, own, wanted, acting if p.printed_excess else clamped(wanted, low, high), limited, error)
    own.wanted, own.stepped = wanted, True
    for x in units:
        x.wanted = wanted * x.share


class Funnel(RecordLaw):
    """Dynamic-surface funnel control with a delay state and a network (paper 003)."""

    Parameters: ClassVar[type] = FunnelParameters
    form = LawForm(funnel_control, FunnelConstants, FunnelState)
    uses_effect = False

    @classmethod
    def model_gains(cls, model: TrainModel, period: float) -> dict[str, Any]:
        """Return the parameters with the bandwidth of `pid` on the same train."""
        kp = LoopGains.of(model, period).speed
        return {
            "k10": kp / 2.2, "k20": kp / 2.2, "clip": 0.1, "gamma_w": 0.0, "bias_rate": kp * kp / 64.0,
            "feedforward": True,
        }  # fmt: skip

    def __init__(self, parameters: FunnelParameters, model: TrainModel, period: float) -> None:
        late, p = round(float(model.delay.mean()) / period), parameters
        super().__init__(parameters, model, period, rows=max(p.rbf_centers, 1 + late))
        self.uses_feedforward, self.feedforward_hint = p.feedforward, "feedforward: true"
        self.uses_train_forces = uses_model = p.resistance != "network" and not p.feedforward
        printed = p.variant == "printed"
        leak = PRINTED_LEAK / model.inertia if printed else p.lam_h
        self.state["phi1"][0], self.state["phi2"][0] = p.phi1, p.phi2
        self.set_constants(
            printed=printed,
            is_fixed=p.funnel == "fixed",
            is_dynamic=p.funnel == "dynamic",
            printed_excess=p.kappa == "printed",
            negative_gains=p.outside_funnel == "printed",
            uses_delay_state=p.delay_state and not p.feedforward,
            uses_model=uses_model,
            uses_network=p.resistance != "model",
            leak=leak,
            decay=math.exp(-leak * period),
            charge=-math.expm1(-leak * period) / leak if leak > 0.0 else period,
            narrow=math.exp(-A2 * period),
            width=p.max_speed / max(1, p.rbf_centers - 1),
            filter_steps=max(1, math.ceil(period / FILTER_STEP - 1e-9)),
            late=late,
            two=2.0,
        )

    def feedback(self) -> tuple[float, float] | None:
        """Return the gains on the errors of speed [1/s] and position [1/s²] at no error, None with the delay state."""
        p = self.parameters
        return (p.k10 + p.k20, p.k10 * p.k20) if p.feedforward and p.variant == "corrected" else None

    def take_over(self, inputs: LawInput, force: Array) -> None:
        """Begin with the nominal resistance in the empty network; the rest of the last command [N] may not last.

        The funnels are narrow, as in a run of this law: those of its begin are for errors that a new law does not have.
        """
        super().take_over(inputs, force)
        if not (self.parameters.variant == "printed" or self.parameters.funnel == "fixed"):
            self.state["phi1"][0], self.state["phi2"][0] = BETA1 / A1, self.parameters.beta2 / A2
        if self.uses_feedforward or self.parameters.resistance != "network" or not is_valid(inputs):
            return
        place, speed = self.model.front(inputs.position), self.mean(inputs.velocity.tolist())
        bias = self.model.resisting_force(place, speed, inputs.train_shoe_force) / self.model.inertia
        self.state["bias"][0] = min(max(bias, -self.parameters.weight_limit), self.parameters.weight_limit)
