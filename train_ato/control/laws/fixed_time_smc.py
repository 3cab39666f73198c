"""Fixed-time sliding mode with an alternating surface, paper 002, eqs. (12)-(36): every vehicle, neighbours only.

Every vehicle is driven and holds its place in a moving chain, knowing only itself, its neighbours and a virtual leader.
The error settles within a time that does not depend on how large it was, at whatever force that takes.

Per unit i, x*_i = x_r minus its offset, accelerations::

    E = x - x*,  E' = v + d1_hat - v_r,  S = E' + S_au(E)                                            (17), (18)
    a = -known - d_hat/m + x_r'' - (dS_au/dE) E' - alpha2 sig^p2(S) - beta2 sig^g2(S)                (14), (36)
    S_au = alpha1 sig^m1(E) + beta1 E                    for |E| > eps                               (19)
           l1 E + l2 sig^m2(E)                           otherwise
    l1 = (alpha1 eps^(m1-1) + beta1)/2,  l2 = (alpha1 eps^(m1-m2) + beta1 eps^(1-m2))/2              (20)
    known = -(couplers to the neighbours + resistance + shoes)/m

sig^p(z) = |z|^p sign z, m2 = p2 = 5/7, m1 = g2 = 5/3, eps = 1 m. The observer's d_hat is m (d2 + d1').

Corrections: x_r'' is missing in print; (20) joins the branches smoothly only for eps = 1 and alpha1 = beta1, so there
is one gain each; |E| is floored at 1e-3 in the derivative of the fractional power. d1_hat, a speed offset no
speedometer sees, is found here from position and speed (``unmatched``); x -> x_r and v -> v_r cannot both
hold while it is not 0.

Gain 50 of the paper settles 108 m in 0.06 s at 1.6e10 m/s²; 1.7-2 give its 1.7 s and still need 2e6 m/s². A real train
(0.5 m/s², lag, delay) wants 0.3 with `eso`, and is lost from 0.6 s of delay on: see `lag_smc`.

Needs: the force of every coupler beside a power unit: best a train whose vehicles are all driven, with linear draft
gears without slack between them (one vehicle alone is fine); elsewhere sensors, or it is refused by the coupler's name.
An observer for d_hat (`cascaded`, `eso`). No feed-forward: compensations that give only that are refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from train_ato.control.contract import LawInput, parameter
from train_ato.control.parts.couplers import UnitCouplers
from train_ato.control.parts.guard import GuardedLaw
from train_ato.control.parts.sliding import sig
from train_ato.control.parts.two_poles import TwoPoles

if TYPE_CHECKING:
    from train_ato.model import TrainModel

LARGE, SMALL = 5.0 / 3.0, 5.0 / 7.0
"""Exponents m1 = g2 and m2 = p2."""
EPS = 1.0
"""Where the surface changes its branch [m]."""
FLOOR = 1e-3
"""Least |E| in the derivative of the fractional power [m]."""


@dataclass(frozen=True)
class FixedTimeSmcParameters:
    """Parameters of :class:`FixedTimeSmc`."""

    surface: float = parameter(0.3, "1/s", 0.0, 1e3, "alpha1 = beta1, gain of the surface; the paper's is 50")
    reaching: float = parameter(0.3, "1/s", 0.0, 1e3, "alpha2 = beta2, gain of the reaching law; the paper's is 50")
    unmatched: bool = parameter(False, "", 0, 1, "find the speed offset d1 between position and speed")
    offset_bandwidth: float = parameter(10.0, "1/s", 1e-3, 1e6, "bandwidth with which d1 is found")


class FixedTimeSmc(GuardedLaw):
    """Fixed-time sliding mode per vehicle, with what its neighbours tell (paper 002)."""

    Parameters: ClassVar[type] = FixedTimeSmcParameters
    leaves_feedforward = "this law brings its own equivalent control: choose pid, rbf_switching_smc or smc for it"

    def __init__(self, parameters: FixedTimeSmcParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._couplers = UnitCouplers(model)
        if self._couplers.missing:
            raise ValueError(
                f"cancels the couplers of every driven vehicle and does not know {self._couplers.refusal()}: "
                "drive every vehicle with linear draft gears between, or fit sensors there"
            )
        self._mass: list[float] = model.unit_inertia.tolist()
        self._offsets = [SpeedOffset(parameters.offset_bandwidth, period) for _ in range(self.n)]

    def forget(self) -> None:
        """Forget the speed offsets."""
        for offset in self._offsets:
            offset.reset()

    def missed(self) -> None:
        """Do not take the gap for a speed offset."""
        for offset in self._offsets:
            offset.restart()

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force wanted [N]."""
        position: list[float] = inputs.position.tolist()
        velocity: list[float] = inputs.velocity.tolist()
        targets, speeds = inputs.reference_position.tolist(), inputs.reference_velocity.tolist()
        pulls = self._couplers.pull(position, velocity, inputs.coupler_force.tolist())
        own = self.model.own_resistance(inputs.velocity, inputs.position).tolist()
        shoes, disturbance = inputs.shoe_force.tolist(), inputs.disturbance.tolist()
        wanted = []
        for unit, (x, v) in enumerate(zip(position, velocity, strict=True)):
            offset = self._offsets[unit].step(x, v) if self.parameters.unmatched else 0.0
            pull = self._pull(x - targets[unit], v + offset - speeds[unit])
            known = pulls[unit] + own[unit] + shoes[unit] - disturbance[unit]
            wanted.append(known + self._mass[unit] * (inputs.acting_acceleration + pull))
        return wanted

    def _pull(self, error: float, rate: float) -> float:
        """Return the error-dependent acceleration [m/s²]."""
        auxiliary, slope = alternating(error, self.parameters.surface)
        surface = rate + auxiliary
        gain: float = self.parameters.reaching
        return -slope * rate - gain * (sig(surface, SMALL) + sig(surface, LARGE))


def alternating(error: float, gain: float) -> tuple[float, float]:
    """Return S_au and dS_au/dE for alpha1 = beta1 = gain, eps = 1."""
    size = max(abs(error), FLOOR)
    if abs(error) > EPS:
        return gain * (sig(error, LARGE) + error), gain * (LARGE * size ** (LARGE - 1.0) + 1.0)
    return gain * (error + sig(error, SMALL)), gain * (1.0 + SMALL * size ** (SMALL - 1.0))


class SpeedOffset:
    """d1 in x' = v + d1: what the speed, integrated, misses of the position."""

    def __init__(self, omega: float, period: float) -> None:
        self._place = TwoPoles(omega, period)
        self.reset()

    def reset(self) -> None:
        """Start at the next sample, with no offset."""
        self._place.reset()
        self._speed: float | None = None

    def restart(self) -> None:
        """Start at the next sample, keeping the offset."""
        self._place.restart()
        self._speed = None

    def step(self, x: float, v: float) -> float:
        """Take position and speed; return the offset [m/s]."""
        before = v if self._speed is None else self._speed
        self._speed = v
        return self._place.step(x, 0.5 * (v + before))
