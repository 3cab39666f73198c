"""Execution of a sweep on Dask: batches to the workers, rows back as they finish."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from itertools import islice
from typing import Any

from train_ato.apps.sweep.batch import Batch, SweepBase, run_batch
from train_ato.apps.sweep.design import Point
from train_ato.apps.sweep.row import TIMES, Row
from train_ato.errors import RunFailed

__all__ = ["execute_points"]

TASK_S = 2.0
"""Duration of a batch that is aimed at [s]: long against the 5 ms of a task, short against a sweep."""
MAX_BATCH = 64
QUEUED = 2
"""Batches for every worker, running and waiting."""
LOST_TASKS = 3
"""Number of times that a batch is sent again after the loss of its result."""


def execute_points(
    client: Any, base: SweepBase, points: Sequence[tuple[int, Point]], take: Callable[[list[Row]], None]
) -> None:
    """Run points on the workers of a client.

    A batch of a killed worker runs again on another one.  If a batch kills every worker it runs on, its points run
    alone, and the row of the point that does it has the status ``failed``.

    Parameters
    ----------
    client
        Client of Dask.
    base
        The sweep.
    points
        Number and values of every run.
    take
        Called with the rows of every finished batch, in the order of their ends.

    Raises
    ------
    RunFailed
        If the scheduler is lost, or a worker cannot run any point.
    """
    _Execution(client, base, points, take).run()


class _Execution:
    """Batches under way and points that wait."""

    def __init__(
        self, client: Any, base: SweepBase, points: Sequence[tuple[int, Point]], take: Callable[[list[Row]], None]
    ) -> None:
        from distributed import as_completed

        self._client, self._base, self._take = client, base, take
        self._waiting = deque(points)
        self._alone: deque[tuple[int, Point]] = deque()
        self._running: dict[Any, Batch] = {}
        self._lost: dict[int, int] = {}
        self._completed = as_completed([], loop=client.loop)
        self._seconds, self._rows = 0.0, 0

    def run(self) -> None:
        """Run all points."""
        self._fill()
        while self._running:
            future = next(self._completed)
            batch = self._running.pop(future)
            rows = self._result(future, batch)
            future.release()
            if rows:
                self._seconds += sum(row[name] for row in rows for name in TIMES)
                self._rows += len(rows)
                self._take(rows)
            self._fill()

    def _fill(self) -> None:
        """Submit batches until every worker has one that runs and one that waits."""
        slots = QUEUED * max(1, sum(self._client.nthreads().values()))
        while len(self._running) < slots and (self._alone or self._waiting):
            if self._alone:
                self._submit([self._alone.popleft()])
                continue
            size = min(self._size(), -(-len(self._waiting) // slots))
            batch = list(islice(self._waiting, size))
            for _ in batch:
                self._waiting.popleft()
            self._submit(batch)

    def _size(self) -> int:
        """Return the number of runs of a batch: 1 before the first result, then that of :data:`TASK_S`."""
        if not self._rows:
            return 1
        return min(MAX_BATCH, max(1, int(TASK_S * self._rows / max(self._seconds, 1e-9))))

    def _submit(self, batch: Batch) -> None:
        future = self._client.submit(run_batch, self._base, batch, pure=False)
        self._running[future] = batch
        self._completed.add(future)

    def _result(self, future: Any, batch: Batch) -> list[Row]:
        """Return the rows of a batch; [] if its points wait again."""
        from distributed import KilledWorker

        if future.status in ("lost", "cancelled"):
            return self._again(batch)
        error = future.exception()
        if error is None:
            rows: list[Row] = future.result()
            return rows
        if not isinstance(error, KilledWorker):
            reason = " ".join(str(error).split()) or type(error).__name__
            raise RunFailed(f"a worker cannot run a batch: {reason}")
        if len(batch) > 1:
            self._alone.extend(batch)
            return []
        reason = "its worker process was killed or ran out of memory, several times"
        return [_failed(number, point, reason) for number, point in batch]

    def _again(self, batch: Batch) -> list[Row]:
        """Let the points of a lost batch wait again, a limited number of times."""
        first = batch[0][0]
        self._lost[first] = self._lost.get(first, 0) + 1
        if self._client.status != "running" or self._lost[first] > LOST_TASKS:
            raise RunFailed("the scheduler of Dask was lost; start it and run the same command again")
        self._waiting.extendleft(reversed(batch))
        return []


def _failed(number: int, point: Point, reason: str) -> Row:
    return {"run": number, "point": dict(point), "status": "failed", "reason": reason, **dict.fromkeys(TIMES, 0.0)}
