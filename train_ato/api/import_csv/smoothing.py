"""Profile of a measured run: the measured speed, averaged according to its resolution.

A speed in whole km/h has steps of 0.28 m/s; differences between rows are not the acceleration of the train.  A moving
average, applied twice, spreads a step over the length of the window.
"""

from itertools import pairwise

import numpy as np

from train_ato.api.import_csv.recording import Measured
from train_ato.messages.types import Array
from train_ato.profile.profile import Profile

RIPPLE = 0.025
"""Permitted rms acceleration from noise and resolution, relative to the sustained acceleration."""
SUSTAINED_S = 20.0
"""Minimum duration of a sustained acceleration [s]."""
MAX_WINDOW = 60.0
"""Maximum window [s]."""
CORRECTION_LENGTH = 500.0
"""Distance over which the profile is corrected to the recorded positions [m]; an odometer drifts with distance."""
MAX_STANDSTILL_SPEED = 0.5 / 3.6
"""Maximum speed of a standstill for a coarse resolution [m/s]."""
MIN_MOTION_SPEED = 1e-3
"""Minimum speed of motion in a profile [m/s]."""


def window_of(found: Measured) -> float:
    """Return the averaging window for the speed [s]; 0: no averaging.

    White noise of rms s in steps of h, averaged twice over w, causes an acceleration of rms s sqrt(2 h) / w^1.5.  Noise
    is estimated from second differences.  Resolution adds noise: step over sqrt(12), lasting for the time in which the
    speed changes by one step.
    """
    time = np.arange(0.0, max(found.end, 2 * SUSTAINED_S), SUSTAINED_S / 4)
    change = np.abs(np.diff(found.speed.at(time)[::4])) / SUSTAINED_S
    sustained = max(0.01, float(np.quantile(change, 0.95)))
    resolution = found.table.resolution(found.speed.column)
    noises = [(_noise(found), found.interval)]
    if resolution > 0:
        noises.append((resolution / 12**0.5, max(found.interval, resolution / sustained)))
    windows = [(noise * (2 * step) ** 0.5 / (RIPPLE * sustained)) ** (2 / 3) for noise, step in noises]
    window = min(MAX_WINDOW, max(windows))
    return round(window, 1) if window > 2 * found.interval else 0.0


def _noise(found: Measured) -> float:
    """Return the rms noise between rows [m/s]; a robust estimate ignores jerk of the train."""
    values = found.speed.values
    if values.size < 9:
        return 0.0
    bends = np.abs(values[2:] - 2 * values[1:-1] + values[:-2])
    return float(np.median(bends)) / (0.6745 * 6**0.5)


def _standstill(found: Measured) -> float:
    """Return the maximum speed of a standstill [m/s], from resolution and noise."""
    return max(
        MIN_MOTION_SPEED,
        min(MAX_STANDSTILL_SPEED, found.table.resolution(found.speed.column)),
        min(MAX_STANDSTILL_SPEED, 2 * _noise(found)),
    )


def measured_profile(found: Measured, tick: float, start: float, window: float) -> Profile:
    """Return the profile of a measured run.

    The linearly interpolated speed is averaged twice. The window shrinks towards both ends, so that the first and the
    last speed do not change. The position is the integral of the speed from ``start``, plus the slow part of the
    difference to recorded positions. So steps of an odometer cause no ripple.

    Parameters
    ----------
    found
        The measured run.
    tick
        Time between the knots [s].
    start
        Position of vehicle 0 at the first row [m].
    window
        Averaging window [s]; 0: none.
    """
    count = int(np.floor(found.end / tick + 1e-9)) + 1
    if count < 3:
        raise ValueError(f"{found.table.path}: {found.end:g} s is too short; give at least two ticks of {tick:g} s")
    time: Array = np.asarray(tick * np.arange(count), dtype=np.float64)
    speed = np.interp(time, found.speed.time, _with_standstills(found.speed.values, _standstill(found)))
    if window > 0:
        speed = _averaged(found.speed.time, found.speed.values, time, window)
        speed = _averaged(time, _without_creep(speed, _standstill(found)), time, window)
    speed = _without_creep(speed, MIN_MOTION_SPEED)
    acceleration = np.gradient(speed, tick)
    ways = tick * (speed[1:] + speed[:-1]) / 2 + tick**2 / 12 * (acceleration[:-1] - acceleration[1:])
    position = start + np.concatenate(([0.0], np.cumsum(ways)))
    if found.position is not None:
        run = np.interp(found.position.time, time, position)
        position = position + _slow_part(run, found.position.values - run, position)
    return Profile.uniform(0.0, tick, position, speed, acceleration)


def _with_standstills(values: Array, least: float) -> Array:
    """Return the rows with 0 inside a standstill: a row not above ``least``, and neither of its neighbours."""
    slow = np.concatenate(([True], values <= least * (1 + 1e-9), [True]))
    return np.where(slow[:-2] & slow[1:-1] & slow[2:], 0.0, values)


def _without_creep(speed: Array, least: float) -> Array:
    """Return the speeds with 0 below ``least``."""
    return np.where(speed < least, 0.0, speed)


def _averaged(time: Array, values: Array, at: Array, window: float) -> Array:
    """Return exact moving averages of a piecewise linear series; the window shrinks towards both ends."""
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


def _slow_part(run: Array, difference: Array, at: Array) -> Array:
    """Return the slow part of a difference: means over ``CORRECTION_LENGTH`` [m], interpolated linearly."""
    edges = np.linspace(run[0], run[-1], max(2, round((run[-1] - run[0]) / CORRECTION_LENGTH) + 1))
    middles, means = [], []
    for begin, end in pairwise(edges):
        inside = (run >= begin) & (run <= end)
        if inside.any():
            middles.append((begin + end) / 2)
            means.append(float(difference[inside].mean()))
    return np.asarray(np.interp(at, middles, means))
