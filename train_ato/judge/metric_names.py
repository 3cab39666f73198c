"""Name and unit of the metrics of a run, which every table, page and message has, and their tables in text and HTML."""

import html
from collections.abc import Iterable, Mapping
from typing import Any

from plant_sim.units import number_text

METRICS: dict[str, tuple[str, str]] = {
    "stop_error_m": ("stop error, last stop", "m"),
    "stop_error_max_m": ("stop error, largest of all stops", "m"),
    "overspeed_max_kmh": ("overspeed, largest", "km/h"),
    "running_time_s": ("running time", "s"),
    "arrival_delay_max_s": ("delay of arrival, largest", "s"),
    "tracking": ("outcome of tracking", ""),
    "speed_rmse_kmh": ("speed error, rms", "km/h"),
    "speed_error_max_kmh": ("speed error, largest", "km/h"),
    "speed_rmse_run_kmh": ("speed error of the run, rms", "km/h"),
    "speed_error_run_max_kmh": ("speed error of the run, largest", "km/h"),
    "position_rmse_m": ("position error, rms", "m"),
    "position_error_max_m": ("position error, largest", "m"),
    "coupler_draft_max_kn": ("coupler draft, largest", "kN"),
    "coupler_buff_max_kn": ("coupler buff, largest", "kN"),
    "coupler_damage": ("coupler fatigue, all couplers", ""),
    "coupler_damage_worst": ("coupler fatigue, worst coupler", ""),
    "acceleration_max": ("acceleration, largest", "m/s²"),
    "jerk_max": ("jerk, largest", "m/s³"),
    "jerk_1s_max": ("jerk over 1 s, largest", "m/s³"),
    "command_variation_kn_per_s": ("command variation", "kN/s"),
    "saturated_s": ("time at a force limit", "s"),
    "held_steps": ("steps with the last command repeated", ""),
    "commands_lost": ("commands lost", ""),
    "commands_missed": ("ticks without a new command", ""),
    "commands_refused": ("commands refused", ""),
    "commands_late": ("commands late", ""),
    "unsound_measurements": ("invalid measurements", ""),
    "replans": ("re-planned profiles", ""),
    "energy_traction_kwh": ("traction energy", "kWh"),
    "energy_regenerated_kwh": ("regenerated energy", "kWh"),
    "simulated_s": ("simulated time", "s"),
    "wall_s": ("wall time", "s"),
    "real_time_factor": ("simulated over wall time", ""),
    "step_time_us_median": ("controller step, median", "µs"),
    "step_time_us_p99": ("controller step, 99th percentile", "µs"),
    "brake_interventions": ("interventions of the supervisor", ""),
    "first_intervention_s": ("first intervention", "s"),
    "strongest_reaction": ("strongest reaction of the train", ""),
    "ato_state": ("ATO at the end", ""),
    "lateness_max_s": ("lateness of a tick, largest", "s"),
    "first_intervention": ("reason of the first intervention", ""),
    "stop_not_kept_s": ("first plan without force for the stop", "s"),
    "stop_not_kept_m": ("largest planned distance beyond a stop", "m"),
    "first_takeover_s": ("first takeover", "s"),
    "first_takeover": ("reason of the first takeover", ""),
    "gap_min_m": ("distance to the train ahead, smallest", "m"),
    "contacts": ("contacts with the train ahead", ""),
    "headway_error_max_m": ("place against the train ahead one headway before, largest error", "m"),
    "headway_error_rms_m": ("place against the train ahead one headway before, rms error", "m"),
    "headway_speed_error_max_kmh": ("speed against the train ahead one headway before, largest error", "km/h"),
    "speed_amplification": ("deviation of the speed from the own profile, times that of the train ahead", ""),
    "takeovers": ("takeovers of the braking law", ""),
}
"""Name and unit by key of ``summary.json``."""


def metric_name(key: str) -> str:
    """Return the name of a metric."""
    return METRICS[key][0]


def metric_unit(key: str) -> str:
    """Return the unit of a metric, "" without one."""
    return METRICS[key][1]


def metric_heading(key: str) -> str:
    """Return name and unit of a metric as the head of a column or row.

    Examples
    --------
    >>> metric_heading("stop_error_m"), metric_heading("takeovers")
    ('stop error, last stop in m', 'takeovers of the braking law')
    """
    name, unit = METRICS[key]
    return f"{name} in {unit}" if unit else name


RESULTS = (
    "tracking", "speed_rmse_kmh", "speed_error_max_kmh", "position_error_max_m", "stop_error_m", "overspeed_max_kmh",
    "coupler_draft_max_kn", "coupler_buff_max_kn", "command_variation_kn_per_s", "energy_traction_kwh",
    "energy_regenerated_kwh", "saturated_s",
)  # fmt: skip
"""Metrics of every run."""
PROTECTION = (
    "brake_interventions", "first_intervention_s", "first_intervention", "strongest_reaction", "takeovers",
    "first_takeover_s", "first_takeover", "ato_state",
)  # fmt: skip
"""Metrics of a run with a supervisor."""


def result_rows(summary: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return name and value of the rows of one run; those of the supervision only if they have a value."""
    shown = [key for key in RESULTS if key in summary]
    shown += [key for key in PROTECTION if summary.get(key) is not None]
    return [(metric_heading(key), summary[key]) for key in shown]


def format_value(value: Any) -> str:
    """Return a figure with three digits, without an exponent for a large one."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return number_text(value, 3)
    return str(value)


def verdict_html(text: str) -> str:
    """Return the first line of an object in a notebook: its verdict."""
    return f"<p><b>{html.escape(text)}</b></p>"


def html_table(title: str, columns: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return a table as HTML; every text is escaped."""
    head = "".join(f"<th>{html.escape(column)}</th>" for column in columns)
    body = "".join(f"<tr>{''.join(f'<td>{html.escape(format_value(cell))}</td>' for cell in row)}</tr>" for row in rows)
    return f"{verdict_html(title)}<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
