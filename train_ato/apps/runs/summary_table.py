"""Metrics of a run in their order in tables, as text and as HTML."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping
from typing import Any

from plant_sim.number_text import number_text

RESULT_ROWS: tuple[tuple[str, str], ...] = (
    ("tracking", "outcome of tracking"),
    ("speed_rmse_kmh", "speed error, rms in km/h"),
    ("speed_error_max_kmh", "speed error, largest in km/h"),
    ("position_error_max_m", "position error, largest in m"),
    ("stop_error_m", "stop error in m"),
    ("overspeed_max_kmh", "overspeed, largest in km/h"),
    ("coupler_draft_max_kn", "coupler draft, largest in kN"),
    ("coupler_buff_max_kn", "coupler buff, largest in kN"),
    ("command_variation_kn_per_s", "command variation in kN/s"),
    ("energy_traction_kwh", "traction energy in kWh"),
    ("energy_regenerated_kwh", "regenerated energy in kWh"),
    ("saturated_s", "time at a force limit in s"),
    ("real_time_factor", "simulated over wall time"),
    ("step_time_us_median", "controller step, median in µs"),
)
"""Key in the summary, and its name with the unit."""
PROTECTION_ROWS: tuple[tuple[str, str], ...] = (
    ("brake_interventions", "interventions of the supervisor"),
    ("first_intervention_s", "first intervention at s"),
    ("first_intervention", "first intervention"),
    ("strongest_reaction", "strongest reaction of the train"),
    ("takeovers", "takeovers of the braking law"),
    ("first_takeover_s", "first takeover at s"),
    ("first_takeover", "first takeover"),
    ("ato_state", "ATO at the end"),
)
"""Rows of a run with a supervisor."""


def result_rows(summary: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """Return name and value of the rows of one run; those of the supervision only if they have a value."""
    rows = [(words, summary[key]) for key, words in RESULT_ROWS if key in summary]
    return rows + [(words, summary[key]) for key, words in PROTECTION_ROWS if summary.get(key) is not None]


def format_value(value: Any) -> str:
    """Return a figure with three digits, without an exponent for a large one."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return number_text(value, 3)
    return str(value)


def html_table(title: str, columns: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return a table as HTML; every text is escaped."""
    head = "".join(f"<th>{html.escape(column)}</th>" for column in columns)
    body = "".join(f"<tr>{''.join(f'<td>{html.escape(format_value(cell))}</td>' for cell in row)}</tr>" for row in rows)
    return f"<p><b>{html.escape(title)}</b></p><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
