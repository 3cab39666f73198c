"""Markdown page with claims, verdicts and tables of a reproduction."""

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from train_ato.judge.metric_names import format_value
from train_ato.papers import claims as c

Row = dict[str, str]
"""One line of ``reproduce.json``: paper, claim, stated, measured, verdict, reason, bounds."""


def cases_of(paper: c.Paper, *, full: bool) -> dict[str, c.Case | c.Calculation]:
    """Return the cases to run, in their order."""
    return {key: case for key, case in paper.cases.items() if full or not case.full_only}


def claims_of(paper: c.Paper, *, full: bool) -> list[c.Claim]:
    """Return the claims to judge: all under ``full``, else those without long cases."""
    short = cases_of(paper, full=False)
    return [claim for claim in paper.claims if full or not (claim.full_only or set(claim.cases) - set(short))]


def judge_paper(paper: c.Paper, results: c.Results, *, full: bool) -> list[Row]:
    """Return one row per claim."""
    return [_row(paper, claim, _judged(claim, results)) for claim in claims_of(paper, full=full)]


def _row(paper: c.Paper, claim: c.Claim, judgement: c.Judgement) -> Row:
    return {
        "paper": paper.number,
        "claim": claim.text,
        "stated": claim.stated,
        "measured": judgement.measured,
        "verdict": judgement.verdict.value,
        "reason": judgement.reason,
        "bounds": "; ".join(str(check) for check in judgement.checks),
    }


def _judged(claim: c.Claim, results: c.Results) -> c.Judgement:
    """Return the judgement; "not reproduced" after a failed run or an error of the judge."""
    needed: Mapping[str, c.Result] = {key: results[key] for key in claim.cases}
    failures = [f"{key}: {result.failure}" for key, result in needed.items() if result.failure]
    if failures and not claim.takes_failures:
        return c.Judgement("-", c.Verdict.NOT_REPRODUCED, "the run failed: " + "; ".join(failures))
    try:
        return claim.judge(needed)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        reason = f"the runs have no figures to judge ({type(error).__name__}: {error})"
        return c.Judgement("-", c.Verdict.NOT_REPRODUCED, "; ".join([*failures, reason]))


INTRODUCTION = Path(__file__).with_name("introduction.md")
FORMER: Mapping[str, tuple[int, int, int]] = {
    "000": (14, 6, 4), "001": (12, 1, 3), "002": (3, 8, 1), "003": (7, 4, 0), "004": (2, 8, 0),
}  # fmt: skip
"""Number of claims by verdict before the bounds had sources."""


def table_rows(table: c.CaseTable, results: c.Results) -> Sequence[Sequence[str]]:
    """Return the rows of a table as text; one row with the reason if a run is missing or failed."""
    try:
        return [[format_value(entry) for entry in row] for row in table.rows(results)]
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        return [(f"not available: {type(error).__name__}: {error}",)]


def papers_overview(rows: Iterable[Row], papers: Mapping[str, c.Paper], options: str) -> str:
    """Return the head of the page: introduction, and number of claims by paper and verdict."""
    counted = Counter((row["paper"], row["verdict"]) for row in rows)
    verdicts = [verdict.value for verdict in c.Verdict]
    lines = [
        (
            f"{number}: {papers[number].title}",
            *(counted[number, verdict] for verdict in verdicts),
            " / ".join(str(count) for count in FORMER.get(number, ())),
        )
        for number in sorted(papers)
    ]
    shares = {
        "better": c.BETTER, "much": c.MUCH_BETTER, "removed": c.REMOVED, "unchanged": c.UNCHANGED, "robust": c.ROBUST,
        "about": c.ABOUT,
    }  # fmt: skip
    head = INTRODUCTION.read_text(encoding="utf-8").format(options=options, **shares)
    return head + "\n" + _table(("paper", *verdicts, "before"), lines)


def section(paper: c.Paper, rows: Iterable[Row], results: c.Results, figures: Iterable[c.FigureFile]) -> str:
    """Return the section of a paper: the rows of its claims, the tables of its cases, the captions of its figures."""
    keys = ("claim", "stated", "measured", "bounds", "verdict", "reason")
    claims = [[by_lines(row[key]) for key in keys] for row in rows]
    parts = [
        f"## Paper {paper.number}: {paper.title}\n",
        _table(("claim", "paper", "here", "bounds", "verdict", "reason"), claims),
    ]
    for table in paper.tables:
        title = " ".join(table.title.split())
        parts += [f"{title}:\n\n{_table(table.columns, table_rows(table, results))}"]
    drawn = [(f"`{figure.path.stem}`", figure.caption) for figure in figures]
    if drawn:
        head = "Figures in the folder of `train-ato reproduce`, as PNG (300 dpi) and PDF:\n\n"
        parts.append(head + _table(("file", "caption"), drawn))
    return "\n".join(parts)


def _table(heads: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a Markdown table; rows may be shorter than the head."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "".join("| " + " | ".join(_cell(entry) for entry in line) + " |\n" for line in lines)


def by_lines(text: str) -> str:
    """Return a text of a claim with each part up to a semicolon outside of brackets in a line of its own.

    Examples
    --------
    >>> by_lines("rms <= 2 (paper; table 1): 1; largest <= 3 (goal): 2")
    'rms <= 2 (paper; table 1): 1<br>largest <= 3 (goal): 2'
    """
    return re.sub(r"; (?![^(]*\))", "<br>", text)


def _cell(entry: Any) -> str:
    return " ".join(str(entry).split()).replace("|", "\\|") or "-"
