"""Order of runs in a comparison, the best value of every metric and the differences from it."""

import math
from collections.abc import Mapping, Sequence
from statistics import mean, median
from typing import Any

from train_ato.judge.run_end import DONE
from train_ato.judge.verdict import is_tracked

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


def standings(comparisons: Sequence[Sequence[Metrics]]) -> list[dict[str, Any]]:
    """Return one row per law over several comparisons: most passed runs first, then tracked ones, then the mean rank.

    Parameters
    ----------
    comparisons
        Rows of every comparison, the best law first, with ``controller`` and ``status``.

    Returns
    -------
    list of dict
        ``law``. ``runs``, ``passed``, ``tracked``, ``first`` and ``refused`` are numbers of comparisons. ``rank`` is
        the mean place among the laws with a run, from 1. ``speed_rmse_kmh`` is the median and ``stop_error_m`` the
        largest magnitude of the tracked runs.
    """
    rows: dict[str, dict[str, Any]] = {}
    places: dict[str, list[int]] = {}
    for comparison in comparisons:
        for place, metrics in enumerate(comparison):
            law = str(metrics["controller"])
            row = rows.setdefault(law, dict.fromkeys(("runs", "passed", "tracked", "first", "refused"), 0))
            if metrics["status"] == "refused":
                row["refused"] += 1
                continue
            row["runs"] += 1
            row["passed"] += metrics.get("verdict") == "passed"
            row["tracked"] += metrics["status"] == "done" and is_tracked(metrics)
            row["first"] += place == 0
            places.setdefault(law, []).append(place + 1)
    for law, row in rows.items():
        tracked = [
            metrics for comparison in comparisons for metrics in comparison
            if metrics["controller"] == law and metrics["status"] == "done" and is_tracked(metrics)
        ]  # fmt: skip
        errors = [abs(value) for m in tracked if (value := _number(m.get("speed_rmse_kmh"))) is not None]
        stops = [abs(value) for m in tracked if (value := _number(m.get("stop_error_m"))) is not None]
        row["rank"] = mean(places[law]) if law in places else None
        row["speed_rmse_kmh"] = median(errors) if errors else None
        row["stop_error_m"] = max(stops, default=None)
    ranked = sorted(rows.items(), key=lambda row: (-row[1]["passed"], -row[1]["tracked"], row[1]["rank"] or math.inf))
    return [{"law": law, **row} for law, row in ranked]


def _whole(runs: Sequence[Metrics]) -> Sequence[Metrics]:
    """Return the runs to their planned end, or all without one: a broken run has the small values of its part."""
    return [metrics for metrics in runs if metrics.get("status", DONE) == DONE] or runs


def best_value(key: str, runs: Sequence[Metrics]) -> float | None:
    """Return the smallest magnitude of a metric; None without two different values, or where none is better."""
    if key not in SMALL_IS_GOOD:
        return None
    found = [abs(value) for metrics in _whole(runs) if (value := _number(metrics.get(key))) is not None]
    return min(found) if len(found) > 1 and max(found) > min(found) else None


def difference_from_best(key: str, metrics: Metrics, runs: Sequence[Metrics]) -> float | None:
    """Return the magnitude of a metric minus the best one, 0.0 for the best; None without a best value."""
    best, value = best_value(key, runs), _number(metrics.get(key))
    return None if best is None or value is None or metrics not in _whole(runs) else abs(value) - best


def _number(value: Any) -> float | None:
    usable = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if usable else None
