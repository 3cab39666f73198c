"""Knots of a profile at one period: what is accepted, and one way to read between them.

Between two knots the position is the cubic Hermite polynomial of positions and speeds, the speed the cubic Hermite
polynomial of speeds and accelerations, the acceleration its derivative; the jerk is the mean over the interval, so
that a limit the knots respect is respected between them too.  So position, speed and acceleration are exact at every
knot and continuous everywhere, and a profile of constant jerk between knots is reproduced exactly.  Where the speed
changes between two knots faster than any train (a step), the knot before is continued at constant acceleration up to
the step instead of smearing it over the interval.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train_ato.types import Array

__all__ = [
    "STEP_ACCELERATION", "check_columns", "even_grid", "hermite", "knot_count", "mean_jerk", "padded", "read_between",
    "seconds", "whole_nanoseconds",
]  # fmt: skip

STEP_ACCELERATION = 20.0
"""A change of speed beyond this between two knots is a step, not an acceleration [m/s²]."""
MOST_KNOTS = 20_000_000
"""Profiles of more knots are refused before memory is."""
LATEST = 1e8
"""Knots beyond this time are refused [s]."""


def read_between(
    knots: tuple[Array, Array, Array], stamps: NDArray[np.int64], period_ns: int
) -> tuple[Array, Array, Array]:
    """Read many stamps at once; the same operations in the same order as ``Profile.at_stamp`` for one.

    Parameters
    ----------
    knots : tuple of Array, shape (n,)
        Positions [m], speeds [m/s] and accelerations [m/s²].
    stamps : Array of int, shape (m,)
        Times after the first knot [ns].
    period_ns : int
        Time between knots [ns].

    Returns
    -------
    position, velocity, acceleration : Array, shape (m,)
        Held at rest before the first knot and beyond the last one.
    """
    position, velocity, acceleration = knots
    index, rest = np.divmod(stamps, period_ns)
    last = position.size - 1
    k = np.clip(index, 0, last - 1)
    s = rest * 1e-9
    period = period_ns * 1e-9
    x0, v0, a0 = position[k], velocity[k], acceleration[k]
    x1, v1, a1 = position[k + 1], velocity[k + 1], acceleration[k + 1]
    x = hermite(x0, v0, x1, v1, s, period)[0]
    v, a = hermite(v0, a0, v1, a1, s, period)
    jump = np.abs(v1 - v0) > STEP_ACCELERATION * period
    x = np.where(jump, x0 + (v0 + 0.5 * a0 * s) * s, x)
    v = np.where(jump, v0 + a0 * s, v)
    a = np.where(jump, a0, a)
    knot = (rest == 0) & (index >= 0) & (index <= last)
    at = np.clip(index, 0, last)
    x, v, a = (np.where(knot, own[at], value) for own, value in zip(knots, (x, v, a), strict=True))
    held = (index < 0) | ((index >= last) & ~knot)
    x = np.where(held, np.where(index < 0, position[0], position[last]), x)
    return x, np.where(held, 0.0, v), np.where(held, 0.0, a)


def mean_jerk(velocity: Array, acceleration: Array, period: float) -> Array:
    """Return the mean jerk from every knot to the next [m/s³], shape (n,); 0 at the last and before a step."""
    v0, v1, a0, a1 = velocity[:-1], velocity[1:], acceleration[:-1], acceleration[1:]
    jerk = np.zeros(velocity.size)
    smooth = np.abs(v1 - v0) <= STEP_ACCELERATION * period
    jerk[:-1] = np.where(smooth, (a1 - a0) / period, 0.0)
    return jerk


def hermite(y0: Any, d0: Any, y1: Any, d1: Any, s: Any, period: float) -> tuple[Any, Any]:
    """Return value and derivative of the cubic Hermite polynomial, ``s`` into an interval; of arrays too."""
    slope = (y1 - y0) / period
    c2 = (3.0 * slope - 2.0 * d0 - d1) / period
    c3 = (d0 + d1 - 2.0 * slope) / (period * period)
    value = y0 + s * (d0 + s * (c2 + s * c3))
    return value, d0 + s * (2.0 * c2 + 3.0 * s * c3)


def knot_count(count: float) -> int:
    """Return a number of knots, refused where it cannot be meant.

    Raises
    ------
    ValueError
        Beyond :data:`MOST_KNOTS`.
    """
    if not count <= MOST_KNOTS:
        raise ValueError(f"a profile of {count:.3g} knots; check its duration and period (at most {MOST_KNOTS} knots)")
    return int(count)


def seconds(stamps: NDArray[np.int64]) -> Array:
    """Return stamps [ns] as times [s]."""
    return np.asarray(stamps * 1e-9, dtype=np.float64)


def whole_nanoseconds(period: float, what: str) -> int:
    """Return a period [s] as nanoseconds.

    Raises
    ------
    ValueError
        If it is not a positive number of whole nanoseconds; the message begins with ``what``.
    """
    period_ns = round(period * 1e9) if math.isfinite(period) else 0
    if period_ns < 1:
        raise ValueError(f"{what} is {period} s; it must be at least 1 ns")
    return period_ns


def check_columns(columns: list[Array]) -> None:
    """Refuse times, positions, speeds and accelerations that differ in length or are not finite.

    Raises
    ------
    ValueError
        With the column, the knot and the value.
    """
    names = ("time", "position", "velocity", "acceleration")
    if any(column.ndim != 1 or column.size != columns[0].size for column in columns):
        sizes = ", ".join(f"{name} {column.size}" for name, column in zip(names, columns, strict=True))
        raise ValueError(f"a profile needs four columns of one length, these are {sizes}")
    if columns[0].size < 2:
        raise ValueError(f"a profile needs at least two knots, this one has {columns[0].size}")
    for name, column in zip(names, columns, strict=True):
        wrong = np.flatnonzero(~np.isfinite(column))
        if wrong.size:
            raise ValueError(
                f"{name} of knot {wrong[0]} is {column[wrong[0]]}; every value of a profile must be finite"
            )


def even_grid(time: Array) -> tuple[int, int]:
    """Return start and period [ns] of evenly spaced times.

    Raises
    ------
    ValueError
        If they are not evenly spaced, or beyond :data:`LATEST`.
    """
    if np.abs(time).max() > LATEST:
        raise ValueError(f"a profile reaches to {np.abs(time).max():.3g} s; at most {LATEST:g} s make sense")
    stamps = np.rint(time * 1e9)
    period = round((float(stamps[-1]) - float(stamps[0])) / (time.size - 1))
    uneven = np.flatnonzero(np.abs(stamps - (stamps[0] + period * np.arange(time.size))) > max(2.0, 1e-6 * period))
    if period < 1 or uneven.size:
        place = int(uneven[0]) if uneven.size else 0
        raise ValueError(f"knots of a profile must be evenly spaced in time, knot {place} at {time[place]} s is not")
    return int(stamps[0]), period


def padded(position: Array, velocity: Array, acceleration: Array, tail: int) -> tuple[Array, Array, Array]:
    """Return the knots followed by ``tail`` knots at rest."""
    pads = (
        np.concatenate((position, np.full(tail, position[-1]))),
        np.concatenate((velocity, np.zeros(tail))),
        np.concatenate((acceleration, np.zeros(tail))),
    )
    for pad in pads:
        pad.flags.writeable = False
    return pads
