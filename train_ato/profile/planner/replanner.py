"""Planning the rest of the run again while it runs: when, from which state, with which force.

What the train cannot follow is not chased.  Once :mod:`train_ato.plan.watch` has seen that force is missing, the rest
is planned again with what was found, from the state that the train will have a short lead later, so that the new
profile can be previewed through delay and lag before it begins.  The speeds of the first profile stay a ceiling at
every place, its stops stay, and what was found missing is remembered.

With ``retry`` traction is counted on again after a while; the brake never is, because a stop that was planned with a
brake that is not there is missed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from train_ato.plan.replan import State, replan
from train_ato.plan.settings import PlanSettings, ReplanSpec
from train_ato.plan.train_tables import AvailableForce
from train_ato.plan.watch import Sample, Shortfall, ShortfallWatch
from train_ato.profile.profile import Profile
from train_ato.types import Measurement

if TYPE_CHECKING:
    from train_ato.model import TrainModel

__all__ = ["Decision", "Replanner"]

STEP = 0.05
"""Step of the prediction over the lead [s]."""
AGAIN = 0.95
"""What was planned with and is not enough is cut to this part."""
PRESUMED = 0.85
"""Part that is counted on in braking of what was found in traction, and vice versa: adhesion falls with the speed."""


@dataclass(frozen=True, slots=True)
class Left:
    """Force that is counted on in one direction: a part of the nominal envelope and a largest force [N].

    ``by_part`` and ``by_level`` tell which of the two was seen; the careful planning takes both.
    """

    part: float = 1.0
    most: float = math.inf
    by_part: bool = False
    by_level: bool = False

    def at(self, envelope: float) -> float:
        """Return the force counted on where the nominal envelope is so large [N]."""
        return min(self.part * envelope, self.most)

    def times(self, factor: float) -> Left:
        """Return so much of it."""
        return Left(self.part * factor, self.most * factor, self.by_part, self.by_level)

    def likely(self) -> Left:
        """Return only what was seen."""
        return replace(self, part=self.part if self.by_part else 1.0, most=self.most if self.by_level else math.inf)

    def tightened(self, other: Left) -> Left:
        """Return what is left of both."""
        return Left(min(self.part, other.part), min(self.most, other.most), other.by_part, other.by_level)


@dataclass(frozen=True, slots=True)
class Decision:
    """Outcome of one look that found force missing: the joined profile, or why there is none."""

    profile: Profile | None
    reason: str


class Replanner:
    """Decides at every measurement whether the rest is planned again.

    Parameters
    ----------
    spec
        The scenario's ``replan:`` block.
    profile
        The first profile: ceiling and stops of all that follow.
    model
        The nominal train and line.
    own
        Settings that the profile was planned with, if it was.

    Attributes
    ----------
    replans, refusals : int
        Profiles planned anew, and plannings that were refused.
    traction, brake : Left
        What is counted on.
    """

    def __init__(self, spec: ReplanSpec, profile: Profile, model: TrainModel, own: PlanSettings | None) -> None:
        self._spec = spec
        self._first = self._profile = profile
        self._model = model
        settings = spec.settings(own)
        self._settings = settings.model_copy(update={"air_brake": False})
        delay = max(float(model.delay.max()), float(model.delay_brake.max()))
        ticks = math.ceil(max(spec.lead, delay + model.lag + model.tick) / model.tick - 1e-9)
        self._tick_ns = round(model.tick * 1e9)
        self._lead_ns = ticks * self._tick_ns
        self._watch = ShortfallWatch(
            model, spec.speed_error, spec.position_error, max(spec.sitting, delay + 3.0 * model.lag)
        )
        self._quiet = 0
        self._pause = spec.interval
        self._retry_at: int | None = None
        self.replans = self.refusals = 0
        self.traction = self.brake = Left()
        self._seen = {1: Left(), -1: Left()}

    def warm_up(self) -> None:
        """Plan the whole run once, so that no step waits for a compiler; whether that works does not matter."""
        first = self._first
        try:
            self._plan(State(first.start, float(first.position[0]), 0.0), AvailableForce())
        except ValueError:
            return

    def step(self, measurement: Measurement) -> Decision | None:
        """Take a measurement; return a decision if one fell."""
        stamp = measurement.stamp
        if stamp < self._quiet or not _finite(measurement):
            return None
        sample = self._sample(measurement)
        found = self._watch.step(sample)
        if found is not None:
            before = self.traction, self.brake, dict(self._seen)
            self._learn(found)
            sample = replace(
                sample,
                position_error=found.position_error,
                speed=sample.speed - sample.speed_error + found.speed_error,
            )
            decision = self._decided(measurement.stamp, sample, f"{_name(found.direction)} {found.level / 1e3:.1f} kN")
            if decision.profile is None:
                self.traction, self.brake, self._seen = before
            return decision
        if self._retry_at is not None and stamp >= self._retry_at and sample.needed >= 0.0:
            self._retry_at, self.traction, self._seen[1] = None, Left(), Left()
            return self._decided(measurement.stamp, sample, "traction counted on again")
        return None

    def _sample(self, measurement: Measurement) -> Sample:
        """Return errors and forces of a measurement, against the reference of its own stamp."""
        model = self._model
        place, speed, acceleration, _ = self._profile.at_stamp(measurement.stamp)
        velocity = float(measurement.velocity.mean())
        forward, backward = (self._watch.envelope(direction, velocity) for direction in (1, -1))
        return Sample(
            position_error=float((measurement.position + model.offsets).mean()) - place,
            speed_error=velocity - speed,
            speed=velocity,
            applied=float(measurement.applied.sum()),
            needed=model.rigid_force(place, speed, acceleration),
            believed=(self.traction.at(forward), self.brake.at(backward)),
        )

    def _learn(self, found: Shortfall) -> None:
        """Remember what is missing."""
        seen = Left(found.part, found.level, found.by_part, found.by_level)
        if found.known and self.replans:
            before = self.traction if found.direction > 0 else self.brake
            seen = before.tightened(seen).times(AGAIN)
        self._seen[found.direction] = self._seen[found.direction].tightened(seen)
        other = Left()
        if self._spec.both_ways and not found.known:
            other = (seen if seen.by_level else seen.likely()).times(PRESUMED)
        ahead, back = (seen, other) if found.direction > 0 else (other, seen)
        self.traction, self.brake = self.traction.tightened(ahead), self.brake.tightened(back)

    def _decided(self, stamp: int, sample: Sample, why: str) -> Decision:
        """Plan again and join, or say why not; nothing is looked at until the new profile has begun."""
        begin = stamp + self._lead_ns
        self._quiet = max(stamp + round(self._pause * 1e9), begin)
        self._watch.forget()
        if self._spec.retry is not None and self.traction != Left():
            self._retry_at = stamp + round(self._spec.retry * 1e9)
        state = self._ahead(stamp, sample, begin)
        refusal = ""
        for available in self._candidates():
            try:
                rest = self._plan(state, available)
                self._profile = self._profile.followed_by(rest)
            except ValueError as error:
                refusal = refusal or str(error)
            else:
                self.replans += 1
                self._pause = self._spec.interval
                return Decision(self._profile, why)
        self.refusals += 1
        self._pause *= 2.0
        return Decision(None, f"{why}: {refusal}")

    def _candidates(self) -> list[AvailableForce]:
        """Return the forces to plan with, the most careful first; the last counts on all that was not seen missing."""
        traction, brake, seen = self.traction, self.brake, self._seen
        pairs = [(traction, brake), (traction, brake.likely()), (traction.likely(), brake.likely())]
        pairs.append((seen[1].likely(), seen[-1].likely()))
        forces = [AvailableForce(a.part, b.part, a.most, b.most) for a, b in pairs]
        return list(dict.fromkeys(forces))

    def _plan(self, state: State, available: AvailableForce) -> Profile:
        model = self._model
        return replan(state, self._first, model.line, model.consist, self._settings, available).profile

    def _ahead(self, stamp: int, sample: Sample, begin: int) -> State:
        """Return the state of the nominal train under the force that acts now, a lead later."""
        model = self._model
        place = self._profile.at_stamp(stamp)[0] + sample.position_error
        speed, acceleration = max(sample.speed, 0.0), 0.0
        lead = (begin - stamp) * 1e-9
        count = max(1, math.ceil(lead / STEP - 1e-9))
        h = lead / count
        for _ in range(count):
            resisting = model.running_resistance(speed) + model.line_force(place)
            acceleration = (sample.applied - resisting) / model.inertia
            if speed + acceleration * h <= 0.0:
                speed = acceleration = 0.0
                continue
            place += (speed + 0.5 * acceleration * h) * h
            speed += acceleration * h
        return State(begin * 1e-9, place, speed, acceleration)


def _name(direction: int) -> str:
    return "traction" if direction > 0 else "brake"


def _finite(measurement: Measurement) -> bool:
    columns = (measurement.position, measurement.velocity, measurement.applied)
    return all(bool(np.isfinite(column).all()) for column in columns)
