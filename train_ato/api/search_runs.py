"""Runs of a search: in this process, or in worker processes of the package ``pebble``; finished ones are kept.

The order of the results does not depend on the number of processes. A lost worker costs its own run only.
"""

import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from plant_sim.formats.fields import PRINTED
from train_ato.api.series_folder import KeptRuns
from train_ato.program.interrupt import workers_without_ctrl_c

Task = Callable[[Any], Any]
"""Function that returns the result of one input; for several processes it is pickled."""
RunAll = Callable[[Sequence[Any]], Iterator[Any]]
"""Function that yields the results of several inputs in their order."""
POLL_S = 0.2
"""Interval at which a waiting parent sees Ctrl-C [s]."""


@contextmanager
def search_runs(
    task: Task,
    jobs: int,
    lost: Callable[[str], Any],
    kept: KeptRuns | None = None,
    read: Callable[[Any], Any] = lambda data: data,
) -> Iterator[RunAll]:
    """Yield the function that runs several inputs; the end of the block ends its processes.

    Parameters
    ----------
    task
        Function of one input.
    jobs
        Number of processes; 1 runs in this one.
    lost
        Returns the result of a run whose process was killed from outside, from the reason; it is not kept.
    kept
        Results of finished runs, which are not run again; it receives the new ones.
    read
        Returns a result from its plain data.
    """
    with _processes(task, jobs) as run:

        def run_all(inputs: Sequence[Any]) -> Iterator[Any]:
            fresh = run([given for given in inputs if kept is None or kept.find(given) is None])
            for given in inputs:
                found = None if kept is None else kept.find(given)
                if found is not None:
                    yield read(found)
                    continue
                result = next(fresh)
                if isinstance(result, LostRun):
                    yield lost(result.reason)
                    continue
                if kept is not None:
                    kept.add(given, result)
                yield result

        yield run_all


@contextmanager
def _processes(task: Task, jobs: int) -> Iterator[RunAll]:
    if jobs == 1:
        yield lambda inputs: map(task, inputs)
        return
    with worker_pool(task, jobs) as submit:
        yield lambda inputs: map(_waited, submit(inputs))


@contextmanager
def worker_pool(task: Task, jobs: int) -> Iterator[Callable[[Iterable[Any]], list[Future[Any]]]]:
    """Yield the function that starts a task for every input; the end of the block kills the processes."""
    from pebble import ProcessPool

    pool = ProcessPool(jobs, context=multiprocessing.get_context("spawn"), initializer=_begin, initargs=[task, PRINTED])

    def submit(inputs: Iterable[Any]) -> list[Future[Any]]:
        with workers_without_ctrl_c():
            return [pool.submit(_work, None, given) for given in inputs]

    try:
        yield submit
    finally:
        pool.stop()  # type: ignore[no-untyped-call]
        pool.join()


@dataclass(frozen=True)
class LostRun:
    """Result of a run whose process has ended."""

    reason: str


def run_outcome(future: Future[Any]) -> Any:
    """Return the result of a finished task, or why it has none."""
    from pebble import ProcessExpired

    try:
        return future.result()
    except ProcessExpired as error:  # killed from outside, or out of memory
        return LostRun(f"its process ended unexpectedly, exit code {error.exitcode}")


def _waited(future: Future[Any]) -> Any:
    """Wait for a result; the wait is divided, so that Ctrl-C ends it."""
    while not wait([future], timeout=POLL_S).done:
        pass
    return run_outcome(future)


_task: Task | None = None
"""Task, in a worker."""


def _begin(task: Task, printed: set[str]) -> None:
    """Store the task, and the notes that the main process has printed."""
    global _task
    _task = task
    PRINTED.update(printed)


def _work(given: Any) -> Any:
    assert _task is not None
    return _task(given)
