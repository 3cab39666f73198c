"""Folder of a series of runs: its specification, and one JSON line for every finished run.

The lines of the finished runs are on the disk before the next ones are counted, so a killed series continues where it
was, with the same command.
"""

import fcntl
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from plant_sim.data_text import parse_json
from train_ato.log.run_folder import RunFolder
from train_ato.log.versions import source_hash, versions
from train_ato.log.whole_file import write_whole, writing
from train_ato.program.errors import RunFailed

Self = TypeVar("Self", bound="SeriesFolder")
RUNS = "runs.jsonl"
REMEDIES = {
    "spec": "the specification is another one; name a new folder, or restore the specification",
    "scenario": "the scenario has changed; name a new folder, or restore the scenario",
    "code": "train_ato has changed; name a new folder, or install the version of the {command}",
}
"""Part of a series that must not change before it is continued, and the message."""


class SeriesFolder:
    """Folder of a series.

    Parameters
    ----------
    path
        An existing folder.
    new
        The same folder, if it was made for this series.
    """

    command: str
    file: str

    def __init__(self, path: Path, new: RunFolder | None = None) -> None:
        self.path = path
        self._new = new

    @classmethod
    def opened(cls: type[Self], path: Path | None, option: str = "--out", name: str = "") -> Self:
        """Return the folder of an earlier series, or a new one; None: ``runs/NAME-N``."""
        if path is not None and cls.holds(path):
            return cls(path)
        new = RunFolder.make(path, name or cls.command, option)
        return cls(new.path, new)

    def discard_empty(self) -> None:
        """Remove a new folder without a finished run."""
        if self._new is not None and not self.rows():
            self._new.discard()

    @classmethod
    def holds(cls, path: Path) -> bool:
        """Return True for the folder of such a series."""
        return (path / cls.file).is_file()

    @classmethod
    def schema(cls) -> str:
        """Return the name of the form of the folder."""
        return f"train_ato/{cls.command}/1"

    def begin(self, identity: Mapping[str, Any]) -> None:
        """Write the specification of a new series, or compare it with that of an interrupted one."""
        if self.holds(self.path):
            before = self.identity()
            for key, remedy in REMEDIES.items():
                if before.get(key) != json.loads(json.dumps(identity[key], default=str)):
                    raise ValueError(f"{self.path}: cannot be continued: {remedy.format(command=self.command)}")
            return
        write_whole(self.path / self.file, json.dumps(identity, indent=2, default=str) + "\n")

    def identity(self) -> dict[str, Any]:
        """Return the specification, with hashes and versions."""
        file, command = self.path / self.file, self.command
        if not file.is_file():
            raise ValueError(
                f"{self.path}: not the folder of a {command}: no {self.file}; name one that `{command}` made"
            )
        try:
            found = parse_json(file.read_bytes())
        except ValueError as error:
            raise ValueError(f"{file}: is not JSON ({error}); name another folder") from None
        if not isinstance(found, dict) or found.get("schema") != self.schema():
            raise ValueError(f"{file}: schema: not '{self.schema()}'; name a folder that `{command}` made")
        return found

    def rows(self) -> list[dict[str, Any]]:
        """Return the rows of the finished runs in the order of their numbers; an incomplete last line is no row."""
        file = self.path / RUNS
        if not file.is_file():
            return []
        found: dict[int, dict[str, Any]] = {}
        for line in file.read_bytes().split(b"\n"):
            try:
                row = parse_json(line)
            except ValueError:
                continue
            if isinstance(row, dict) and isinstance(row.get("run"), int):
                found.setdefault(row["run"], row)
        return [found[number] for number in sorted(found)]

    @contextmanager
    def appending(self) -> "Iterator[RowWriter]":
        """Open the file of the finished runs; only one process at a time can."""
        with (self.path / RUNS).open("ab", buffering=0) as file:  # a buffer would be written again when it is closed
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise ValueError(f"{self.path}: another {self.command} writes into it; wait for its end") from None
            yield RowWriter(file)

    @contextmanager
    def full_disk_told(self) -> Iterator[None]:
        """Context of the runs and of their files: a full disk ends it with the number of kept runs and a remedy.

        Raises
        ------
        RunFailed
            In place of an OSError, if there are finished runs.
        """
        try:
            yield
        except OSError as error:
            if not (kept := len(self.rows())):
                raise
            runs = f"{kept} finished {'run is' if kept == 1 else 'runs are'} in {self.path}; make room"
            raise RunFailed(
                f"{error.filename or self.path}: {error.strerror or error}; {runs} and repeat the command to go on"
            ) from None


class RowWriter:
    """Writer of finished runs; every row is on the disk when :meth:`add` returns."""

    def __init__(self, file: Any) -> None:
        self._file = file
        self._begin = "\n" if file.tell() > 0 else ""  # ends the incomplete line of a killed process

    def add(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Append rows."""
        lines = "".join(f"{_text(row)}\n" for row in rows)
        data = f"{self._begin}{lines}".encode()
        with writing(Path(self._file.name)):
            while data:
                data = data[self._file.write(data) :]
            os.fsync(self._file.fileno())
        self._begin = ""


class SearchFolder(SeriesFolder):
    """Folder of a search whose next runs depend on the results of the former ones.

    A search that is repeated with the results of its finished runs goes on as if it had not been interrupted.
    """

    command = "search"
    file = "search.json"

    @contextmanager
    def kept(self, command: str, spec: Mapping[str, Any], scenario: Any) -> "Iterator[KeptRuns]":
        """Open the finished runs of a search, specified by ``command``, ``spec`` and the hashes ``scenario``.

        A new folder without a finished run is removed at the end.
        """
        identity = {
            "schema": self.schema(),
            "spec": {"command": command, **spec},
            "scenario": scenario,
            "code": source_hash(),
            "versions": versions(),
        }
        try:
            with self.full_disk_told(), self.appending() as writer:
                self.begin(identity)
                yield KeptRuns(self.rows(), writer)
        finally:
            self.discard_empty()


class KeptRuns:
    """Results of the finished runs of a search by their input.

    Parameters
    ----------
    rows
        Number, input and result of the finished runs.
    writer
        Receiver of the new ones.
    """

    def __init__(self, rows: Iterable[Mapping[str, Any]], writer: RowWriter) -> None:
        self._found = {_text(row["input"]): row["result"] for row in rows if {"input", "result"} <= {*row}}
        self._writer = writer

    def __len__(self) -> int:
        return len(self._found)

    def find(self, given: Any) -> Any:
        """Return the result of an input as plain data; None for a new one."""
        return self._found.get(_text(given))

    def add(self, given: Any, result: Any) -> None:
        """Keep a result; neither may have other values than those of JSON, and numbers of numpy."""
        self._writer.add([{"run": len(self._found) + 1, "input": given, "result": result}])
        self._found[_text(given)] = result


def _text(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, default=lambda number: number.item())
