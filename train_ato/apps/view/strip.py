"""Rows of the last minutes of a run for the strip charts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from train_ato.apps.view.snapshot import STRIP
from train_ato.messages.types import Array

MOST_ROWS = 6000
"""Number of kept rows: five minutes of wall time at 20 frames a second."""
GROW = 2


class Strip:
    """Rows of :data:`train_ato.apps.view.snapshot.STRIP` with constant row numbers, newest last.

    Attributes
    ----------
    added : int
        Number of rows added so far.
    """

    def __init__(self, rows: int = MOST_ROWS) -> None:
        self.rows = rows
        self._table: Array = np.zeros((GROW * rows, len(STRIP)))
        self._used = 0
        self.added = 0

    def add(self, row: Sequence[float]) -> None:
        """Add the newest row; the oldest rows are dropped when the table is full."""
        if self._used == len(self._table):
            self._table[: self.rows] = self._table[-self.rows :]
            self._used = self.rows
        self._table[self._used] = row
        self._used += 1
        self.added += 1

    def since(self, number: int) -> dict[str, Array]:
        """Return the columns of the kept rows from a row number on."""
        count = min(self.added - number, self._used, self.rows)
        rows = self._table[self._used - max(0, count) : self._used]
        return {name: rows[:, column].astype(np.float32 if column else np.float64) for column, name in enumerate(STRIP)}
