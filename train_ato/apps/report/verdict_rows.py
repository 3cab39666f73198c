"""First screen of a page: one line of verdict per run, and the criteria with their values."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from train_ato.apps.report.page_data import PageData
from train_ato.apps.runs.ranking import rank_of
from train_ato.loop.verdict import CRITERIA, is_tracked, place_text, three_digits, tracking_text, verdict_line

STATES = {True: "passed", False: "failed", None: "incomplete"}


@dataclass(frozen=True)
class VerdictText:
    """Verdict of a run: label of the run, its state and its line.

    The state is ``passed``, ``failed``, ``incomplete`` or ``none``; ``failed`` also for a run that is not tracked.
    """

    label: str
    state: str
    text: str


@dataclass(frozen=True)
class CriterionCells:
    """One criterion: name, limit with unit, and value, state, time and place of the worst value for every run."""

    words: str
    limit: str
    cells: list[tuple[str, str, str]]

    @property
    def failed(self) -> bool:
        """True if a run fails the criterion."""
        return any(state == STATES[False] for _, state, _ in self.cells)


def verdict_texts(pages: Sequence[PageData]) -> list[VerdictText]:
    """Return the verdicts of the runs with metrics."""
    return [
        VerdictText(data.label, _state(data.summary), typeset(line))
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
    error = three_digits(first.summary["speed_rmse_kmh"])
    return f"Best: {first.label} ({words}speed error {error} km/h rms). Order: tracking, verdict, failed criteria, rms."


def criterion_cells(pages: Sequence[PageData]) -> list[CriterionCells]:
    """Return the criteria that any run has, failed ones first; runs without one have a dash."""
    found = []
    for criterion in CRITERIA:
        rows = [_row(data.summary, criterion.key) for data in pages]
        limits = {row["limit"] for row in rows if row is not None}
        if not limits:
            continue
        unit = f" {criterion.unit}" if criterion.unit else ""
        limit = " / ".join(three_digits(value) for value in sorted(limits))
        cells = [_cell(row, unit) for row in rows]
        found.append(CriterionCells(criterion.words, f"{limit}{unit}", cells))
    return sorted(found + _requirement_cells(pages), key=lambda entry: not entry.failed)


def _cell(row: dict[str, Any] | None, unit: str) -> tuple[str, str, str]:
    """Return value, state, time and place of a criterion of a run; a dash without it."""
    return ("–", "none", "") if row is None else (_value(row["value"], unit), STATES[row["passed"]], place_text(row))


def _requirement_cells(pages: Sequence[PageData]) -> list[CriterionCells]:
    """Return the requirements that any run has, with their robustness; its limit is 0."""
    named: dict[tuple[str, str], None] = {}
    for data in pages:
        named |= {(row["criterion"], row["formula"]): None for row in _rows(data.summary) if "formula" in row}
    found = []
    for name, formula in named:
        rows = [next((row for row in _rows(data.summary) if row.get("formula") == formula), None) for data in pages]
        cells = [_cell(row, f" {row['unit']}" if row and row["unit"] else "") for row in rows]
        found.append(CriterionCells(f"{name}: {typeset(formula)}", "robustness 0", cells))
    return found


def _rows(summary: dict[str, Any]) -> Sequence[dict[str, Any]]:
    return summary.get("criteria") or ()


def _row(summary: dict[str, Any], key: str) -> dict[str, Any] | None:
    return next((row for row in _rows(summary) if row["criterion"] == key), None)


def _value(value: Any, unit: str) -> str:
    return "–" if value is None else typeset(f"{three_digits(value)}{unit}")


def typeset(text: str) -> str:
    """Return a text with the signs of a page: minus and ellipsis."""
    signed = re.sub(r"(?<![\w-])-(?=\d)", "−", text)
    return signed.replace("...", "…")
