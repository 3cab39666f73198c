"""Re-planning during the run: trigger, start state and available force of the new plan.

After :mod:`train_ato.profile.planner.replanner` has detected a shortfall, the rest is planned again with the
observed force.  The new profile starts from the state predicted for the end of a lead time, so that it can be previewed
over delay and lag.  The speeds of the first profile remain a ceiling, its stops are kept, and observed shortfalls are
remembered.

With ``catch_up`` the first profile is no ceiling. The rest of the run returns to the timing points of the plan. The
reason of the decision names the first window that is lost. With ``lateness`` a late or early train is a sufficient
reason.  A train that overruns a stop keeps its profile up to the end of the halt there.

With ``retry`` the full traction is assumed again after some time.  The full brake is never assumed again, because a
stop planned with a missing brake would be missed.

Detection of a force shortfall from measurements.

A law whose response is delayed increases the force while the error grows.  At a shortfall the applied force stays
constant, or decreases with the speed like an envelope.  It is then below the force that the profile requires, or at the
maximum assumed so far, and the error grows in the direction of the missing force.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from plant_sim.elementary import plain_sum
from train_ato.messages.types import Measurement
from train_ato.profile.planner.plan_from_state import TrainState, catch_up, replan, scheduled_points, timetable_points
from train_ato.profile.planner.settings import PlanSettings, ReplanSpec
from train_ato.profile.planner.timing_points import TimingPoint
from train_ato.profile.planner.train_tables import AvailableForce
from train_ato.profile.profile import Profile

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel


CONSTANT_TOLERANCE = 0.01
"""Relative change within the window up to which a force counts as constant."""
FORCE_TOLERANCE = 0.01
"""Relative force that must be missing, and relative distance at which a limit counts as reached."""
GROWING_FRACTION = 0.2
"""Fraction of the speed threshold above which a growing position error is sufficient."""
MIN_ERROR_FRACTION = 0.1
"""Fraction of the speed threshold below which no detection takes place."""


@dataclass(frozen=True, slots=True)
class Sample:
    """Measurement of one tick.

    Attributes
    ----------
    position_error, speed_error : float
        Measured minus profile [m, m/s].
    speed : float
        Measured speed [m/s].
    applied : float
        Applied force of the whole train [N], > 0 forward.
    required : float
        Force of the nominal train on the profile [N].
    available : tuple of float
        Maximum assumed so far in traction and in braking [N], both >= 0.
    """

    position_error: float
    speed_error: float
    speed: float
    applied: float
    required: float
    available: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Shortfall:
    """A detected force shortfall.

    Attributes
    ----------
    direction : int
        1 traction, -1 braking.
    observed : ForceEstimate
        Force during the shortfall, >= 0; it followed the envelope, was constant, or both on a flat envelope.
    expected : bool
        The force is at the maximum assumed so far: the mass or the resistance is larger than in the model.
    position_error, speed_error : float
        Errors at the last sample, from a linear regression over the window [m, m/s].
    """

    direction: int
    observed: ForceEstimate
    expected: bool
    position_error: float
    speed_error: float


class ShortfallDetector:
    """Detector of a force shortfall over a sliding window.

    Parameters
    ----------
    model
        Nominal train.
    speed_error, position_error
        Thresholds of the detection [m/s, m].
    window
        Window [s].
    """

    def __init__(self, model: TrainModel, speed_error: float, position_error: float, window: float) -> None:
        self._model = model
        self._speed_error = speed_error
        self._position_error = position_error
        self._samples: deque[Sample] = deque(maxlen=max(4, round(window / model.tick) + 1))
        low, high = model.force_limits(np.zeros(model.n_units))
        self._largest = max(float(high.sum()), -float(low.sum()), 1.0)

    def reset(self) -> None:
        """Discard all samples, for a new profile."""
        self._samples.clear()

    def step(self, sample: Sample) -> Shortfall | None:
        """Add a sample; return the shortfall if one is detected."""
        samples = self._samples
        samples.append(sample)
        if len(samples) < (samples.maxlen or 0) or abs(sample.speed_error) < MIN_ERROR_FRACTION * self._speed_error:
            return None
        speed = _regression_end([entry.speed_error for entry in samples])
        position = _regression_end([entry.position_error for entry in samples])
        direction = -1 if speed > 0 else 1
        behind = -direction * position > self._position_error
        if abs(speed) <= self._speed_error * (GROWING_FRACTION if behind else 1.0):
            return None
        forces = [direction * entry.applied for entry in samples]
        level = forces[-1]
        tolerance = CONSTANT_TOLERANCE * max(abs(level), 0.01 * self._largest)
        errors, half = [-direction * entry.speed_error for entry in samples], len(samples) // 2
        if min(forces) < -tolerance or plain_sum(errors[-half:]) <= plain_sum(errors[:half]):  # it does not grow
            return None
        constant = max(forces) - min(forces) <= tolerance
        places = (0, len(forces) // 2, -1)
        fractions = [forces[place] / self.envelope(direction, samples[place].speed) for place in places]
        follows = max(fractions) - min(fractions) <= CONSTANT_TOLERANCE * max(fractions[-1], 0.01)
        if not (constant or follows):
            return None
        available = sample.available[0 if direction > 0 else 1]
        expected = level >= (1.0 - FORCE_TOLERANCE) * available
        if not expected and level >= (1.0 - FORCE_TOLERANCE) * direction * sample.required:
            return None
        observed = ForceEstimate(max(fractions[-1], 0.0), max(level, 0.0), follows, constant)
        return Shortfall(direction, observed, expected, position, speed)

    def envelope(self, direction: int, speed: float) -> float:
        """Return the nominal maximum force in a direction at a speed [N], at least 1."""
        low, high = self._model.force_limits(np.full(self._model.n_units, max(speed, 0.0)))
        return max(float(high.sum()) if direction > 0 else -float(low.sum()), 1.0)


def _regression_end(values: list[float]) -> float:
    """Return the linear regression of evenly spaced values at the last of them."""
    n = len(values)
    middle = (n - 1) / 2
    slope = plain_sum((k - middle) * value for k, value in enumerate(values)) / (n * (n * n - 1) / 12)
    return plain_sum(values) / n + slope * middle


PREDICTION_STEP = 0.05
"""Integration step of the prediction over the lead time [s]."""
REPEATED_FACTOR = 0.95
"""Factor on a force estimate after a plan with this estimate had a shortfall again."""
HALT_DISTANCE = 5.0
"""Largest distance from the profile of a train that waits with it at a stop; a plan there would begin the dwell again
or leave it out [m]."""
MIN_LATE_SPEED = 1.0
"""Speed below which a train is not late: the place is no measure of the time at a stop [m/s]."""
OTHER_DIRECTION_FACTOR = 0.85
"""Factor for the brake estimate after a traction shortfall, and vice versa: adhesion decreases with the speed."""


@dataclass(frozen=True, slots=True)
class ForceEstimate:
    """Assumed force in one direction: a fraction of the nominal envelope and a maximum [N].

    ``follows_envelope`` and ``is_constant`` mark the observed one of the two; the most careful plan uses both.
    """

    fraction: float = 1.0
    maximum: float = math.inf
    follows_envelope: bool = False
    is_constant: bool = False

    def at(self, envelope: float) -> float:
        """Return the assumed force [N] for a nominal envelope [N]."""
        return min(self.fraction * envelope, self.maximum)

    def scaled(self, factor: float) -> ForceEstimate:
        """Return the estimate multiplied by a factor."""
        return ForceEstimate(self.fraction * factor, self.maximum * factor, self.follows_envelope, self.is_constant)

    def observed_only(self) -> ForceEstimate:
        """Return the estimate without the unobserved bound."""
        fraction = self.fraction if self.follows_envelope else 1.0
        return replace(self, fraction=fraction, maximum=self.maximum if self.is_constant else math.inf)

    def tightened(self, other: ForceEstimate) -> ForceEstimate:
        """Return the minimum of both estimates."""
        fraction, maximum = min(self.fraction, other.fraction), min(self.maximum, other.maximum)
        return ForceEstimate(fraction, maximum, other.follows_envelope, other.is_constant)


@dataclass(frozen=True, slots=True)
class ReplanDecision:
    """Result of one shortfall: the joined profile, or None with the reason of the refusal."""

    profile: Profile | None
    reason: str


class Replanner:
    """Decision on re-planning at every measurement.

    Parameters
    ----------
    spec
        The scenario's ``replan:`` block.
    profile
        The first profile: speed ceiling and stops of all later ones.
    model
        Nominal train and line.
    own
        Settings of the scenario's plan; None for a profile from another source.
    first
        The profile with the timetable, which a train is late to until it is planned again; differs after an engagement.

    Attributes
    ----------
    replans, refusals : int
        Number of new profiles and of refused plans.
    traction, brake : ForceEstimate
        Assumed forces.
    """

    def __init__(
        self, spec: ReplanSpec, profile: Profile, model: TrainModel, own: PlanSettings | None, first: Profile
    ) -> None:
        self._spec = spec
        self._initial = self._profile = profile
        self._timing = first.time, first.position
        self._model = model
        settings = spec.settings(own)
        self._settings = settings.model_copy(update={"air_brake": False})
        delay = model.longest_delay
        ticks = math.ceil(max(spec.lead, delay + model.lag + model.tick) / model.tick - 1e-9)
        self._tick_ns = round(model.tick * 1e9)
        self._lead_ns = ticks * self._tick_ns
        self._detector = ShortfallDetector(
            model, spec.speed_error, spec.position_error, max(spec.confirmation_time, delay + 3.0 * model.lag)
        )
        self._blocked_until = 0
        self._points: tuple[TimingPoint, ...] = ()
        self._half = model.consist.vehicles[0].length / 2
        if spec.catch_up and own is not None:
            self._points = scheduled_points(first, self._half) if own.allowance else timetable_points(model.line, own)
        self._lost = ""
        self._pause = spec.interval
        self._retry_at: int | None = None
        self.replans = self.refusals = 0
        self.traction = self.brake = ForceEstimate()
        self._observed = {1: ForceEstimate(), -1: ForceEstimate()}

    def warm_up(self) -> None:
        """Plan the whole run once, so that no later step waits for a compiler; a refused plan is ignored."""
        first = self._initial
        try:
            self._plan(TrainState(first.start, float(first.position[0]), 0.0), AvailableForce())
        except ValueError:
            return

    def step(self, measurement: Measurement) -> ReplanDecision | None:
        """Process a measurement; return a decision if there is one."""
        stamp = measurement.stamp
        if stamp < self._blocked_until or not _is_finite(measurement):
            return None
        sample = self._sample(measurement)
        shortfall = self._detector.step(sample)
        if shortfall is not None:
            before = self.traction, self.brake, dict(self._observed)
            self._update_estimates(shortfall)
            sample = replace(
                sample,
                position_error=shortfall.position_error,
                speed=sample.speed - sample.speed_error + shortfall.speed_error,
            )
            force = "traction" if shortfall.direction > 0 else "brake"
            decision = self._replanned(measurement.stamp, sample, f"{force} {shortfall.observed.maximum / 1e3:.1f} kN")
            if decision.profile is None:
                self.traction, self.brake, self._observed = before
            return decision
        halts = sample.speed < MIN_LATE_SPEED and abs(sample.position_error) < HALT_DISTANCE
        if self._retry_at is not None and stamp >= self._retry_at and sample.required >= 0.0 and not halts:
            self._retry_at, self.traction, self._observed[1] = None, ForceEstimate(), ForceEstimate()
            return self._replanned(measurement.stamp, sample, "full traction assumed again")
        late = self._lateness(stamp, sample)
        if late is not None:
            return self._replanned(stamp, sample, f"{abs(late):.1f} s {'late' if late > 0 else 'early'}")
        return None

    def _lateness(self, stamp: int, sample: Sample) -> float | None:
        """Return the time behind the profile [s] if it is larger than the permitted one; None otherwise."""
        limit, profile = self._spec.lateness, self._profile
        if limit is None or not self._points or sample.speed < MIN_LATE_SPEED:
            return None
        now, (times, places) = stamp * 1e-9, self._timing
        place = profile.at(now)[0] + sample.position_error
        late = now - float(np.interp(place, places, times))
        return late if abs(late) > limit and self._overrun(now, place) is None else None

    def _follow(self, rest: Profile) -> None:
        """Follow a plan from its begin on; the profile before it is ahead of a late train."""
        self._profile, self._timing = self._profile.followed_by(rest), (rest.time, rest.position)

    def _overrun(self, time: float, place: float) -> float | None:
        """Return the place of a stop behind a place [m] from which the profile departs after a time [s], or None."""
        profile = self._profile
        first = int(np.searchsorted(profile.time, time))
        stops = profile.position[first:][profile.velocity[first:] == 0.0]
        return float(stops[0]) if stops.size and stops[0] < place else None

    def _sample(self, measurement: Measurement) -> Sample:
        """Return errors and forces of a measurement relative to the profile at its stamp."""
        model = self._model
        place, speed, acceleration, _ = self._profile.at(measurement.stamp * 1e-9)
        velocity = float(measurement.velocity.mean())
        forward, backward = (self._detector.envelope(direction, velocity) for direction in (1, -1))
        return Sample(
            position_error=float((measurement.position + model.offsets).mean()) - place,
            speed_error=velocity - speed,
            speed=velocity,
            applied=float(measurement.applied.sum()),
            required=model.rigid_force(place, speed, acceleration),
            available=(self.traction.at(forward), self.brake.at(backward)),
        )

    def _update_estimates(self, shortfall: Shortfall) -> None:
        """Update the assumed forces after a shortfall."""
        observed = shortfall.observed
        if shortfall.expected and self.replans:
            before = self.traction if shortfall.direction > 0 else self.brake
            observed = before.tightened(observed).scaled(REPEATED_FACTOR)
        self._observed[shortfall.direction] = self._observed[shortfall.direction].tightened(observed)
        other = ForceEstimate()
        if self._spec.both_ways and not shortfall.expected:
            other = (observed if observed.is_constant else observed.observed_only()).scaled(OTHER_DIRECTION_FACTOR)
        ahead, back = (observed, other) if shortfall.direction > 0 else (other, observed)
        self.traction, self.brake = self.traction.tightened(ahead), self.brake.tightened(back)

    def _replanned(self, stamp: int, sample: Sample, reason: str) -> ReplanDecision:
        """Plan and join the rest, or refuse; no detection until the new profile has started."""
        begin = stamp + self._lead_ns
        self._blocked_until = max(stamp + round(self._pause * 1e9), begin)
        self._detector.reset()
        if self._spec.retry is not None and self.traction != ForceEstimate():
            self._retry_at = stamp + round(self._spec.retry * 1e9)
        state = self._predicted_state(stamp, sample, begin)
        missed, refusal = self._overrun(state.time, state.position), ""
        if missed is not None:
            refusal = f"the stop at km {(missed + self._half) / 1000:.3f} is overrun; the halt there is kept"
        for available in self._candidates() if missed is None else ():
            try:
                self._follow(self._plan(state, available))
            except ValueError as error:
                refusal = refusal or str(error)
            else:
                self.replans += 1
                self._pause = self._spec.interval
                return ReplanDecision(self._profile, reason + self._lost)
        self.refusals += 1
        self._pause *= 2.0
        return ReplanDecision(None, f"{reason}: {refusal}")

    def _candidates(self) -> list[AvailableForce]:
        """Return the available forces to plan with, most careful first; the last uses observed bounds only."""
        traction, brake, observed = self.traction, self.brake, self._observed
        pairs = [
            (traction, brake),
            (traction, brake.observed_only()),
            (traction.observed_only(), brake.observed_only()),
        ]
        pairs.append((observed[1].observed_only(), observed[-1].observed_only()))
        forces = [AvailableForce(a.fraction, b.fraction, a.maximum, b.maximum) for a, b in pairs]
        return list(dict.fromkeys(forces))

    def _plan(self, state: TrainState, available: AvailableForce) -> Profile:
        model = self._model
        self._lost = ""
        if not self._points:
            return replan(state, self._initial, model.line, model.consist, self._settings, available=available).profile
        rest, lost = catch_up(
            state,
            self._points,
            model.line,
            model.consist,
            self._settings,
            period=self._initial.period,
            available=available,
        )
        self._lost = "" if lost is None else f"; {lost}"
        return rest.profile

    def _predicted_state(self, stamp: int, sample: Sample, begin: int) -> TrainState:
        """Return the state of the nominal train after the lead time at the present force."""
        model = self._model
        place = self._profile.at(stamp * 1e-9)[0] + sample.position_error
        speed, acceleration = max(sample.speed, 0.0), 0.0
        lead = (begin - stamp) * 1e-9
        count = max(1, math.ceil(lead / PREDICTION_STEP - 1e-9))
        h = lead / count
        for _ in range(count):
            resisting = model.running_resistance(speed) + model.line_force(place)
            acceleration = (sample.applied - resisting) / model.inertia
            if speed + acceleration * h <= 0.0:
                speed = acceleration = 0.0
                continue
            place += (speed + 0.5 * acceleration * h) * h
            speed += acceleration * h
        return TrainState(begin * 1e-9, place, speed, acceleration)


def _is_finite(measurement: Measurement) -> bool:
    columns = (measurement.position, measurement.velocity, measurement.applied)
    return all(bool(np.isfinite(column).all()) for column in columns)
