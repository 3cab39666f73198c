"""PID with feed-forward, the baseline of papers 000 (section 3.1), 001 (eq. 15) and 004.

The feed-forward supplies most of the force, and three gains correct the remaining speed error. Every other law is
compared with this one. In papers 001, 003 and 004 most of the improvement of the law over its PID comes from the
preview, because the PID there has no preview.

Law, per unit, e = v - v_d (with the opposite sign in papers 001 and 004)::

    u = u_ff - K (kp e + ki I + kd de/dt) - d_hat
    I = the measured position error (default), or int e dt; both clamped to +-integral_limit
    de/dt through a first-order filter of time constant derivative_time

``K`` is the unit's share of the train's inertia (``per_mass: true``; kp in 1/s, ki in 1/s², kd dimensionless) or its
share of 1 (``per_mass: false``; kp in N/(m/s), ki in N/m, kd in N s²/m). With ``gains: model`` kp and ki follow from
the model. The train is an integrator of the force behind the dead time theta = delay + lag + period. For it the rule of
Skogestad (SIMC, Journal of Process Control 13, 2003, table 1) gives kp = 1/(2 theta), ki = kp/(8 theta). Two limits
lower kp on trains with elastic couplers. The first limit follows from the modes of the couplers that delay and lag turn
by a quarter or more. At a certain gain such a mode loses its damping; kp is at most half of this gain. Damping by
friction counts only a third. The second limit is two thirds of the wave impedance of the hauled vehicles. ki is at most
kp²/4, and kp at most 1/s. Paper 000 prints the second form with 1e7, 1, 1. Its error is then the force divided by 1e7.

With ``u_ff`` the nominal train follows the reference at the time at which the command takes effect. The PID of the
papers has no feed-forward (``feedforward: false``).

The defaults suit a long train. Above its first mode the locomotive does not move the mass of the train but a wave in
the couplers. The ratio of force to speed in this wave (wave impedance) is about 1e6 N s/m, and K kp must be below it.

``filter_time`` smooths e in the first and third term only.

Anti-windup: the integral is held while the unit is at a limit and the error would increase it.

Needs: any train; inertia and shares of the model, measured state, and by default the feed-forward and the estimate. It
needs no coupler sensor. ``feedforward: false`` is rejected with compensations that give only a feed-forward (`pade`,
`twin`).
"""

import math
from dataclasses import dataclass
from math import copysign
from typing import Any, ClassVar

from plant_sim.compiled import compiled
from plant_sim.record import Records, quantity
from train_ato.control.algorithms.loop_gains import LoopGains
from train_ato.control.algorithms.sliding import clamped
from train_ato.control.contract import LawInput, choice, flag, parameter
from train_ato.control.gains import gains_choice
from train_ato.control.law import INVALID, LawForm, LawNow, LawUnit, RecordLaw
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array


@dataclass(frozen=True)
class PidParameters:
    """Parameters of :class:`Pid`."""

    gains: str = gains_choice()
    kp: float = parameter(0.05, "1/s or N/(m/s)", 0.0, 1e9, "gain on the speed error")
    ki: float = parameter(0.001, "1/s² or N/m", 0.0, 1e9, "gain on the integral of the speed error")
    kd: float = parameter(0.0, "1 or N s²/m", 0.0, 1e9, "gain on the derivative of the speed error")
    per_mass: bool = flag("kp, ki, kd are multiplied by the inertia of the train", default=True)
    integral: str = choice("integral: the measured position error, or the sum of the speed error", "position", "speed")
    integral_limit: float = parameter(20.0, "m", 0.0, 1e6, "largest magnitude of the integral")
    filter_time: float = parameter(0.0, "s", 0.0, 60.0, "time constant of the low-pass filter of the speed error")
    derivative_time: float = parameter(0.1, "s", 0.0, 60.0, "time constant of the filter of the derivative")
    feedforward: bool = flag("add the feed-forward force of the nominal train", default=True)
    disturbance: bool = flag("subtract the estimate of the observer", default=True)


@dataclass(frozen=True)
class PidConstants(PidParameters):
    """Constants of :func:`pid`: its parameters and the values computed from them."""

    of_position: bool = quantity("", "the integral is the position error")
    filter_decay: float = quantity("1", "part of the filtered error that is left after a period")
    derivative_decay: float = quantity("1", "part of the filtered derivative that is left after a period")
    period: float = quantity("s", "control period")


@dataclass
class PidUnit:
    """State of :func:`pid` for one unit."""

    inertia: float = quantity("kg", "factor of the gains: share of the train's inertia, or of 1")
    integral: float = quantity("m", "sum of the speed error")
    rate: float = quantity("m/s²", "filtered derivative of the error")
    before: float = quantity("m/s", "error of the last step")
    filtered: float = quantity("m/s", "filtered error")
    known: bool = quantity("", "the error of the last step is known")
    has_filtered: bool = quantity("", "the filtered error is known")


@compiled
def pid(p: PidConstants, state: Records[PidUnit], now: LawNow, units: Records[LawUnit]) -> None:
    """Compute the demand of PID on the speed error with feed-forward [N]."""
    limit = p.integral_limit
    for u in range(units.size):
        x, own = units[u], state[u]
        error = x.velocity - x.reference_velocity
        if p.filter_decay != 0.0:
            error = error + p.filter_decay * ((own.filtered if own.has_filtered else error) - error)
            own.has_filtered, own.filtered = True, error
        if p.of_position:
            total = x.position - x.reference_position
            if not -limit <= total <= limit:
                total = copysign(limit, total)
        else:
            if not (x.saturated and (x.force > 0) == (error < 0)):  # at a limit only towards the inside
                own.integral = clamped(own.integral + error * p.period, -limit, limit)
            total = own.integral
        correction = own.inertia * p.kp * error + own.inertia * p.ki * total
        if p.kd != 0.0:
            if own.known:
                raw = (error - own.before) / p.period
                own.rate = p.derivative_decay * own.rate + (1.0 - p.derivative_decay) * raw
            correction += own.inertia * p.kd * own.rate
        own.known, own.before = True, error
        known = x.feedforward if p.feedforward else 0.0
        x.wanted = known - (x.disturbance if p.disturbance else 0.0) - correction


class Pid(RecordLaw):
    """PID on the speed error with feed-forward, clamped integral and filtered derivative."""

    Parameters: ClassVar[type] = PidParameters
    form = LawForm(pid, PidConstants, PidUnit)
    uses_effect = uses_train_forces = False

    @classmethod
    def model_gains(cls, model: TrainModel, period: float) -> dict[str, Any]:
        """Return kp [1/s] and ki [1/s²] for delay, lag and couplers of a train."""
        loop = LoopGains.of(model, period)
        return {"kp": loop.speed, "ki": loop.position}

    def __init__(self, parameters: PidParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self.uses_feedforward, self.feedforward_hint = parameters.feedforward, "feedforward: true"
        self.state["inertia"] = (model.inertia if parameters.per_mass else 1.0) * model.share
        self.set_constants(
            of_position=parameters.integral == "position",
            filter_decay=decay(parameters.filter_time, period),
            derivative_decay=decay(parameters.derivative_time, period),
        )

    def feedback(self) -> tuple[float, float] | None:
        """Return the gains on the errors of speed [1/s] and position [1/s²], None with a derivative."""
        p, inertia = self.parameters, 1.0 if self.parameters.per_mass else self.model.inertia
        return None if p.kd > 0.0 else (p.kp / inertia, p.ki / inertia)

    def take_over(self, inputs: LawInput, force: Array) -> None:
        """Begin at the last command [N] by the sums of the speed error; the position error cannot be chosen."""
        if self.parameters.integral == "speed" and self.call(inputs) != INVALID:
            p, wanted = self.parameters, self.units["wanted"].tolist()
            self.clear_state()
            for own, demand, last in zip(self.state, wanted, force.tolist(), strict=True):
                if (ki := own["inertia"] * p.ki) > 0.0:
                    own["integral"] = min(max((demand - last) / ki, -p.integral_limit), p.integral_limit)
        super().take_over(inputs, force)


def decay(time_constant: float, period: float) -> float:
    """Return the part that a filter keeps over a period, 0 without a time constant [s]."""
    return math.exp(-period / time_constant) if time_constant > 0 else 0.0
