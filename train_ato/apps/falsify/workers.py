"""Runs of a falsification: in this process, or in worker processes of the package ``pebble``."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import nan
from typing import Any

from train_ato.apps.falsify.search import RunAll
from train_ato.apps.falsify.target import RequirementTarget, TargetRun, run_target
from train_ato.apps.runs.scenario_choice import ScenarioChoice
from train_ato.interrupt import workers_without_ctrl_c

POLL_S = 0.2
"""Interval at which a waiting parent sees Ctrl-C [s]."""


@contextmanager
def target_runner(choice: ScenarioChoice, target: RequirementTarget, jobs: int) -> Iterator[RunAll]:
    """Yield the function that runs several sets of changes; the end of the block ends its processes.

    Parameters
    ----------
    choice, target
        Scenario and requirement.
    jobs
        Number of processes; 1 runs in this one.
    """
    if jobs == 1:
        yield lambda changes: (run_target(choice, target, change) for change in changes)
        return
    from pebble import ProcessExpired, ProcessPool

    context = multiprocessing.get_context("spawn")
    pool = ProcessPool(jobs, context=context, initializer=_begin, initargs=[choice, target])

    def run_all(changes: Sequence[dict[str, Any]]) -> Iterator[TargetRun]:
        with workers_without_ctrl_c():
            futures = [pool.submit(_work, None, change) for change in changes]
        for future in futures:
            try:
                yield _result(future)
            except ProcessExpired as error:
                yield TargetRun(nan, f"failed: its process ended unexpectedly, exit code {error.exitcode}")

    try:
        yield run_all
    finally:
        pool.stop()  # type: ignore[no-untyped-call]
        pool.join()


def _result(future: Any) -> TargetRun:
    """Wait for a result; the wait is divided, so that Ctrl-C ends it."""
    from concurrent.futures import wait

    while True:
        done, _ = wait([future], timeout=POLL_S)
        if done:
            found: TargetRun = future.result()
            return found


_task: tuple[ScenarioChoice, RequirementTarget] | None = None
"""Scenario and requirement, in a worker."""


def _begin(choice: ScenarioChoice, target: RequirementTarget) -> None:
    global _task
    _task = choice, target


def _work(changes: dict[str, Any]) -> TargetRun:
    assert _task is not None
    return run_target(*_task, changes)
