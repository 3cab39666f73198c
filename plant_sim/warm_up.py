"""Compilation of the kernel before a run."""

from __future__ import annotations

import numpy as np

from plant_sim import kernel as k
from plant_sim.consist import Consist
from plant_sim.kernel_cache import kernels_are_kept
from plant_sim.line import Line
from plant_sim.plant_setup import PlantSetup
from plant_sim.train import Train


def compile_kernel() -> bool:
    """Load the compiled kernel by one step of a two-vehicle train; return True if it was compiled.

    The first compilation on a machine takes some seconds; :mod:`plant_sim.compiled` describes the cache.
    """
    consist = Consist.model_validate(
        {
            "schema": "train_ato/consist/1",
            "name": "warm-up",
            "vehicle_types": {"car": {"mass": 1e5, "length": 10.0, "resistance": {"n": (1e3, 0.0, 0.0)}}},
            "train": ({"type": "car", "count": 2},),
            "draft_gears": {"spring": {"kind": "linear", "stiffness": 1e6}},
            "default_gear": "spring",
        }
    )
    line = Line.model_validate({"schema": "train_ato/line/1", "name": "level", "end": 1000.0})
    Train(consist, line, PlantSetup(), 1_000_000, 1_000_000).advance(np.zeros((1, 0)))
    stats = getattr(k.advance, "stats", None)  # missing with NUMBA_DISABLE_JIT
    return stats is not None and (not kernels_are_kept() or bool(sum(stats.cache_misses.values())))
