"""The folder of one run: log, metadata, resolved scenario, summary and figure."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import yaml

from plant_sim.library import StrictLoader
from train_ato.outcome import Outcome
from train_ato.record.layout import LOG, PARTIAL
from train_ato.record.reading import attachments, log_file
from train_ato.record.run_log import RunLog
from train_ato.record.versions import SCENARIO, SUMMARY, attachments_for
from train_ato.run_setup import RunSetup, prepare
from train_ato.scenario import check, load
from train_ato.topics import EPOCH_NS
from train_ato.wire import Wire

RUNS = Path("runs")
STARTED = "scenario.started.yaml"
"""The scenario as a run was started, where changes from outside made it another one."""


class RunFolder:
    """A run's folder; it is made before the run and holds everything that the run leaves."""

    def __init__(self, path: Path, made: tuple[Path, ...] = ()) -> None:
        self.path = path
        self._made = made

    @classmethod
    def make(cls, wanted: Path | None, name: str) -> RunFolder:
        """Make the folder of a new run.

        Raises
        ------
        ValueError
            If it exists already or cannot be written.
        """
        path = wanted if wanted is not None else _next_free(name)
        try:
            taken = path.exists()
        except OSError as error:
            raise ValueError(f"--out {str(path)[:60]}...: {error.strerror}; name another folder") from None
        if taken:
            raise ValueError(f"--out {path}: exists already; name a folder that does not")
        made = (path, *(parent for parent in path.parents if not parent.exists()))
        try:
            path.mkdir(parents=True)
        except OSError as error:
            raise ValueError(f"--out {path}: cannot be made ({error.strerror}); name a writable place") from None
        return cls(path, made)

    @property
    def recorded(self) -> bool:
        """Whether a log was begun."""
        return any((self.path / name).exists() for name in (LOG, PARTIAL))

    def discard(self) -> None:
        """Remove the folder of a run that never started, and the folders above that were made for it."""
        shutil.rmtree(self.path, ignore_errors=True)
        for path in self._made[1:]:
            with suppress(OSError):
                path.rmdir()

    @contextmanager
    def sink(self, setup: RunSetup, more: Mapping[str, bytes] | None = None) -> Iterator[Encoder]:
        """Open the log for the engine, with ``more`` attached; it is closed and renamed however the run ends."""
        topics = [topic for topic in setup.shape.topics if topic.recorded]
        attached = {**attachments_for(setup.resolved_yaml()), **(more or {})}
        with RunLog(self.path, topics, attachments=attached) as log:
            yield Encoder(log, Wire(setup.shape))

    def begin(self, setup: RunSetup) -> None:
        """Write the resolved scenario: whatever becomes of the run, this alone reproduces it."""
        (self.path / SCENARIO).write_text(setup.resolved_yaml(), encoding="utf-8")

    def finish(self, setup: RunSetup, outcome: Outcome) -> None:
        """Write the summary and the figure, and the scenario as it was driven where something was changed from outside.

        The scenario as it was started then stands beside it.
        """
        if any(not row["planned"] for row in outcome.summary["changes"]):
            started = self.path / SCENARIO
            started.rename(self.path / STARTED)
            again = dataclasses.replace(setup, scenario=outcome.told.driven(setup.scenario))
            started.write_text(again.resolved_yaml(), encoding="utf-8")
        (self.path / SUMMARY).write_text(summary_text(outcome.summary), encoding="utf-8")
        if outcome.history is not None:
            from train_ato.figure import draw_run  # matplotlib: only runs that are drawn pay for it

            draw_run(setup, outcome.history, outcome.summary, self.path / "figure.png")


def summary_text(summary: dict[str, Any]) -> str:
    """Return a summary as it is written."""
    return json.dumps(summary, indent=2, ensure_ascii=False) + "\n"


def open_run(path: Path) -> tuple[RunSetup, dict[str, Any]]:
    """Return the setup and the summary of a recorded run.

    Parameters
    ----------
    path
        Run folder, or its log alone: the scenario is attached to that, a summary only where the run was measured.

    Raises
    ------
    ValueError
        If it is not a run's.
    """
    if path.is_dir():
        summary = read_summary(path)
        return prepare(*load(str(path / SCENARIO))), summary
    attached = attachments(log_file(path))
    text = attached.get(SCENARIO)
    if text is None:
        raise ValueError(f"{path}: no {SCENARIO} is attached; name a log or a run folder that `train-ato run` made")
    try:
        data = yaml.load(text, Loader=StrictLoader)
    except yaml.YAMLError as error:
        raise ValueError(f"{path}: the attached {SCENARIO} is not YAML ({error})") from None
    return prepare(check(data, path), path), _attached_summary(path, attached)


def read_summary(path: Path) -> dict[str, Any]:
    """Return the summary of a recorded run.

    Raises
    ------
    ValueError
        If the folder is not that of a run.
    """
    if not (path / SCENARIO).is_file():
        raise ValueError(f"{path}: not a run folder: no scenario.yaml; name a folder that `run` made")
    log = log_file(path)
    file = path / SUMMARY
    if not file.is_file():
        return _attached_summary(log, attachments(log)) or {"status": "killed"}
    return _figures(file, file.read_bytes())


def _attached_summary(log: Path, attached: Mapping[str, bytes]) -> dict[str, Any]:
    """Return the summary that is attached to a log, empty where none is."""
    text = attached.get(SUMMARY)
    return {} if text is None else _figures(log, text)


def _figures(file: Path, text: bytes) -> dict[str, Any]:
    try:
        summary = json.loads(text)
    except ValueError as error:
        raise ValueError(f"{file}: is not JSON ({error}); take the file away, the log is whole without it") from None
    if not isinstance(summary, dict):
        raise ValueError(f"{file}: holds {type(summary).__name__}, not figures by name; take the file away")
    return summary


class Encoder:
    """Turns messages into bytes and hands them to the log, publish time = receipt time = stamp."""

    def __init__(self, log: RunLog, wire: Wire) -> None:
        self._log = log
        self._wire = wire

    @property
    def counts(self) -> dict[str, int]:
        """Messages written of every topic."""
        return self._log.counts

    def add(self, topic: str, message: object, stamp: int) -> None:
        """Encode and record one message."""
        moment = EPOCH_NS + stamp
        self._log.add(topic, moment, moment, self._wire.encode(topic, message))


def _next_free(name: str) -> Path:
    stem = re.sub(r"[^A-Za-z0-9_.-]+", "-", name)
    taken = [path.name for path in RUNS.glob(f"{stem}-*")] if RUNS.is_dir() else []
    numbers = [int(entry.rsplit("-", 1)[1]) for entry in taken if entry.rsplit("-", 1)[1].isdigit()]
    return RUNS / f"{stem}-{max(numbers, default=0) + 1}"
