"""Search of a falsification: find a break of a requirement, then the smallest departure that still breaks it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from train_ato.apps.falsify.proposals import closer_points, first_points, next_points
from train_ato.apps.falsify.search_space import SearchSpace
from train_ato.apps.falsify.target import TargetRun
from train_ato.messages.types import Array

RunAll = Callable[[Sequence[dict[str, Any]]], Iterable[TargetRun]]
"""Function that runs the scenario with each of several sets of changes, in their order."""
BISECTIONS = 6
"""Halvings of the distance between a break and the nominal point: 1/64 of it remains."""
REACHES = (0.8, 0.9, 0.95)
"""Departures that are tried, over the smallest one so far; after a success from the first one again."""


@dataclass(frozen=True)
class SearchRow:
    """One run: its number from 1, phase of the search, point, departure from nominal and result."""

    number: int
    phase: str
    point: Array
    departure: float
    run: TargetRun


class FalsificationSearch:
    """Search with a limited number of runs.

    Parameters
    ----------
    space
        Dimensions and nominal point.
    run_all
        Function that runs points in unit coordinates as values by key.
    runs
        Largest number of runs.
    batch
        Number of points that are chosen and run together.
    seed
        Seed of the random stream.
    note
        Called with every row.
    """

    def __init__(
        self, space: SearchSpace, run_all: RunAll, runs: int, batch: int = 1, seed: int = 1,
        note: Callable[[SearchRow], None] | None = None,
    ) -> None:  # fmt: skip
        self.space, self.rows = space, list[SearchRow]()
        self._run_all, self._runs, self._batch, self._note = run_all, runs, batch, note
        self._stream = np.random.default_rng(seed)

    @property
    def smallest(self) -> SearchRow | None:
        """Run that breaks the requirement with the smallest departure; None without a break."""
        broken = [row for row in self.rows if row.run.breaks]
        return min(broken, key=lambda row: row.departure) if broken else None

    @property
    def left(self) -> int:
        """Number of runs that are left."""
        return self._runs - len(self.rows)

    def find(self) -> None:
        """Run points until one breaks the requirement; the nominal point is the first one."""
        nominal, size = self.space.nominal, self.space.size
        first = first_points(nominal, size + 1, self._stream)
        self._run(first[:1], "nominal")
        for begin in range(1, len(first), self._batch):
            if self.smallest is None:
                self._run(first[begin : begin + self._batch], "search")
        while self.smallest is None and self.left > 0:
            points = next_points(*self._known(), nominal, self._batch, self._stream)
            if not self._run(points, "search"):
                self._run(self._stream.random((self._batch, size)), "search")

    def shrink(self) -> None:
        """Reduce the departure of the break: fewer keys, towards the nominal point, then other directions."""
        if self.smallest is None or self.smallest.departure == 0.0:
            return
        self._drop_keys()
        self._bisect()
        tries = 0
        while tries < len(REACHES) and self.left > 0:
            best = self.smallest
            points = closer_points(
                *self._known(), self.space.nominal, best.point, REACHES[tries], self._batch, self._stream
            )
            self._run(points, "shrink")
            if self.smallest is best:
                tries += 1
                continue
            tries = 0
            self._bisect()
        self._drop_keys()
        self._bisect()

    def _drop_keys(self) -> None:
        """Set every key to its nominal value if the rest still breaks the requirement, the smallest step first."""
        best = self.smallest
        assert best is not None
        for axis in np.argsort(np.abs(best.point - self.space.nominal)):
            best = self.smallest
            assert best is not None
            point = best.point.copy()
            point[axis] = self.space.nominal[axis]
            if point[axis] != best.point[axis]:
                self._run(point[None], "shrink")

    def _bisect(self) -> None:
        """Halve the distance between the nominal point and the break on their connecting line."""
        best = self.smallest
        assert best is not None
        held, broken = 0.0, 1.0
        for _ in range(BISECTIONS):
            middle = 0.5 * (held + broken)
            rows = self._run(self.space.nominal + middle * (best.point - self.space.nominal)[None], "shrink")
            if not rows:
                return
            held, broken = (held, middle) if rows[0].run.breaks else (middle, broken)

    def _known(self) -> tuple[Array, list[float]]:
        return np.array([row.point for row in self.rows]), [row.run.robustness for row in self.rows]

    def _run(self, points: Array, phase: str) -> list[SearchRow]:
        """Run the points that are new, as far as runs are left; return their rows."""
        fresh: list[Array] = []
        for wanted in points:
            point = self.space.on_values(wanted)
            seen = (*(row.point for row in self.rows), *fresh)
            if not any(np.array_equal(point, other) for other in seen) and len(fresh) < self.left:
                fresh.append(point)
        found = []
        for point, run in zip(fresh, self._run_all([self.space.values(point) for point in fresh]), strict=True):
            row = SearchRow(len(self.rows) + 1, phase, point, self.space.departure(point), run)
            self.rows.append(row)
            found.append(row)
            if self._note is not None:
                self._note(row)
        return found
