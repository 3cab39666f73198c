"""Figures that judges take from the series of a run, and how they are written."""

from __future__ import annotations

import math

import numpy as np

from train_ato.history import History
from train_ato.types import Array

__all__ = [
    "largest",
    "last_outside",
    "mean_speed_error",
    "position_error",
    "rms",
    "speed_error",
    "written",
]


def position_error(history: History, offsets: Array | None = None) -> Array:
    """Return x + offset - x_d of every unit [m], shape (k, units).

    Parameters
    ----------
    history
        The run.
    offsets
        Nominal distances behind vehicle 0 [m]; default: those at the start, couplers unstretched.
    """
    if offsets is None:
        offsets = history.front_position[0] - history.position[0]
    return np.asarray(history.position + offsets - history.reference_position[:, None])


def speed_error(history: History) -> Array:
    """Return v - v_d of every unit [m/s], shape (k, units)."""
    return np.asarray(history.velocity - history.reference_velocity[:, None])


def mean_speed_error(history: History) -> Array:
    """Return the mean over the units of v - v_d [m/s], shape (k,)."""
    return np.asarray(speed_error(history).mean(axis=1))


def rms(values: Array) -> float:
    """Return the root mean square over all entries."""
    return float(np.sqrt(np.mean(np.square(values))))


def largest(values: Array) -> float:
    """Return the largest magnitude."""
    return float(np.abs(values).max())


def last_outside(time: Array, values: Array, band: float, begin: float = -math.inf, end: float = math.inf) -> float:
    """Return the last time between two at which any magnitude exceeds a band [s]; NaN if none does."""
    inside = (time >= begin) & (time < end)
    beyond = np.abs(values[inside]) > band
    late = np.flatnonzero(beyond.reshape(beyond.shape[0], -1).any(axis=1))
    return float(time[inside][late[-1]]) if late.size else math.nan


def written(value: float, unit: str = "", digits: int = 3) -> str:
    """Return a figure with its unit, in kilometres or millimetres where metres read badly."""
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
