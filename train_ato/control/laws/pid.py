"""PID with feed-forward, the baseline of papers 000 (section 3.1), 001 (eq. 15) and 004.

Feed-forward does the work, three gains correct what is left of the speed error. It is the baseline that every other law
is compared with: most of what the papers' laws gain over their own PID is the preview that theirs lacks.

Law, per unit, e = v - v_d (papers 001 and 004 write it with the other sign)::

    u = u_ff - K (kp e + ki I + kd de/dt) - d_hat
    I = int e dt, clamped to +-integral_limit; or, as default, the measured position error, clamped likewise
    de/dt through a first-order filter of time constant derivative_time

``K`` is the unit's share of the train's inertia (``gains: per_mass``; kp in 1/s, ki in 1/s², kd dimensionless) or its
share of 1 (``gains: force``; kp in N/(m/s), ki in N/m, kd in N s²/m). Paper 000 prints the second with 1e7, 1, 1: its
error is then the force divided by 1e7.  ``u_ff`` makes the nominal train follow the reference at the time the command
acts; the papers' own PID has none (``feedforward: false``).

The defaults suit a long train: above its first mode the locomotive feels the wave impedance of the couplers, about
1e6 N s/m, not the train's mass, and K kp must stay below it.

``filter_time`` smooths e in the first and third term only.

Anti-windup: the integral holds while the unit is at a limit and the error drives it further.

Needs: any train. Of the model it takes inertia and shares, of the loop the feed-forward (``feedforward: true``), the
estimate and the measured state; no coupler sensor. ``feedforward: false`` is refused under compensations that give
nothing else (`pade`, `twin`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import sub
from typing import TYPE_CHECKING, ClassVar

from train_ato.control.contract import LawInput, parameter
from train_ato.control.parts.guard import GuardedLaw

if TYPE_CHECKING:
    from train_ato.model import TrainModel


@dataclass(frozen=True)
class PidParameters:
    """Parameters of :class:`Pid`."""

    gains: str = parameter(
        "per_mass", "", 0, 0, "kp, ki, kd multiply the train's inertia, or are forces", choices=("per_mass", "force")
    )
    kp: float = parameter(0.05, "1/s or N/(m/s)", 0.0, 1e9, "gain on the speed error")
    ki: float = parameter(0.001, "1/s² or N/m", 0.0, 1e9, "gain on the integral of the speed error")
    kd: float = parameter(0.0, "1 or N s²/m", 0.0, 1e9, "gain on the rate of the speed error")
    integral: str = parameter(
        "position",
        "",
        0,
        0,
        "take the measured position error as integral, or sum the speed error",
        choices=("position", "speed"),
    )
    integral_limit: float = parameter(20.0, "m", 0.0, 1e6, "clamp of the integral")
    filter_time: float = parameter(0.0, "s", 0.0, 60.0, "low-pass filter of the speed error, against noise")
    derivative_time: float = parameter(0.1, "s", 0.0, 60.0, "filter of the error's rate")
    feedforward: bool = parameter(True, "", 0, 1, "add the force that the nominal train needs")
    disturbance: bool = parameter(True, "", 0, 1, "take the observer's estimate off")


class Pid(GuardedLaw):
    """PID on the speed error with feed-forward, clamped integral and filtered derivative."""

    Parameters: ClassVar[type] = PidParameters

    def __init__(self, parameters: PidParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        scale = model.inertia if parameters.gains == "per_mass" else 1.0
        gains = (parameters.kp, parameters.ki, parameters.kd)
        self._gains = [tuple(scale * share * gain for gain in gains) for share in model.share.tolist()]
        self._keep = math.exp(-period / parameters.derivative_time) if parameters.derivative_time > 0 else 0.0
        self._smooth = math.exp(-period / parameters.filter_time) if parameters.filter_time > 0 else 0.0
        if not parameters.feedforward:
            self.leaves_feedforward = "this law is told to leave it: set pid.feedforward: true"
        self._of_position = parameters.integral == "position"
        self._led, self._told = parameters.feedforward, parameters.disturbance
        self._nothing = [0.0] * self.n
        self.forget()

    def forget(self) -> None:
        """Empty the integrals and the derivative filter."""
        self._integral = [0.0] * self.n
        self._rate = [0.0] * self.n
        self._before: list[float] | None = None
        self._filtered: list[float] | None = None

    def missed(self) -> None:
        """Leave the gap out of the difference quotient."""
        self._before = None

    def demand(self, inputs: LawInput) -> list[float]:
        """Return the force wanted [N]."""
        errors = list(map(sub, inputs.velocity.tolist(), inputs.reference_velocity.tolist()))
        if self._smooth:
            errors = self._filter(errors)
        integrals = self._distances(inputs) if self._of_position else self._summed(errors)
        known = inputs.feedforward.tolist() if self._led else self._nothing
        disturbance = inputs.disturbance.tolist() if self._told else self._nothing
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
        keep, before = self._smooth, errors if self._filtered is None else self._filtered
        self._filtered = [now + keep * (old - now) for now, old in zip(errors, before, strict=True)]
        return self._filtered

    def _derivative(self, unit: int, error: float) -> float:
        if self._before is not None:
            raw = (error - self._before[unit]) / self.period
            self._rate[unit] = self._keep * self._rate[unit] + (1.0 - self._keep) * raw
        return self._rate[unit]

    def _distances(self, inputs: LawInput) -> list[float]:
        """Return the measured position errors, clamped [m]."""
        limit: float = self.parameters.integral_limit
        errors = map(sub, inputs.position.tolist(), inputs.reference_position.tolist())
        return [error if -limit <= error <= limit else math.copysign(limit, error) for error in errors]

    def _summed(self, errors: list[float]) -> list[float]:
        """Return the summed speed errors, clamped; a unit at a limit holds its own while that drives it further [m]."""
        limit: float = self.parameters.integral_limit
        for unit, error in enumerate(errors):
            if not (self.cut[unit] and (self._held[unit] > 0) == (error < 0)):
                total = self._integral[unit] + error * self.period
                self._integral[unit] = min(max(total, -limit), limit)
        return self._integral
