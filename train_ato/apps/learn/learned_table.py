"""Errors of the runs from which a resistance was learned."""

from __future__ import annotations

from typing import Any

from train_ato.apps.learn.learn import LearnResult

FIGURES = {
    "rms m/s": ("speed_rmse_kmh", 1 / 3.6),
    "largest m/s": ("speed_error_max_kmh", 1 / 3.6),
    "position m": ("position_error_max_m", 1.0),
    "stop m": ("stop_error_m", 1.0),
    "kN/s": ("command_variation_kn_per_s", 1.0),
}
"""Columns: metric and factor."""


def learned_rows(result: LearnResult) -> list[dict[str, Any]]:
    """Return a row for every repeated run: number of runs before it that are learned, and its errors."""
    rows: list[dict[str, Any]] = []
    learned = result.learned.runs - (len(result.metrics) - 1 - len(result.unused))
    for number, metrics in enumerate(result.metrics):
        row: dict[str, Any] = {"run": number + 1, "learned from": learned, "seed": metrics["seed"]}
        for heading, (name, factor) in FIGURES.items():
            value = metrics.get(name)
            row[heading] = None if value is None else factor * value
        rows.append(row)
        learned += f"run {number + 1}" not in result.unused
    return rows
