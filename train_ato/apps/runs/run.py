"""One run: metrics, tables, plots, folder."""

from __future__ import annotations

from collections.abc import Iterator, KeysView
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.apps.runs.record import RunRecord, copy_run
from train_ato.apps.runs.summary_table import html_table, result_rows
from train_ato.log.recorded import open_recording
from train_ato.log.run_folder import read_run_folder, read_summary
from train_ato.loop.recording import Recording
from train_ato.loop.result import RunResult
from train_ato.loop.setup import RunSetup

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from train_ato.log.tables.loading import Frames


class Run:
    """A run: metrics, tables by topic, plots.

    Made by :func:`train_ato.run` and :func:`train_ato.open_run`.

    Attributes
    ----------
    metrics : dict
        Metrics and settings of the run, as in ``summary.json``.

    Examples
    --------
    >>> import train_ato as ta
    >>> run = ta.run("demo", set={"duration": 20})
    >>> run.metrics["status"], round(run.metrics["speed_error_max_kmh"], 1)
    ('done', 0.6)
    >>> run["ato/reference"].columns.tolist()
    ['position_m', 'speed_m_s', 'acceleration_m_s2', 'planned_s']
    >>> run.plot("speed.png")  # doctest: +SKIP
    >>> run.save("runs/short")  # doctest: +SKIP
    """

    def __init__(
        self,
        metrics: dict[str, Any],
        path: Path | None = None,
        record: RunRecord | None = None,
        setup: RunSetup | None = None,
        outcome: RunResult | None = None,
    ) -> None:
        self.metrics = metrics
        self._path = path
        self._record = record
        self._setup = setup
        self._outcome = outcome
        self._tables: Frames | None = None
        self._finished = record is None

    @property
    def path(self) -> Path | None:
        """Run folder; None for a run that is not saved."""
        return self._path if self._record is None else self._record.lasting

    @property
    def traceback(self) -> str:
        """Traceback of the failure that ended the run, for example of a law; empty if there is none."""
        assert self._record is not None or self._path is not None
        log = self._record.log_folder if self._record is not None else self._path / "log"  # type: ignore[operator]
        return "\n".join(path.read_text(encoding="utf-8") for path in sorted(log.glob("*.traceback.txt")))

    @property
    def setup(self) -> RunSetup:
        """Scenario, train, line, model and profile of the run.

        Raises
        ------
        ValueError
            If the scenario of an opened run cannot be prepared, for example because its law is not installed.
        """
        if self._setup is None:
            assert self._path is not None
            self._setup, _ = read_run_folder(self._path)
        return self._setup

    @property
    def tables(self) -> Frames:
        """Table of every topic, as :func:`train_ato.load` returns them."""
        if self._tables is None:
            from train_ato.log.tables.loading import load  # pandas: not needed for metrics only

            assert self._record is not None or self._path is not None
            self._tables = load(self._path if self._record is None else self._record.written().path)  # type: ignore[arg-type]
        return self._tables

    def __getitem__(self, topic: str) -> pd.DataFrame:
        """Return the table of one topic, for example ``run["train/measurement"]``."""
        return self.tables[topic]

    def __iter__(self) -> Iterator[str]:
        return iter(self.tables)

    def __contains__(self, topic: object) -> bool:
        return topic in self.tables

    def keys(self) -> KeysView[str]:
        """Return the topics that have a table."""
        return self.tables.keys()

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.tables)

    def folder(self) -> Path:
        """Return the folder with log, scenario and summary; a temporary one before the run is saved."""
        if self._record is None:
            assert self._path is not None
            return self._path
        folder = self._record.written()
        if not self._finished:
            assert self._outcome is not None
            folder.finish(self.setup, self._outcome)
            self._finished = True
        return folder.path

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw speed, error, force, couplers and air brake over time.

        Parameters
        ----------
        path
            PNG or SVG file to write; default: none, a notebook shows the figure.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        ValueError
            If the run holds no complete tick.
        """
        from train_ato.apps.report.print_parts import SCREEN_DPI, save_figure
        from train_ato.apps.report.run_figure import run_figure

        figure = run_figure(self.recording)
        if figure is None:
            raise ValueError(f"{self.metrics.get('scenario', self.path)}: the run has no complete tick to draw")
        if path is not None:
            save_figure(figure, Path(path), SCREEN_DPI)
        return figure

    @property
    def recording(self) -> Recording:
        """Return the recording of the run, from memory or from the log."""
        if self._outcome is None:
            recording = open_recording(self.folder())
        elif self._outcome.recording is not None:
            recording = replace(self._outcome.recording, setup=self.setup, summary=self.metrics)
        else:
            raise ValueError(f"{self.metrics.get('scenario', self.path)}: the run has no complete tick to draw")
        return recording

    def report(self, path: str | Path | None = None) -> Path:
        """Write the page of linked figures and return its path.

        Parameters
        ----------
        path
            HTML file; default: ``report.html`` in the run folder, a temporary one before the run is saved.
        """
        from train_ato.apps.report.page_data import page_data
        from train_ato.apps.report.words import REPORT
        from train_ato.apps.report.writing import write_run
        from train_ato.arguments import check_new_file

        folder = self.folder()
        page = folder / REPORT if path is None else Path(path)
        if path is not None:
            check_new_file(page, (".html", ".htm"))
        write_run(page_data(open_recording(folder)), page)
        return page

    def finish(self) -> Path:
        """Write log, scenario, summary and figure if they are missing, and return their folder."""
        folder = self.folder()
        figure = folder / "figure.png"
        if self._outcome is not None and self._outcome.recording is not None and not figure.exists():
            self.plot(figure)
        return folder

    def save(self, path: str | Path) -> Path:
        """Save the run folder with log, scenario, summary and figure, and return its path.

        It is an input of ``train-ato verify``, ``report`` and ``view``.

        Raises
        ------
        ValueError
            If the folder exists already or cannot be written.
        """
        folder = copy_run(self.finish(), Path(path), str(self.metrics.get("scenario", "run")))
        if self._record is not None:
            self._record.settle(folder)
        self._path = folder.path
        return folder.path

    def __repr__(self) -> str:
        metrics = self.metrics
        names = " / ".join(str(metrics.get(key, "-")) for key in ("controller", "observer", "compensation"))
        place = self.path if self.path is not None else "not saved"
        return f"<Run {metrics.get('scenario', '')}: {names}, {metrics.get('status', 'done')}, {place}>"

    def _repr_html_(self) -> str:
        rows = result_rows(self.metrics)
        return html_table(repr(self).strip("<>"), ("quantity", "value"), rows)


def open_run(path: str | Path) -> Run:
    """Open a recorded run.

    Parameters
    ----------
    path
        Run folder of ``train-ato run``, ``train-ato import`` or :meth:`Run.save`.

    Raises
    ------
    ValueError
        If it is not a run folder.

    Examples
    --------
    >>> import tempfile, train_ato as ta
    >>> with tempfile.TemporaryDirectory() as place:
    ...     saved = ta.run("demo", set={"duration": 20}).save(place + "/short")
    ...     ta.open_run(saved).metrics["ticks"]
    200
    """
    folder = Path(path)
    return Run(read_summary(folder), folder)
