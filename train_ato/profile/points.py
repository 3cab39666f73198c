"""Profiles from points and from steps of the speed."""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from plant_sim.units import Length, SiModel, Speed, Time
from train_ato.profile.knots import knot_count
from train_ato.profile.profile import Profile
from train_ato.types import Array

__all__ = ["Point", "Step", "from_points", "from_steps"]


class Point(SiModel):
    """One corner of a trapezoid: a speed at a time or at a place of the train's front."""

    time: Time | None = None
    place: Length | None = None
    speed: Speed

    @model_validator(mode="after")
    def _one_axis(self) -> Point:
        if (self.time is None) == (self.place is None):
            raise ValueError("a point has a speed and either a time or a place")
        return self


class Step(SiModel):
    """A speed from a time on, reached with infinite acceleration."""

    at: Time = Field(ge=0)
    speed: Speed


def from_points(points: tuple[Point, ...], jerk: float | None, start: float, half: float, period: float) -> Profile:
    """Return the profile through corners of constant acceleration, its corners rounded to a limit on the jerk.

    The speed is averaged over a sliding window as long as the largest change of acceleration takes at that jerk.  The
    distance run stays the same, no speed is exceeded, and the whole profile takes one window longer.

    Parameters
    ----------
    points
        Corners; all over time or all over the place.
    jerk
        Limit [m/s³]; None leaves the corners.
    start
        Position of vehicle 0's centre at the begin where the points are over time [m].
    half
        From vehicle 0's centre to the front [m].
    period
        Of the knots [s].

    Raises
    ------
    ValueError
        With the number of the first point that makes no sense.
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
    """Return time and speed of every corner."""
    if len(points) < 2:
        raise ValueError("points: at least two are needed")
    over_time = points[0].time is not None
    if any((point.time is not None) != over_time for point in points):
        raise ValueError("points: all of them are over time or all over the place")
    speed = np.array([point.speed for point in points])
    axis = np.array([float(point.time if point.time is not None else point.place or 0.0) for point in points])
    for number in np.flatnonzero(np.diff(axis) <= 0):
        raise ValueError(f"points: number {number + 1} does not lie beyond the one before")
    if over_time:
        return axis, speed
    both = speed[1:] + speed[:-1]
    for number in np.flatnonzero(both <= 0):
        raise ValueError(f"points: numbers {number} and {number + 1} are at rest, the way between is never run")
    return np.concatenate(([0.0], np.cumsum(2 * np.diff(axis) / both))), speed


def _averaged(time: Array, speed: Array, start: float, window: float, period: float) -> Profile:
    """Average a piecewise linear speed over a window and sample it; exact, by differences of its integrals."""
    reach = 2 * window + 2 * period + 1.0
    t = np.concatenate(([time[0] - reach], time, [time[-1] + reach]))
    v = np.concatenate((speed[:1], speed, speed[-1:]))
    a = np.append(np.diff(v) / np.diff(t), 0.0)
    x = np.concatenate(([0.0], np.cumsum(np.diff(t) * (v[1:] + v[:-1]) / 2)))
    x -= x[1]
    y = np.concatenate(([0.0], np.cumsum(np.diff(t) * (x[:-1] + np.diff(t) * (v[:-1] / 2 + np.diff(t) * a[:-1] / 6)))))

    def read(at: Array) -> tuple[Array, Array, Array, Array]:
        k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, t.size - 2)
        s = at - t[k]
        ramp = v[k] + s * a[k]
        way = x[k] + s * (v[k] + s * a[k] / 2)
        return y[k] + s * (x[k] + s * (v[k] / 2 + s * a[k] / 6)), way, ramp, a[k]

    lead = window / 2 if speed[0] == 0.0 else 0.0
    length = time[-1] - time[0] + lead + (window / 2 if speed[-1] == 0.0 else 0.0)
    knots = period * np.arange(knot_count(float(np.ceil(length / period - 1e-9)) + 1))
    centre = knots + time[0] - lead
    if window <= 0:
        _, way, ramp, rate = read(centre)
    else:
        after, before = read(centre + window / 2), read(centre - window / 2)
        way, ramp, rate = ((late - early) / window for late, early in zip(after[:3], before[:3], strict=True))
    done = knots >= length - 1e-12
    if speed[-1] == 0.0:
        way, ramp, rate = np.where(done, x[-2], way), np.where(done, 0.0, ramp), np.where(done, 0.0, rate)
    return Profile.uniform(float(time[0]), period, start + way, ramp, rate)


def from_steps(steps: tuple[Step, ...], until: float, start: float, period: float) -> Profile:
    """Return a profile whose speed steps: the reference of paper 002, which no train follows.

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
        raise ValueError(f"steps: number {number} does not end before the next one, or before until = {until:g} s")
    corner = np.concatenate(([0.0], np.cumsum(np.diff(time) * speed)))
    knots = time[0] + period * np.arange(knot_count(float(np.floor((until - time[0]) / period + 1e-9)) + 1))
    index = np.clip(np.searchsorted(time, knots + 1e-12, side="right") - 1, 0, speed.size - 1)
    position = start + corner[index] + speed[index] * (knots - time[index])
    return Profile.uniform(float(time[0]), period, position, speed[index], np.zeros(knots.size))
