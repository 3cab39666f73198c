"""Groups of the runs of a sweep, for example by law, and the runs that a figure counts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from train_ato.judge.metric_names import METRICS, metric_heading
from train_ato.program.display_units import display_unit, shown_name, symbol_in
from train_ato.program.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from train_ato.studies.sweep.spec import SweepSpec

ERROR_METRIC = "speed_rmse_kmh"
"""Metric of the figures if no other one is chosen."""
BORDERS = {"tracking": ("tracking", "tracked"), "verdict": ("verdict", "passed")}
"""Border of stability: column of the table, and its value inside."""
NOT_METRICS = ("run", "seed", "wall_s", "evaluation_s", "overhead_s")


class NotDrawable(InputError):
    """The design or the runs of a sweep do not permit a figure."""


def list_key(spec: SweepSpec) -> str | None:
    """Return the list whose values the figures compare: ``law``, else the first one but ``seed``; None without."""
    keys = [dimension.key for dimension in spec.dimensions if not dimension.is_range and dimension.key != "seed"]
    return "law" if "law" in keys else (keys[0] if keys else None)


def grouped(table: pd.DataFrame, key: str | None) -> list[tuple[str, pd.DataFrame]]:
    """Return label and runs for every value of a key, in the order of the values; without a key, all runs."""
    return [("all runs", table)] if key is None else [(str(value), runs) for value, runs in table.groupby(key)]


def inside(table: pd.DataFrame, border: str = "tracking") -> Any:
    """Return True for every complete run inside of the border of stability, shape (runs,)."""
    if border not in BORDERS:
        raise ValueError(f"border '{border}': is unknown; use {' or '.join(BORDERS)}")
    column, good = BORDERS[border]
    return ((table["status"] == "done") & (table[column] == good)).to_numpy()


def numeric_metrics(table: pd.DataFrame) -> list[str]:
    """Return the columns that a figure can show."""
    return [
        name
        for name, kind in table.dtypes.items()
        if kind.kind in "fiu" and "." not in str(name) and name not in NOT_METRICS
    ]


def metric_words(table: pd.DataFrame, metric: str) -> str:
    """Return the name of a metric with its unit."""
    from plant_sim.input_error import close_match

    known = numeric_metrics(table)
    if metric not in known:
        if not (table["status"] == "done").any():
            raise NotDrawable("no run ended regularly")
        raise ValueError(
            f"metric '{metric}': is no numeric column{close_match(metric, known)}; use one of: {', '.join(known)}"
        )
    return shown_name(metric_heading(metric) if metric in METRICS else metric)


def shown_metrics(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table of runs with its metrics in the units of display."""
    factors = {key: display_unit(symbol_in(key))[1] for key in numeric_metrics(table)}
    return table.assign(**{key: factor * table[key] for key, factor in factors.items() if factor != 1.0})
