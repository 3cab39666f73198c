"""Execution of a sweep on Dask: batches to the workers, rows back as they finish."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from itertools import islice
from typing import Any

from train_ato.apps.sweep.batch import Batch, SweepBase, run_batch
from train_ato.apps.sweep.design import Point
from train_ato.apps.sweep.row import TIMES, Row
from train_ato.errors import RunFailed

__all__ = ["execute_points"]

TASK_S = 8.0
"""Duration of a batch that is aimed at [s]: long against the transfer of a task, short against a sweep."""
MAX_BATCH = 64
QUEUED = 2
"""Batches for every worker, running and waiting."""
SHOWN = 8
"""Number of runs that are named."""
LOST_TASKS = 3
"""Number of times that a batch is sent again after the loss of its result."""
LOOK_S = 5.0
"""Wall time between two looks at the workers while no batch ends [s]."""
SILENT_S = 60.0
"""Wall time without the end of a batch after which the runs under way are named [s], at least."""
SILENT_BATCHES = 10.0
"""The same in durations of the longest batch so far."""
NO_WORKER_S = 300.0
"""Wall time without a worker after which a sweep ends [s]; a worker that was killed starts again within seconds."""


def execute_points(
    client: Any,
    base: SweepBase,
    points: Sequence[tuple[int, Point]],
    take: Callable[[list[Row]], None],
    announce: Callable[[str], None] = lambda text: None,
) -> None:
    """Run points on the workers of a client.

    A batch of a killed or frozen worker runs again on another one.  The points of a batch whose workers are killed
    again and again run at the end, one at a time and nothing beside them: the row of a point whose workers are killed
    then, too, has the status ``failed``.

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
    announce
        Called with a line that names the runs under way if none ends for long.

    Raises
    ------
    RunFailed
        If the scheduler is lost, or a worker cannot run any point.
    """
    _Execution(client, base, points, take, announce).run()


class _Execution:
    """Batches under way and points that wait."""

    def __init__(
        self,
        client: Any,
        base: SweepBase,
        points: Sequence[tuple[int, Point]],
        take: Callable[[list[Row]], None],
        announce: Callable[[str], None],
    ) -> None:
        self._client, self._base, self._take, self._announce = client, base, take, announce
        self._waiting = deque(points)
        self._suspects: deque[tuple[int, Point]] = deque()
        self._alone = False
        self._running: dict[Any, Batch] = {}
        self._lost: dict[int, int] = {}
        self._seconds, self._rows, self._longest = 0.0, 0, 0.0

    def run(self) -> None:
        """Run all points."""
        self._fill()
        while self._running:
            for future in self._ended():
                batch = self._running.pop(future)
                rows = self._result(future, batch)
                future.release()
                if rows:
                    seconds = sum(row[name] for row in rows for name in TIMES)
                    self._seconds, self._longest = self._seconds + seconds, max(self._longest, seconds)
                    self._rows += len(rows)
                    self._take(rows)
            self._fill()

    def _ended(self) -> set[Any]:
        """Wait for the end of at least one batch, and return all that have ended.

        Raises
        ------
        RunFailed
            If there is no worker for :data:`NO_WORKER_S`.
        """
        from distributed import CancelledError, wait
        from distributed import TimeoutError as NoneEnded  # in Python 3.10 not the TimeoutError of Python

        begun = time.monotonic()
        last, named = begun + NO_WORKER_S, False
        while True:
            try:
                with self._client.as_current():
                    done: set[Any] = wait(list(self._running), timeout=LOOK_S, return_when="FIRST_COMPLETED").done
                return done
            except NoneEnded:
                if not named and time.monotonic() - begun > max(SILENT_S, SILENT_BATCHES * self._longest):
                    named = True
                    self._announce(f"no run has ended for {time.monotonic() - begun:.0f} s; {self._under_way()}")
                if self._client.nthreads():
                    last = time.monotonic() + NO_WORKER_S
                elif time.monotonic() > last:
                    raise RunFailed("no worker is left; start one and run the same command again") from None
            except CancelledError:
                return {future for future in self._running if future.done()}

    def _under_way(self) -> str:
        """Return the numbers of the runs that the workers have, first those that were sent first."""
        runs = [str(number) for batch in self._running.values() for number, _ in batch]
        more = f" and {len(runs) - SHOWN} more" if len(runs) > SHOWN else ""
        return f"under way: run {', '.join(runs[:SHOWN])}{more}"

    def _fill(self) -> None:
        """Submit batches until every worker has one that runs and one that waits; suspects last, one at a time."""
        slots = QUEUED * max(1, sum(self._client.nthreads().values()))
        while self._waiting and len(self._running) < slots:
            size = min(self._size(), -(-len(self._waiting) // slots))
            batch = list(islice(self._waiting, size))
            for _ in batch:
                self._waiting.popleft()
            self._submit(batch)
        if not self._running and self._suspects:
            self._alone = True
            self._submit([self._suspects.popleft()])

    def _size(self) -> int:
        """Return the number of runs of a batch: 1 before the first result, then that of :data:`TASK_S`."""
        if not self._rows:
            return 1
        return min(MAX_BATCH, max(1, int(TASK_S * self._rows / max(self._seconds, 1e-9))))

    def _submit(self, batch: Batch) -> None:
        future = self._client.submit(run_batch, self._base, batch, pure=False)
        self._running[future] = batch

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
        if not self._alone:
            self._suspects.extend(batch)
            return []
        reason = "its worker process was killed or ran out of memory, every time"
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
