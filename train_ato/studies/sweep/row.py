"""One run of a sweep and its row: values, end of the run, metrics, hash of the resolved scenario."""

import gc
import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from plant_sim.library import split_name
from plant_sim.train import compile_kernel
from train_ato.api.scenario_choice import ScenarioChoice
from train_ato.log.versions import source_hash
from train_ato.loop.engine import run_engine
from train_ato.program.interrupt import no_silent_exit
from train_ato.scenario.overlays import RefusedScenario
from train_ato.scenario.scenario_data import PartCache
from train_ato.scenario.setup import RunSetup
from train_ato.studies.sweep.spec import Point

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
        Plain data. ``status`` is ``done``, ``failed`` with the reason, or ``refused`` with the reason if the
        combination of values is no valid run. ``sha256`` is the hash of the resolved scenario. The wall times are
        ``wall_s`` of the loop of the engine, ``evaluation_s`` of its start and its metrics, and ``overhead_s`` of all
        else.
    """
    begin = time.perf_counter()
    row: Row = {"run": number, "point": dict(point), "status": "refused", "reason": ""}
    try:
        with no_silent_exit():
            setup = base.with_(point).prepare(parts=parts, noted=False)
    except ValueError as error:
        return {**row, "reason": one_line(error, base), **_times(begin)}
    row |= {
        "sha256": scenario_hash(setup),
        "law": setup.scenario.law,
        "observer": setup.scenario.observer,
        "compensation": setup.scenario.compensation,
        "seed": setup.scenario.seed,
    }
    start = time.perf_counter()
    try:
        with no_silent_exit():
            summary = run_engine(setup, summary_only=True).summary
    except (Exception, SystemExit) as error:  # the constructor of a user's component may raise any
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        return {**row, "status": "failed", "reason": reason, **_times(begin)}
    engine = time.perf_counter() - start
    return {**row, **row_end(summary), **_times(begin, engine, float(summary["wall_s"]))}


def _times(begin: float, engine: float = 0.0, loop: float = 0.0) -> dict[str, float]:
    """Return the wall times of a run [s] from its begin, the time of the engine and that of its loop."""
    return {"wall_s": loop, "evaluation_s": engine - loop, "overhead_s": time.perf_counter() - begin - engine}


def one_line(error: Exception, base: ScenarioChoice) -> str:
    """Return the message of a refusal without the scenario's file."""
    text = error.problem if isinstance(error, RefusedScenario) else str(error)
    return " ".join(text.split()).removeprefix(f"{base.path}: ")


def row_end(summary: Mapping[str, Any]) -> Row:
    """Return end, verdicts and numeric metrics of a run, without wall times and seed."""
    return {
        "status": summary["status"],
        "reason": " ".join(str(summary.get("failure", "")).split()),
        "verdict": summary.get("verdict"),
        "tracking": summary.get("tracking"),
        "metrics": {
            key: value
            for key, value in summary.items()
            if isinstance(value, (int, float)) and not isinstance(value, bool) and key not in (*WALL_TIMES, "seed")
        },
    }


def scenario_hash(setup: RunSetup) -> str:
    """Return the SHA-256 of the resolved scenario of a run, the text of its ``scenario.yaml``."""
    return hashlib.sha256(setup.resolved_yaml().encode()).hexdigest()


def data_hash(data: Any, folder: Path) -> str:
    """Return the SHA-256 of a scenario before it is resolved, with the content of the files and modules that it names.

    Parameters
    ----------
    data
        Plain data.
    folder
        Folder of the scenario; its files have their paths from there.
    """
    named = {text: _content(text, folder) for text in sorted(set(_texts(data)))}
    return hashlib.sha256(json.dumps([data, named], sort_keys=True, default=str).encode()).hexdigest()


def _texts(data: Any) -> Iterator[str]:
    """Yield the texts among the values of plain data."""
    if isinstance(data, str):
        yield data
    elif isinstance(data, Mapping):
        for value in data.values():
            yield from _texts(value)
    elif isinstance(data, Sequence):
        for value in data:
            yield from _texts(value)


def _content(text: str, folder: Path) -> str:
    """Return the SHA-256 of the file of a train, line or other input, or of the module of a component, "" for none."""
    for place in (folder / text, Path(text)):
        with suppress(OSError, ValueError):  # no name of a file
            file = Path(split_name(str(place))[0])
            if file.is_file():
                return hashlib.sha256(file.read_bytes()).hexdigest()
    module, colon, name = text.partition(":")
    with suppress(ImportError, ValueError):
        if colon and name.isidentifier() and (spec := find_spec(module)) is not None and spec.has_location:
            return hashlib.sha256(Path(str(spec.origin)).read_bytes()).hexdigest()
    return ""


@dataclass(frozen=True)
class SweepBase:
    """Part of a sweep that all its runs share.

    Attributes
    ----------
    scenario, path
        Name of the scenario and its file.
    data
        Content of the scenario with base, variants and fixed keys.
    source
        Hash of the code; a worker with other code refuses the runs.
    """

    scenario: str | dict[str, Any]
    path: Path
    data: dict[str, Any]
    source: str

    def choice(self) -> ScenarioChoice:
        """Return the scenario with the fixed keys."""
        return ScenarioChoice(self.scenario, self.path, self.data)


Batch = Sequence[tuple[int, Point]]
"""Number and values of every run."""


def run_batch(base: SweepBase, batch: Batch) -> list[Row]:
    """Run a batch and return its rows; ValueError if the code of this process is not that of the sweep."""
    if code_of_process() != base.source:
        raise ValueError("a worker has other code of train_ato; install the same version on every worker")
    compile_kernel()
    global _last
    first = _last is None
    if _last is None or _last[0] != base:
        _last = (base, base.choice(), PartCache())
    _, choice, parts = _last
    rows = [drive_point(choice, number, point, parts) for number, point in batch]
    if first:
        keep_loaded_objects()
    return rows


def keep_loaded_objects() -> None:
    """Leave what the first runs of a process have loaded, mostly compiled code, out of later garbage collections."""
    gc.collect()
    gc.freeze()


_last: tuple[SweepBase, ScenarioChoice, PartCache] | None = None
"""Sweep of the last batch of this process, its scenario and the parts of its runs."""


@lru_cache(maxsize=1)
def code_of_process() -> str:
    """Return the hash of the code, read once in a process."""
    return source_hash()
