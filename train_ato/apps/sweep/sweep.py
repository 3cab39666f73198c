"""Sweep of a scenario over keys, laws, observers, compensations and seeds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from train_ato.apps.runs.progress import Report, activity, share_bar
from train_ato.apps.sweep.batch import SweepBase
from train_ato.apps.sweep.check import check_values, sweep_base
from train_ato.apps.sweep.cluster import MAX_JOBS, sweep_client
from train_ato.apps.sweep.design import Point, design_points
from train_ato.apps.sweep.execution import execute_points
from train_ato.apps.sweep.folder import RowWriter, SweepFolder, sweep_identity
from train_ato.apps.sweep.result import SweepResult
from train_ato.apps.sweep.row import Row
from train_ato.apps.sweep.spec import SweepSpec, read_sweep
from train_ato.apps.sweep.table import sweep_table, write_results
from train_ato.errors import RunInterrupted
from train_ato.interrupt import uninterrupted

__all__ = ["PreparedSweep", "prepare_sweep", "sweep"]


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
    prepared = prepare_sweep(read_sweep(spec), jobs=jobs, scheduler=scheduler, dashboard=dashboard)
    return prepared.run(None if out is None else SweepFolder.opened(Path(out), "out"), shown=progress)


def prepare_sweep(
    spec: SweepSpec,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    dashboard: bool = False,
    dash: str = "",
) -> PreparedSweep:
    """Return a sweep with its points, all values checked; ``dash`` precedes names of options in messages.

    Raises
    ------
    ValueError
        One line: file, key, value, problem; remedy.
    """
    if jobs is not None and not 1 <= jobs <= MAX_JOBS:
        raise ValueError(f"{dash}jobs {jobs}: out of range; give 1 to {MAX_JOBS}")
    if jobs is not None and scheduler is not None:
        raise ValueError(f"{dash}jobs {jobs}: the scheduler has its own workers; remove it or {dash}scheduler")
    if dashboard and scheduler is not None:
        raise ValueError(f"{dash}dashboard: the scheduler has its own; remove it or {dash}scheduler")
    base = sweep_base(spec)
    points = design_points(spec)
    with activity("checking the values"):
        check_values(spec, base, points)
    return PreparedSweep(spec, base, points, jobs, scheduler, dashboard)


class PreparedSweep:
    """Checked sweep.

    Parameters
    ----------
    spec, base, points
        Specification, scenario with the fixed keys, values of the runs.
    jobs, scheduler, dashboard
        As for :func:`sweep`.
    """

    def __init__(
        self,
        spec: SweepSpec,
        base: SweepBase,
        points: list[Point],
        jobs: int | None,
        scheduler: str | None,
        dashboard: bool = False,
    ) -> None:
        self.spec, self.base, self.points = spec, base, points
        self._jobs, self._scheduler, self._dashboard = jobs, scheduler, dashboard
        self.identity = sweep_identity(spec, base)

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
            if folder is not None:
                writer = stack.enter_context(folder.appending())
                folder.begin(self.identity)
                rows = [row for row in folder.rows() if row["run"] <= len(self.points)]
            try:
                self._run_missing(rows, writer, shown, announce or (lambda text: None))
            except KeyboardInterrupt:
                place = "" if folder is None else f"; {len(rows)} finished runs: {folder.path}"
                raise RunInterrupted(f"interrupted{place}") from None
            finally:
                if folder is not None and rows:
                    with uninterrupted():
                        write_results(folder.results, self._table(rows), self.identity)
                elif folder is not None:
                    folder.discard_empty()
        return SweepResult(self.spec, self._table(rows), None if folder is None else folder.path)

    def _run_missing(
        self, rows: list[Row], writer: RowWriter | None, shown: bool | None, announce: Callable[[str], None]
    ) -> None:
        """Run the points without a row; append their rows."""
        finished = {row["run"] for row in rows}
        missing = [(number, point) for number, point in enumerate(self.points, 1) if number not in finished]
        if finished:
            announce(f"{len(finished)} of {len(self.points)} runs are finished, {len(missing)} are missing")
        if not missing:
            return
        from plant_sim.warm_up import compile_kernel

        compile_kernel()
        with ExitStack() as stack:
            with activity("starting the workers"):
                client = stack.enter_context(sweep_client(self._scheduler, self._jobs, self._dashboard))
            if self._dashboard or self._scheduler is not None:
                announce(f"Dask dashboard: {client.dashboard_link}")
            bar = stack.enter_context(share_bar(f"sweep {self.spec.title}", shown))
            self._report(bar, rows)

            def take(new: list[Row]) -> None:
                if writer is not None:
                    writer.add(new)
                rows.extend(new)
                self._report(bar, rows)

            execute_points(client, self.base, missing, take, announce)

    def _report(self, bar: Report, rows: list[Row]) -> None:
        """Show the number of finished runs, and of those that did not end regularly."""
        bad = sum(row["status"] != "done" for row in rows)
        more = f", {bad} failed or refused" if bad else ""
        bar(len(rows) / len(self.points), f"{len(rows)} of {len(self.points)} runs{more}")

    def _table(self, rows: list[Row]) -> Any:
        return sweep_table(sorted(rows, key=lambda row: int(row["run"])), self.spec.keys)
