"""One row of a sweep again: run alone, recorded, and compared with the table."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from train_ato.api.drive import RunMode, drive
from train_ato.api.scenario_choice import ScenarioChoice
from train_ato.log.run_folder import next_free
from train_ato.program.errors import RunFailed, RunInterrupted
from train_ato.scenario.setup import RunSetup
from train_ato.studies.sweep.result import FIRST, LAST, SweepFolder, read_results
from train_ato.studies.sweep.row import Row, code_of_process, one_line, row_end, scenario_hash
from train_ato.studies.sweep.spec import read_sweep
from train_ato.studies.sweep.sweep import sweep_base

TEXTS = ("status", "reason", "verdict", "tracking", "sha256")
"""Compared entries beside the metrics."""


@dataclass(frozen=True)
class RowCheck:
    """Comparison of a row with a new run of its values.

    Attributes
    ----------
    run
        Number of the run.
    point
        Values by key.
    values
        Number of compared values.
    difference
        First difference in words, "" for equal rows.
    folder
        Folder of the new run; None for a refused one.
    """

    run: int
    point: dict[str, Any]
    values: int
    difference: str
    folder: Path | None


def recorded_row(path: Path, number: int) -> tuple[Row, dict[str, Any]]:
    """Return a row and the specification with the versions of its sweep.

    Parameters
    ----------
    path
        Folder of a sweep, or its Parquet file.
    number
        Number of the run, from 1.
    """
    file = path if path.is_file() else SweepFolder(path).results
    if file.is_file():
        table, identity = read_results(file)
        found = table[table["run"] == number]
        rows = [_row_of(found.iloc[0].to_dict())] if len(found) else []
        last = int(table["run"].max()) if len(table) else 0
    else:
        folder = SweepFolder(path)
        identity, rows = folder.identity(), [row for row in folder.rows() if row["run"] == number]
        last = max((row["run"] for row in folder.rows()), default=0)
    if not rows:
        raise ValueError(f"--row {number}: {path} has no such run; give 1 to {last}")
    return rows[0], identity


def _row_of(columns: Mapping[Any, Any]) -> Row:
    """Return a row of the table in the form of a finished run."""
    point = json.loads(columns["point"])
    other = {"run", *point, *FIRST, *LAST}
    metrics = {
        key: value
        for key, value in columns.items()
        if key not in other and isinstance(value, (int, float)) and not math.isnan(value)
    }
    texts = {key: value if isinstance(value := columns.get(key), str) else None for key in TEXTS}
    return {"run": int(columns["run"]), "point": point, "metrics": metrics, **texts}


def run_row_again(path: Path, number: int, out: Path | None = None) -> RowCheck:
    """Run one row alone, record it in a run folder, and compare metrics and hash with the row.

    Parameters
    ----------
    path, number
        As for :func:`recorded_row`.
    out
        Run folder to make; default: ``runs/sweep-row-N``.
    """
    before, identity = recorded_row(path, number)
    base = sweep_base(read_sweep(identity["spec"], f"{path}: specification")).choice()
    again, folder = _run(base, before["point"], out, number)
    difference = _first_difference(before, again)
    if difference and identity["code"] != code_of_process():
        difference += "; the code of train_ato has changed since the sweep"
    values = len(TEXTS) + len(again["metrics"])
    return RowCheck(number, before["point"], values, difference, folder)


def _run(base: ScenarioChoice, point: Mapping[str, Any], out: Path | None, number: int) -> tuple[Row, Path | None]:
    """Run a point and return its row and its folder."""
    try:
        setup: RunSetup = base.with_(point).prepare()
    except ValueError as error:
        return {"status": "refused", "reason": one_line(error, base), "metrics": {}}, None
    folder = out or next_free(f"sweep-row-{number}")
    summary: Mapping[str, Any] = {}
    try:
        summary = drive(setup, RunMode(), out=folder, title=f"row {number}").metrics
    except RunInterrupted:
        raise
    except RunFailed as error:
        summary = {"status": "failed", "failure": str(error)} if error.run is None else error.run.metrics
    return {"sha256": scenario_hash(setup), **row_end(summary)}, folder


def _first_difference(before: Row, again: Row) -> str:
    """Return the first difference in words, "" for equal rows."""
    for key in TEXTS:
        if before.get(key) != again.get(key):
            reason = f" ({again['reason']})" if key == "status" and again.get("reason") else ""
            return f"{key}: {before.get(key)!r} in the table, {again.get(key)!r} now{reason}"
    first, second = before.get("metrics", {}), again["metrics"]
    for key in dict.fromkeys((*first, *second)):
        if first.get(key) != second.get(key):
            return f"{key}: {first.get(key)} in the table, {second.get(key)} now"
    return ""
