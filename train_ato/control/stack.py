"""The control stack: compensation, law, guards, bumpless swap, brake policy. One object, one call per tick."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from train_ato.compensate.contract import Compensation, Situation
from train_ato.compensate.rigid import ProfileLike, RigidForce
from train_ato.control.contract import Law, LawInput, Preview
from train_ato.control.held import HeldSteps
from train_ato.control.parts.guard import FARTHEST, FASTEST, STRONGEST, within
from train_ato.control.registry import LAWS
from train_ato.control.sent import SentCommands
from train_ato.control.standstill import RELEASING, kept_from_departing, left_to_holding_brake
from train_ato.types import Array, DisturbanceEstimate, Measurement, Reference

if TYPE_CHECKING:
    from train_ato.brake.policy import BrakePolicy
    from train_ato.model import TrainModel

BLEND = 1.0
"""Time over which the jump between two laws is worn off after a swap [s]."""


class ControlStack:
    """Everything between a measurement and the command that answers it.

    Parameters
    ----------
    model
        The nominal train.
    period
        Period of the law [s], an integer multiple of the tick; in between the command is held.
    tick
        Period of the loop [s].
    controller
        Name of the law.
    controller_parameters
        Parameters that differ from the defaults, by law.
    compensation
        The delay compensation.
    brake_policy
        When the air brake is applied.
    profile
        The speed profile.
    hold_limit
        Longest time for which the last command is repeated for want of a usable one [s].

    Attributes
    ----------
    holding : bool
        The last step repeated the command before it: the measurement or the law's answer was not usable.

    Raises
    ------
    ValueError
        If the law, its parameters or the period are refused.
    """

    def __init__(
        self,
        model: TrainModel,
        period: float,
        tick: float,
        controller: str,
        controller_parameters: Mapping[str, Mapping[str, Any]],
        compensation: Compensation,
        brake_policy: BrakePolicy,
        profile: ProfileLike,
        hold_limit: float,
    ) -> None:
        self.model = model
        self.period = period
        self._every = round(period / tick)
        if self._every < 1 or abs(self._every * tick - period) > 1e-9:
            raise ValueError(f"control_period {period:g} s is not a multiple of the tick {tick:g} s")
        self._name = controller
        self._law: Law = LAWS.make(controller, controller_parameters.get(controller, {}), model, period)
        self._compensation = compensation
        self._policy = brake_policy
        self._lead = float(max(model.delay.max(), model.delay_brake.max())) + model.lag
        self._air_brake = model.consist.air_brake is not None
        self._sent = SentCommands(model, tick)
        self._ticks = 0
        self._last = [0.0] * model.n_units
        self._offset: list[float] | None = None
        self._blend = _blend_weights(period)
        self._blended = 0
        self._pressure: float | None = None
        self._cut = False
        self._unsound = 0
        self._unsound_estimates = 0
        self._held = HeldSteps(hold_limit, period)
        self._saturated = 0
        self._swaps = 0
        self._nothing = np.zeros(model.n_units)
        self._no_preview = Preview(np.zeros(0), np.zeros(0), np.zeros(0))
        self.set_profile(profile)
        take_policy = getattr(compensation, "set_brake_policy", None)
        if take_policy is not None:
            take_policy(copy.deepcopy(brake_policy))
        self._tell_sent = getattr(compensation, "sent", None)

    def set_profile(self, profile: ProfileLike) -> None:
        """Take a new profile, at the start or when it was planned anew."""
        self._profile = profile
        self._compensation.set_profile(RigidForce(self.model, profile))

    def swap(self, name: str, parameters: Mapping[str, Any]) -> None:
        """Put another law, or other parameters, in place; the force does not jump.

        The new law's first output equals the last command; the offset that takes wears off within a second.

        Raises
        ------
        ValueError
            With the reason; the old law goes on.
        """
        self._law = LAWS.make(name, parameters, self.model, self.period)
        self._name = name
        self._offset = []
        self._blended = 0
        self._swaps += 1

    @property
    def holding(self) -> bool:
        """Tell whether the last step of the law repeated the command before it."""
        return self._held.in_a_row > 0

    def diagnostics(self) -> dict[str, str]:
        """Return counts of what the guards did, as text."""
        return {
            "unsound_measurements": str(self._unsound),
            "unsound_estimates": str(self._unsound_estimates),
            "held_steps": str(self._held.total),
            "saturated_steps": str(self._saturated),
            "swaps": str(self._swaps),
        }

    def step(
        self, measurement: Measurement, reference: Reference, estimate: DisturbanceEstimate
    ) -> tuple[Array, float | None]:
        """Return the force demand per unit [N] and the brake-pipe pressure demanded [Pa], None without an air brake.

        Raises
        ------
        RunFailed
            If the last command has been repeated for longer than the limit.
        """
        self._held.check()
        due = self._ticks % self._every == 0
        self._ticks += 1
        healthy = _sound(measurement)
        if not healthy:
            self._unsound += 1
        elif self._air_brake:
            self._pressure = self._policy.step(
                measurement.stamp * 1e-9,
                float(measurement.position[0]),
                float(measurement.velocity[0]),
                float(measurement.applied.sum()),
            )
        if due and not healthy:
            self._held.count("no measurement of the power units could be used")
            if (tell_missed := getattr(self._law, "missed", None)) is not None:
                tell_missed()
        elif due:
            self._last = self._decide(measurement, reference, estimate)
            self._last = self._at_standstill(measurement, reference)
            if self._tell_sent is not None:
                self._tell_sent(np.array(self._last))
        force = np.array(self._last)
        self._sent.push(force)
        return force, self._pressure

    def _at_standstill(self, measurement: Measurement, reference: Reference) -> list[float]:
        """Return the command, or what holds or releases a train that stands."""
        if left_to_holding_brake(measurement, reference, self._profile, self._lead):
            return [0.0] * self.model.n_units
        if kept_from_departing(self._last, measurement, self._profile, self._lead, self.model):
            return [RELEASING] * self.model.n_units
        return self._last

    def _decide(self, measurement: Measurement, reference: Reference, estimate: DisturbanceEstimate) -> list[float]:
        low, high = self.model.force_limits(measurement.velocity)
        output = self._law.step(self._gather(measurement, reference, estimate, low, high))
        wanted = output.force.tolist()
        if not all(map(math.isfinite, wanted)) or len(wanted) != self.model.n_units:
            self._held.count(f"law '{self._name}' answered {str(wanted)[:60]} N")
            return self._last
        if output.held:
            self._held.count(f"law '{self._name}' found no force ({output.held})")
        else:
            self._held.over()
        if self._air_brake and output.brake_pipe is not None and math.isfinite(output.brake_pipe):
            self._pressure = min(max(output.brake_pipe, 0.0), self.model.consist.air_brake.charged)  # type: ignore[union-attr]
        if self._offset is not None:
            wanted = self._bumpless(wanted)
        limits = list(zip(low.tolist(), high.tolist(), strict=True))
        sent = [min(max(force, a), b) for force, (a, b) in zip(wanted, limits, strict=True)]
        self._cut = any(force and (force <= a or force >= b) for force, (a, b) in zip(sent, limits, strict=True))
        self._saturated += self._cut
        return sent

    def _bumpless(self, wanted: list[float]) -> list[float]:
        """Add what is left of the offset between the new law's first output and the last command."""
        assert self._offset is not None
        if not self._offset:
            self._offset = [last - force for last, force in zip(self._last, wanted, strict=True)]
        weight = self._blend[self._blended]
        self._blended += 1
        blended = [force + weight * offset for force, offset in zip(wanted, self._offset, strict=True)]
        if self._blended == len(self._blend):
            self._offset = None
        return blended

    def _gather(
        self,
        measurement: Measurement,
        reference: Reference,
        estimate: DisturbanceEstimate,
        low: Array,
        high: Array,
    ) -> LawInput:
        """Return what the law may know, as the compensation shows it."""
        disturbance = estimate.force
        if not within(disturbance, STRONGEST):
            disturbance = self._nothing
            self._unsound_estimates += 1
        under_way = self._sent.under_way()
        t = measurement.stamp * 1e-9
        view = self._compensation.see(
            Situation(
                t,
                measurement.position,
                measurement.velocity,
                measurement.applied,
                disturbance,
                under_way,
                (reference.position, reference.velocity, reference.acceleration),
                self._pressure,
            )
        )
        horizon = getattr(self._law, "horizon", 0)
        preview = self._no_preview
        if horizon:
            preview = Preview(*self._profile.window(view.acting_time, horizon, self.period)[:3])
        return LawInput(
            t,
            view.position,
            view.velocity,
            view.applied,
            view.reference_position,
            view.reference_velocity,
            view.reference_acceleration,
            view.lead,
            view.acting_acceleration,
            view.acting_jerk,
            view.feedforward,
            preview,
            disturbance,
            measurement.deflection,
            measurement.rate,
            measurement.force if view.coupler_force is None else view.coupler_force,
            view.shoe_force,
            view.train_shoe_force,
            under_way,
            low,
            high,
            self._cut,
        )


def _sound(measurement: Measurement) -> bool:
    """Tell whether the state of every unit was measured; what a law needs beyond that it checks itself."""
    return (
        within(measurement.position, FARTHEST)
        and within(measurement.velocity, FASTEST)
        and within(measurement.applied, STRONGEST)
    )


def _blend_weights(period: float) -> list[float]:
    """Return the weights of the offset after a swap: 1 at the first step, 0 a second later."""
    count = max(1, round(BLEND / period))
    return [1.0 - index / count for index in range(count)]
