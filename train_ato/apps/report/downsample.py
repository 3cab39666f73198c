"""Downsampling for drawing: fewer points and one-byte heat maps; peaks are kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from train_ato.messages.types import Array

LARGEST_CODE = 127
"""Largest magnitude of the codes of a heat map."""
NO_CODE = -128
"""Code of a cell without a value."""
LARGEST_STEP = 5.0
"""Largest difference of a step of a profile from that of its speed that is no jump [m]."""
GAP = 3.0
"""Number of steps for which a value is held; a longer pause is a gap."""


def after_jump(time: Array, position: Array, velocity: Array) -> int:
    """Return the first knot of a profile after its last jump, 0 without one.

    The plan after an engagement begins at the place of the train, not on the profile before it.

    Parameters
    ----------
    time, position, velocity : shape (k,)
        Knots [s, m, m/s].
    """
    steps = np.diff(position) - np.diff(time) * (velocity[1:] + velocity[:-1]) / 2.0
    jumps = np.flatnonzero(np.abs(steps) > LARGEST_STEP)
    return int(jumps[-1]) + 1 if jumps.size else 0


def kept(columns: list[Array], rows: int) -> NDArray[np.intp]:
    """Return rows of a table that contain the peaks of every column.

    The table is divided into equal bins.  The rows of the minimum and maximum of every column in every bin are kept,
    and the first and the last row.

    Parameters
    ----------
    columns
        Columns of one length k; NaN where there is no value.
    rows
        Maximum number of rows, at least ``2 len(columns) + 2``.

    Returns
    -------
    ndarray of intp
        Increasing row numbers; all rows of a table with at most ``rows``.  Rows at the ends of gaps are added.
    """
    count = columns[0].size if columns else 0
    if count <= rows:
        return np.arange(count)
    bins = max(1, (rows - 2) // (2 * len(columns)))
    edges = np.linspace(0, count, bins + 1).astype(np.intp)
    width = int(np.diff(edges).max())
    cells = np.minimum(edges[:-1, None] + np.arange(width), edges[1:, None] - 1)
    found = [np.array([0, count - 1])]
    for column in columns:
        values = column[cells]
        holes = np.isnan(values)
        found.append(cells[np.arange(bins), np.where(holes, np.inf, values).argmin(axis=1)])
        found.append(cells[np.arange(bins), np.where(holes, -np.inf, values).argmax(axis=1)])
    chosen = np.unique(np.concatenate(found))
    return np.union1d(chosen, _edges_of_gaps(columns, chosen))


def _edges_of_gaps(columns: list[Array], chosen: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the rows at the ends of gaps, so that gaps stay visible; none if there are many."""
    edges: list[NDArray[np.intp]] = []
    for column in columns:
        changes = np.flatnonzero(np.diff(np.isnan(column).astype(np.int8)))
        edges += [changes, changes + 1]
    together = np.unique(np.concatenate(edges)) if edges else chosen[:0]
    return together if together.size <= chosen.size // 4 else chosen[:0]


@dataclass(frozen=True)
class HeatMap:
    """Values of all vehicles over time with one byte per cell.

    Attributes
    ----------
    codes : ndarray of int8, shape (places, columns)
        Value over ``unit``; -128: no value.
    unit : float
        Value of one step of the code.
    begin, end : float
        Time at the left and the right edge [s].
    """

    codes: NDArray[np.int8]
    unit: float
    begin: float
    end: float

    @property
    def largest(self) -> float:
        """Value of the largest code."""
        return LARGEST_CODE * self.unit

    def scaled(self, largest: float) -> HeatMap:
        """Return the same values on a scale with another value of the largest code."""
        unit = largest / LARGEST_CODE
        codes = np.rint(np.clip(self.codes * (self.unit / unit), -LARGEST_CODE, LARGEST_CODE)).astype(np.int8)
        return HeatMap(np.where(self.codes == NO_CODE, np.int8(NO_CODE), codes), unit, self.begin, self.end)


def heat_map(time: Array, values: NDArray[np.floating], columns: int) -> HeatMap:
    """Return a heat map of values over time; a cell has the value with the largest magnitude.

    Parameters
    ----------
    time : shape (k,)
        Increasing times [s].
    values : shape (k, places)
        Values.
    columns
        Maximum number of columns.
    """
    begin, end = float(time[0]), float(time[-1])
    step = (end - begin) / max(1, time.size - 1) or 1.0
    end += step
    count = max(1, min(columns, time.size))
    width = (end - begin) / count
    column = np.minimum(((time - begin) / width + 1e-6).astype(np.intp), count - 1)
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    finite = np.nan_to_num(values, nan=0.0)
    high, low = np.maximum.reduceat(finite, starts, axis=0), np.minimum.reduceat(finite, starts, axis=0)
    extreme = np.where(high >= -low, high, low)
    top = float(np.abs(extreme).max())
    unit = top / LARGEST_CODE if top > 0 else 1.0
    codes = np.rint(np.clip(extreme.T / unit, -LARGEST_CODE, LARGEST_CODE)).astype(np.int8)
    held = np.searchsorted(column[starts], np.arange(count), side="right") - 1
    picture = codes[:, held]
    middles: Array = np.asarray(begin + width * (np.arange(count) + 0.5), dtype=np.float64)
    picture[:, _uncovered(time, middles, max(width, step))] = NO_CODE
    return HeatMap(picture, unit, begin, end)


def _uncovered(time: Array, middles: Array, reach: float) -> NDArray[np.bool_]:
    """Return a mask of the columns in a gap: the last value before their middle is too old."""
    before = np.maximum(np.searchsorted(time, middles, side="right") - 1, 0)
    return np.asarray(middles - time[before] > GAP * reach)
