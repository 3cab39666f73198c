"""Worker processes for cases: a pool of the package ``pebble``, with progress during the cases.

A lost worker costs its own case only. The end of the pool kills the workers; the end of the parent ends them.
"""

import multiprocessing
import queue
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, wait
from dataclasses import dataclass, replace
from typing import Any

from pebble import ProcessExpired, ProcessPool

from train_ato.judge.result import Progress
from train_ato.loop.engine import run_engine
from train_ato.papers.claims import Calculation, Case, Result
from train_ato.program.interrupt import workers_without_ctrl_c

Task = tuple[str, Case | Calculation]
POLL_S = 0.1
"""Interval at which progress is read [s]."""


@dataclass(frozen=True)
class Moved:
    """Progress of a case, 0 to 1."""

    key: str
    fraction: float


@dataclass(frozen=True)
class Finished:
    """Result of a case."""

    key: str
    result: Result


def carry_out(case: Case | Calculation, progress: Any = None) -> Result:
    """Run one case in this process; an error is in ``failure`` of the result, as one line.

    Parameters
    ----------
    case
        The case.
    progress
        Called with :class:`train_ato.judge.result.Progress` during an engine run.
    """
    try:
        if isinstance(case, Calculation):
            figures, series = case.function(**case.arguments)
            return Result(figures, None, None, series)
        run = run_engine(case.setup(), progress=progress)
        # judges need the series only
        recording = run.recording and replace(run.recording, profiles=(), kept_reports=())
        return Result(run.summary, recording, run.failure)
    except Exception as error:
        return Result({}, None, " ".join(f"{type(error).__name__}: {error}".split()))


class WorkerPool:
    """Pool of worker processes, a context manager; its end kills the processes."""

    def __init__(self, jobs: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._progress: Any = context.Queue()
        self._pool = ProcessPool(jobs, context=context, initializer=_begin_worker, initargs=[self._progress])

    def __enter__(self) -> "WorkerPool":
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.stop()  # type: ignore[no-untyped-call]
        self._pool.join()

    def run(self, tasks: Iterable[Task]) -> Iterator[Moved | Finished]:
        """Run tasks in their order; yield progress and results."""
        with workers_without_ctrl_c():
            keys: dict[Any, str] = {self._pool.submit(_work, None, key, case): key for key, case in tasks}
        while keys:
            done, _ = wait(keys, timeout=POLL_S, return_when=FIRST_COMPLETED)
            yield from self._moved()
            for future in done:
                try:
                    result = future.result()
                except ProcessExpired as error:  # killed from outside, or out of memory
                    result = Result({}, None, f"its process ended unexpectedly, exit code {error.exitcode}")
                yield Finished(keys.pop(future), result)

    def _moved(self) -> Iterator[Moved]:
        while True:
            try:
                yield Moved(*self._progress.get_nowait())
            except queue.Empty:
                return


_progress: Any = None
"""Queue to the parent, in a worker."""


def _begin_worker(progress: Any) -> None:
    """Store the queue to the parent; it must not delay the end of the worker."""
    global _progress
    _progress = progress
    progress.cancel_join_thread()


def _work(key: str, case: Case | Calculation) -> Result:
    """Run a case in a worker."""

    def report(progress: Progress) -> None:
        _progress.put((key, progress.simulated / progress.duration))

    return carry_out(case, report)
