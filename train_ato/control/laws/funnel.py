"""Dynamic-surface funnel control with input delay and saturation, paper 003, eqs. (6)-(28), for the whole train.

Boundaries (funnels) limit the errors of position and speed; they narrow with time and widen while the force is at its
limit, and the gain rises towards the boundary. A delay state removes the input delay from the speed error, and a
network estimates the resistance.

m the inertia of the train, s and v its mean position and speed (weighted by the shares of the units), the force split
over the units::

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

``variant: printed`` keeps (13) with Mh' = gamma_M |z| (19), sigma(t) = .001 exp(-.001 t) + .0001, the leak, k_i0 = 1,
beta2 = 3e-7, uses the unlimited u for h, now and a delay ago, and learns at a limit; the sign of (27), (28) is
corrected and e²/phi² clipped as well, unless ``outside_funnel: printed`` allows negative gains. After a saturation its
dynamic funnel equals fixed gains k1 = k2 = 1 to four digits (phi2 grows like e^t and does not return).
``funnel: prescribed`` narrows without regard to saturation, the comparison of the paper; ``fixed`` keeps the boundaries
constant.

``feedforward: true`` takes f and m v_d' from the feed-forward of the compensation, which leads the command by delay and
lag. The delay state, which compares command and force of one time, is then not used.

Gains of the model: ``feedforward: true`` without delay state is the loop kp = k1 + k2, ki = k1 k2. (With the delay
state e2 has no delay, but e1 has the loop kp = k1 + lam_h, ki = k1 lam_h behind the delay, and the speed is late after
every change of the acceleration.) From the kp of `pid` on the same train k10 = k20 = kp/2.2, because with ``clip: 0.1``
the gains rise by a tenth. The bias is the integral of e2 at bias_rate = kp²/64, a sixteenth of critical; the part of
the network that depends on the speed has no use on a known train (gamma_w = 0).

Needs: any train; several units are controlled as one. Inertia and shares; for ``resistance: model`` also the nominal
resistance and line. The delay state replaces a predictor (with one, set ``delay_state: false``). Compensations that
give only a feed-forward are rejected unless ``feedforward: true``.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from operator import sub
from typing import TYPE_CHECKING, Any, ClassVar

from plant_sim.summation import plain_sum
from train_ato.control.algorithms.guard import GuardedLaw, is_valid
from train_ato.control.algorithms.loop_gains import LoopGains
from train_ato.control.algorithms.rbf import Weights, activations
from train_ato.control.contract import LawInput, parameter
from train_ato.control.gains import gains_choice
from train_ato.messages.types import Array

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel

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
    variant: str = parameter(
        "corrected", "", 0, 0, "corrected, or as printed in the paper", choices=("corrected", "printed")
    )
    funnel: str = parameter(
        "dynamic", "", 0, 0, "funnels widen in saturation, narrow regardless, or are constant",
        choices=("dynamic", "prescribed", "fixed"),
    )  # fmt: skip
    resistance: str = parameter(
        "network", "", 0, 0, "f from the network, from the model, or both", choices=("network", "model", "both")
    )
    feedforward: bool = parameter(
        False, "", 0, 1, "take f and m v_d' from the feed-forward of the compensation, without the delay state"
    )
    k10: float = parameter(0.3, "1/s", 0.0, 100.0, "gain on the position error; 1 in variant printed")
    k20: float = parameter(0.7, "1/s", 0.0, 100.0, "gain on the speed error; 1 in variant printed")
    lam_h: float = parameter(5.0, "1/s", 0.0, 1e3, "leak of the delay state; .5/tau for an uncertain delay")
    delay_state: bool = parameter(True, "", 0, 1, "use the delay state h; not needed with a predictor")
    beta2: float = parameter(1e-4, "m/s²", 0.0, 1.0, "floor of the speed funnel times a2, corrected variant")
    phi1: float = parameter(0.5, "m", 1e-6, MAX_FUNNEL, "initial position funnel")
    phi2: float = parameter(0.1, "m/s", 1e-6, MAX_FUNNEL, "initial speed funnel")
    outside_funnel: str = parameter(
        "clip", "", 0, 0, "outside the funnel: clip e²/phi², or negative k_i as printed",
        choices=("clip", "printed"),
    )  # fmt: skip
    clip: float = parameter(0.5, "1", 0.0, 0.999, "largest e²/phi²")
    kappa: str = parameter(
        "present", "", 0, 0, "excess of (8): |u - sat u|, or |u - sat u(t - tau)| as printed in (9)",
        choices=("present", "printed"),
    )  # fmt: skip
    delta: float = parameter(1e-3, "m/s", 1e-9, 10.0, "smallest |e2| in (8)")
    gamma_w: float = parameter(0.05, "1/s²", 0.0, 100.0, "learning rate of the network")
    bias_rate: float = parameter(0.3, "1/s²", 0.0, 100.0, "gamma_eps, learning rate of the bias of the network")
    rbf_centers: int = parameter(11, "1", 1, 101, "number of centres of the network")
    max_speed: float = parameter(
        100.0,
        "m/s",
        1.0,
        200.0,
        "speed of the last centre; the width is the distance of the centres",
    )
    weight_limit: float = parameter(2.0, "m/s²", 0.0, 100.0, "largest magnitude of a weight")


class Funnel(GuardedLaw):
    """Dynamic-surface funnel control with a delay state and a network (paper 003)."""

    Parameters: ClassVar[type] = FunnelParameters

    @classmethod
    def model_gains(cls, model: TrainModel, period: float) -> dict[str, Any]:
        """Return the parameters with the bandwidth of `pid` on the same train.

        Parameters
        ----------
        model
            The train.
        period
            Control period [s].
        """
        kp = LoopGains.of(model, period).speed
        return {
            "k10": kp / 2.2, "k20": kp / 2.2, "clip": 0.1, "gamma_w": 0.0, "bias_rate": kp * kp / 64.0,
            "feedforward": True,
        }  # fmt: skip

    def __init__(self, parameters: FunnelParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        p = parameters
        self.uses_feedforward, self.feedforward_hint = p.feedforward, "feedforward: true"
        self._uses_delay_state = p.delay_state and not p.feedforward
        self._printed = p.variant == "printed"
        self._k10, self._k20, self._beta2 = (1.0, 1.0, PRINTED_BETA2) if self._printed else (p.k10, p.k20, p.beta2)
        leak = PRINTED_LEAK / model.inertia if self._printed else p.lam_h
        self._leak = leak
        self._decay = math.exp(-leak * period)
        self._charge = -math.expm1(-leak * period) / leak if leak > 0.0 else period
        self._width = p.max_speed / max(1, p.rbf_centers - 1)
        self._clip, self._negative_gains = float(p.clip), p.outside_funnel == "printed"
        self._narrow = math.exp(-A2 * period)
        self._centres = [index * self._width for index in range(p.rbf_centers)]
        self._weights = Weights([0.0] * p.rbf_centers, p.weight_limit)
        self.clear_state()

    def clear_state(self) -> None:
        """Reset funnels, delay state and network."""
        self._weights.reset()
        self._bias = 0.0
        self.phi1, self.phi2 = self.parameters.phi1, self.parameters.phi2
        self._h, self._bound, self._t = 0.0, 0.0, 0.0
        self._alpha: float | None = None
        self._wanted: float | None = None
        self._excess: deque[float] = deque(maxlen=1 + round(float(self.model.delay.mean()) / self.period))

    def on_missed_sample(self) -> None:
        """Handle a missed sample: the filter restarts at the next one."""
        self._alpha = None

    def take_over(self, inputs: LawInput, force: Array) -> None:
        """Begin with the nominal resistance in the empty network; the rest of the last command [N] may not last."""
        super().take_over(inputs, force)
        if self.uses_feedforward or self.parameters.resistance != "network" or not is_valid(inputs):
            return
        place, speed = self.model.front(inputs.position), self.mean(inputs.velocity.tolist())
        bias = self.model.resisting_force(place, speed, inputs.train_shoe_force) / self.model.inertia
        self._bias = min(max(bias, -self.parameters.weight_limit), self.parameters.weight_limit)

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force demand of every unit [N]."""
        mass = self.model.inertia
        place_error = self.mean(list(map(sub, inputs.position.tolist(), inputs.reference_position.tolist())))
        speed, target = self.mean(inputs.velocity.tolist()), self.mean(inputs.reference_velocity.tolist())
        pull = 0.0 if self.uses_feedforward else self.mean(inputs.reference_acceleration.tolist())
        self._advance_delay_state(inputs)
        k1 = self._gain(self._k10, place_error, self.phi1)
        alpha, rate = self._surface(target - k1 * place_error, pull - k1 * (speed - target))
        error = speed - alpha - self._h
        k2 = self._gain(self._k20, error, self.phi2)
        wanted = mass * (rate - k2 * error - self._leak * self._h) + self._resistance(inputs, speed, error)
        wanted -= plain_sum(inputs.disturbance.tolist())
        self._widen(wanted, error, inputs)
        self._wanted = wanted
        return [wanted * share for share in self.share]

    def _advance_delay_state(self, inputs: LawInput) -> None:
        """Integrate the delay state (21) over the last sample."""
        if self._wanted is None or not self._uses_delay_state:
            return
        sent, acting = plain_sum(self._last_force), plain_sum(inputs.applied.tolist())
        if self._printed:
            self._excess.append(self._wanted - sent)
            sent, acting = self._wanted, acting + self._excess[0]
        missing = (acting - sent) / self.model.inertia
        self._h = self._decay * self._h + self._charge * missing

    def _gain(self, gain: float, error: float, boundary: float) -> float:
        inside = (error / boundary) ** 2
        if self._negative_gains:
            return gain / (1.0 - inside) if abs(1.0 - inside) > 1e-9 else gain * 1e9
        return gain / (1.0 - min(inside, self._clip))

    def _surface(self, aim: float, slope: float) -> tuple[float, float]:
        """Return alpha1 [m/s] and its derivative [m/s²]: those of the aim, or of the printed filter (13), (19).

        The filter is faster than most samples. Its derivative is the mean over the sample, because the filter settles
        within the sample. After a gap the filter starts settled, with the slope of the aim.
        """
        if not self._printed:
            return aim, slope
        fresh = self._alpha is None
        if self._alpha is None:
            self._alpha = aim
        count = max(1, math.ceil(self.period / FILTER_STEP - 1e-9))
        h, before = self.period / count, self._alpha
        for _ in range(count):
            z = self._alpha - aim
            sigma = 1e-3 * math.exp(-1e-3 * self._t) + 1e-4
            rate = -z / IOTA - self._bound**2 * z / math.sqrt((self._bound * z) ** 2 + sigma * sigma)
            self._bound = min(self._bound + h * GAMMA_M * abs(z), MAX_FUNNEL)
            self._alpha += h * rate
            self._t += h
        return self._alpha, slope if fresh else (self._alpha - before) / self.period

    def _resistance(self, inputs: LawInput, speed: float, error: float) -> float:
        """Return f_hat [N] and update the weights."""
        p = self.parameters
        model = self.model
        force = 0.0
        if self.uses_feedforward:
            force = plain_sum(inputs.feedforward.tolist())
        elif p.resistance != "network":
            force = model.resisting_force(model.front(inputs.position), speed, inputs.train_shoe_force)
        if p.resistance == "model":
            return force
        hidden = activations((speed,), self._centres, self._width)
        found = self._weights.output(hidden) + self._bias
        if self._printed or not any(self.saturated):
            self._weights.learn(-p.gamma_w * error * self.period, hidden)
            bias = self._bias - p.bias_rate * error * self.period
            self._bias = min(max(bias, -p.weight_limit), p.weight_limit)
        return force + model.inertia * found

    def _widen(self, wanted: float, error: float, inputs: LawInput) -> None:
        """Integrate the funnels (7), (8) over the next sample."""
        if self.parameters.funnel == "fixed":
            return
        h, beta2, before = self.period, self._beta2, self.phi2
        rest = beta2 / A2
        wide = (before - rest) * self._narrow + rest
        low, high = plain_sum(inputs.force_min.tolist()), plain_sum(inputs.force_max.tolist())
        printed = self.parameters.kappa == "printed"
        if self.parameters.funnel == "dynamic" and (printed or not low <= wanted <= high):
            possible = plain_sum(inputs.applied.tolist()) if printed else min(max(wanted, low), high)
            excess = abs(wanted - possible) / self.model.inertia
            grow = excess / max(abs(error), self.parameters.delta)
            wide *= math.exp(min(grow * h, 20.0))
        self.phi2 = min(wide, MAX_FUNNEL)
        slope = P1 * before - A1 * self.phi1 + BETA1 - P1 * beta2 / A2
        self.phi1 = min(max(self.phi1 + h * slope, BETA1 / A1), MAX_FUNNEL)
