"""Knots of a profile at a constant period: validation and interpolation.

Between two knots the position is the cubic Hermite polynomial of positions and speeds, the speed the cubic Hermite
polynomial of speeds and accelerations, the acceleration its derivative; the jerk is the mean over the interval, so
that a limit valid at the knots is valid between them.  Position, speed and acceleration are exact at every knot and
continuous everywhere; a profile with constant jerk between the knots is reproduced exactly.  At a step of the speed
between two knots, the state of the knot before continues at constant acceleration up to the step.
"""

from __future__ import annotations

import math
from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant_sim.compiled import compiled
from plant_sim.number_text import number_text
from train_ato.messages.types import Array

STEP_ACCELERATION = 20.0
"""Mean acceleration between two knots above which the change of speed is a step [m/s²]."""
MAX_KNOTS = 2_000_000
"""Maximum number of knots of a profile, 27 h at 20 Hz; a profile is one message of up to 112 MB, which every node
decodes whole."""
MAX_TIME = 1e8
"""Maximum time of a knot [s]."""


def read_between(
    knots: tuple[Array, Array, Array], stamps: NDArray[np.int64], period_ns: int
) -> tuple[Array, Array, Array]:
    """Return the state at many stamps, with the same operations in the same order as ``Profile.at_stamp``.

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
        At rest before the first and after the last knot.
    """
    shape = np.shape(stamps)
    flat = np.atleast_1d(stamps)
    found = np.empty((3, flat.size))
    _read_each(knots[0], knots[1], knots[2], flat, period_ns, found)
    x, v, a = found
    return x.reshape(shape), v.reshape(shape), a.reshape(shape)


@compiled
def _read_each(position, velocity, acceleration, stamps, period_ns, found):  # type: ignore[no-untyped-def]
    """Compute position, speed and acceleration at every stamp, shape (3, m); arguments as in :func:`read_between`."""
    last = position.size - 1
    period = period_ns * 1e-9
    for i in range(stamps.size):
        index = stamps[i] // period_ns
        rest = stamps[i] - index * period_ns
        if index < 0 or index > last or (index == last and rest != 0):
            found[0, i] = position[0] if index < 0 else position[last]
            found[1, i] = found[2, i] = 0.0
        elif rest == 0:
            found[0, i], found[1, i], found[2, i] = position[index], velocity[index], acceleration[index]
        else:
            s = rest * 1e-9
            v0, v1, a0 = velocity[index], velocity[index + 1], acceleration[index]
            if abs(v1 - v0) > STEP_ACCELERATION * period:
                found[0, i] = position[index] + (v0 + 0.5 * a0 * s) * s
                found[1, i], found[2, i] = v0 + a0 * s, a0
            else:
                found[0, i] = _hermite(position[index], v0, position[index + 1], v1, s, period)[0]
                found[1, i], found[2, i] = _hermite(v0, a0, v1, acceleration[index + 1], s, period)


def mean_jerk(velocity: Array, acceleration: Array, period: float) -> Array:
    """Return the mean jerk from every knot to the next [m/s³], shape (n,); 0 at the last and before a step."""
    v0, v1, a0, a1 = velocity[:-1], velocity[1:], acceleration[:-1], acceleration[1:]
    jerk = np.zeros(velocity.size)
    smooth = np.abs(v1 - v0) <= STEP_ACCELERATION * period
    jerk[:-1] = np.where(smooth, (a1 - a0) / period, 0.0)
    return jerk


def hermite(y0: Any, d0: Any, y1: Any, d1: Any, s: Any, period: Any) -> tuple[Any, Any]:
    """Return value and derivative of the cubic Hermite polynomial at ``s`` within an interval."""
    slope = (y1 - y0) / period
    c2 = (3.0 * slope - 2.0 * d0 - d1) / period
    c3 = (d0 + d1 - 2.0 * slope) / (period * period)
    value = y0 + s * (d0 + s * (c2 + s * c3))
    return value, d0 + s * (2.0 * c2 + 3.0 * s * c3)


_hermite = compiled(hermite)


def knot_count(count: float) -> int:
    """Return a number of knots as an integer after a check.

    Raises
    ------
    ValueError
        Above :data:`MAX_KNOTS`.
    """
    if not count <= MAX_KNOTS:
        raise ValueError(
            f"a profile of {number_text(count, 3)} knots, at most {MAX_KNOTS}; shorten it or increase the tick"
        )
    return int(count)


def stamps_to_seconds(stamps: NDArray[np.int64]) -> Array:
    """Return times [s] of stamps [ns]."""
    return np.asarray(stamps * 1e-9, dtype=np.float64)


def whole_nanoseconds(period: float, what: str) -> int:
    """Return a period [s] in nanoseconds.

    Raises
    ------
    ValueError
        If it is not a positive number of whole nanoseconds; the message begins with ``what``.
    """
    period_ns = round(period * 1e9) if math.isfinite(period) else 0
    if period_ns < 1:
        raise ValueError(f"{what} is {period} s; give at least 1 ns")
    return period_ns


def check_columns(columns: list[Array]) -> None:
    """Check that times, positions, speeds and accelerations are finite and of equal length.

    Raises
    ------
    ValueError
        With the column, the knot and the value.
    """
    names = ("time", "position", "velocity", "acceleration")
    if any(column.ndim != 1 or column.size != columns[0].size for column in columns):
        sizes = ", ".join(f"{name} {column.size}" for name, column in zip(names, columns, strict=True))
        raise ValueError(f"columns of a profile differ in length ({sizes}); make them one length")
    if columns[0].size < 2:
        raise ValueError(f"a profile of {columns[0].size} knots; give at least two")
    for name, column in zip(names, columns, strict=True):
        wrong = np.flatnonzero(~np.isfinite(column))
        if wrong.size:
            raise ValueError(f"{name} of knot {wrong[0]} is {column[wrong[0]]}; give a finite number")


def even_grid(time: Array) -> tuple[int, int]:
    """Return start and period [ns] of evenly spaced times.

    Raises
    ------
    ValueError
        If they are not evenly spaced or exceed :data:`MAX_TIME`.
    """
    if np.abs(time).max() > MAX_TIME:
        raise ValueError(
            f"a profile up to {number_text(np.abs(time).max(), 3)} s; give at most {number_text(MAX_TIME)} s"
        )
    stamps = np.rint(time * 1e9)
    period = round((float(stamps[-1]) - float(stamps[0])) / (time.size - 1))
    uneven = np.flatnonzero(np.abs(stamps - (stamps[0] + period * np.arange(time.size))) > max(2.0, 1e-6 * period))
    if period < 1 or uneven.size:
        place = int(uneven[0]) if uneven.size else 0
        raise ValueError(f"knot {place} at {time[place]} s: the knots are not evenly spaced in time; resample them")
    return int(stamps[0]), period


def padded(
    position: Array, velocity: Array, acceleration: Array, tail: int
) -> tuple[array[float], array[float], array[float]]:
    """Return the knots followed by ``tail`` knots at rest, as numbers of Python."""
    pads = []
    for column, rest in ((position, position[-1]), (velocity, 0.0), (acceleration, 0.0)):
        pad = array("d", [rest]) * (column.size + tail)
        np.frombuffer(pad)[: column.size] = column
        pads.append(pad)
    return pads[0], pads[1], pads[2]


def read_only(numbers: array[float]) -> Array:
    """Return the numbers as a read-only array, without a copy."""
    found: Array = np.frombuffer(numbers)
    found.flags.writeable = False
    return found
