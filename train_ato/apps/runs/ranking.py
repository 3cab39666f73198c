"""Order of runs in a comparison, the best value of every metric and the differences from it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from train_ato.loop.verdict import is_tracked

Metrics = Mapping[str, Any]
SMALL_IS_GOOD = frozenset({
    "stop_error_m", "stop_error_max_m", "overspeed_max_kmh", "arrival_delay_max_s", "speed_rmse_kmh",
    "speed_error_max_kmh", "speed_rmse_run_kmh", "speed_error_run_max_kmh", "position_rmse_m", "position_error_max_m",
    "coupler_draft_max_kn", "coupler_buff_max_kn", "acceleration_max", "jerk_max", "jerk_1s_max",
    "command_variation_kn_per_s", "saturated_s", "energy_traction_kwh", "held_steps", "brake_interventions",
    "commands_lost", "commands_late",
})  # fmt: skip
"""Metrics whose smallest magnitude is the best value; the others have none."""
VERDICTS = {"passed": 0, None: 0, "incomplete": 1, "failed": 2}


def rank_of(metrics: Metrics) -> tuple[bool, bool, int, int, float]:
    """Return the sort key of a run: runs to the end, tracked runs, verdict, failed criteria, rms of the speed error.

    Parameters
    ----------
    metrics
        Content of ``summary.json``; empty for a law without a run, which is last.
    """
    failed = sum(row["passed"] is False for row in metrics.get("criteria") or ())
    error = _number(metrics.get("speed_rmse_kmh"))
    ended = metrics.get("status") == "done"
    verdict = VERDICTS.get(metrics.get("verdict"), 0)
    return not ended, not is_tracked(metrics), verdict, failed, math.inf if error is None else error


def best_value(key: str, runs: Sequence[Metrics]) -> float | None:
    """Return the smallest magnitude of a metric; None without two different values, or where none is better."""
    if key not in SMALL_IS_GOOD:
        return None
    found = [abs(value) for metrics in runs if (value := _number(metrics.get(key))) is not None]
    return min(found) if len(found) > 1 and max(found) > min(found) else None


def difference_from_best(key: str, metrics: Metrics, runs: Sequence[Metrics]) -> float | None:
    """Return the magnitude of a metric minus the best one, 0.0 for the best; None without a best value."""
    best, value = best_value(key, runs), _number(metrics.get(key))
    return None if best is None or value is None else abs(value) - best


def _number(value: Any) -> float | None:
    usable = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if usable else None
