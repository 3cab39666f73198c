"""Folder of one run: log, metadata, resolved scenario and summary."""

import dataclasses
import itertools
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from plant_sim.data_text import parse_json, parse_yaml
from plant_sim.input_error import explain, kind_of
from train_ato.judge.result import RunResult
from train_ato.log.bag_layout import LOG, PARTIAL, not_a_run
from train_ato.log.compression import DEFAULT
from train_ato.log.log_writer import RunLog
from train_ato.log.mcap_writer import TickRecords
from train_ato.log.reading import attachments, log_file
from train_ato.log.versions import SCENARIO, SUMMARY, attachments_for
from train_ato.log.whole_file import write_whole
from train_ato.messages.codec import Wire
from train_ato.messages.topics import EPOCH_NS, TickBlock, topics_of
from train_ato.scenario.scenario import check_scenario, load_scenario
from train_ato.scenario.setup import RunSetup, prepare


class RecordedChange(BaseModel):
    """Row of ``changes``: time [s], name and value of a change during the run."""

    model_config = ConfigDict(extra="allow", strict=True)

    at_s: float
    name: str
    value: bool | int | float | str | dict[str, bool | int | float | str]
    planned: bool | None = None


class RecordedSummary(BaseModel):
    """Keys of a summary that commands use; all others are values of a table."""

    model_config = ConfigDict(extra="allow", strict=True)

    changes: list[RecordedChange] = []
    scenario: str = ""
    controller: str = ""
    observer: str = ""
    compensation: str = ""
    status: str = "done"
    failure: str | None = None
    mode: str | None = None
    way: str | None = None


def summary_text(summary: dict[str, Any]) -> str:
    """Return the JSON text of a summary."""
    return json.dumps(summary, indent=2, ensure_ascii=False) + "\n"


def parse_summary(file: Path, text: bytes) -> dict[str, Any]:
    """Return the content of a ``summary.json``."""
    try:
        summary = parse_json(text)
    except ValueError as error:
        raise ValueError(f"{file}: is not JSON ({error}); remove the file; the log is complete") from None
    if not isinstance(summary, dict):
        raise ValueError(f"{file}: holds {kind_of(summary)}, not metrics by name; remove the file")
    try:
        RecordedSummary.model_validate(summary)
    except ValidationError as error:
        fault = explain(error, file, RecordedSummary).lines[0]
        raise ValueError(f"{fault}; remove the file; the log is complete") from None
    return summary


RUNS = Path("runs")
STARTED = "scenario.started.yaml"
"""Initial scenario of a run with unplanned changes."""


def check_free(path: Path, option: str = "--out") -> None:
    """Check that a run folder can be created; ``option`` is its name in messages."""
    try:
        taken = path.exists()
    except OSError as error:
        raise ValueError(f"{option} {str(path)[:60]}...: {error.strerror}; name another folder") from None
    if taken:
        raise ValueError(f"{option} {path}: exists already; name a folder that does not")
    parent = next(parent for parent in path.absolute().parents if parent.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK):
        raise ValueError(f"{option} {path}: cannot be made in {parent}; name a writable place")


class RunFolder:
    """Folder with all files of one run, created before its start.

    Attributes
    ----------
    begun : bool
        True after the scenario was written.
    """

    def __init__(self, path: Path, made: tuple[Path, ...] = ()) -> None:
        self.path = path
        self._made = made
        self.begun = False

    @classmethod
    def make(cls, wanted: Path | None, name: str, option: str = "--out") -> "RunFolder":
        """Create the folder of a new run; ``option`` is its name in messages."""
        path = wanted if wanted is not None else next_free(name)
        check_free(path, option)
        made = (path, *(parent for parent in path.parents if not parent.exists()))
        try:
            path.mkdir(parents=True)
        except OSError as error:
            raise ValueError(f"{option} {path}: cannot be made ({error.strerror}); name a writable place") from None
        return cls(path, made)

    @property
    def recorded(self) -> bool:
        """True if the folder or a subfolder has a log, also a partial one."""
        return any(True for name in (LOG, PARTIAL) for _ in self.path.glob(f"**/{name}"))

    def discard(self, *, converted: bool = False) -> None:
        """Remove the folder of a run that did not start, and the folders above created for it.

        A folder with a log is kept, unless the log was ``converted`` from another file.
        """
        if self.recorded and not converted:
            return
        shutil.rmtree(self.path, ignore_errors=True)
        for path in self._made[1:]:
            with suppress(OSError):
                path.rmdir()

    @contextmanager
    def kept_if_recorded(self) -> Iterator[None]:
        """Discard the folder after an error of the block without a log."""
        try:
            yield
        except BaseException:
            self.discard()
            raise

    @contextmanager
    def sink(
        self,
        setup: RunSetup,
        more: Mapping[str, bytes] | None = None,
        compression: str = DEFAULT,
        *,
        timed: bool = True,
    ) -> "Iterator[Encoder]":
        """Open the log for the engine with attachments ``more``; it is closed and renamed on exit.

        ``timed``: with the wall time of the recording.
        """
        topics = [topic for topic in topics_of(setup.layout) if topic.recorded]
        attached = {**attachments_for(setup.resolved_yaml()), **(more or {})}
        with RunLog(self.path, topics, attachments=attached, compression=compression, timed=timed) as log:
            yield Encoder(log, Wire(setup.layout))

    def begin(self, setup: RunSetup) -> None:
        """Write the resolved scenario, which reproduces the run."""
        write_whole(self.path / SCENARIO, setup.resolved_yaml())
        self.begun = True

    def finish(self, setup: RunSetup, result: RunResult) -> None:
        """Write the summary; after unplanned changes also the scenario with them, and keep the initial scenario."""
        if any(not row["planned"] for row in result.summary["changes"]):
            started = self.path / SCENARIO
            again = dataclasses.replace(setup, scenario=result.changes.driven(setup.scenario))
            write_whole(self.path / STARTED, started.read_text(encoding="utf-8"))
            write_whole(started, again.resolved_yaml())
        write_whole(self.path / SUMMARY, summary_text(result.summary))


def read_run_folder(path: Path) -> tuple[RunSetup, dict[str, Any]]:
    """Return the setup and the summary of a recorded run.

    Parameters
    ----------
    path
        Run folder, or its log with the attached scenario; only the log of a measured run has an attached summary.  A
        folder without ``scenario.yaml`` is that of a recorder that was killed, or found no room at the end.
    """
    if path.is_dir() and ((path / SCENARIO).is_file() or not (path / LOG).is_file()):
        summary = read_summary(path)
        file = path / SCENARIO
        return prepare(*load_scenario(str(file)), recorded=True), summary
    attached = attachments(log_file(path), once=SCENARIO)
    text = attached.get(SCENARIO)
    if text is None:
        raise ValueError(f"{path}: no {SCENARIO} is attached; name a log or a run folder that `train-ato run` made")
    try:
        data = parse_yaml(text)
    except ValueError as error:
        raise ValueError(f"{path}: the attached {SCENARIO} is not YAML ({error}); name another log") from None
    unknown = {"status": "killed"} if path.is_dir() else {}
    return prepare(check_scenario(data, path), path, recorded=True), _attached_summary(path, attached) or unknown


def read_summary(path: Path) -> dict[str, Any]:
    """Return the summary of a recorded run; ValueError if the folder is not a run folder."""
    if not (path / SCENARIO).is_file():
        raise not_a_run(path, "no scenario.yaml; name a folder that `run` made")
    log = log_file(path)
    file = path / SUMMARY
    if not file.is_file():
        return _attached_summary(log, attachments(log)) or {"status": "killed"}
    return parse_summary(file, file.read_bytes())


def _attached_summary(log: Path, attached: Mapping[str, bytes]) -> dict[str, Any]:
    """Return the summary attached to a log, empty without one."""
    text = attached.get(SUMMARY)
    return {} if text is None else parse_summary(log, text)


class Encoder:
    """Encoder of messages for the log, with publish time = log time = stamp."""

    def __init__(self, log: RunLog, wire: Wire) -> None:
        self._log = log
        self._wire = wire

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages per topic."""
        return self._log.counts

    def add(self, topic: str, message: object, stamp: int) -> None:
        """Encode and record one message."""
        moment = EPOCH_NS + stamp
        self._log.add(topic, moment, moment, self._wire.encode(topic, message))

    def add_ticks(self, block: TickBlock) -> None:
        """Encode and record the messages of a block of ticks."""
        self._log.extend_ticks(TickRecords(block, self._wire, self._log.numbers))


def next_beside(out: Path) -> Path:
    """Return the first free folder of ``OUT-2``, ``OUT-3``, ... for the next run of the same scenario."""
    stem, dash, number = out.name.rpartition("-")
    begin, count = (stem, int(number)) if dash and number.isdigit() else (out.name, 1)
    return next(found for i in itertools.count(count + 1) if not (found := out.with_name(f"{begin}-{i}")).exists())


def next_free(name: str) -> Path:
    """Return the folder of the next run of a scenario: ``runs/NAME-N``."""
    stem = re.sub(r"[^A-Za-z0-9_.-]+", "-", name)
    taken = [path.name for path in RUNS.glob(f"{stem}-*")] if RUNS.is_dir() else []
    numbers = [int(entry.rsplit("-", 1)[1]) for entry in taken if entry.rsplit("-", 1)[1].isdigit()]
    return RUNS / f"{stem}-{max(numbers, default=0) + 1}"
