"""Twin: feed-forward from a copy of the whole nominal train that runs ahead of the real one.

The best that is known for long trains: `pid` with low gains on top of it needs no more than to add what the model is
off.

A long train cannot be fed forward as one rigid mass. The twin is the nominal multi-mass train, with ideal actuators and
the same brake policy, driven along the profile by inverse dynamics at every unit::

    u_i = FC_i + W_i + Fa_i + m_i [v_d' - l1 (v_i - v_d) - l2 (x_i - x_d)]

with its own coupler forces FC, resistance W and shoe forces Fa, known exactly. It is simulated tau + Ta ahead, and the
force it has there is what to send now::

    u_ff(t) = u_twin(t + tau + Ta)

The state stays as measured; the law adds what little the train is off. A unit whose delay depends on the sign of its
command reads its force at the delay of the sign it has.

Needs: the model's consist and line whole, and a law that takes the feed-forward (`pid`, `rbf_switching_smc`, `smc` with
``equivalent: feedforward``); others are refused, because nothing would change for them.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from train_ato.compensate.contract import Situation, View
from train_ato.compensate.copy import nominal_copy
from train_ato.compensate.preview import Preview
from train_ato.control.contract import parameter
from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.brake.policy import BrakePolicy
    from train_ato.compensate.rigid import ProfileLike
    from train_ato.model import TrainModel

L1, L2 = 1.0, 0.25
"""Gains of the twin's follower [1/s, 1/s²]."""


@dataclass(frozen=True)
class TwinParameters:
    """Parameters of :class:`Twin`."""

    lag: bool = parameter(True, "", 0, 1, "run ahead by the actuators' lag as well as the delay")
    delay_factor: float = parameter(1.0, "1", 0.0, 10.0, "run ahead by so many times the model's delay")
    period: float = parameter(0.05, "s", 0.001, 1.0, "period of the twin's follower")
    step: float = parameter(0.005, "s", 1e-4, 0.1, "integration step of the twin")


class Twin(Preview):
    """Feed-forward from the nominal multi-mass train run ahead along the profile."""

    Parameters: ClassVar[type] = TwinParameters
    feedforward_only: ClassVar[bool] = True

    def __init__(self, parameters: TwinParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)  # type: ignore[arg-type]
        self._policy: BrakePolicy | None = None
        self._ahead: AheadTrain | None = None

    def set_brake_policy(self, policy: BrakePolicy) -> None:
        """Take the policy that the twin's own air brake follows."""
        self._policy = policy

    def reset(self) -> None:
        """Begin anew with the next profile."""
        super().reset()
        self._ahead = None

    def see(self, now: Situation) -> View:
        """Return the measured state with the force the twin has at the acting time."""
        self.shoes.tell(now.t, now.pressure)
        if self._ahead is None:
            self._ahead = AheadTrain(self.model, self.rigid.profile, self.parameters, self._policy, now.t)
        delay = self.mean_delay(now.under_way)
        _, _, acceleration, jerk = self.rigid.profile.at(now.t + delay)
        shoes = self.shoes.at(now.t, now.reference[1])
        feedforward = self._read(now.t)
        return self.as_measured(now, now.t + delay, acceleration, jerk, feedforward, shoes)

    def _read(self, t: float) -> Array:
        assert self._ahead is not None
        self._ahead.profile = self.rigid.profile
        self._ahead.run(t + max(max(self.forward), max(self.backward)) + self.lag, keep_from=t)
        wanted = []
        for unit, (forward, backward) in enumerate(zip(self.forward, self.backward, strict=True)):
            force = self._ahead.force(unit, t + forward + self.lag)
            if force < 0.0 and backward != forward:
                force = min(0.0, self._ahead.force(unit, t + backward + self.lag))
            wanted.append(force)
        return np.array(wanted)


class AheadTrain:
    """The nominal train driven along the profile on its own clock.

    Parameters
    ----------
    model
        The nominal train.
    profile
        What it follows.
    parameters
        Period and step.
    policy
        Of the air brake, its own copy; None if there is none.
    start
        Time at which it begins [s].
    """

    def __init__(
        self,
        model: TrainModel,
        profile: ProfileLike,
        parameters: TwinParameters,
        policy: BrakePolicy | None,
        start: float,
    ) -> None:
        self.profile = profile
        self._model = model
        self._policy = policy if model.consist.air_brake is not None else None
        self._train = nominal_copy(model, profile, start, parameters.period, parameters.step)
        self._substeps, self._period = self._train.substeps, round(parameters.period * 1e9) * 1e-9
        self._start = start
        self._units = np.array(model.units)
        self._front = np.array([vehicle - 1 for vehicle in model.units])
        self._forces: deque[list[float]] = deque()
        self._first = 0

    def run(self, until: float, keep_from: float) -> None:
        """Drive on until the forces up to a time are known; forget those before another [s]."""
        while self._start + (self._first + len(self._forces) - 1) * self._period < until:
            self._forces.append(self._drive())
        while len(self._forces) > 2 and self._start + (self._first + 1) * self._period < keep_from:
            self._forces.popleft()
            self._first += 1

    def force(self, unit: int, t: float) -> float:
        """Return the force of a unit at a time that was run [N], linear between the follower's steps."""
        place = (t - self._start) / self._period - self._first
        index = min(max(int(place), 0), len(self._forces) - 2)
        low = self._forces[index][unit]
        return low + (place - index) * (self._forces[index + 1][unit] - low)

    def _drive(self) -> list[float]:
        train, model = self._train, self._model
        t = self._start + train.time
        pressure = None
        position, velocity = train.position, train.velocity
        if self._policy is not None:
            pressure = self._policy.step(t, float(position[0]), float(velocity[0]), float(train.applied.sum()))
        place, speed, _, _ = self.profile.at(t)
        _, _, pull, _ = self.profile.at(t + 0.5 * self._period)
        own_place, own_speed = position[self._units], velocity[self._units]
        force = train.coupler_force
        held = force[self._units] - np.where(self._front >= 0, force[self._front], 0.0) + train.shoe_force[self._units]
        held += model.own_resistance(own_speed, own_place)
        error = own_place + model.offsets - place
        wanted = held + model.unit_inertia * (pull - L1 * (own_speed - speed) - L2 * error)
        low, high = model.force_limits(own_speed)
        wanted = np.minimum(np.maximum(wanted, low), high)
        train.advance(np.broadcast_to(wanted, (self._substeps, wanted.size)), pressure)
        sent: list[float] = wanted.tolist()
        return sent
