"""Sustained oscillation of a series: turning points, regular periods, autocorrelation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from train_ato.messages.types import Array

PERIODS = 6
"""Smallest number of regular periods in a row; Thornhill, Huang, Zhang, J. Process Control 13 (2003) 91-100: 5."""
REGULARITY = 0.25
"""Largest standard deviation over mean of the periods; 1/3 of Thornhill et al. also accepts filtered noise."""
EQUALITY = 0.2
"""Largest standard deviation over mean of the swings; a limit cycle has one amplitude, noise any."""
CORRELATION = 0.5
"""Smallest autocorrelation after one period: Miao and Seborg, IEEE Conf. Control Applications (1999).  Noise has 0."""
LAGS = np.linspace(0.8, 1.2, 9)
"""Lags of the autocorrelation over the median period."""
BAND = 0.1
"""Relative difference of the frequency up to which two periods count as equal."""


@dataclass(frozen=True)
class Oscillation:
    """Sustained oscillation.

    Attributes
    ----------
    begin, duration : float
        First turning point, and time of the regular part [s].
    period : float
        Median period [s].
    amplitude : float
        Half of the median swing between turning points, in the unit of the series.
    """

    begin: float
    duration: float
    period: float
    amplitude: float


def sustained_oscillation(
    time: Array, values: Array, *, amplitude: float, max_period: float, min_duration: float
) -> Oscillation | None:
    """Return the longest sustained oscillation of a series, None without one.

    The swings between turning points are at least twice the amplitude and equal (``EQUALITY``), the period is regular
    (``REGULARITY``), and the series after one period is similar to itself (``CORRELATION``), over at least ``PERIODS``
    periods and ``min_duration``.  Noise has irregular periods and no correlation, a decaying oscillation
    has too few swings.

    Parameters
    ----------
    time, values : shape (k,)
        Evenly spaced times [s], and values.
    amplitude
        Smallest amplitude, in the unit of the values.
    max_period, min_duration
        Longest period, and shortest duration of the oscillation [s].
    """
    if values.size < 2 * PERIODS or float(np.ptp(values)) < 2 * amplitude:
        return None
    turns = turning_points(values, 2 * amplitude)
    found = [
        _confirmed(time, values, turns[first : last + 1], min_duration)
        for first, last in _regular_spans(time[turns], np.abs(np.diff(values[turns])), max_period)
    ]
    return max((entry for entry in found if entry is not None), key=lambda entry: entry.duration, default=None)


def turning_points(values: Array, swing: float) -> NDArray[np.intp]:
    """Return the rows of maxima and minima, in turn, with at least ``swing`` between neighbours; the ends are none."""
    change = np.diff(values)
    moving = np.flatnonzero(change)
    rising = change[moving] > 0
    rows = moving[np.flatnonzero(rising[1:] != rising[:-1])] + 1
    rows = np.concatenate(([0], rows, [values.size - 1]))
    found: list[int] = []
    low = high = float(values[0])
    at_low = at_high = direction = 0
    for row, value in zip(rows.tolist(), values[rows].tolist(), strict=True):
        if direction >= 0 and value > high:
            high, at_high = value, row
        if direction <= 0 and value < low:
            low, at_low = value, row
        if direction >= 0 and high - value >= swing:
            found.append(at_high)
            direction, low, at_low = -1, value, row
        elif direction <= 0 and value - low >= swing:
            found.append(at_low)
            direction, high, at_high = 1, value, row
    return np.array(found, dtype=np.intp)


def _regular_spans(turns: Array, swings: Array, max_period: float) -> Iterator[tuple[int, int]]:
    """Yield first and last turning point of the spans with regular periods and swings; ``turns`` are times [s]."""
    count = 2 * PERIODS - 1
    periods = turns[2:] - turns[:-2]
    if periods.size < count:
        return
    windows = sliding_window_view(periods, count)
    regular = (windows.max(axis=1) <= max_period) & (windows.std(axis=1) <= REGULARITY * windows.mean(axis=1))
    heights = sliding_window_view(swings, count + 1)
    regular &= heights.std(axis=1) <= EQUALITY * heights.mean(axis=1)
    covered = np.zeros(turns.size + 1, dtype=np.int64)
    covered[:-1][np.flatnonzero(regular)] += 1
    covered[np.flatnonzero(regular) + count + 1] -= 1
    inside = np.concatenate(([0], np.cumsum(covered)[:-1] > 0, [0])).astype(np.int8)
    edges = np.flatnonzero(np.diff(inside))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _confirmed(time: Array, values: Array, turns: NDArray[np.intp], min_duration: float) -> Oscillation | None:
    """Return the oscillation between turning points, None if too short or without correlation."""
    turns = turns[turns < values.size]
    at = time[turns]
    period = float(np.median(at[2:] - at[:-2]))
    length = max(min_duration, PERIODS * period)
    blocks = int((at[-1] - at[0]) / length * (1 + 1e-9))
    if blocks < 1:
        return None
    tick = float(time[1] - time[0])
    parts = np.array_split(values[turns[0] : turns[-1] + 1], blocks)
    lags = {max(1, round(lag)) for lag in (LAGS * period / tick).tolist()}
    similar = sum(max(_correlation(part, lag) for lag in lags) >= CORRELATION for part in parts)
    if 2 * similar < blocks:
        return None
    swings = np.abs(np.diff(values[turns]))
    duration = float(at[-1] - at[0]) * similar / blocks
    return Oscillation(float(at[0]), duration, period, float(np.median(swings)) / 2)


def _correlation(values: Array, lag: int) -> float:
    """Return the autocorrelation of a series after ``lag`` rows, -1 ... 1; 0 for a constant series."""
    if lag >= values.size:
        return 0.0
    deviation = values - values.mean()
    early, late = deviation[: values.size - lag], deviation[lag:]
    scale = float(np.sqrt((early**2).sum() * (late**2).sum()))
    return float((early * late).sum()) / scale if scale > 0 else 0.0


def share_at_period(values: Array, period: float) -> float:
    """Return the part of the variance of a series within 10 % of a period, 0 ... 1; 0 for a constant series.

    Parameters
    ----------
    values : shape (k,)
        Evenly spaced values.
    period
        Period [rows].
    """
    power = np.abs(np.fft.rfft(values - values.mean())) ** 2
    near = np.abs(np.fft.rfftfreq(values.size) * period - 1) <= max(BAND, period / values.size)
    total = float(power.sum())
    return float(power[near].sum()) / total if total > 0 else 0.0
