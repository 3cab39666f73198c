"""Cases of the papers in worker processes, with progress during the cases. A lost worker costs its own case only."""

import multiprocessing
import queue
from collections.abc import Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, wait
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from train_ato.api.search_runs import LostRun, run_outcome, worker_pool
from train_ato.loop.engine import run_engine
from train_ato.papers.claims import Calculation, Case, Result

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


def run_cases(tasks: Iterable[Task], jobs: int) -> Generator[Moved | Finished, None, None]:
    """Run tasks in their order in worker processes; yield progress and results. ``close`` kills the processes."""
    moved: Any = multiprocessing.get_context("spawn").Queue()
    tasks = list(tasks)
    with worker_pool(partial(_work, moved), jobs) as submit:
        keys = dict(zip(submit(tasks), (key for key, _ in tasks), strict=True))
        while keys:
            done, _ = wait(keys, timeout=POLL_S, return_when=FIRST_COMPLETED)
            with suppress(queue.Empty):
                while True:
                    yield Moved(*moved.get_nowait())
            for future in done:
                result = run_outcome(future)
                lost = isinstance(result, LostRun)
                yield Finished(keys.pop(future), Result({}, None, result.reason) if lost else result)


def _work(moved: Any, task: Task) -> Result:
    """Run a case in a worker; the queue to the parent must not delay the end of the worker."""
    moved.cancel_join_thread()
    return carry_out(task[1], lambda progress: moved.put((task[0], progress.simulated / progress.duration)))
