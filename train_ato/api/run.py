"""One run: metrics, tables, plots, folder."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, KeysView
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from train_ato.judge.metric_names import html_table, result_rows
from train_ato.judge.recording import Recording
from train_ato.judge.result import RunResult
from train_ato.judge.typed_result import TypedResult
from train_ato.log.compression import DEFAULT
from train_ato.log.recorded import open_recording
from train_ato.log.run_folder import Encoder, RunFolder, read_run_folder, read_summary
from train_ato.messages.topics import TickBlock
from train_ato.program.errors import check_packages, refusing
from train_ato.scenario.setup import RunSetup

if TYPE_CHECKING:
    import pandas as pd
    import xarray
    from matplotlib.figure import Figure

    from train_ato.log.table_loading import Frames


MESSAGES_IN_MEMORY = 300_000
"""Maximum number of messages in memory: about 100 MB for a train of 106 vehicles, an hour at 10 Hz."""


class RunRecord:
    """Sink for the messages of the engine; creates the run folder.

    Parameters
    ----------
    setup
        The run.
    folder
        Run folder for all messages.  None: messages in memory; a temporary folder, removed with this object, is created
        for tables, files, or too many messages.
    compression
        Compression of the log: ``none``, ``fast`` or ``small``.
    """

    def __init__(self, setup: RunSetup, folder: RunFolder | None = None, compression: str = DEFAULT) -> None:
        self._compression = compression
        self._setup = setup
        self._folder = folder
        self._scratch = tempfile.TemporaryDirectory(prefix="train_ato_run_") if folder is None else None
        self._messages: list[TickBlock | tuple[str, object, int]] = []
        self._count = 0
        self._log = ExitStack()
        self._sink: Encoder | None = None
        if folder is not None:
            folder.begin(setup)

    def __del__(self) -> None:
        if self.__dict__.get("_scratch") is not None:
            self._scratch.cleanup()  # type: ignore[union-attr]  # before its own end, which warns

    @property
    def lasting(self) -> Path | None:
        """Path of the run folder; None for a temporary one."""
        return None if self._folder is None or self._scratch is not None else self._folder.path

    @property
    def log_folder(self) -> Path:
        """Folder for the traceback of a failure; it need not exist."""
        if self._scratch is not None:
            return Path(self._scratch.name) / "run" / "log"
        assert self._folder is not None
        return self._folder.path / "log"

    def __getstate__(self) -> dict[str, Any]:
        """Return the messages in memory, and the files of a temporary folder; another process may have neither."""
        assert self._scratch is not None, "a saved run is in its folder"
        root = Path(self._scratch.name)
        files = {path.relative_to(root): path.read_bytes() for path in root.rglob("*") if path.is_file()}
        return {**self.__dict__, "_log": None, "_sink": None, "_scratch": files, "_folder": self._folder is not None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Write the files into a temporary folder of this process."""
        self.__dict__ = {**state, "_log": ExitStack()}
        self._scratch = tempfile.TemporaryDirectory(prefix="train_ato_run_")
        self._folder = RunFolder(self.log_folder.parent) if state["_folder"] else None
        for name, data in state["_scratch"].items():
            path = Path(self._scratch.name, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)

    def add(self, topic: str, message: object, stamp: int) -> None:
        """Add one message."""
        if self._sink is not None:
            self._sink.add(topic, message, stamp)
            return
        self._keep((topic, message, stamp), 1)

    def add_ticks(self, block: TickBlock) -> None:
        """Add the messages of a block of ticks."""
        if self._sink is not None:
            self._sink.add_ticks(block)
            return
        self._keep(block.copy(), len(block.stamps) * len(block.rows) + sum(map(len, block.between.values())))

    def _keep(self, messages: TickBlock | tuple[str, object, int], count: int) -> None:
        """Keep messages in memory, and all in a log from their maximum number on."""
        self._messages.append(messages)
        self._count += count
        if self._count >= MESSAGES_IN_MEMORY:
            self.begin_log()

    def folder(self) -> RunFolder:
        """Return the run folder; create a temporary one if there is none."""
        if self._folder is None:
            path = self.log_folder.parent
            path.mkdir(exist_ok=True)
            self._folder = RunFolder(path)
            self._folder.begin(self._setup)
        return self._folder

    def begin_log(self) -> None:
        """Open the log and write the messages in memory."""
        self._sink = self._log.enter_context(self.folder().sink(self._setup, compression=self._compression))
        messages, self._messages = self._messages, []
        for entry in messages:
            if isinstance(entry, TickBlock):
                self._sink.add_ticks(entry)
            else:
                self._sink.add(*entry)

    def close_log(self) -> None:
        """Close the log if it is open."""
        self._log.close()

    def counted(self, outcome: RunResult) -> RunResult:
        """Return the result of the run, as failed if messages are missing in the log."""
        return outcome if self._sink is None else outcome.checked_against(self._sink.counts)

    def written(self) -> RunFolder:
        """Return the run folder with its log."""
        if self.lasting is not None and not self.lasting.is_dir():
            raise ValueError(f"{self.lasting}: is no longer there; open its present place with open_run()")
        if not self.folder().recorded and (self._messages or self.lasting is None):
            self.begin_log()
            self.close_log()
        return self.folder()

    def settle(self, folder: RunFolder) -> None:
        """Replace the run folder by its copy."""
        if self._scratch is not None:
            self._scratch.cleanup()
            self._scratch = None
        self._folder = folder


def copy_run(source: Path, path: Path, name: str) -> RunFolder:
    """Copy a run folder."""
    target = RunFolder.make(path, name, "save")
    try:
        shutil.copytree(source, target.path, dirs_exist_ok=True)
    except (OSError, shutil.Error) as error:
        target.discard()
        raise ValueError(f"save {path}: cannot be written ({error}); give a writable folder") from None
    return target


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

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for a copy, also in another process; that of a saved run is in its folder."""
        if self.path is None:
            return self.__dict__
        return {**self.__dict__, "_path": self.path.absolute(), "_record": None}

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
    @refusing
    def tables(self) -> Frames:
        """Table of every topic, as :func:`train_ato.load` returns them."""
        if self._tables is None:
            from train_ato.log.table_loading import load  # pandas: not needed for metrics only

            assert self._record is not None or self._path is not None
            path = self._path if self._record is None else self._record.written().path
            self._tables = load(path)  # type: ignore[arg-type]
        return self._tables

    @property
    def result(self) -> TypedResult:
        """Verdict, criteria with time and place, stops, and energy."""
        return TypedResult.of(self.metrics)

    @refusing
    def to_xarray(self) -> xarray.Dataset:
        """Return the numbers of all tables as one dataset.

        A variable is named by topic, owner and quantity, as ``train_vehicles_vehicle_speed_m_s``, and has its unit in
        ``units``. Its dimensions are a time and the number of the owner, ``unit``, ``vehicle`` or ``coupler``; topics
        with a message for every tick share ``time_s``.

        Raises
        ------
        InputError
            If xarray is not installed, with the command that installs it.
        """
        from train_ato.log.table_columns import dataset_of

        return dataset_of(self.tables, self.metrics)

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

    @refusing
    def plot(self, out: str | Path | None = None) -> Figure:
        """Draw speed, error, force, couplers and air brake over time.

        Parameters
        ----------
        out
            PNG or SVG file to write; default: none, a notebook shows the figure.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        ValueError
            If the run holds no complete tick.
        """
        from train_ato.report.print_figures import run_figure, shown_figure

        figure = run_figure(self.recording)
        if figure is None:
            raise ValueError(f"{self.metrics.get('scenario', self.path)}: the run has no complete tick to draw")
        return shown_figure(figure, out)

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

    @refusing
    def report(self, out: str | Path | None = None) -> Path:
        """Write the page of linked figures and return its path.

        Parameters
        ----------
        out
            HTML file; default: ``report.html`` in the run folder, a temporary one before the run is saved.
        """
        check_packages("report", "bokeh", "jinja2")
        from train_ato.program.arguments import check_new_file
        from train_ato.report.page_data import page_data
        from train_ato.report.words import REPORT
        from train_ato.report.writing import write_page

        folder = self.folder()
        page = folder / REPORT if out is None else Path(out)
        if out is not None:
            check_new_file(page, (".html", ".htm"))
        write_page([page_data(open_recording(folder))], page, compared=False)
        return page

    def finish(self) -> Path:
        """Write log, scenario, summary and figure if they are missing, and return their folder."""
        folder = self.folder()
        figure = folder / "figure.png"
        if self._outcome is not None and self._outcome.recording is not None and not figure.exists():
            self.plot(figure)
        return folder

    @refusing
    def save(self, out: str | Path) -> Path:
        """Save the run folder with log, scenario, summary and figure, and return its path.

        It is an input of ``train-ato verify``, ``report`` and ``view``.

        Raises
        ------
        ValueError
            If the folder exists already or cannot be written.
        """
        folder = copy_run(self.finish(), Path(out), str(self.metrics.get("scenario", "run")))
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
        return html_table(self.result.title, (repr(self).strip("<>"), "value"), result_rows(self.metrics))


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
