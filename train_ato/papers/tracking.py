"""Figures from the series of a run, and their text form."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from train_ato.loop.recording import Recording
from train_ato.messages.types import Array
from train_ato.papers.checks import recording as series_of
from train_ato.papers.claims import Result


def position_error(recording: Recording, offsets: Array | None = None) -> Array:
    """Return x + offset - x_d of every unit [m], shape (k, units).

    Parameters
    ----------
    recording
        The run.
    offsets
        Nominal distances behind vehicle 0 [m]; default: distances at the start, couplers unstretched.
    """
    if offsets is None:
        offsets = recording.front_position[0] - recording.position[0]
    return np.asarray(recording.position + offsets - recording.reference_position[:, None])


def speed_error(recording: Recording) -> Array:
    """Return v - v_d of every unit [m/s], shape (k, units)."""
    return np.asarray(recording.velocity - recording.reference_velocity[:, None])


def mean_speed_error(recording: Recording) -> Array:
    """Return the mean over the units of v - v_d [m/s], shape (k,)."""
    return np.asarray(speed_error(recording).mean(axis=1))


def rms(values: Array) -> float:
    """Return the root mean square over all entries."""
    return float(np.sqrt(np.mean(np.square(values))))


def largest(values: Array) -> float:
    """Return the largest magnitude."""
    return float(np.abs(values).max())


MOVING = 1.0
"""Reference speed from which speed errors are evaluated [m/s]; at rest the holding brake acts."""

STEADY = 1e-6
"""Acceleration of the reference below which its speed is constant [m/s²]."""


def moving(recording: Recording) -> NDArray[np.bool_]:
    """Return a mask of the ticks at which the reference moves, shape (k,)."""
    return np.asarray(recording.reference_velocity > MOVING)


def late_cruise(recording: Recording) -> NDArray[np.bool_]:
    """Return a mask of the last half of the longest interval at constant speed, shape (k,).

    Raises
    ------
    ValueError
        If the reference has no such interval.
    """
    steady = moving(recording) & (np.abs(recording.reference_acceleration) < STEADY)
    changes = np.flatnonzero(np.diff(np.concatenate(([False], steady, [False]))))
    begins, ends = changes[::2], changes[1::2]
    if not begins.size:
        raise ValueError("the reference has no constant speed")
    longest = int(np.argmax(ends - begins))
    mask = np.zeros(steady.size, dtype=bool)
    mask[(begins[longest] + ends[longest]) // 2 : ends[longest]] = True
    return mask


def largest_position_error(result: Result) -> float:
    """Return the largest position error of any unit, also at rest [m]."""
    return largest(position_error(series_of(result)))


def largest_speed_error(result: Result) -> float:
    """Return the largest speed error of any unit while moving [m/s]."""
    recording = series_of(result)
    return largest(speed_error(recording)[moving(recording)])


def time_within(time: Array, values: Array, band: float, begin: float = 0.0, end: float = math.inf) -> float:
    """Return the time after which all magnitudes stay within a band [s].

    Parameters
    ----------
    time, values
        Samples [s], shape (k,) and (k,) or (k, n).
    band
        Largest magnitude.
    begin, end
        Interval of the evaluation [s]; the result counts from its begin.

    Returns
    -------
    float
        0 if no sample is outside; NaN if the last one is, or is not finite.
    """
    part = (time >= begin) & (time < end)
    inside = np.abs(values[part]) <= band
    late = np.flatnonzero(~inside.reshape(inside.shape[0], -1).all(axis=1))
    if late.size == 0:
        return 0.0
    return math.nan if late[-1] == inside.shape[0] - 1 else float(time[part][late[-1] + 1]) - begin


def written(value: float, unit: str = "", digits: int = 3) -> str:
    """Return a figure with its unit, from 1000 m on in km, below 0.01 m in mm."""
    if not math.isfinite(value):
        return "never" if math.isnan(value) else f"beyond measure {unit}".strip()
    for plain, small, big in (("m", "mm", "km"), ("m/s", "mm/s", "")):
        if unit == plain:
            if 0 < abs(value) < 0.01:
                return f"{1000 * value:.{digits}g} {small}"
            if abs(value) >= 1000 and big:
                return f"{value / 1000:.{digits}g} {big}"
    text = f"{value:.{digits}g}" if abs(value) < 10**digits or abs(value) >= 1e5 else f"{value:.0f}"
    return f"{text} {unit}".strip()
