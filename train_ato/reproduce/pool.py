"""Worker processes that carry out cases: two runs at a time, progress while they run, nobody left behind.

Every worker is a spawned process at the end of a pipe.  It ignores Ctrl-C (the parent ends it) and ends itself as soon
as the pipe is closed, so that none outlives its parent, however that one ends.
"""

from __future__ import annotations

import multiprocessing
import signal
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Any

from train_ato.engine import run_engine
from train_ato.outcome import Progress
from train_ato.reproduce.claims import Calculation, Case, Result
from train_ato.run_setup import prepare
from train_ato.scenario import load

__all__ = ["Finished", "Moved", "WorkerPool", "carry_out"]

Task = tuple[str, Case | Calculation]


@dataclass(frozen=True)
class Moved:
    """A case has come so far, 0 to 1."""

    key: str
    fraction: float


@dataclass(frozen=True)
class Finished:
    """A case is done."""

    key: str
    result: Result


def carry_out(case: Case | Calculation, progress: Any = None) -> Result:
    """Run one case in this process; whatever goes wrong is in the result's failure, as one line.

    Parameters
    ----------
    case
        The case.
    progress
        Called with :class:`train_ato.outcome.Progress` while an engine run is under way.
    """
    try:
        if isinstance(case, Calculation):
            figures, series = case.function(**case.arguments)
            return Result(figures, None, None, series)
        scenario, path = load(case.scenario, changes=dict(case.changes))
        outcome = run_engine(prepare(scenario, path), progress=progress)
        if outcome.interrupted:
            return Result({}, None, "interrupted")
        return Result(outcome.summary, outcome.history, outcome.failure)
    except Exception as error:
        return Result({}, None, " ".join(f"{type(error).__name__}: {error}".split()))


class WorkerPool:
    """So many workers; a context manager that ends them all when it is left.

    Parameters
    ----------
    jobs
        Number of worker processes.
    """

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._context = multiprocessing.get_context("spawn")
        self._workers: dict[Connection, Any] = {}
        self._busy: dict[Connection, str] = {}

    def __enter__(self) -> WorkerPool:
        return self

    def __exit__(self, *_: object) -> None:
        for connection, process in self._workers.items():
            with suppress(OSError):
                connection.close()
            process.kill()  # it holds nothing, and a long calculation would not listen
        for process in self._workers.values():
            process.join()
        self._workers.clear()

    def run(self, tasks: Iterable[Task]) -> Iterator[Moved | Finished]:
        """Carry out tasks in their order, as many at a time as there are workers; yields what happens."""
        waiting = deque(tasks)
        for _ in range(min(self._jobs, len(waiting)) - len(self._workers)):
            self._start()
        for connection in list(self._workers):
            self._next(connection, waiting)
        while self._busy:
            for ready in wait(list(self._busy)):
                assert isinstance(ready, Connection)
                key = self._busy[ready]
                try:
                    message = ready.recv()
                except (EOFError, OSError):
                    yield Finished(key, self._died(ready))
                    if waiting:
                        self._next(self._start(), waiting)
                    continue
                if isinstance(message, Result):
                    del self._busy[ready]
                    self._next(ready, waiting)
                    yield Finished(key, message)
                else:
                    yield Moved(key, message)

    def _start(self) -> Connection:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_work, args=(theirs,), daemon=True, name="reproduce")
        # The terminal's Ctrl-C is for this process alone; a worker inherits the mask from its very first moment on.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
        try:
            process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self._workers[ours] = process
        return ours

    def _next(self, connection: Connection, waiting: deque[Task]) -> None:
        if waiting:
            key, case = waiting.popleft()
            self._busy[connection] = key
            with suppress(OSError):  # it died meanwhile: the empty pipe tells at the next recv
                connection.send(case)

    def _died(self, connection: Connection) -> Result:
        """Take a worker out that ended by itself: killed from outside, or out of memory."""
        del self._busy[connection]
        process = self._workers.pop(connection)
        process.join()
        connection.close()
        return Result({}, None, f"its process ended unexpectedly, exit code {process.exitcode}")


def _work(connection: Connection) -> None:
    """Carry out whatever comes through the pipe until it is closed."""

    def report(progress: Progress) -> None:
        connection.send(progress.simulated / progress.duration)

    with suppress(EOFError, OSError):
        while True:
            connection.send(carry_out(connection.recv(), report))
