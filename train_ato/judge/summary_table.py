"""Metrics of a run in their order in tables, as text and as HTML."""

import html
from collections.abc import Iterable, Mapping
from typing import Any

from plant_sim.units import number_text
from train_ato.judge.metric_names import metric_heading

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
