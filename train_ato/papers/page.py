"""The claims, verdicts and tables of a reproduction as one Markdown page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from train_ato.reproduce.claims import Paper, Results, Table, Verdict
from train_ato.reproduce.judging import Row

__all__ = ["overview", "section", "table_rows"]

INTRODUCTION = """\
# What the papers claim and what holds here

Written by `train-ato reproduce{options}`. Every figure is of a run of that command on the shipped scenarios.
"Reproduced" is what holds as the paper states it; "only in another setting" is what holds after the change that the
reason names. "Goal" marks claims that are not the paper's but ours; "independent" are the figures of an earlier
implementation of the same corrected equations, on another driver's run or reference where the paper gives none.
"""


def table_rows(table: Table, results: Results) -> Sequence[Sequence[Any]]:
    """Return a table's rows; one row that says why where a run that it needs is missing or failed."""
    try:
        return table.rows(results)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        return [(f"not available: {type(error).__name__}: {error}",)]


def overview(rows: Iterable[Row], papers: Mapping[str, Paper], options: str) -> str:
    """Return the head of the page: what it is, and how many claims of each paper got which verdict."""
    counted = Counter((row["paper"], row["verdict"]) for row in rows)
    verdicts = [verdict.value for verdict in Verdict]
    lines = [
        (f"{number}: {papers[number].title}", *(counted[number, verdict] for verdict in verdicts))
        for number in sorted(papers)
    ]
    return INTRODUCTION.format(options=options) + "\n" + _table(("paper", *verdicts), lines)


def section(paper: Paper, rows: Iterable[Row], results: Results, figures: Iterable[str], shown: Any = str) -> str:
    """Return a paper's part of the page.

    Parameters
    ----------
    paper, rows, results
        The paper, its judged claims and its cases' results.
    figures
        Names of the drawings that lie beside the page.
    shown
        Turns a figure of a table into text.
    """
    claims = [(row["claim"], row["stated"], row["measured"], row["verdict"], row["reason"]) for row in rows]
    parts = [
        f"## Paper {paper.number}: {paper.title}\n",
        _table(("claim", "paper", "here", "verdict", "reason"), claims),
    ]
    for table in paper.tables:
        lines = [[shown(entry) for entry in row] for row in table_rows(table, results)]
        parts.append(f"{' '.join(table.title.split())}:\n\n" + _table(table.columns, lines))
    drawn = ", ".join(f"`{name}`" for name in figures)
    return "\n".join(parts) + (f"\nDrawn beside this page: {drawn}.\n" if drawn else "")


def _table(heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a Markdown table; rows may be shorter than the head."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "".join("| " + " | ".join(_cell(entry) for entry in line) + " |\n" for line in lines)


def _cell(entry: Any) -> str:
    return " ".join(str(entry).split()).replace("|", "\\|")
