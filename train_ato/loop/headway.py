"""Profile behind the train ahead: where that train was one headway before.

The train ahead at a time s gives the place of the train at s + headway. The deviation of these places from the own
profile is averaged over the smoothing time on both sides, with the weight (1 - u²)³. It is known in time because the
headway is longer. The profile is the own profile plus this deviation. So a jump of the reported place at a balise
becomes a smooth motion, and the parts of the own profile are not averaged. Beyond the newest report the deviation
stays. The train is at most a few metres ahead of its own profile, also if the train ahead drives on. Near a stop of the
own profile the deviation fades to 0, so that the train stops at its own place. A new profile begins at the present
profile. Within the smoothing time it changes to the deviation of the new reports.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

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


class SmoothFunction(NamedTuple):
    """A function of time with its first two derivatives at the knots of a profile."""

    value: Array
    rate: Array
    curvature: Array

    def times(self, other: SmoothFunction) -> SmoothFunction:
        """Return the product of two functions."""
        return SmoothFunction(
            self.value * other.value,
            self.rate * other.value + self.value * other.rate,
            self.curvature * other.value + 2.0 * self.rate * other.rate + self.value * other.curvature,
        )

    def plus(self, other: SmoothFunction) -> SmoothFunction:
        """Return the sum of two functions."""
        return SmoothFunction(*(a + b for a, b in zip(self, other, strict=True)))

    def minus(self, other: SmoothFunction) -> SmoothFunction:
        """Return the difference of two functions."""
        return SmoothFunction(*(a - b for a, b in zip(self, other, strict=True)))


def smooth_step(time: Array, duration: float) -> SmoothFunction:
    """Return the step from 0 at time 0 to 1 at a duration [s] with continuous acceleration, at times [s]."""
    u = np.clip(time / duration, 0.0, 1.0)
    return SmoothFunction(
        u**3 * (10.0 + u * (6.0 * u - 15.0)),
        30.0 * u**2 * (1.0 - u) ** 2 / duration,
        60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / duration**2,
    )


def following_weight(profile: Profile, spec: LeaderSpec) -> SmoothFunction:
    """Return the weight of the deviation at the knots.

    It is 0 at a stop of the profile and after the time ``until``, 1 one smoothing time before and after a stop.
    """
    duration = spec.smoothing
    at_rest = np.abs(profile.velocity) <= REST_SPEED
    places = np.arange(profile.time.size)
    before = np.maximum.accumulate(np.where(at_rest, places, -(10**9)))
    after = np.minimum.accumulate(np.where(at_rest, places, 10**9)[::-1])[::-1]
    since = smooth_step(np.asarray((places - before) * profile.period, dtype=np.float64), duration)
    until = smooth_step(np.asarray((after - places) * profile.period, dtype=np.float64), duration)
    weight = since.times(SmoothFunction(until.value, -until.rate, until.curvature))
    if spec.until is None:
        return weight
    left = smooth_step(spec.until - profile.time, duration)
    return weight.times(SmoothFunction(left.value, -left.rate, left.curvature))


def averaging_kernel(half: int, period: float) -> SmoothFunction:
    """Return the weights of an average over ``half`` knots on both sides, and of its two derivatives."""
    u = np.arange(-half, half + 1) / half
    rest = 1.0 - u**2
    whole, span = float((rest**3).sum()), half * period
    bend = (24.0 * u**2 * rest - 6.0 * rest**2) / (whole * span**2)
    return SmoothFunction(rest**3 / whole, -6.0 * u * rest**2 / (whole * span), bend - bend.mean())


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
        self._weight = following_weight(setup.profile, spec)
        self._found = SmoothFunction(*np.zeros((3, setup.profile.time.size)))
        self._every = max(1.0, (spec.headway - spec.smoothing - spec.link.longest - RESERVE) / 2.0)
        self._times: list[float] = []
        self._deviations: list[float] = []
        self._built_at = -np.inf
        self._due: int | None = None

    def _take(self, time: float, front: float) -> None:
        """Keep the deviation of a report from the own profile one headway later."""
        at = time + self._headway
        self._times.append(at)
        self._deviations.append(min(front - self._half - self._own.at(at)[0], MAX_LEAD))

    def step(self, stamp: int, ahead: TrainAhead | None = None) -> Profile | None:
        """Return a new profile at a stamp [ns] if the reports, also a live one, give enough more of it, else None."""
        self.receiver.hear(ahead)
        due = self.next_due((stamp,))
        if due is None or due > stamp:
            return None
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
        first = (stamp - own.start_ns) // own.period_ns + 1
        if first < 0 or first >= own.time.size - 2:
            return None
        ahead = slice(first, None)
        new, old = self._averaged(first), SmoothFunction(*(part[ahead] for part in self._found))
        change = smooth_step(own.time[ahead] - own.time[first], self._smoothing).times(new.minus(old))
        for part, added in zip(self._found, change, strict=True):
            part[ahead] += added
        shift = self._found.times(self._weight)
        kept = slice(max(0, first - round(KEPT_TIME / own.period)), None)
        columns = (own.position, own.velocity, own.acceleration)
        return Profile(own.time[kept], *(a[kept] + b[kept] for a, b in zip(columns, shift, strict=True)))

    def _averaged(self, first: int) -> SmoothFunction:
        """Return the averaged deviation from a knot on; beyond the reports it stays."""
        own, side = self._own, self._side
        known = round((self._times[-1] - own.start) / own.period) + 2 * side
        last = int(np.clip(known, first + 1, own.time.size))
        times = own.start + own.period * np.arange(first - side, last + side)
        raw = np.interp(times, self._times, self._deviations)
        found = np.zeros((3, own.time.size - first))
        found[0] = self._deviations[-1]
        _average(raw, np.array(self._kernel), found[:, : last - first])
        return SmoothFunction(*found)


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
