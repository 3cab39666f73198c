"""Rows of the summary table: order, labels, units and meanings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Row:
    """One row of the summary: key in ``summary.json``, label, unit, decimals and meaning."""

    key: str
    words: str
    unit: str
    digits: int
    meaning: str


GROUPS: tuple[tuple[str, tuple[Row, ...]], ...] = (
    (
        "Stops and speed limit",
        (
            Row("stop_error_m", "stopping error", "m", 3, "at the last stop: front minus target at standstill"),
            Row("stop_error_max_m", "stopping error, worst of all stops", "m", 3, "front minus target at standstill"),
            Row("overspeed_max_kmh", "overspeed, maximum", "km/h", 2, "above the lowest limit under the train"),
            Row("running_time_s", "running time", "s", 1, "from the first motion to the arrival at the last stop"),
            Row("arrival_delay_max_s", "delay of arrival, maximum", "s", 1, "at a stop, against the profile"),
        ),
    ),
    (
        "Tracking",
        (
            Row("tracking", "outcome of tracking", "", 0, "tracked, or the worst deviation from the reference"),
            Row("speed_rmse_kmh", "speed error, rms", "km/h", 3, "over the evaluation; mean of the power units"),
            Row("speed_error_max_kmh", "speed error, maximum", "km/h", 3, "over the evaluation; of all power units"),
            Row("speed_rmse_run_kmh", "speed error of the run, rms", "km/h", 3, "with the final braking"),
            Row("speed_error_run_max_kmh", "speed error of the run, maximum", "km/h", 3, "with the final braking"),
            Row("position_rmse_m", "position error, rms", "m", 2, "over the evaluation"),
            Row("position_error_max_m", "position error, maximum", "m", 2, "over the evaluation"),
        ),
    ),
    (
        "Forces in the train and comfort",
        (
            Row("coupler_draft_max_kn", "coupler force, maximum draft", "kN", 0, "all couplers, all plant steps"),
            Row("coupler_buff_max_kn", "coupler force, maximum buff", "kN", 0, "all couplers, all plant steps"),
            Row("coupler_damage", "coupler fatigue, all couplers", "", 3, "rainflow; 1 per cycle of 1 MN, slope 5"),
            Row("coupler_damage_worst", "coupler fatigue, worst coupler", "", 4, "of one coupler"),
            Row("acceleration_max", "acceleration of vehicle 0, maximum", "m/s²", 3, "differences over 0.1 s"),
            Row("jerk_max", "jerk of vehicle 0, maximum", "m/s³", 2, "over 0.1 s, with the capture at standstill"),
            Row("jerk_1s_max", "jerk of vehicle 0 over 1 s, maximum", "m/s³", 3, "of the mean acceleration"),
        ),
    ),
    (
        "Command",
        (
            Row("command_variation_kn_per_s", "variation of the command", "kN/s", 1, "sum of its changes, per second"),
            Row("saturated_s", "time at a force limit", "s", 1, "demand at or beyond it, clipped by law or train"),
            Row("held_steps", "steps with the last command repeated", "", 0, "no new command arrived in time"),
            Row("commands_lost", "commands lost", "", 0, "on the link to the train"),
            Row("commands_missed", "ticks without a new command", "", 0, "at the train"),
            Row("commands_refused", "commands refused", "", 0, "by the train: invalid or too old"),
            Row("commands_late", "commands late", "", 0, "after their tick, in real time without lockstep"),
            Row("unsound_measurements", "invalid measurements", "", 0, "not finite or physically impossible; not used"),
            Row("replans", "re-planned profiles", "", 0, "after a shortfall of the force"),
        ),
    ),
    (
        "Energy",
        (
            Row("energy_traction_kwh", "traction", "kWh", 1, "work of the traction forces"),
            Row("energy_regenerated_kwh", "regenerated", "kWh", 1, "work of the electric brake"),
        ),
    ),
    (
        "Run",
        (
            Row("simulated_s", "simulated time", "s", 1, ""),
            Row("wall_s", "wall time", "s", 1, ""),
            Row("real_time_factor", "simulated over wall time", "", 0, ""),
            Row("step_time_us_median", "controller step, median", "µs", 0, "wall time of one step of the law"),
            Row("step_time_us_p99", "controller step, 99th percentile", "µs", 0, "wall time of one step of the law"),
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
        Row("brake_interventions", "interventions of the supervisor", "", 0, "service or emergency brake"),
        Row("first_intervention_s", "first intervention", "s", 1, first),
        Row("strongest_reaction", "strongest reaction of the train", "", 0, "of the train protection, for any reason"),
        Row(
            "takeovers",
            "takeovers of the braking law",
            "",
            0,
            str(summary.get("first_takeover") or "the law was near the warning speed"),
        ),
        Row("ato_state", "ATO at the end", "", 0, disengaged),
    ]


def run_groups(summary: dict[str, Any]) -> list[tuple[str, list[tuple[Row, list[str]]]]]:
    """Return the groups of one run; those of :func:`filled_groups`, and the supervision after the first."""
    groups = filled_groups([summary])
    rows = [(row, [shown(row, summary)]) for row in _supervision_rows(summary) if summary.get(row.key) is not None]
    return [*groups[:1], (SUPERVISION, rows), *groups[1:]] if rows else groups
