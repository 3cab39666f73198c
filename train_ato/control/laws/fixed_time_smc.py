"""Fixed-time sliding mode with an alternating surface per vehicle, paper 002, eqs. (12)-(36).

Every vehicle is driven and keeps its position in the train from its own state, those of its neighbours and a virtual
leader. The settling time does not depend on the initial error; the force does.

Per unit i, x*_i = x_r minus its offset, all terms as accelerations::

    E = x - x*,  E' = v + d1_hat - v_r,  S = E' + S_au(E)                                            (17), (18)
    a = -known - d_hat/m + x_r'' - (dS_au/dE) E' - alpha2 sig^p2(S) - beta2 sig^g2(S)                (14), (36)
    S_au = alpha1 sig^m1(E) + beta1 E                    for |E| > eps                               (19)
           l1 E + l2 sig^m2(E)                           otherwise
    l1 = (alpha1 eps^(m1-1) + beta1)/2,  l2 = (alpha1 eps^(m1-m2) + beta1 eps^(1-m2))/2              (20)
    known = -(couplers to the neighbours + resistance + shoes)/m

sig^p(z) = |z|^p sign z, m2 = p2 = 5/7, m1 = g2 = 5/3, eps = 1 m. The observer's d_hat is m (d2 + d1').

Corrections: x_r'' is missing in the paper. (20) joins the branches smoothly only for eps = 1 and alpha1 = beta1, so
each pair is one gain. |E| is at least 1e-3 in the derivative of the fractional power. The speed offset d1_hat, which a
speedometer does not measure, is estimated from position and speed (``unmatched``); x -> x_r and v -> v_r are
incompatible while it is not 0.

``states: estimated`` is (36) as printed: x, v, d1, d1' and d2 are the estimates of a cascade (7), (11) inside the law,
also in the forces of the couplers, and d_hat is not used. Default: measured x and v, d_hat of the observer node.
The graph of the paper is the chain of the train; the law takes the states of the neighbours from the message of the
plant, there are no links between the cars.

The gain 50 of the paper settles 108 m in 0.06 s at 1.6e10 m/s²; gains of 1.7-2 give its 1.7 s and still need 2e6 m/s².
A real train (0.5 m/s², lag, delay) needs 0.3 with `eso`, and is unstable from 0.6 s of delay on: see `lag_smc`.
``equivalent: feedforward`` is for such trains: the feed-forward replaces x_r'' and -known, and the inertia of the train
that of the vehicle.

Gains of the model: ``equivalent: feedforward``, and one gain g for surface and reaching law. For errors of the size z
(in m and m/s) kp = g (1 + 1.43 z^(-2/7) + 1.67 z^(2/3)), which is 4.1 g at 1, 4.1 g at .1 and 6.4 g at .01. With a
fifth of the kp of `pid` on the same train, g = kp/5, it is below the limit of stability, 3.1 kp, for all errors
above .3 mm and .3 mm/s.

Needs: with ``equivalent: measured`` the force of every coupler beside a power unit: a train of driven vehicles with
linear draft gears without slack (one vehicle is sufficient), or sensors; the error message names the missing couplers.
An observer for d_hat (`cascaded`, `eso`). Compensations that give only a feed-forward are rejected. With
``equivalent: feedforward`` any train.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from train_ato.control.algorithms.couplers import UnitCouplers
from train_ato.control.algorithms.guard import GuardedLaw
from train_ato.control.algorithms.loop_gains import LoopGains
from train_ato.control.algorithms.luenberger import LuenbergerObserver
from train_ato.control.algorithms.sliding import sig
from train_ato.control.contract import LawInput, parameter
from train_ato.control.gains import gains_choice
from train_ato.control.observers.cascaded import CascadedParameters, make_cascade
from train_ato.control.parameters import RefusedParameter

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel

LARGE, SMALL = 5.0 / 3.0, 5.0 / 7.0
"""Exponents m1 = g2 and m2 = p2."""
BRANCH_ERROR = 1.0
"""eps, error at which the surface changes its branch [m]."""
MIN_ERROR = 1e-3
"""Smallest |E| in the derivative of the fractional power [m]."""


@dataclass(frozen=True)
class FixedTimeSmcParameters:
    """Parameters of :class:`FixedTimeSmc`."""

    gains: str = gains_choice()
    surface: float = parameter(0.3, "1/s", 0.0, 1e3, "alpha1 = beta1, gain of the surface; 50 in the paper")
    reaching: float = parameter(0.3, "1/s", 0.0, 1e3, "alpha2 = beta2, gain of the reaching law; 50 in the paper")
    unmatched: bool = parameter(False, "", 0, 1, "estimate the speed offset d1 between position and speed")
    states: str = parameter(
        "measured", "", 0, 0, "x and v of (36): measured, or estimates of the cascade as in the paper",
        choices=("measured", "estimated"),
    )  # fmt: skip
    offset_bandwidth: float = parameter(10.0, "1/s", 1e-3, 1e6, "bandwidth of the estimate of d1")
    equivalent: str = parameter(
        "measured", "", 0, 0, "equivalent control from couplers and resistance, or from the feed-forward",
        choices=("measured", "feedforward"),
    )  # fmt: skip


class FixedTimeSmc(GuardedLaw):
    """Fixed-time sliding mode per vehicle, with the states of its neighbours (paper 002)."""

    Parameters: ClassVar[type] = FixedTimeSmcParameters

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
        gain = LoopGains.of(model, period).speed / 5.0
        return {"equivalent": "feedforward", "surface": gain, "reaching": gain}

    def __init__(self, parameters: FixedTimeSmcParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._measured = parameters.equivalent == "measured"
        self.uses_feedforward, self.feedforward_hint = not self._measured, "equivalent: feedforward"
        self._couplers = UnitCouplers(model)
        needs_couplers = self._measured or parameters.states == "estimated"
        if needs_couplers and self._couplers.unknown:
            setting = "equivalent: feedforward" if self._measured else "states: measured"
            raise RefusedParameter(
                f"{'equivalent: measured' if self._measured else 'states: estimated'} needs the force of "
                f"{self._couplers.unknown_names()} beside driven vehicles",
                setting,
                f"drive every vehicle with linear draft gears between them, or {self._couplers.sensors_text()}",
            )
        self._own_mass: list[float] = model.unit_inertia.tolist()
        self._mass = self._own_mass if self._measured else (model.inertia * model.share).tolist()
        self._offsets = [SpeedOffset(parameters.offset_bandwidth, period) for _ in range(self.n)]
        self._estimators = [make_cascade(CascadedParameters(), period) for _ in range(self.n)]
        self._modelled: list[float] | None = None

    def clear_state(self) -> None:
        """Clear the speed offsets and the estimates."""
        for offset, estimator in zip(self._offsets, self._estimators, strict=True):
            offset.reset()
            estimator.reset()
        self._modelled = None

    def on_missed_sample(self) -> None:
        """Handle a missed sample: the gap does not change the speed offsets."""
        for offset, estimator in zip(self._offsets, self._estimators, strict=True):
            offset.restart()
            estimator.restart()
        self._modelled = None

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force demand of every unit [N]."""
        if self.parameters.states == "estimated":
            inputs = self._estimated(inputs)
        position: list[float] = inputs.position.tolist()
        velocity: list[float] = inputs.velocity.tolist()
        targets, speeds = inputs.reference_position.tolist(), inputs.reference_velocity.tolist()
        equivalent, disturbance = self._equivalent(inputs), inputs.disturbance.tolist()
        wanted = []
        for unit, (x, v) in enumerate(zip(position, velocity, strict=True)):
            pull = self._pull(x - targets[unit], v + self._offset(unit, x, v) - speeds[unit])
            if self._measured:
                pull += inputs.acceleration_at_effect
            wanted.append(equivalent[unit] - disturbance[unit] + self._mass[unit] * pull)
        return wanted

    def _equivalent(self, inputs: LawInput) -> list[float]:
        """Return the force against the motion of every unit's vehicle [N], or the feed-forward in its place."""
        if self._measured:
            return [forces.total for forces in self._couplers.opposing(inputs)]
        known: list[float] = inputs.feedforward.tolist()
        return known

    def _offset(self, unit: int, x: float, v: float) -> float:
        """Return the estimated speed offset d1 of a unit [m/s]; 0 without ``unmatched``."""
        if not self.parameters.unmatched:
            return 0.0
        if self.parameters.states == "estimated":
            return self._estimators[unit].d1
        return self._offsets[unit].step(x, v)

    def _estimated(self, inputs: LawInput) -> LawInput:
        """Return the inputs with the estimates of position, speed and disturbance of the cascades."""
        known = zip(inputs.applied.tolist(), self._couplers.opposing(inputs), self._own_mass, strict=True)
        now = [(applied - opposing.total) / mass for applied, opposing, mass in known]
        before = self._modelled or now
        self._modelled = now
        measured = zip(inputs.position.tolist(), inputs.velocity.tolist(), strict=True)
        for unit, (x, v) in enumerate(measured):
            self._estimators[unit].step(x, v, 0.5 * (before[unit] + now[unit]))
        return replace(
            inputs,
            position=np.array([found.position for found in self._estimators]),
            velocity=np.array([found.velocity for found in self._estimators]),
            disturbance=np.array(
                [m * (found.d2 + found.d1_rate) for m, found in zip(self._own_mass, self._estimators, strict=True)]
            ),
        )

    def _pull(self, error: float, rate: float) -> float:
        """Return the acceleration for an error [m] and its rate [m/s] in m/s²."""
        auxiliary, slope = alternating(error, self.parameters.surface)
        surface = rate + auxiliary
        gain: float = self.parameters.reaching
        return float(-slope * rate - gain * (sig(surface, SMALL) + sig(surface, LARGE)))


def alternating(error: float, gain: float) -> tuple[float, float]:
    """Return S_au [m/s] and dS_au/dE [1/s] for alpha1 = beta1 = gain [1/s] and eps = 1 m."""
    size = max(abs(error), MIN_ERROR)
    if abs(error) > BRANCH_ERROR:
        return gain * (sig(error, LARGE) + error), gain * (LARGE * size ** (LARGE - 1.0) + 1.0)
    return gain * (error + sig(error, SMALL)), gain * (1.0 + SMALL * size ** (SMALL - 1.0))


class SpeedOffset:
    """Estimate of the speed offset d1 in x' = v + d1.

    Parameters
    ----------
    omega
        Bandwidth [1/s].
    period
        Sampling period [s].
    """

    def __init__(self, omega: float, period: float) -> None:
        self._place = LuenbergerObserver(omega, period)
        self.reset()

    def reset(self) -> None:
        """Restart at the next sample with an offset of 0."""
        self._place.reset()
        self._speed: float | None = None

    def restart(self) -> None:
        """Restart at the next sample with the present offset."""
        self._place.restart()
        self._speed = None

    def step(self, x: float, v: float) -> float:
        """Return the offset [m/s] for a position [m] and a speed [m/s]."""
        before = v if self._speed is None else self._speed
        self._speed = v
        return self._place.step(x, 0.5 * (v + before))
