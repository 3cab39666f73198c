"""The profile of a measured run: its speed, averaged as far as the way it was written asks for.

A speed written in whole km/h jumps by 0.28 m/s; its slope from row to row is no acceleration of a train.  The mean
over a sliding window, taken twice, spreads a jump over the window's length.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from train_ato.measured.recording import Measured
from train_ato.profile.profile import Profile
from train_ato.types import Array

__all__ = ["measured_profile", "window_of"]

RIPPLE = 0.025
"""Rms of the acceleration that may be left of noise and resolution, over the acceleration that the train sustains."""
SUSTAINED_S = 20.0
"""Accelerations that last this long are the train's [s]."""
LONGEST = 60.0
"""Longest window [s]."""
PLACES = 500.0
"""Positions of the recorder pull the profile to themselves over this way [m]: an odometer errs by the way run."""
CREEP = 0.5 / 3.6
"""However coarse a speed is written, this is no standstill [m/s]."""
STANDING = 1e-3
"""Slower is a standstill [m/s], as a profile has it."""


def window_of(found: Measured) -> float:
    """Return how long a window the speed needs [s]; 0 where it needs none.

    White noise of rms s in steps of h, averaged twice over w, leaves an acceleration of rms s sqrt(2 h) / w^1.5. Noise
    is told by the bends between three rows. The resolution is noise too: its step over sqrt(12), and a step of its
    own for as long as the speed takes to run through it.
    """
    sustained = _sustained(found)
    resolution = found.table.resolution(found.speed.column)
    noises = [(_noise(found), found.interval)]
    if resolution > 0:
        noises.append((resolution / 12**0.5, max(found.interval, resolution / sustained)))
    windows = [(noise * (2 * step) ** 0.5 / (RIPPLE * sustained)) ** (2 / 3) for noise, step in noises]
    window = min(LONGEST, max(windows))
    return round(window, 1) if window > 2 * found.interval else 0.0


def _noise(found: Measured) -> float:
    """Return the rms of the noise from row to row [m/s]; robust, so that the train's own bends do not count."""
    values = found.speed.values
    if values.size < 9:
        return 0.0
    bends = np.abs(values[2:] - 2 * values[1:-1] + values[:-2])
    return float(np.median(bends)) / (0.6745 * 6**0.5)


def _sustained(found: Measured) -> float:
    """Return the acceleration that the train kept up [m/s²]: the largest but 5 % over a time, at least 0.01."""
    time = np.arange(0.0, max(found.end, 2 * SUSTAINED_S), SUSTAINED_S / 4)
    change = np.abs(np.diff(found.speed.at(time)[::4])) / SUSTAINED_S
    return max(0.01, float(np.quantile(change, 0.95)))


def _standstill(found: Measured) -> float:
    """Return the speed below which a train is taken to stand [m/s]: what resolution and noise cannot tell from 0."""
    return max(STANDING, min(CREEP, found.table.resolution(found.speed.column)), min(CREEP, 2 * _noise(found)))


def measured_profile(found: Measured, tick: float, start: float, window: float) -> Profile:
    """Return the profile that a train driven like this one would have followed.

    Between rows the speed is linear; it is averaged twice over a window that shrinks towards both ends, so that begin
    and end stay what they are.  The position is its integral from ``start`` on; where the recorder gives positions, the
    slow difference to them is added, so that an odometer's steps leave no ripple.

    Parameters
    ----------
    found
        The measured run.
    tick
        Period of the knots [s].
    start
        Position of vehicle 0's centre at the first row [m].
    window
        Of the average [s]; 0 for none.

    Raises
    ------
    ValueError
        If the run is shorter than two ticks.
    """
    count = int(np.floor(found.end / tick + 1e-9)) + 1
    if count < 3:
        raise ValueError(f"{found.table.path}: {found.end:g} s are no run; at least two ticks of {tick:g} s are needed")
    time: Array = np.asarray(tick * np.arange(count), dtype=np.float64)
    speed = found.speed.at(time)
    if window > 0:
        speed = _averaged(found.speed.time, found.speed.values, time, window)
        speed = _averaged(time, _standing(speed, _standstill(found)), time, window)
    speed = _standing(speed, STANDING)
    acceleration = np.gradient(speed, tick)
    ways = tick * (speed[1:] + speed[:-1]) / 2 + tick**2 / 12 * (acceleration[:-1] - acceleration[1:])
    position = start + np.concatenate(([0.0], np.cumsum(ways)))
    if found.position is not None:
        run = np.interp(found.position.time, time, position)
        position = position + _pull(run, found.position.values - run, position)
    return Profile.uniform(0.0, tick, position, speed, acceleration)


def _standing(speed: Array, least: float) -> Array:
    """Return 0 for speeds that cannot be told from a standstill."""
    return np.where(speed < least, 0.0, speed)


def _averaged(time: Array, values: Array, at: Array, window: float) -> Array:
    """Return means of a piecewise linear series over a sliding window that shrinks towards both ends; exact."""
    slope = np.diff(values) / np.diff(time)
    areas = np.concatenate(([0.0], np.cumsum(np.diff(time) * (values[1:] + values[:-1]) / 2)))

    def area(moments: Array) -> Array:
        k = np.clip(np.searchsorted(time, moments, side="right") - 1, 0, time.size - 2)
        s = moments - time[k]
        return np.asarray(areas[k] + s * (values[k] + s * slope[k] / 2))

    half = np.minimum(window / 2, np.minimum(at - time[0], time[-1] - at))
    inside = half > 1e-9
    result = np.interp(at, time, values)
    left, right = at[inside] - half[inside], at[inside] + half[inside]
    result[inside] = (area(right) - area(left)) / (right - left)
    return result


def _pull(run: Array, difference: Array, at: Array) -> Array:
    """Return the slow part of a difference over the way that was run: means over some way, linear between."""
    edges = np.linspace(run[0], run[-1], max(2, round((run[-1] - run[0]) / PLACES) + 1))
    middles, means = [], []
    for begin, end in pairwise(edges):
        inside = (run >= begin) & (run <= end)
        if inside.any():
            middles.append((begin + end) / 2)
            means.append(float(difference[inside].mean()))
    return np.asarray(np.interp(at, middles, means))
