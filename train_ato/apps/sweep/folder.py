"""Folder of a sweep: its specification, one line for every finished run, and the table of results.

``sweep.json`` has the specification and the versions, ``runs.jsonl`` one JSON line for every finished run.  The lines
of a batch are on the disk before the next batch is counted, so a killed sweep continues where it was.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from plant_sim.data_text import parse_json
from train_ato.apps.sweep.batch import SweepBase
from train_ato.apps.sweep.row import Row
from train_ato.apps.sweep.spec import SweepSpec, read_sweep
from train_ato.log.run_folder import RunFolder
from train_ato.log.versions import versions
from train_ato.log.whole_file import write_whole, writing

__all__ = ["SweepFolder", "sweep_identity"]

SWEEP = "sweep.json"
RUNS = "runs.jsonl"
RESULTS = "results.parquet"
SCHEMA = "train_ato/sweep/1"
REMEDIES = {
    "spec": "the specification is another one; name a new folder, or restore the specification",
    "scenario": "the scenario has changed; name a new folder, or restore the scenario",
    "code": "train_ato has changed; name a new folder, or install the version of the sweep",
}
"""Part of a sweep that must not change before it is continued, and the message."""


def sweep_identity(spec: SweepSpec, base: SweepBase) -> dict[str, Any]:
    """Return specification, hashes of scenario and code, and versions of a sweep."""
    scenario = json.dumps(base.data, sort_keys=True, default=str)
    return {
        "schema": SCHEMA,
        "spec": {**spec.data, "scenario": spec.scenario},
        "scenario": hashlib.sha256(scenario.encode()).hexdigest(),
        "code": base.source,
        "versions": versions(),
    }


class SweepFolder:
    """Folder of a sweep.

    Parameters
    ----------
    path
        An existing folder.
    new
        The same folder, if it was made for this sweep.
    """

    def __init__(self, path: Path, new: RunFolder | None = None) -> None:
        self.path = path
        self._new = new

    @classmethod
    def opened(cls, path: Path | None, option: str = "--out") -> SweepFolder:
        """Return the folder of an earlier sweep, or a new one; None: ``runs/sweep-N``.

        Raises
        ------
        ValueError
            If it exists and is no folder of a sweep, or cannot be written.
        """
        if path is not None and cls.holds(path):
            return cls(path)
        new = RunFolder.make(path, "sweep", option)
        return cls(new.path, new)

    def discard_empty(self) -> None:
        """Remove a new folder without a finished run."""
        if self._new is not None and not self.rows():
            self._new.discard()

    @property
    def results(self) -> Path:
        """File of the table."""
        return self.path / RESULTS

    @classmethod
    def holds(cls, path: Path) -> bool:
        """Return True for the folder of a sweep."""
        return (path / SWEEP).is_file()

    def begin(self, identity: dict[str, Any]) -> None:
        """Write the specification of a new sweep, or compare it with that of an interrupted one.

        Raises
        ------
        ValueError
            If the sweep of the folder is another one.
        """
        if self.holds(self.path):
            before = self.identity()
            for key, remedy in REMEDIES.items():
                if before.get(key) != json.loads(json.dumps(identity[key], default=str)):
                    raise ValueError(f"{self.path}: cannot be continued: {remedy}")
            return
        write_whole(self.path / SWEEP, json.dumps(identity, indent=2, default=str) + "\n")

    def identity(self) -> dict[str, Any]:
        """Return the content of ``sweep.json``.

        Raises
        ------
        ValueError
            If the folder has none, or it is damaged.
        """
        file = self.path / SWEEP
        if not file.is_file():
            raise ValueError(f"{self.path}: not the folder of a sweep: no {SWEEP}; name one that `sweep` made")
        try:
            found = parse_json(file.read_bytes())
        except ValueError as error:
            raise ValueError(f"{file}: is not JSON ({error}); name another folder") from None
        if not isinstance(found, dict) or found.get("schema") != SCHEMA:
            raise ValueError(f"{file}: schema: not '{SCHEMA}'; name a folder that `sweep` made")
        return found

    def spec(self) -> SweepSpec:
        """Return the specification of the sweep."""
        return read_sweep(self.identity()["spec"], str(self.path / SWEEP))

    def rows(self) -> list[Row]:
        """Return the rows of the finished runs in the order of their numbers; an incomplete last line is no row."""
        file = self.path / RUNS
        if not file.is_file():
            return []
        found: dict[int, Row] = {}
        for line in file.read_bytes().split(b"\n"):
            try:
                row = parse_json(line)
            except ValueError:
                continue
            if isinstance(row, dict) and isinstance(row.get("run"), int):
                found.setdefault(row["run"], row)
        return [found[number] for number in sorted(found)]

    @contextmanager
    def appending(self) -> Iterator[RowWriter]:
        """Open the file of the finished runs; only one process at a time can.

        Raises
        ------
        ValueError
            If another process writes it.
        """
        with (self.path / RUNS).open("ab") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                raise ValueError(f"{self.path}: another sweep writes into it; wait for its end") from None
            yield RowWriter(file)


class RowWriter:
    """Writer of finished runs; every batch is on the disk when :meth:`add` returns."""

    def __init__(self, file: Any) -> None:
        self._file = file
        self._begin = "\n" if file.tell() > 0 else ""  # ends the incomplete line of a killed process

    def add(self, rows: Iterable[Row]) -> None:
        """Append rows."""
        lines = "".join(f"{json.dumps(row, ensure_ascii=False)}\n" for row in rows)
        with writing(Path(self._file.name)):
            self._file.write(f"{self._begin}{lines}".encode())
            self._file.flush()
            os.fsync(self._file.fileno())
        self._begin = ""
