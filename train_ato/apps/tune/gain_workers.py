"""Evaluation of gains in this process, or in worker processes of the package ``pebble``.

The order of the results does not depend on the number of processes. A lost worker costs its own run only.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from typing import Any

from pebble import ProcessExpired, ProcessPool

from train_ato.apps.tune.gain_runs import GainRunner, GainTask
from train_ato.interrupt import workers_without_ctrl_c

Work = tuple[int, Mapping[str, Any] | None]
"""Number of a task and its gains; None for the reference run."""
POLL_S = 0.5
"""Interval at which the main process handles a Ctrl-C [s]."""


def run_work(runner: GainRunner, work: Work) -> dict[str, Any]:
    """Return the metrics of one run; an error that is no refusal is in ``failure``, as one line."""
    index, gains = work
    try:
        return runner.reference(index) if gains is None else runner.run(index, gains)
    except Exception as error:
        return {"status": "failed", "failure": " ".join(f"{type(error).__name__}: {error}".split())}


class GainWorkers:
    """Evaluation of many runs, a context manager; its end kills the worker processes.

    Parameters
    ----------
    tasks
        All tasks.
    jobs
        Number of processes; 1 runs in this process.
    """

    def __init__(self, tasks: Sequence[GainTask], jobs: int) -> None:
        self._runner = GainRunner(tasks)
        self._pool: ProcessPool | None = None
        if jobs > 1:
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPool(jobs, context=context, initializer=_begin_gain_worker, initargs=[tasks])

    def __enter__(self) -> GainWorkers:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.stop()  # type: ignore[no-untyped-call]
            self._pool.join()

    def run(self, works: Sequence[Work], done: Callable[[], None]) -> list[dict[str, Any]]:
        """Return the metrics of all runs in their order; ``done`` is called after each."""
        if self._pool is None:
            found = []
            for work in works:
                found.append(run_work(self._runner, work))
                done()
            return found
        return self._run_in_pool(self._pool, works, done)

    @staticmethod
    def _run_in_pool(pool: ProcessPool, works: Sequence[Work], done: Callable[[], None]) -> list[dict[str, Any]]:
        with workers_without_ctrl_c():
            futures: list[Any] = [pool.submit(_work_in_process, None, work) for work in works]
        waiting = set(futures)
        while waiting:
            finished, waiting = wait(waiting, timeout=POLL_S, return_when=FIRST_COMPLETED)
            for _ in finished:
                done()
        return [_result_of(future) for future in futures]


def _result_of(future: Any) -> dict[str, Any]:
    try:
        found: dict[str, Any] = future.result()
    except ProcessExpired as error:  # killed from outside, or out of memory
        return {"status": "failed", "failure": f"its process ended unexpectedly, exit code {error.exitcode}"}
    return found


_runner: GainRunner | None = None
"""Runner of a worker process."""


def _begin_gain_worker(tasks: Sequence[GainTask]) -> None:
    """Store the tasks in a worker."""
    global _runner
    _runner = GainRunner(tasks)


def _work_in_process(work: Work) -> dict[str, Any]:
    assert _runner is not None
    return run_work(_runner, work)
