"""Sweep of a scenario over keys, laws, observers, compensations and seeds."""

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from itertools import islice
from pathlib import Path
from typing import Any

from plant_sim.formats.fields import print_assumption
from train_ato.api.progress import Report, activity, share_bar
from train_ato.api.scenario_choice import ScenarioChoice, choose_scenario
from train_ato.api.series_folder import RowWriter
from train_ato.control.registry import REGISTRIES
from train_ato.log.versions import source_hash
from train_ato.program.errors import RunFailed, RunInterrupted
from train_ato.program.interrupt import uninterrupted
from train_ato.scenario.dimensions import Dimension
from train_ato.scenario.scenario_data import PartCache
from train_ato.studies.sweep.cluster import MAX_JOBS, sweep_client
from train_ato.studies.sweep.result import SweepFolder, SweepResult, sweep_identity, sweep_table, write_results
from train_ato.studies.sweep.row import TIMES, Batch, Row, SweepBase, one_line, run_batch
from train_ato.studies.sweep.spec import Point, SweepSpec, design_points, read_sweep


def sweep_base(spec: SweepSpec) -> SweepBase:
    """Return the scenario of a sweep with its fixed keys, checked."""
    try:
        choice = choose_scenario(spec.scenario)
    except ValueError as error:
        raise ValueError(f"{spec.source}: scenario: {error}") from None
    try:
        fixed = choice.with_(spec.fixed)
    except ValueError as error:
        raise ValueError(f"{spec.source}: set: {one_line(error, choice)}") from None
    return SweepBase(spec.scenario, fixed.path, fixed.data, source_hash())


def check_values(spec: SweepSpec, base: SweepBase, points: list[Point]) -> None:
    """Check every value of every list, and the limits of every range.

    A value is valid if the scenario accepts it alone or in the first point that has it. A key is valid if at least one
    of its values can be prepared. Other values, such as a law that does not fit the train, are rows of the table with
    the status ``refused``.

    Parameters
    ----------
    spec, base, points
        The sweep.
    """
    choice, parts = base.choice(), PartCache()
    for dimension in spec.dimensions:
        refusals = []
        accepted = False
        for value, candidates in _candidates(dimension, points):
            where = f"{spec.source}: over: {dimension.key}: {value!r}"
            _check_registered(dimension.key, value, where)
            refusal = _refusal(choice, candidates, parts, where)
            accepted |= refusal is None
            refusals.append(f"{where}: {refusal}")
        if not accepted:
            raise ValueError(refusals[0])
        _note_unused(dimension.key, choice, points, f"{spec.source}: over: {dimension.key}")


def _note_unused(key: str, choice: ScenarioChoice, points: list[Point], where: str) -> None:
    """Print a line on a varied parameter of a law, observer or compensation that no run has."""
    block, _, rest = key.partition(".")
    if (kind := block.removesuffix("s")) not in REGISTRIES or block == kind or not rest:
        return
    name, scenario = rest.partition(".")[0], choice.checked
    used = {point.get(kind, getattr(scenario, kind)) for point in points}
    if kind == "law":
        used |= {law for change in scenario.law_changes for law in (change.law, *change.laws)}
    if name not in used:
        print_assumption(f"{where}: no run has the {kind} {name}, so its values change nothing; set {kind}: {name}")


def _candidates(dimension: Dimension, points: list[Point]) -> Iterator[tuple[Any, tuple[Point, ...]]]:
    """Yield the values to check, each with the points in which it may be valid."""
    key = dimension.key
    values: list[Any] = list(dimension.values)
    if dimension.is_range:
        used = [point[key] for point in points]
        values = list(dict.fromkeys((min(used), max(used))))
    for value in values:
        same = next((point for point in points if point[key] == value), None)
        yield value, ({key: value}, *([] if same is None else [same]))


def _check_registered(key: str, value: Any, where: str) -> None:
    """Refuse an unknown law, observer or compensation."""
    registry = REGISTRIES.get(key)
    if registry is None or not isinstance(value, str):
        return
    try:
        registry.get(value)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _refusal(choice: ScenarioChoice, candidates: tuple[Point, ...], parts: PartCache, where: str) -> str | None:
    """Return the reason of a value that no candidate can be prepared with, None if one can."""
    reasons, valid = [], False
    for point in candidates:
        try:
            changed = choice.with_(point)
        except ValueError as error:
            reasons.append(one_line(error, choice))
            continue
        valid = True
        try:
            changed.prepare(parts=parts)
        except ValueError as error:
            reasons.insert(0, one_line(error, choice))
        else:
            return None
    if not valid:
        raise ValueError(f"{where}: {reasons[0]}")
    return reasons[0]


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
END_S = 3600.0
"""Wall time without the end of a batch after which local workers are started again [s], at least."""
END_BATCHES = 100.0
"""The same in durations of the longest batch so far; before the first end of a batch no worker is."""
NO_WORKER_S = 300.0
"""Wall time without a worker after which a sweep ends [s]; a worker that was killed starts again within seconds."""


class Execution:
    """Batches under way and points that wait.

    A batch of a killed or frozen worker runs again on another one.  The points of a batch whose workers are killed
    again and again, or of one that does not end, run at the end, one at a time and nothing beside them: the row of a
    point whose workers are killed then, too, or that does not end, has the status ``failed``.

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
    local
        True for workers of this sweep alone, which are started again if they do not end a batch.
    """

    def __init__(
        self,
        client: Any,
        base: SweepBase,
        points: Sequence[tuple[int, Point]],
        take: Callable[[list[Row]], None],
        announce: Callable[[str], None] = lambda text: None,
        *,
        local: bool = False,
    ) -> None:
        self._local = local
        self._client, self._base, self._take, self._announce = client, base, take, announce
        self._waiting = deque(points)
        self._suspects: deque[tuple[int, Point]] = deque()
        self._alone = False
        self._running: dict[Any, Batch] = {}
        self._lost: dict[int, int] = {}
        self._seconds, self._rows, self._longest = 0.0, 0, 0.0

    def run(self) -> None:
        """Run all points.

        Raises
        ------
        RunFailed
            If the scheduler is lost, or a worker cannot run any point.
        """
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
        """Wait for the end of at least one batch, and return all that have ended; none after a restart of workers.

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
                silent = time.monotonic() - begun
                if not named and silent > max(SILENT_S, SILENT_BATCHES * self._longest):
                    named = True
                    self._announce(f"no run has ended for {silent:.0f} s; {self._under_way()}")
                if self._local and self._longest and silent > max(END_S, END_BATCHES * self._longest):
                    self._end_overdue(silent)
                    return set()
                if self._client.nthreads():
                    last = time.monotonic() + NO_WORKER_S
                elif time.monotonic() > last:
                    raise RunFailed("no worker is left; start one and run the same command again") from None
            except CancelledError:
                return {future for future in self._running if future.done()}

    def _end_overdue(self, seconds: float) -> None:
        """Start the workers again; the points of the first batch of every worker are suspects, the others wait."""
        processing = self._client.processing()
        running, self._running = self._running, {}
        overdue = {next((future.key for future in running if future.key in keys), "") for keys in processing.values()}
        self._client.cancel(list(running))
        for future, batch in reversed(running.items()):
            if future.key not in overdue:
                self._waiting.extendleft(reversed(batch))
            elif self._alone:
                self._take([_failed(*batch[0], f"did not end within {seconds:.0f} s, twice; its worker was ended")])
            else:
                self._suspects.extendleft(reversed(batch))
                runs = ", ".join(str(number) for number, _ in batch[:SHOWN])
                self._announce(f"run {runs} did not end within {seconds:.0f} s; once more at the end, alone")
        self._client.restart_workers(list(processing), timeout=NO_WORKER_S, raise_for_error=False)

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


def sweep(
    spec: str | Path | Mapping[str, Any],
    *,
    out: str | Path | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    dashboard: bool = False,
    progress: bool | None = None,
) -> SweepResult:
    """Run a scenario at many points in the engine, on Dask.

    A run that fails, or whose values are no valid run, is a row with its reason.

    Parameters
    ----------
    spec
        YAML file, or its content: ``scenario``, ``design`` (grid, random, latin_hypercube, sobol), ``runs``, ``seed``
        of the design, ``over`` (varied keys), ``set`` (fixed keys).
    out
        Folder for the finished runs and the table; one with some runs of the same sweep is continued.  Default: none,
        the result is in memory.
    jobs
        Number of local worker processes; default: one for each core.
    scheduler
        Address ``tcp://HOST:PORT`` of a Dask scheduler with workers; default: local workers.
    dashboard
        Serve the Dask dashboard of the local workers on this machine, for all its users.
    progress
        Show a progress bar; default: in a terminal and in a notebook.

    Returns
    -------
    SweepResult
        Table and figures.

    Raises
    ------
    ValueError
        Bad input, in one line with the remedy; nothing was started.
    RunFailed
        The workers are lost; the finished runs are in ``out``.
    RunInterrupted
        Ctrl-C; the finished runs are in ``out``.

    Examples
    --------
    >>> import train_ato as ta
    >>> result = ta.sweep({"scenario": "demo", "design": "grid", "over": {"law": ["pid", "smc"], "seed": [1, 2]},
    ...     "set": {"duration": 20}}, jobs=1)
    >>> result.counts
    {'done': 4}
    >>> result.table[["run", "law", "seed"]].values.tolist()
    [[1, 'pid', 1], [2, 'pid', 2], [3, 'smc', 1], [4, 'smc', 2]]
    """
    prepared = PreparedSweep(read_sweep(spec), jobs=jobs, scheduler=scheduler, dashboard=dashboard)
    return prepared.run(None if out is None else SweepFolder.opened(Path(out), "out"), shown=progress)


class PreparedSweep:
    """Sweep with its points, all values checked.

    Parameters
    ----------
    spec
        Specification.
    jobs, scheduler, dashboard
        As for :func:`sweep`.
    dash
        Begin of the names of options in messages.
    """

    def __init__(
        self,
        spec: SweepSpec,
        *,
        jobs: int | None = None,
        scheduler: str | None = None,
        dashboard: bool = False,
        dash: str = "",
    ) -> None:
        if jobs is not None and not 1 <= jobs <= MAX_JOBS:
            raise ValueError(f"{dash}jobs {jobs}: out of range; give 1 to {MAX_JOBS}")
        if jobs is not None and scheduler is not None:
            raise ValueError(f"{dash}jobs {jobs}: the scheduler has its own workers; remove it or {dash}scheduler")
        if dashboard and scheduler is not None:
            raise ValueError(f"{dash}dashboard: the scheduler has its own; remove it or {dash}scheduler")
        self._jobs, self._scheduler, self._dashboard = jobs, scheduler, dashboard
        self.spec, self.base, self.points = spec, sweep_base(spec), design_points(spec)
        with activity("checking the values"):
            check_values(spec, self.base, self.points)
        self.identity = sweep_identity(spec, self.base)

    def run(
        self,
        folder: SweepFolder | None = None,
        *,
        shown: bool | None = None,
        announce: Callable[[str], None] | None = None,
    ) -> SweepResult:
        """Run the points that the folder lacks, and write its table.

        Parameters
        ----------
        folder
            Folder of the sweep; None: the rows are kept in memory only.
        shown
            Show a progress bar; None: in a terminal and in a notebook.
        announce
            Called with lines of text: address of the dashboard, number of kept runs.

        Raises
        ------
        ValueError, RunFailed, RunInterrupted
            As :func:`sweep`.
        """
        with ExitStack() as stack:
            rows: list[Row] = []
            writer = None
            try:
                if folder is not None:
                    stack.enter_context(folder.full_disk_told())
                    writer = stack.enter_context(folder.appending())
                    folder.begin(self.identity)
                    rows = self._kept(folder)
                self._run_missing(rows, writer, shown=shown, announce=announce or (lambda text: None))
            except KeyboardInterrupt:
                rows = rows if folder is None else self._kept(folder)  # a row is on the disk before it counts here
                place = (
                    f"; {len(rows)} finished run{'s' * (len(rows) > 1)}: {folder.path}"
                    if folder is not None and rows
                    else ""
                )
                raise RunInterrupted(f"interrupted{place}") from None
            finally:
                if folder is not None and rows:
                    with uninterrupted():
                        write_results(folder.results, self._table(rows), self.identity)
                elif folder is not None:
                    folder.discard_empty()
        return SweepResult(self.spec, self._table(rows), None if folder is None else folder.path)

    def _run_missing(
        self, rows: list[Row], writer: RowWriter | None, *, shown: bool | None, announce: Callable[[str], None]
    ) -> None:
        """Run the points without a row; append their rows."""
        finished = {row["run"] for row in rows}
        missing = [(number, point) for number, point in enumerate(self.points, 1) if number not in finished]
        if finished:
            announce(f"{len(finished)} of {len(self.points)} runs are finished, {len(missing)} are missing")
        if not missing:
            return
        from plant_sim.train import compile_kernel

        compile_kernel()
        with ExitStack() as stack:
            with activity("starting the workers"):
                client = stack.enter_context(sweep_client(self._scheduler, self._jobs, dashboard=self._dashboard))
            if self._dashboard or self._scheduler is not None:
                announce(f"Dask dashboard: {client.dashboard_link}")
            bar = stack.enter_context(share_bar(f"sweep {self.spec.title}", shown=shown))
            self._report(bar, rows)

            def take(new: list[Row]) -> None:
                if writer is not None:
                    writer.add(new)
                rows.extend(new)
                self._report(bar, rows)

            Execution(client, self.base, missing, take, announce, local=self._scheduler is None).run()

    def _kept(self, folder: SweepFolder) -> list[Row]:
        """Return the rows of the finished runs of a folder."""
        return [row for row in folder.rows() if row["run"] <= len(self.points)]

    def _report(self, bar: Report, rows: list[Row]) -> None:
        """Show the number of finished runs, and of those that did not end regularly."""
        bad = sum(row["status"] != "done" for row in rows)
        more = f", {bad} failed or refused" if bad else ""
        bar(len(rows) / len(self.points), f"{len(rows)} of {len(self.points)} runs{more}")

    def _table(self, rows: list[Row]) -> Any:
        return sweep_table(sorted(rows, key=lambda row: int(row["run"])), self.spec.keys)
