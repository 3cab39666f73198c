"""Fewer points and smaller numbers with the same picture: peaks are kept, between them much is left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from train_ato.types import Array

LARGEST_CODE = 127
"""Codes of a heat map go from minus to plus this."""
NO_CODE = -128
"""Code of a cell without a value."""
GAP = 3.0
"""A value is held for so many steps; what comes later is a gap."""


def kept(columns: list[Array], rows: int) -> NDArray[np.intp]:
    """Choose rows of a table so that no peak of any column is lost.

    The table is cut into equal bins of rows; of every bin the rows of each column's smallest and largest value are
    kept, and the first and the last row of all.

    Parameters
    ----------
    columns
        Columns of one length k; NaN where there is no value.
    rows
        Most rows to keep, at least ``2 len(columns) + 2``.

    Returns
    -------
    ndarray of intp
        Numbers of the rows kept, rising; all of them where there are no more than ``rows``.  The rows at the ends of
        gaps come on top.
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
    """Return the rows at which a column's values begin or end, so that gaps stay gaps; none where there are many."""
    edges: list[NDArray[np.intp]] = []
    for column in columns:
        changes = np.flatnonzero(np.diff(np.isnan(column).astype(np.int8)))
        edges += [changes, changes + 1]
    together = np.unique(np.concatenate(edges)) if edges else chosen[:0]
    return together if together.size <= chosen.size // 4 else chosen[:0]


@dataclass(frozen=True)
class HeatMap:
    """A picture of many places over time in one byte a cell.

    Attributes
    ----------
    codes : ndarray of int8, shape (places, columns)
        Value over ``unit``; -128 where there is none.
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
        """Return the same picture with another value of the largest code."""
        unit = largest / LARGEST_CODE
        codes = np.rint(np.clip(self.codes * (self.unit / unit), -LARGEST_CODE, LARGEST_CODE)).astype(np.int8)
        return HeatMap(np.where(self.codes == NO_CODE, np.int8(NO_CODE), codes), unit, self.begin, self.end)


def heat_map(time: Array, values: NDArray[np.floating], columns: int, largest: float | None = None) -> HeatMap:
    """Make a picture of values over time: of every cell the value farthest from zero.

    Parameters
    ----------
    time : shape (k,)
        Times [s], rising.
    values : shape (k, places)
        Values.
    columns
        Most columns of the picture.
    largest
        Value of the largest code; default: the largest there is.
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
    top = float(np.abs(extreme).max()) if largest is None else largest
    unit = top / LARGEST_CODE if top > 0 else 1.0
    codes = np.rint(np.clip(extreme.T / unit, -LARGEST_CODE, LARGEST_CODE)).astype(np.int8)
    held = np.searchsorted(column[starts], np.arange(count), side="right") - 1
    picture = codes[:, held]
    middles: Array = np.asarray(begin + width * (np.arange(count) + 0.5), dtype=np.float64)
    picture[:, _uncovered(time, middles, max(width, step))] = NO_CODE
    return HeatMap(picture, unit, begin, end)


def _uncovered(time: Array, middles: Array, reach: float) -> NDArray[np.bool_]:
    """Tell which columns lie in a gap: the last value before their middle is older than a gap is."""
    before = np.maximum(np.searchsorted(time, middles, side="right") - 1, 0)
    return np.asarray(middles - time[before] > GAP * reach)


def aligned(time: Array, other: Array, values: Array) -> Array:
    """Return values at other times: exact where the times agree, else linear between neighbours, NaN in gaps.

    Parameters
    ----------
    time : shape (k,)
        Wanted times [s].
    other : shape (j,)
        Times of the values [s], rising.
    values : shape (j,) or (j, n)
        Values.
    """
    if other.size == time.size and np.array_equal(other, time):
        return np.asarray(values, dtype=np.float64)
    if other.size == 0:
        return np.full((time.size, *values.shape[1:]), np.nan)
    if values.ndim == 2:
        return np.column_stack([aligned(time, other, column) for column in values.T])
    result = np.interp(time, other, values)
    after = np.clip(np.searchsorted(other, time), 0, other.size - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.minimum(np.abs(other[after] - time), np.abs(time - other[before]))
    usual = float(np.median(np.diff(other))) if other.size > 1 else 0.0
    return np.where(nearest <= 0.75 * usual + 1e-9, result, np.nan)
