"""PID with feed-forward, the baseline of papers 000 (section 3.1), 001 (eq. 15) and 004.

The feed-forward supplies most of the force, three gains correct the remaining speed error. Every other law is compared
with this one: in papers 001, 003 and 004 most of the improvement of the law over its PID comes from the preview, which
that PID does not have.

Law, per unit, e = v - v_d (with the opposite sign in papers 001 and 004)::

    u = u_ff - K (kp e + ki I + kd de/dt) - d_hat
    I = the measured position error (default), or int e dt; both clamped to +-integral_limit
    de/dt through a first-order filter of time constant derivative_time

``K`` is the unit's share of the train's inertia (``per_mass: true``; kp in 1/s, ki in 1/s², kd dimensionless) or its
share of 1 (``per_mass: false``; kp in N/(m/s), ki in N/m, kd in N s²/m).  With ``gains: model`` kp and ki follow from
the model. The train is an integrator of the force behind the dead time theta = delay + lag + period, and the rule of
Skogestad (SIMC, Journal of Process Control 13, 2003, table 1) gives kp = 1/(2 theta), ki = kp/(8 theta). Two limits
lower kp on trains with elastic couplers: half of the gain at which a mode of the couplers, a quarter of a turn or more
behind through delay and lag, loses its damping (of that by friction a third counts); and two thirds of the wave
impedance of the hauled vehicles. ki is at most kp²/4, and kp at most 1/s. Paper 000 prints the second form with 1e7,
1, 1; its error is then the force divided by 1e7.

With ``u_ff`` the nominal train follows the reference at the time at which the command takes effect; the PID of the
papers has no feed-forward (``feedforward: false``).

The defaults suit a long train. Above its first mode the locomotive does not move the mass of the train but a wave in
the couplers, with a ratio of force to speed (wave impedance) of about 1e6 N s/m; K kp must be below it.

``filter_time`` smooths e in the first and third term only.

Anti-windup: the integral is held while the unit is at a limit and the error would increase it.

Needs: any train; inertia and shares of the model, measured state, and by default the feed-forward and the estimate; no
coupler sensor. ``feedforward: false`` is rejected with compensations that give only a feed-forward (`pade`, `twin`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import sub
from typing import TYPE_CHECKING, Any, ClassVar

from train_ato.control.algorithms.guard import GuardedLaw, is_valid
from train_ato.control.algorithms.loop_gains import LoopGains
from train_ato.control.contract import LawInput, parameter
from train_ato.control.gains import gains_choice
from train_ato.messages.types import Array

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel


@dataclass(frozen=True)
class PidParameters:
    """Parameters of :class:`Pid`."""

    gains: str = gains_choice()
    kp: float = parameter(0.05, "1/s or N/(m/s)", 0.0, 1e9, "gain on the speed error")
    ki: float = parameter(0.001, "1/s² or N/m", 0.0, 1e9, "gain on the integral of the speed error")
    kd: float = parameter(0.0, "1 or N s²/m", 0.0, 1e9, "gain on the derivative of the speed error")
    per_mass: bool = parameter(True, "", 0, 1, "kp, ki, kd are multiplied by the inertia of the train")
    integral: str = parameter(
        "position",
        "",
        0,
        0,
        "integral: the measured position error, or the sum of the speed error",
        choices=("position", "speed"),
    )
    integral_limit: float = parameter(20.0, "m", 0.0, 1e6, "largest magnitude of the integral")
    filter_time: float = parameter(0.0, "s", 0.0, 60.0, "time constant of the low-pass filter of the speed error")
    derivative_time: float = parameter(0.1, "s", 0.0, 60.0, "time constant of the filter of the derivative")
    feedforward: bool = parameter(True, "", 0, 1, "add the feed-forward force of the nominal train")
    disturbance: bool = parameter(True, "", 0, 1, "subtract the estimate of the observer")


class Pid(GuardedLaw):
    """PID on the speed error with feed-forward, clamped integral and filtered derivative."""

    Parameters: ClassVar[type] = PidParameters

    @classmethod
    def model_gains(cls, model: TrainModel, period: float) -> dict[str, Any]:
        """Return kp [1/s] and ki [1/s²] for delay, lag and couplers of a train.

        Parameters
        ----------
        model
            The train.
        period
            Control period [s].
        """
        loop = LoopGains.of(model, period)
        return {"kp": loop.speed, "ki": loop.position}

    def __init__(self, parameters: PidParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        scale = model.inertia if parameters.per_mass else 1.0
        gains = (parameters.kp, parameters.ki, parameters.kd)
        self._gains = [tuple(scale * share * gain for gain in gains) for share in model.share.tolist()]
        self._derivative_decay = (
            math.exp(-period / parameters.derivative_time) if parameters.derivative_time > 0 else 0.0
        )
        self._filter_decay = math.exp(-period / parameters.filter_time) if parameters.filter_time > 0 else 0.0
        self.uses_feedforward, self.feedforward_hint = parameters.feedforward, "feedforward: true"
        self._of_position = parameters.integral == "position"
        self._uses_estimate = parameters.disturbance
        self._zeros = [0.0] * self.n
        self.clear_state()

    def clear_state(self) -> None:
        """Clear the integrals and the filters."""
        self._integral = [0.0] * self.n
        self._rate = [0.0] * self.n
        self._before: list[float] | None = None
        self._filtered: list[float] | None = None

    def on_missed_sample(self) -> None:
        """Handle a missed sample: the difference quotient restarts."""
        self._before = None

    def take_over(self, inputs: LawInput, force: Array) -> None:
        """Begin at the last command [N] by the sums of the speed error; the position error cannot be chosen."""
        super().take_over(inputs, force)
        if self._of_position or not is_valid(inputs):
            return
        wanted, limit = self.demand(inputs), self.parameters.integral_limit
        self.clear_state()
        for unit, (_, ki, _) in enumerate(self._gains):
            if ki > 0.0:
                self._integral[unit] = min(max((wanted[unit] - float(force[unit])) / ki, -limit), limit)

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force demand of every unit [N]."""
        errors = list(map(sub, inputs.velocity.tolist(), inputs.reference_velocity.tolist()))
        if self._filter_decay:
            errors = self._filter(errors)
        integrals = self._distances(inputs) if self._of_position else self._summed(errors)
        known = inputs.feedforward.tolist() if self.uses_feedforward else self._zeros
        disturbance = inputs.disturbance.tolist() if self._uses_estimate else self._zeros
        wanted = []
        for unit, (kp, ki, kd) in enumerate(self._gains):
            error = errors[unit]
            force = kp * error + ki * integrals[unit]
            if kd:
                force += kd * self._derivative(unit, error)
            wanted.append(known[unit] - disturbance[unit] - force)
        self._before = errors
        return wanted

    def _filter(self, errors: list[float]) -> list[float]:
        decay, before = self._filter_decay, errors if self._filtered is None else self._filtered
        self._filtered = [now + decay * (old - now) for now, old in zip(errors, before, strict=True)]
        return self._filtered

    def _derivative(self, unit: int, error: float) -> float:
        if self._before is not None:
            raw = (error - self._before[unit]) / self.period
            self._rate[unit] = self._derivative_decay * self._rate[unit] + (1.0 - self._derivative_decay) * raw
        return self._rate[unit]

    def _distances(self, inputs: LawInput) -> list[float]:
        """Return the measured position errors, clamped [m]."""
        limit: float = self.parameters.integral_limit
        errors = map(sub, inputs.position.tolist(), inputs.reference_position.tolist())
        return [error if -limit <= error <= limit else math.copysign(limit, error) for error in errors]

    def _summed(self, errors: list[float]) -> list[float]:
        """Return the clamped sums of the speed errors [m]; at a limit a sum is held if the error would increase it."""
        limit: float = self.parameters.integral_limit
        for unit, error in enumerate(errors):
            if not (self.saturated[unit] and (self._last_force[unit] > 0) == (error < 0)):
                total = self._integral[unit] + error * self.period
                self._integral[unit] = min(max(total, -limit), limit)
        return self._integral
