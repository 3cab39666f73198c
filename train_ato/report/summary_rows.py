"""Rows of the summary table: order, decimals and meanings."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from train_ato.judge.metric_names import metric_name, metric_unit
from train_ato.judge.ranking import rank_of
from train_ato.judge.verdict import (
    CRITERIA,
    is_tracked,
    place_text,
    shown_digits,
    shown_quantity,
    tracking_text,
    verdict_line,
)
from train_ato.program.display_units import display_unit
from train_ato.report.page_data import PageData
from train_ato.report.quantities import TABLES


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
        return display_unit(metric_unit(self.key))[0]


GROUPS: dict[str, tuple[Row, ...]] = {
    title: tuple(Row(key, *cells) for key, cells in rows.items()) for title, rows in TABLES["metrics"].items()
}
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
    value *= display_unit(metric_unit(row.key))[1]
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
    for title, rows in GROUPS.items():
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


STATES = {True: "passed", False: "failed", None: "incomplete"}


def verdict_texts(pages: Sequence[PageData]) -> list[dict[str, str]]:
    """Return label, state and line of the verdicts of the runs with metrics; a run that is not tracked is failed."""
    return [
        {"label": data.label, "state": _state(data.summary), "text": typeset(line)}
        for data in pages
        if (line := verdict_line(data.summary))
    ]


def _state(summary: dict[str, Any]) -> str:
    return str(summary.get("verdict") or "none") if is_tracked(summary) else "failed"


def best_text(pages: Sequence[PageData]) -> str:
    """Return the best run and the reason as one line, "" without two runs of one scenario with metrics."""
    judged = [data for data in pages if data.summary.get("speed_rmse_kmh") is not None]
    if len(judged) < 2 or len({data.summary.get("scenario") for data in judged}) > 1:
        return ""
    first, second = sorted(judged, key=lambda data: rank_of(data.summary))[:2]
    if rank_of(first.summary) == rank_of(second.summary):
        return ""
    words = "" if is_tracked(first.summary) else f"{tracking_text(first.summary)}, "
    verdict = first.summary.get("verdict")
    words += f"{verdict}, " if verdict else ""
    error = shown_quantity(first.summary["speed_rmse_kmh"], "km/h")
    return f"Best: {first.label} ({words}speed error {error} rms). Order: tracking, verdict, failed criteria, rms."


Cells = tuple[str, str, list[tuple[str, str, str]]]
"""Name of a criterion, limit with unit, and value, state, time and place of the worst value for every run."""


def criterion_cells(pages: Sequence[PageData]) -> list[Cells]:
    """Return the criteria that any run has, failed ones first; runs without one have a dash."""
    found = []
    for criterion in CRITERIA:
        rows = [next((row for row in _rows(data.summary) if row["criterion"] == criterion.key), None) for data in pages]
        limits = {row["limit"] for row in rows if row is not None}
        if not limits:
            continue
        limit = " / ".join(shown_digits(value, criterion.unit) for value in sorted(limits))
        cells = [_cell(row, criterion.unit) for row in rows]
        limit = f"{limit} {display_unit(criterion.unit)[0]}".rstrip()
        found.append((metric_name(criterion.metric), limit, cells))
    return sorted(
        found + _requirement_cells(pages), key=lambda entry: all(state != STATES[False] for _, state, _ in entry[2])
    )


def _cell(row: dict[str, Any] | None, unit: str) -> tuple[str, str, str]:
    """Return value, state, time and place of a criterion of a run; a dash without it."""
    return ("–", "none", "") if row is None else (_value(row["value"], unit), STATES[row["passed"]], place_text(row))


def _requirement_cells(pages: Sequence[PageData]) -> list[Cells]:
    """Return the requirements that any run has, with their robustness; its limit is 0."""
    named: dict[tuple[str, str], None] = {}
    for data in pages:
        named |= {(row["criterion"], row["formula"]): None for row in _rows(data.summary) if "formula" in row}
    found = []
    for name, formula in named:
        rows = [next((row for row in _rows(data.summary) if row.get("formula") == formula), None) for data in pages]
        cells = [_cell(row, (row and row["unit"]) or "") for row in rows]
        found.append((f"{name}: {typeset(formula)}", "robustness 0", cells))
    return found


def _rows(summary: dict[str, Any]) -> Sequence[dict[str, Any]]:
    return summary.get("criteria") or ()


def _value(value: Any, unit: str) -> str:
    return "–" if value is None else typeset(shown_quantity(value, unit))


def typeset(text: str) -> str:
    """Return a text with the signs of a page: minus and ellipsis."""
    signed = re.sub(r"(?<![\w-])-(?=\d)", "−", text)
    return signed.replace("...", "…")
