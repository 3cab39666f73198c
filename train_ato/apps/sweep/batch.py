"""Batch of runs in a worker process."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from plant_sim.warm_up import compile_kernel
from train_ato.apps.runs.scenario_choice import ScenarioChoice
from train_ato.apps.sweep.design import Point
from train_ato.apps.sweep.row import Row, drive_point
from train_ato.log.versions import source_hash
from train_ato.loop.part_cache import PartCache

__all__ = ["Batch", "SweepBase", "keep_loaded_objects", "run_batch"]


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

    scenario: str
    path: Path
    data: dict[str, Any]
    source: str

    def choice(self) -> ScenarioChoice:
        """Return the scenario with the fixed keys."""
        return ScenarioChoice(self.scenario, self.path, self.data)


Batch = Sequence[tuple[int, Point]]
"""Number and values of every run."""


def run_batch(base: SweepBase, batch: Batch) -> list[Row]:
    """Run a batch and return its rows.

    Raises
    ------
    ValueError
        If the code of this process is not that of the sweep.
    """
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
