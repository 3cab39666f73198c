"""Rows of the summary table: order, decimals and meanings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from train_ato.loop.metric_names import metric_name, metric_unit


@dataclass(frozen=True)
class Row:
    """One row of the summary: key in ``summary.json``, decimals and meaning."""

    key: str
    digits: int
    meaning: str

    @property
    def words(self) -> str:
        """Name of the metric."""
        return metric_name(self.key)

    @property
    def unit(self) -> str:
        """Unit of the metric."""
        return metric_unit(self.key)


GROUPS: tuple[tuple[str, tuple[Row, ...]], ...] = (
    (
        "Stops and speed limit",
        (
            Row("stop_error_m", 3, "at the last stop: front minus target at standstill"),
            Row("stop_error_max_m", 3, "front minus target at standstill"),
            Row("overspeed_max_kmh", 2, "above the lowest limit under the train"),
            Row("running_time_s", 1, "from the first motion to the arrival at the last stop"),
            Row("arrival_delay_max_s", 1, "at a stop, against the profile"),
        ),
    ),
    (
        "Tracking",
        (
            Row("tracking", 0, "tracked, or the worst deviation from the reference"),
            Row("speed_rmse_kmh", 3, "over the evaluation; mean of the power units"),
            Row("speed_error_max_kmh", 3, "over the evaluation; of all power units"),
            Row("speed_rmse_run_kmh", 3, "with the final braking"),
            Row("speed_error_run_max_kmh", 3, "with the final braking"),
            Row("position_rmse_m", 2, "over the evaluation"),
            Row("position_error_max_m", 2, "over the evaluation"),
        ),
    ),
    (
        "Forces in the train and comfort",
        (
            Row("coupler_draft_max_kn", 0, "of all couplers, at every step of the plant"),
            Row("coupler_buff_max_kn", 0, "of all couplers, at every step of the plant"),
            Row("coupler_damage", 3, "rainflow; 1 per cycle of 1 MN, slope 5"),
            Row("coupler_damage_worst", 4, "of one coupler"),
            Row("acceleration_max", 3, "of vehicle 0, over 0.1 s"),
            Row("jerk_max", 2, "of vehicle 0 over 0.1 s, with the capture at standstill"),
            Row("jerk_1s_max", 3, "of the mean acceleration of vehicle 0"),
        ),
    ),
    (
        "Command",
        (
            Row("command_variation_kn_per_s", 1, "sum of its changes, per second"),
            Row("saturated_s", 1, "demand at or beyond it, clipped by law or train"),
            Row("held_steps", 0, "no new command arrived in time"),
            Row("commands_lost", 0, "on the link to the train"),
            Row("commands_missed", 0, "at the train"),
            Row("commands_refused", 0, "by the train: invalid or too old"),
            Row("commands_late", 0, "after their tick, in real time without lockstep"),
            Row("unsound_measurements", 0, "not finite or physically impossible; not used"),
            Row("replans", 0, "after a shortfall of the force"),
        ),
    ),
    (
        "Energy",
        (
            Row("energy_traction_kwh", 1, "work of the traction forces"),
            Row("energy_regenerated_kwh", 1, "work of the electric brake"),
        ),
    ),
    (
        "Run",
        (
            Row("simulated_s", 1, ""),
            Row("wall_s", 1, ""),
            Row("real_time_factor", 0, ""),
            Row("step_time_us_median", 0, "wall time of one step of the law"),
            Row("step_time_us_p99", 0, "wall time of one step of the law"),
        ),
    ),
)
"""The rows of the summary."""
SUPERVISION = "Supervision"
"""Title of the rows of a run with a supervisor."""

FINER = 3
"""Maximum number of additional decimals of a small value."""
NOT_STANDING = "stop_error_m"
"""Row that is also shown without a value: the train did not stop."""


def shown(row: Row, summary: dict[str, Any]) -> str:
    """Return the value of a row as text; a dash without a value or for a number that is not finite."""
    value = summary.get(row.key)
    if isinstance(value, str):
        return value
    if value is None or isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return "–"
    digits = row.digits
    if 0 < abs(value) < 10.0**-digits:  # otherwise a small value would be shown as 0
        digits = min(digits + FINER, 1 - math.floor(math.log10(abs(value))))
    text = f"{value:.{digits}f}"
    return text.replace("-", "−") if float(text) != 0 else f"{0:.{row.digits}f}"


def difference_text(row: Row, difference: float | None) -> str:
    """Return the difference of a value from the best one, "" without one."""
    return "" if difference is None else f"+{shown(row, {row.key: difference})}"


def filled_groups(summaries: list[dict[str, Any]]) -> list[tuple[str, list[tuple[Row, list[str]]]]]:
    """Return the groups with one text per run; rows and groups without values are omitted."""
    groups = []
    for title, rows in GROUPS:
        filled = [(row, [shown(row, summary) for summary in summaries]) for row in rows]
        tracked = any(summary.get("speed_rmse_kmh") is not None for summary in summaries)
        filled = [
            (row, texts)
            for row, texts in filled
            if any(text != "–" for text in texts) or (tracked and row.key == NOT_STANDING)
        ]
        if any(any(text != "–" for text in texts) for _, texts in filled):
            groups.append((title, filled))
    return groups


def _supervision_rows(summary: dict[str, Any]) -> list[Row]:
    """Return the rows of a run with a supervisor; their meanings contain the reasons."""
    ended = summary.get("ato_disengaged_s")
    disengaged = "" if ended is None else f"disengaged at {ended:.1f} s: {summary.get('ato_disengaged')}"
    first = str(summary.get("first_intervention") or "")
    return [
        Row("brake_interventions", 0, "service or emergency brake"),
        Row("first_intervention_s", 1, first),
        Row("strongest_reaction", 0, "of the train protection, for any reason"),
        Row("takeovers", 0, str(summary.get("first_takeover") or "the law was near the warning speed")),
        Row("ato_state", 0, disengaged),
    ]


def run_groups(summary: dict[str, Any]) -> list[tuple[str, list[tuple[Row, list[str]]]]]:
    """Return the groups of one run; those of :func:`filled_groups`, and the supervision after the first."""
    groups = filled_groups([summary])
    rows = [(row, [shown(row, summary)]) for row in _supervision_rows(summary) if summary.get(row.key) is not None]
    return [*groups[:1], (SUPERVISION, rows), *groups[1:]] if rows else groups
