"""One run of a sweep and its row: values, end of the run, metrics, hash of the resolved scenario."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping
from typing import Any

from train_ato.apps.runs.scenario_choice import ScenarioChoice
from train_ato.loop.engine import run_engine
from train_ato.loop.part_cache import PartCache
from train_ato.loop.setup import RunSetup
from train_ato.scenario.overlays import RefusedScenario

__all__ = ["TIMES", "WALL_TIMES", "Row", "drive_point", "one_line", "row_metrics", "scenario_hash"]

TIMES = ("wall_s", "evaluation_s", "overhead_s")
"""Wall times of a run [s]: loop of the engine, its start and metrics, all else."""
Row = dict[str, Any]
"""Run, point, status, reason, metrics of one run as plain data."""
WALL_TIMES = ("wall_s", "real_time_factor", "step_time_us_median", "step_time_us_p99")
"""Metrics of the machine, different in every run."""


def drive_point(base: ScenarioChoice, number: int, point: Mapping[str, Any], parts: PartCache) -> Row:
    """Run one point in the engine and return its row.

    Parameters
    ----------
    base
        Scenario with the fixed keys.
    number
        Number of the run, from 1.
    point
        Values by key.
    parts
        Parts of former runs of this process.

    Returns
    -------
    dict
        Plain data.  ``status``: ``done``; ``failed`` with the reason; ``refused`` with the reason if the combination of
        values is no valid run.  ``sha256``: hash of the resolved scenario.  Wall times: ``wall_s`` of the loop of the
        engine, ``evaluation_s`` of its start and its metrics, ``overhead_s`` of all else.
    """
    begin = time.perf_counter()
    row: Row = {"run": number, "point": dict(point), "status": "refused", "reason": ""}
    try:
        setup = base.with_(point).prepare(parts=parts)
    except ValueError as error:
        return {**row, "reason": one_line(error, base), **_times(begin)}
    row |= {
        "sha256": scenario_hash(setup),
        "law": setup.controller,
        "observer": setup.observer,
        "compensation": setup.compensation,
        "seed": setup.seed,
    }
    start = time.perf_counter()
    try:
        summary = run_engine(setup, summary_only=True).summary
    except (Exception, SystemExit) as error:  # the constructor of a user's component may raise any
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        return {**row, "status": "failed", "reason": reason, **_times(begin)}
    engine = time.perf_counter() - start
    return {
        **row,
        "status": summary["status"],
        "reason": " ".join(str(summary.get("failure", "")).split()),
        "verdict": summary.get("verdict"),
        "tracking": summary.get("tracking"),
        "metrics": row_metrics(summary),
        **_times(begin, engine, float(summary["wall_s"])),
    }


def _times(begin: float, engine: float = 0.0, loop: float = 0.0) -> dict[str, float]:
    """Return the wall times of a run [s] from its begin, the time of the engine and that of its loop."""
    return {"wall_s": loop, "evaluation_s": engine - loop, "overhead_s": time.perf_counter() - begin - engine}


def one_line(error: Exception, base: ScenarioChoice) -> str:
    """Return the message of a refusal without the scenario's file."""
    text = error.problem if isinstance(error, RefusedScenario) else str(error)
    return " ".join(text.split()).removeprefix(f"{base.path}: ")


def row_metrics(summary: Mapping[str, Any]) -> dict[str, float | int]:
    """Return the numeric metrics of a run, without wall times and seed."""
    return {
        key: value
        for key, value in summary.items()
        if isinstance(value, (int, float)) and not isinstance(value, bool) and key not in (*WALL_TIMES, "seed")
    }


def scenario_hash(setup: RunSetup) -> str:
    """Return the SHA-256 of the resolved scenario of a run, the text of its ``scenario.yaml``."""
    return hashlib.sha256(setup.resolved_yaml().encode()).hexdigest()
