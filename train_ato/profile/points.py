"""Profiles from points of a speed curve and from speed steps."""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from plant_sim.si_model import SiModel
from plant_sim.units import Length, Speed, Time
from train_ato.messages.types import Array
from train_ato.profile.knots import knot_count
from train_ato.profile.profile import Profile


class Point(SiModel):
    """A corner of the speed curve: a speed at a time or at a place of the train's front."""

    time: Time | None = None
    place: Length | None = None
    speed: Speed

    @model_validator(mode="after")
    def _one_axis(self) -> Point:
        if (self.time is None) == (self.place is None):
            raise ValueError("a point needs either a time or a place; give exactly one")
        return self


class Step(SiModel):
    """A constant speed from a time on, without transition."""

    at: Time = Field(ge=0)
    speed: Speed


def from_points(points: tuple[Point, ...], jerk: float | None, start: float, half: float, period: float) -> Profile:
    """Return the profile through corners of the speed curve, rounded to a jerk limit.

    The speed is averaged over a sliding window: the largest change of acceleration divided by the jerk limit.  The
    distance does not change, no speed is exceeded, and the profile takes one window longer.

    Parameters
    ----------
    points
        Corners, all with a time or all with a place.
    jerk
        Jerk limit [m/s³]; None: corners are not rounded.
    start
        Initial position of vehicle 0's centre for points over time [m].
    half
        Distance from vehicle 0's centre to the front [m].
    period
        Time between the knots [s].

    Raises
    ------
    ValueError
        If a point is not possible; the message has its number.
    """
    time, speed = _corners(points)
    if points[0].place is not None:
        start = points[0].place - half
    acceleration = np.diff(speed) / np.diff(time)
    window = 0.0
    if jerk is not None:
        window = float(max(acceleration.max(), 0.0) - min(acceleration.min(), 0.0)) / jerk
    return _averaged(time, speed, start, window, period)


def _corners(points: tuple[Point, ...]) -> tuple[Array, Array]:
    """Return time [s] and speed [m/s] of every corner."""
    if len(points) < 2:
        raise ValueError("points: fewer than two; add points")
    over_time = points[0].time is not None
    if any((point.time is not None) != over_time for point in points):
        raise ValueError("points: times and places are mixed; use one of them in all points")
    speed = np.array([point.speed for point in points])
    axis = np.array([float(point.time if point.time is not None else point.place or 0.0) for point in points])
    for number in np.flatnonzero(np.diff(axis) <= 0):
        raise ValueError(f"points: number {number + 1} is not beyond the previous one; sort the points")
    if over_time:
        return axis, speed
    both = speed[1:] + speed[:-1]
    for number in np.flatnonzero(both <= 0):
        raise ValueError(
            f"points: numbers {number} and {number + 1} are at rest at different places; add a speed between them"
        )
    return np.concatenate(([0.0], np.cumsum(2 * np.diff(axis) / both))), speed


def _averaged(time: Array, speed: Array, start: float, window: float, period: float) -> Profile:
    """Return the profile of a piecewise linear speed averaged over a window [s]; exact, from its integrals."""
    margin = 2 * window + 2 * period + 1.0
    t = np.concatenate(([time[0] - margin], time, [time[-1] + margin]))
    v = np.concatenate((speed[:1], speed, speed[-1:]))
    a = np.append(np.diff(v) / np.diff(t), 0.0)
    x = np.concatenate(([0.0], np.cumsum(np.diff(t) * (v[1:] + v[:-1]) / 2)))
    x -= x[1]
    y = np.concatenate(([0.0], np.cumsum(np.diff(t) * (x[:-1] + np.diff(t) * (v[:-1] / 2 + np.diff(t) * a[:-1] / 6)))))

    def integrals_at(at: Array) -> tuple[Array, Array, Array, Array]:
        k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, t.size - 2)
        s = at - t[k]
        ramp = v[k] + s * a[k]
        distance = x[k] + s * (v[k] + s * a[k] / 2)
        return y[k] + s * (x[k] + s * (v[k] / 2 + s * a[k] / 6)), distance, ramp, a[k]

    lead = window / 2 if speed[0] == 0.0 else 0.0
    length = time[-1] - time[0] + lead + (window / 2 if speed[-1] == 0.0 else 0.0)
    knots = period * np.arange(knot_count(float(np.ceil(length / period - 1e-9)) + 1))
    centre = knots + time[0] - lead
    if window <= 0:
        _, distance, ramp, rate = integrals_at(centre)
    else:
        after, before = integrals_at(centre + window / 2), integrals_at(centre - window / 2)
        distance, ramp, rate = ((late - early) / window for late, early in zip(after[:3], before[:3], strict=True))
    done = knots >= length - 1e-12
    if speed[-1] == 0.0:
        distance, ramp, rate = np.where(done, x[-2], distance), np.where(done, 0.0, ramp), np.where(done, 0.0, rate)
    return Profile.uniform(float(time[0]), period, start + distance, ramp, rate)


def from_steps(steps: tuple[Step, ...], until: float, start: float, period: float) -> Profile:
    """Return a profile with speed steps, as the reference of paper 002.

    Parameters
    ----------
    until
        Time of the last knot [s].
    start
        Position of vehicle 0's centre at the first step [m].
    """
    time = np.array([step.at for step in steps] + [until])
    speed = np.array([step.speed for step in steps])
    for number in np.flatnonzero(np.diff(time) <= 0):
        raise ValueError(
            f"steps: number {number} is not before the next one or before until = {until:g} s; sort the steps"
        )
    corner = np.concatenate(([0.0], np.cumsum(np.diff(time) * speed)))
    knots = time[0] + period * np.arange(knot_count(float(np.floor((until - time[0]) / period + 1e-9)) + 1))
    index = np.clip(np.searchsorted(time, knots + 1e-12, side="right") - 1, 0, speed.size - 1)
    position = start + corner[index] + speed[index] * (knots - time[index])
    return Profile.uniform(float(time[0]), period, position, speed[index], np.zeros(knots.size))
