"""The rows of a recorder's file in the order of time, and every quantity at the moments at which it has numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from train_ato.measured.columns import TIMESTAMP, Column
from train_ato.measured.table import Table
from train_ato.types import Array

__all__ = ["LARGEST_GAP", "Rows", "Samples"]

LARGEST_GAP = 5.0
"""Rows further apart than this are not joined unless the user says so [s]."""


@dataclass(frozen=True)
class Samples:
    """One quantity at its own moments, SI, shape (k,) each; between them it is read linearly."""

    column: Column
    time: Array
    values: Array
    rows: NDArray[np.intp]

    def at(self, moments: Array) -> Array:
        """Return the values at some moments [s]; before the first and behind the last that one is held."""
        return np.asarray(np.interp(moments, self.time, self.values))

    def moved(self, values: Array) -> Samples:
        """Return the same moments with other values."""
        return Samples(self.column, self.time, values, self.rows)


class Rows:
    """The rows of a file.

    Parameters
    ----------
    table
        The file.
    largest_gap
        Rows, or numbers of one column, further apart are refused [s].

    Attributes
    ----------
    time : Array, shape (n,)
        From the first row on [s].
    notes : list of str
        What was bridged, in one line each.

    Raises
    ------
    ValueError
        If there is no time, or it does not rise, or a gap is too long.
    """

    def __init__(self, table: Table, largest_gap: float) -> None:
        self.table = table
        self.notes: list[str] = []
        self._largest_gap = largest_gap
        self.time = self._clock()

    def _clock(self) -> Array:
        """Return the times of the rows, from the first one on."""
        table = self.table
        columns = [table.find("time"), table.find(TIMESTAMP)]
        column = columns[0] or columns[1]
        if column is None:
            raise ValueError(f"{table.path}: no column of the time; name one time_s, or timestamp for date and time")
        if columns[0] and columns[1]:
            raise ValueError(
                f"{table.path}: '{columns[0].title}' and '{columns[1].title}' both say the time; --ignore one of them"
            )
        time = table.values[column.title]
        if time.size < 2:
            raise ValueError(f"{table.path}: {time.size} rows of numbers; a history needs at least two")
        empty = np.flatnonzero(np.isnan(time))
        if empty.size:
            raise table.wrong(int(empty[0]), column, "is empty; every row needs its time, take the row out")
        steps = np.diff(time)
        wrong = np.flatnonzero(steps <= 0)
        if wrong.size:
            row = int(wrong[0]) + 1
            what = "the same time as" if steps[row - 1] == 0 else f"{-steps[row - 1]:g} s before"
            raise table.wrong(row, column, f"{what} the row above; rows are in order of time, each time once")
        wide = np.flatnonzero(steps > self._largest_gap * (1 + 1e-9))
        if wide.size:
            row = int(wide[0]) + 1
            raise table.wrong(row, column, self._gap(steps[row - 1], "the row above"))
        return np.asarray(time - time[0])

    def _gap(self, seconds: float, since: str) -> str:
        return (
            f"{seconds:g} s after {since}; more than {self._largest_gap:g} s are not bridged: cut the run there, or "
            f"bridge it with --largest-gap {np.ceil(seconds):g}"
        )

    def find(self, quantity: str, unit: int | None = None) -> Samples | None:
        """Return a quantity, None if the file has no column of it."""
        column = self.table.find(quantity, unit)
        return None if column is None else self.samples(column)

    def samples(self, column: Column) -> Samples:
        """Return a column where it has numbers; what it lacks must be short enough to be bridged."""
        values = self.table.values[column.title]
        rows = np.flatnonzero(~np.isnan(values))
        if not rows.size:
            raise ValueError(f"{self.table.path}: column '{column.title}' is empty; --ignore '{column.title}'")
        time = self.time[rows]
        edges = np.concatenate(([0.0], time, [self.time[-1]]))
        gaps = np.diff(edges)
        wide = np.flatnonzero(gaps > self._largest_gap * (1 + 1e-9))
        if wide.size:
            place = int(wide[0])
            row = int(rows[place]) if place < rows.size else values.size - 1
            above = "the first row" if place == 0 else f"the last value, in line {self.table.lines[rows[place - 1]]}"
            raise self.table.wrong(row, column, self._gap(gaps[place], above))
        if rows.size < values.size:
            line = self.table.lines[int(np.flatnonzero(np.isnan(values))[0])]
            self.notes.append(
                f"{column.title}: {values.size - rows.size} empty cells bridged, the first in line {line}, at most "
                f"{gaps.max():.3g} s"
            )
        return Samples(column, time, values[rows], rows)

    def refuse(self, samples: Samples, wrong: NDArray[np.bool_], text: str) -> None:
        """Refuse the first value that is wrong; ``{}`` in the text stands for it, as it is written."""
        places = np.flatnonzero(wrong)
        if places.size:
            place = int(places[0])
            value = samples.values[place] / samples.column.factor
            raise self.table.wrong(int(samples.rows[place]), samples.column, text.format(f"{value:g}"))
