"""The last minutes of a run, for the strip charts of every browser that looks on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from train_ato.types import Array
from train_ato.view.moment import STRIP

MOST_ROWS = 6000
"""Rows that are kept; at the page's rate that is five minutes of wall time."""
GROW = 2


class Strip:
    """Rows of :data:`train_ato.view.moment.STRIP`, the newest last; each row has a number that never changes.

    Attributes
    ----------
    added : int
        Number of rows that were ever added.
    """

    def __init__(self, rows: int = MOST_ROWS) -> None:
        self.rows = rows
        self._table: Array = np.zeros((GROW * rows, len(STRIP)))
        self._used = 0
        self.added = 0

    def add(self, row: Sequence[float]) -> None:
        """Add the newest row; the oldest is forgotten when there are too many."""
        if self._used == len(self._table):
            self._table[: self.rows] = self._table[-self.rows :]
            self._used = self.rows
        self._table[self._used] = row
        self._used += 1
        self.added += 1

    def since(self, number: int) -> dict[str, Array]:
        """Return the columns of all rows that are kept from a number on."""
        count = min(self.added - number, self._used, self.rows)
        rows = self._table[self._used - max(0, count) : self._used]
        return {name: rows[:, column].astype(np.float32 if column else np.float64) for column, name in enumerate(STRIP)}
