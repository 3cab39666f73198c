"""Dynamic-surface funnel control with input delay and saturation, paper 003, eqs. (6)-(28), for the train as a whole.

The errors of position and speed are kept inside boundaries that narrow with time and widen while the force is at its
limit; the gain rises towards the boundary. A delay state takes the input delay out of the speed error, a network finds
the resistance.

m the train's inertia, s and v its mean position and speed (by the units' shares), the force split over the units::

    e1 = s - s_d,  e2 = v - alpha1 - h,  alpha_bar = -k1 e1 + v_d                                (6), (12), (20)
    k_i = k_i0/(1 - e_i²/phi_i²)                                                                  (12), (23)
    h' = -lam_h h + (u(t-tau) - u)/m,  h(0) = 0                                                   (21)
    u = m (-k2 e2 + alpha1') - m lam_h h + f_hat - d_hat                                          (23), (26)
    phi1' = P1 phi2 - a1 phi1 + beta1 - P1 beta2/a2                                               (7)
    phi2' = -a2 phi2 + beta2 + phi2 kappa/max(|e2|, delta),  kappa = |u - sat u|/m                (8), (9)
    f_hat = m (W'Phi(v) + eps),  W' = -gamma_w e2 Phi,  eps' = -gamma_eps e2                      (24)-(28)

``variant: corrected``:

1. lam_h in 1/s: the print's lambda = 5 inside (...)/m leaks with 24 hours, e1 -> h/k1, and Theorem 1 does not hold.
   Keep lam_h tau <= 0.5.
2. e²/phi² is clipped at 0.5: outside the funnel the print's k_i turn negative, which is its "kilometres of error".
3. beta2 = 1e-4 (3 cm/s): the print's funnel of 9e-5 m/s no sampled loop can hold.
4. alpha1' = a_d - k1 (v - v_d) in place of the 5 ms filter (13), which turns 0.1 m of noise into MN/s.
5. h runs on sat(u), here the force sent and the force measured; learning (in m/s², with the minus sign lost in
   (27), (28)) holds while the force is at a limit.

``variant: printed`` keeps (13) with Mh' = gamma_M |z| (19), sigma(t) = .001 exp(-.001 t) + .0001, the leak, k_i0 = 1,
beta2 = 3e-7, runs h on the unlimited u, now and a delay ago, and learns on at a limit; the sign of (27), (28) is
repaired and e²/phi² clipped in it as well, unless ``outside: printed`` lets the gains turn negative. Its dynamic funnel
equals fixed gains k1 = k2 = 1 to four digits once a saturation has been (phi2 grows like e^t and never comes back).
``funnel: prescribed`` narrows without regard to saturation, the paper's comparison; ``fixed`` holds the boundaries.

Needs: any train; several units are steered as one. Inertia and shares, for ``resistance: model`` the nominal resistance
and line as well. The delay state replaces a predictor (with one, set ``delay_state: false``). No feed-forward:
compensations that give only that are refused.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from operator import sub
from typing import TYPE_CHECKING, ClassVar

from train_ato.control.contract import LawInput, parameter
from train_ato.control.parts.guard import GuardedLaw
from train_ato.control.parts.rbf import Weights, bells

if TYPE_CHECKING:
    from train_ato.model import TrainModel

P1, A1, A2, BETA1, PRINTED_BETA2 = 1.05, 0.0035, 0.0034, 6e-4, 3e-7
IOTA, GAMMA_M, PRINTED_LEAK = 0.005, 0.5, 5.0
WIDEST = 1e4
"""Cap of the funnels [m, m/s]."""
FILTER_STEP = 1e-3
"""Step of the printed filter (13) within a sample [s]."""


@dataclass(frozen=True)
class FunnelParameters:
    """Parameters of :class:`Funnel`."""

    variant: str = parameter("corrected", "", 0, 0, "corrected, or as printed", choices=("corrected", "printed"))
    funnel: str = parameter(
        "dynamic", "", 0, 0, "funnels widen in saturation, narrow all the same, or stand still",
        choices=("dynamic", "prescribed", "fixed"),
    )  # fmt: skip
    resistance: str = parameter(
        "network", "", 0, 0, "f from the network, from the model, or both", choices=("network", "model", "both")
    )
    k10: float = parameter(0.3, "1/s", 0.0, 100.0, "gain on the position error; print 1, taken by variant printed")
    k20: float = parameter(0.7, "1/s", 0.0, 100.0, "gain on the speed error; print 1, taken by variant printed")
    lam_h: float = parameter(5.0, "1/s", 0.0, 1e3, "leak of the delay state; .5/tau where the delay is uncertain")
    delay_state: bool = parameter(True, "", 0, 1, "keep h; not needed under a predictor")
    beta2: float = parameter(1e-4, "m/s²", 0.0, 1.0, "floor of the speed funnel times a2, corrected variant")
    phi1: float = parameter(0.5, "m", 1e-6, WIDEST, "position funnel at the start")
    phi2: float = parameter(0.1, "m/s", 1e-6, WIDEST, "speed funnel at the start")
    outside: str = parameter(
        "clip", "", 0, 0, "outside the funnel clip e²/phi², or let k_i turn negative", choices=("clip", "printed")
    )
    clip: float = parameter(0.5, "1", 0.0, 0.999, "largest e²/phi²")
    delta: float = parameter(1e-3, "m/s", 1e-9, 10.0, "floor of |e2| in (8)")
    gamma_w: float = parameter(0.05, "1/s²", 0.0, 100.0, "learning rate of the network")
    gamma_eps: float = parameter(0.3, "1/s²", 0.0, 100.0, "learning rate of its offset")
    bells: int = parameter(11, "1", 1, 101, "bells of the network")
    fastest: float = parameter(100.0, "m/s", 1.0, 200.0, "speed of the last bell; the width is their distance")
    weight_limit: float = parameter(2.0, "m/s²", 0.0, 100.0, "largest magnitude of a weight")


class Funnel(GuardedLaw):
    """Dynamic-surface funnel control with a delay state and a network (paper 003)."""

    Parameters: ClassVar[type] = FunnelParameters
    leaves_feedforward = "this law brings its own equivalent control: choose pid, rbf_switching_smc or smc for it"

    def __init__(self, parameters: FunnelParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        p = parameters
        self._printed = p.variant == "printed"
        self._k10, self._k20, self._beta2 = (1.0, 1.0, PRINTED_BETA2) if self._printed else (p.k10, p.k20, p.beta2)
        leak = PRINTED_LEAK / model.inertia if self._printed else p.lam_h
        self._leak = leak
        self._keep = math.exp(-leak * period)
        self._charge = -math.expm1(-leak * period) / leak if leak > 0.0 else period
        self._width = p.fastest / max(1, p.bells - 1)
        self._clip, self._flips = float(p.clip), p.outside == "printed"
        self._narrow = math.exp(-A2 * period)
        self._centres = [index * self._width for index in range(p.bells)]
        self._weights = Weights([0.0] * p.bells, p.weight_limit)
        self.forget()

    def forget(self) -> None:
        """Close the funnels, empty the delay state and the network."""
        self._weights.reset()
        self._offset = 0.0
        self.phi1, self.phi2 = self.parameters.phi1, self.parameters.phi2
        self._h, self._bound, self._t = 0.0, 0.0, 0.0
        self._alpha: float | None = None
        self._wanted: float | None = None
        self._beyond: deque[float] = deque(maxlen=1 + round(float(self.model.delay.mean()) / self.period))

    def missed(self) -> None:
        """Start the filter anew at the next sample."""
        self._alpha = None

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force wanted [N]."""
        mass = self.model.inertia
        place_error = self.mean(list(map(sub, inputs.position.tolist(), inputs.reference_position.tolist())))
        speed, target = self.mean(inputs.velocity.tolist()), self.mean(inputs.reference_velocity.tolist())
        pull = self.mean(inputs.reference_acceleration.tolist())
        self._remember(inputs)
        k1 = self._gain(self._k10, place_error, self.phi1)
        alpha, rate = self._surface(target - k1 * place_error, pull - k1 * (speed - target))
        error = speed - alpha - self._h
        k2 = self._gain(self._k20, error, self.phi2)
        wanted = mass * (rate - k2 * error - self._leak * self._h) + self._resistance(inputs, speed, error)
        wanted -= sum(inputs.disturbance.tolist())
        self._widen(wanted, error, inputs)
        self._wanted = wanted
        return [wanted * share for share in self.share]

    def _remember(self, inputs: LawInput) -> None:
        """Move the delay state (21) over the sample that ends here."""
        if self._wanted is None or not self.parameters.delay_state:
            return
        sent, acting = sum(self._held), sum(inputs.applied.tolist())
        if self._printed:
            self._beyond.append(self._wanted - sent)
            sent, acting = self._wanted, acting + self._beyond[0]
        missing = (acting - sent) / self.model.inertia
        self._h = self._keep * self._h + self._charge * missing

    def _gain(self, gain: float, error: float, boundary: float) -> float:
        inside = (error / boundary) ** 2
        if self._flips:
            return gain / (1.0 - inside) if abs(1.0 - inside) > 1e-9 else gain * 1e9
        return gain / (1.0 - min(inside, self._clip))

    def _surface(self, aim: float, slope: float) -> tuple[float, float]:
        """Return alpha1 and its derivative: those of the aim, or of the printed filter (13), (19).

        The filter is faster than most samples; its derivative is the mean over the sample, because at the sample's end
        it has settled and its own is 0.  After a gap it begins settled, with the aim's slope.
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
            self._bound = min(self._bound + h * GAMMA_M * abs(z), WIDEST)
            self._alpha += h * rate
            self._t += h
        return self._alpha, slope if fresh else (self._alpha - before) / self.period

    def _resistance(self, inputs: LawInput, speed: float, error: float) -> float:
        """Return f_hat [N] and learn."""
        p = self.parameters
        model = self.model
        force = 0.0
        if p.resistance != "network":
            place = float(inputs.position[0] + model.offsets[0])
            force = model.running_resistance(speed) + model.line_force(place) + inputs.train_shoe_force
        if p.resistance == "model":
            return force
        hidden = bells((speed,), self._centres, self._width)
        found = self._weights.output(hidden) + self._offset
        if self._printed or not any(self.cut):
            self._weights.learn(-p.gamma_w * error * self.period, hidden)
            offset = self._offset - p.gamma_eps * error * self.period
            self._offset = min(max(offset, -p.weight_limit), p.weight_limit)
        return force + model.inertia * found

    def _widen(self, wanted: float, error: float, inputs: LawInput) -> None:
        """Move the funnels (7), (8) over the coming sample."""
        if self.parameters.funnel == "fixed":
            return
        h, beta2, before = self.period, self._beta2, self.phi2
        rest = beta2 / A2
        wide = (before - rest) * self._narrow + rest
        low, high = sum(inputs.force_min.tolist()), sum(inputs.force_max.tolist())
        if not low <= wanted <= high and self.parameters.funnel == "dynamic":
            cut = abs(wanted - min(max(wanted, low), high)) / self.model.inertia
            grow = cut / max(abs(error), self.parameters.delta)
            wide *= math.exp(min(grow * h, 20.0))
        self.phi2 = min(wide, WIDEST)
        slope = P1 * before - A1 * self.phi1 + BETA1 - P1 * beta2 / A2
        self.phi1 = min(max(self.phi1 + h * slope, BETA1 / A1), WIDEST)
