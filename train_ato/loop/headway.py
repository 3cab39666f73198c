"""Profile behind the train ahead: where that train was one headway before.

The train ahead at a time s gives the place of the train at s + headway. The deviation of these places from the own
profile is averaged over the smoothing time on both sides, with the weight (1 - u²)³. It is known in time because the
headway is longer. The profile is the own profile plus this deviation. So a jump of the reported place at a balise
becomes a smooth motion, and the parts of the own profile are not averaged. Beyond the newest report the deviation
stays. The train is at most a few metres ahead of its own profile, also if the train ahead drives on. Near a stop of the
own profile the deviation fades to 0, so that the train stops at its own place. If the train ahead reaches or leaves a
stop late, the own profile does so too, and only what remains fades. A new profile begins at the present profile. Within
the smoothing time it changes to the deviation of the new reports. After missing reports or at the start, where this
would run back or be too fast, it follows the reports with a bounded speed and acceleration, or waits until they reach
it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from plant_sim.compiled import compiled
from train_ato.loop.train_ahead import ReportReceiver
from train_ato.messages.types import Array, TrainAhead
from train_ato.profile.profile import Profile
from train_ato.scenario.leader import RESERVE, LeaderSpec
from train_ato.scenario.setup import RunSetup

KEPT_TIME = 60.0
"""Time before the present for which a new profile has knots [s]."""
MAX_LEAD = 20.0
"""Largest distance before the own profile [m]: it brakes for the own stop, also behind a train that runs on."""
REST_SPEED = 1e-6
"""Speed up to which a knot is at rest [m/s]."""
TURNING_SPEED = 0.01
"""Speed of the slowest knot around up to which a stop is next to it [m/s]."""
FADING_ACCELERATION = 0.1
"""Largest acceleration with which a deviation fades near a stop [m/s²]; of a larger deviation the rest is a delay."""
STEP_CURVATURE = 10.0 / 3.0**0.5
"""Largest curvature of :func:`smooth_step` for a duration of 1."""
RECOVERED = 0.25
"""Largest part of the time between two stops that the train recovers of a delay."""
BACKWARDS = -0.05
"""Lowest speed after missing reports [m/s]; the average before a stop makes it a little negative."""
JOIN_LIMITS = (1.15, 2.5)
"""Largest speed and acceleration after missing reports, as multiples of those of the own profile: of the largest
acceleration, and of the largest speed up to ``MAX_LEAD`` from the place."""
CHASE_LIMITS = (1.1, 1.5)
"""The same on a way with bounded speed and acceleration; it exceeds its speed by a few mm/s."""


SmoothFunction = Array
"""A function of time with its first two derivatives at the knots of a profile: value, rate and curvature in rows."""


def smooth_product(one: SmoothFunction, other: SmoothFunction) -> SmoothFunction:
    """Return the product of two functions."""
    value = one[0] * other[0]
    rate = one[1] * other[0] + one[0] * other[1]
    return np.array((value, rate, one[2] * other[0] + 2.0 * one[1] * other[1] + one[0] * other[2]))


def reverse(function: SmoothFunction) -> SmoothFunction:
    """Return a function of the time that is left as one of the time."""
    return np.array((function[0], -function[1], function[2]))


def smooth_step(time: Array, duration: float) -> SmoothFunction:
    """Return the step from 0 at time 0 to 1 at a duration [s] with continuous acceleration, at times [s]."""
    u = np.clip(time / duration, 0.0, 1.0)
    rate = 30.0 * u**2 * (1.0 - u) ** 2 / duration
    curvature = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / duration**2
    return np.array((u**3 * (10.0 + u * (6.0 * u - 15.0)), rate, curvature))


def knots_at_rest(velocity: Array) -> NDArray[np.bool_]:
    """Return which knots with speeds [m/s] are at rest; one next to a stop without a duration counts, too."""
    speed = np.abs(velocity)
    around = np.pad(speed, 1)
    least = speed <= np.minimum(around[:-2], around[2:])
    return np.asarray((speed <= REST_SPEED) | (least & (speed <= TURNING_SPEED)))


def stop_weight(profile: Profile, duration: float) -> SmoothFunction:
    """Return a weight at the knots: 0 at a stop of the profile, 1 at least a duration [s] before and after a stop."""
    at_rest = knots_at_rest(profile.velocity)
    places = np.arange(profile.time.size)
    before = np.maximum.accumulate(np.where(at_rest, places, -(10**9)))
    after = np.minimum.accumulate(np.where(at_rest, places, 10**9)[::-1])[::-1]
    since = smooth_step(np.asarray((places - before) * profile.period, dtype=np.float64), duration)
    until = smooth_step(np.asarray((after - places) * profile.period, dtype=np.float64), duration)
    return smooth_product(since, reverse(until))


def following_weight(profile: Profile, spec: LeaderSpec) -> SmoothFunction:
    """Return the weight of the deviation at the knots.

    It is 0 at a stop of the profile and after the time ``until``, 1 one smoothing time before and after a stop.
    """
    return fading_until(profile.time, stop_weight(profile, spec.smoothing), spec)


def fading_until(times: Array, weight: SmoothFunction, spec: LeaderSpec) -> SmoothFunction:
    """Return a weight at times [s] that fades to 0 at the time ``until``."""
    if spec.until is None:
        return weight
    return smooth_product(weight, reverse(smooth_step(spec.until - times, spec.smoothing)))


def averaging_kernel(half: int, period: float) -> SmoothFunction:
    """Return the weights of an average over ``half`` knots on both sides, and of its two derivatives."""
    u = np.arange(-half, half + 1) / half
    rest = 1.0 - u**2
    whole, span = float((rest**3).sum()), half * period
    bend = (24.0 * u**2 * rest - 6.0 * rest**2) / (whole * span**2)
    return np.array((rest**3 / whole, -6.0 * u * rest**2 / (whole * span), bend - bend.mean()))


class DelayedProfile:
    """The own profile with the delays of the train ahead at the stops.

    A delay changes between two stops as :func:`smooth_step` of the own time, and during a stop linearly.

    Parameters
    ----------
    own
        The profile.
    smoothing
        Time before and after a stop in which a deviation fades [s].
    """

    def __init__(self, own: Profile, smoothing: float) -> None:
        self._own, self._smoothing = own, smoothing
        self._weight = stop_weight(own, smoothing)
        at_rest = np.concatenate(([False], knots_at_rest(own.velocity), [False]))
        at_rest[-2] = True  # the end counts as a stop
        self._stops = np.flatnonzero(np.diff(at_rest)).reshape(-1, 2) - (0, 1)
        self._fading = FADING_ACCELERATION * smoothing**2 / STEP_CURVATURE
        self._delay: SmoothFunction = np.zeros((3, own.time.size))

    @property
    def lasting(self) -> float:
        """Delay at the end [s]; 0 for a profile that ends in motion."""
        return 0.0 if self._own.ends_rolling else float(self._delay[0, -1])

    def set_delays(self, times: Array, places: Array) -> None:
        """Set the delays with which a train has places [m] at times [s].

        The delay is the least one with which the profile is ahead of the train by at most what fades near a stop.
        """
        own, late, begin = self._own, 0.0, self._own.start
        reached = np.maximum.accumulate(places) + self._fading
        newest, passed = map(float, np.interp(reached[-1] - (0.0, 2.0 * self._fading), own.position, own.time))
        self._delay = np.zeros((3, own.time.size))
        departures = [(-np.inf, 0.0)]

        def delay_at(t: float) -> float:
            place = own.at(t)[0]
            if place > reached[-1]:  # the train is not there yet, and late as from its newest place on
                return min(max(late, float(times[-1]) - min(t, newest)), max(0.0, float(times[-1]) - passed))
            return max(0.0, float(np.interp(place, reached, times, left=-np.inf)) - t)

        for first, last in self._stops.tolist():
            end = float(own.time[first]) - self._smoothing
            if end > begin:
                change = max(delay_at(end) - late, RECOVERED * (begin - end))
                step = smooth_step(own.time - begin, max(min(end, newest), begin + self._smoothing) - begin)
                self._delay = self._delay + change * step
                late += change
            begin = float(own.time[last]) + self._smoothing
            if last < own.time.size - 1:
                change = max(delay_at(begin) - late, 0.0)
                stay = np.clip((np.arange(own.time.size) - first) / max(last - first, 1), 0.0, 1.0)
                self._delay[0] += change * stay
                late += change
                departures.append((float(own.time[last]) + late, late))
        self._departures = np.array(departures).T

    def deviation(self, t: Array, places: Array) -> Array:
        """Return how far places [m] at times [s] are ahead of the profile [m].

        They are at most ``MAX_LEAD`` ahead of the profile, also of one that kept its delay since the last departure.
        """
        left, late = self._departures
        kept = self._own.at_times(t - late[np.searchsorted(left, t, "right") - 1])[0]
        profile = self.at(t)[0][0]
        return np.asarray(np.minimum(places, np.maximum(profile, kept) + MAX_LEAD) - profile)

    def at(self, t: Array) -> tuple[SmoothFunction, SmoothFunction]:
        """Return the profile and its weight near the stops at times [s]."""
        own = self._own
        delay, rate, curvature = self._delay
        s = np.interp(t, own.time + delay, own.time) if delay.any() else t
        stretch, bend = 1.0 + np.interp(s, own.time, rate), np.interp(s, own.time, curvature)

        def over_time(value: Array, slope: Array, curve: Array) -> SmoothFunction:
            return np.array((value, slope / stretch, (curve - slope * bend / stretch) / stretch**2))

        return over_time(*own.at_times(s)), over_time(*(np.interp(s, own.time, part) for part in self._weight))


class HeadwayProfile:
    """Profile of a train one headway behind the train ahead.

    Parameters
    ----------
    setup
        Prepared run with ``leader.headway``.
    """

    def __init__(self, setup: RunSetup) -> None:
        spec = setup.scenario.leader
        assert spec is not None
        assert spec.headway is not None
        self._own, self._headway, self._smoothing = setup.profile, spec.headway, spec.smoothing
        self.receiver = ReportReceiver(setup, "profile")
        self._half = setup.consist.vehicles[0].length / 2.0
        self._side = max(2, round(spec.smoothing / setup.profile.period))
        self._kernel = averaging_kernel(self._side, setup.profile.period)
        self._spec, self._delayed = spec, DelayedProfile(setup.profile, spec.smoothing)
        own, self._time = setup.profile, setup.profile.time
        self._present: SmoothFunction = np.array((own.position, own.velocity, own.acceleration))
        self._every = max(1.0, (spec.headway - spec.smoothing - spec.link.longest - RESERVE) / 2.0)
        self._last = math.inf if spec.until is None else spec.until - spec.smoothing / 2.0
        self._times: list[float] = []
        self._places: list[float] = []
        self._built_at = -np.inf
        self._due: int | None = None
        self._missed = self._bounded = False
        around = (np.interp(own.position + way, own.position, own.velocity) for way in (-MAX_LEAD, 0.0, MAX_LEAD))
        self._fastest = np.array((own.position, np.maximum.reduce(list(around))))
        self._strongest = float(np.abs(own.acceleration).max())

    def _take(self, time: float, front: float) -> None:
        """Keep the place of a report, which counts one headway later, up to the middle of the fading at ``until``."""
        counts = time + self._headway
        if counts <= self._last or not self._times:
            self._times.append(counts)
            self._places.append(front - self._half)

    def step(self, stamp: int, ahead: TrainAhead | None = None) -> Profile | None:
        """Return a new profile at a stamp [ns] if the reports, also a live one, give enough more of it, else None."""
        self.receiver.hear(ahead)
        due = self.next_due((stamp,))
        if due is None or due > stamp:
            return None
        self._bounded = self._built_at < stamp * 1e-9 + self._smoothing
        self._missed |= self._bounded and self._built_at > -np.inf
        self._due, self._built_at = None, self._times[-1]
        return self._built(stamp)

    def next_due(self, stamps: Iterable[int]) -> int | None:
        """Return the first of the stamps [ns] with a new profile, None without one; a later call does not repeat it."""
        for stamp in stamps:
            if self._due is not None:
                break
            report = self.receiver.receive(stamp)
            if not self._times:
                first = self.receiver.newest(-1)
                self._take(first.time, first.front)
            if report is not None and report.time + self._headway > self._times[-1]:
                self._take(report.time, report.front)
            if self._times[-1] - self._built_at >= self._every:
                self._due = stamp
        return self._due

    def _built(self, stamp: int) -> Profile | None:
        """Return the profile of the reports so far; None at its end."""
        own = self._own
        self._delayed.set_delays(np.array(self._times), np.array(self._places))
        self._set_size(max(own.time.size + math.ceil(self._delayed.lasting / own.period), self._time.size))
        first = (stamp - own.start_ns) // own.period_ns + 1
        if first < 0 or first >= self._time.size - 2:
            return None
        profile, weight = self._delayed.at(self._time)
        deviation = np.zeros((3, self._time.size))
        deviation[:, first:] = self._averaged(first)
        wanted = profile + smooth_product(deviation, fading_until(self._time, weight, self._spec))
        self._present = self._joined(first, wanted)
        kept = slice(max(0, first - round(KEPT_TIME / own.period)), None)
        return Profile(self._time[kept], *self._present[:, kept])

    def _set_size(self, knots: int) -> None:
        """Set the number of knots of the present profile; new ones are at rest."""
        if knots != self._time.size:
            self._time = self._own.start + self._own.period * np.arange(float(knots))
            self._present = _resized(self._present, knots)

    def _joined(self, first: int, wanted: SmoothFunction) -> SmoothFunction:
        """Return the present profile that changes to the wanted one from a knot on."""
        joined = self._changed(self._present, first, wanted)
        if not (self._missed or self._bounded) or self._permitted(joined, first):
            return joined
        self._missed = True
        before, smoothing = self._time.size, round(self._smoothing / self._own.period)
        if not self._own.ends_rolling:
            self._set_size(before + self._own.time.size)
        chased, wanted = self._present.copy(), _resized(wanted, self._time.size)
        speed, acceleration = CHASE_LIMITS
        limits = self._fastest * ((1.0,), (speed,)), self._strongest * acceleration
        close = _chase(chased, wanted, first, self._own.period, *limits, smoothing)
        joined = self._changed(chased, close, wanted)
        found = joined if self._permitted(joined, first) else chased
        moving = int(np.max(np.flatnonzero(found[1] > TURNING_SPEED), initial=0)) + 2
        self._set_size(min(self._time.size, max(before, moving)))
        return _resized(found, self._time.size)

    def _changed(self, profile: SmoothFunction, first: int, wanted: SmoothFunction) -> SmoothFunction:
        """Return a profile that is the wanted one from one smoothing time after a knot on."""
        step = smooth_step(self._time - self._time[first], self._smoothing)
        return profile + smooth_product(step, wanted - profile)

    def _permitted(self, profile: SmoothFunction, first: int) -> bool:
        """Return True if a profile from a knot on is in its limits after missing reports or at the start."""
        place, speed, acceleration = profile[:, first:]
        fastest = JOIN_LIMITS[0] * np.interp(place, *self._fastest)
        strongest = JOIN_LIMITS[1] * self._strongest
        return bool(((speed >= BACKWARDS) & (speed <= fastest) & (abs(acceleration) <= strongest)).all())

    def _averaged(self, first: int) -> SmoothFunction:
        """Return the averaged deviation from a knot on; beyond the reports it stays."""
        own, side = self._own, self._side
        known = round((self._times[-1] - own.start) / own.period) + 2 * side
        last = int(np.clip(known, first + 1, self._time.size))
        times = own.start + own.period * np.arange(first - side, last + side)
        deviations = self._delayed.deviation(np.array(self._times), np.array(self._places))
        raw = np.interp(times, self._times, deviations)
        early = np.minimum(np.append(times, np.inf), self._times[0])  # no delay before the first place that counts
        ahead = own.at_times(early)[0] - self._delayed.at(early)[0][0]
        raw += ahead[:-1] - ahead[-1]
        found = np.zeros((3, self._time.size - first))
        found[0] = deviations[-1]
        _average(raw, self._kernel, found[:, : last - first])
        return found


@compiled
def _average(raw: Array, weights: Array, found: Array) -> None:
    """Write the weighted sums of values around every knot, shape (weights, knots)."""
    width = weights.shape[1]
    for row in range(weights.shape[0]):
        for knot in range(found.shape[1]):
            total = 0.0
            for j in range(width):
                total += weights[row, j] * raw[knot + width - 1 - j]
            found[row, knot] = total


def _resized(profile: SmoothFunction, knots: int) -> SmoothFunction:
    """Return a profile with a number of knots; new ones are as the last one."""
    return np.ascontiguousarray(np.pad(profile, ((0, 0), (0, max(0, knots - profile.shape[1]))), "edge")[:, :knots])


@compiled
def _chase(
    profile: Array, wanted: Array, first: int, period: float, fastest: Array, strongest: float, near: int
) -> int:
    """Let a profile follow the wanted one from a knot on.

    Both have place, speed and acceleration in rows. ``fastest`` has places and the largest speeds there. Return the
    first knot before which ``near`` knots are close to the wanted profile, else the last one.
    """
    place, speed, acceleration = profile[:, first]
    last, close = profile.shape[1] - 1, 0
    found = int(last)
    stops = np.full(last + 1, np.inf if wanted[1, last] > TURNING_SPEED else wanted[0, last])
    for knot in range(last - 1, first, -1):
        stops[knot] = wanted[0, knot] if wanted[1, knot] <= TURNING_SPEED else stops[knot + 1]
    parts, at = math.ceil(period / 0.05), 0
    step = period / parts
    for knot in range(first + 1, last + 1):
        while at < fastest.shape[1] - 1 and fastest[0, at + 1] <= place:
            at += 1
        for part in range(parts):
            there, ahead = wanted[:2, knot - 1] + part / parts * (wanted[:2, knot] - wanted[:2, knot - 1])
            aim = min(max(ahead + _closing(there - place, strongest), 0.0), fastest[1, at])
            if stops[knot] > place:
                aim = min(aim, _closing(stops[knot] - place, strongest))
            jerk = (min(max(1.5 * (aim - speed), -strongest), strongest) - acceleration) / max(step, 0.2)
            place += step * (speed + step * (acceleration / 2.0 + step * jerk / 6.0))
            speed += step * (acceleration + step * jerk / 2.0)
            acceleration += step * jerk
        profile[0, knot], profile[1, knot], profile[2, knot] = place, speed, acceleration
        apart = max(abs(wanted[0, knot] - place), abs(wanted[1, knot] - speed))
        close = close + 1 if apart <= 0.1 else 0
        if close == near:
            found = min(found, knot)
    return found


@compiled
def _closing(distance: float, acceleration: float) -> float:
    """Return the speed with which a distance [m] is reduced."""
    far = abs(distance)
    return math.copysign(min(0.3 * far, math.sqrt(0.5 * acceleration * far)), distance)
