"""Rows of verdicts from the results of a paper."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from train_ato.papers.claims import Calculation, Case, Claim, Judgement, Paper, Result, Results, Verdict

Row = dict[str, str]
"""One line of ``reproduce.json``: paper, claim, stated, measured, verdict, reason, bounds."""


def cases_of(paper: Paper, full: bool) -> dict[str, Case | Calculation]:
    """Return the cases to run, in their order."""
    return {key: case for key, case in paper.cases.items() if full or not case.full_only}


def claims_of(paper: Paper, full: bool) -> list[Claim]:
    """Return the claims to judge: all under ``full``, else those without long cases."""
    short = cases_of(paper, False)
    return [claim for claim in paper.claims if full or not (claim.full_only or set(claim.cases) - set(short))]


def judge_paper(paper: Paper, results: Results, full: bool) -> list[Row]:
    """Return one row per claim."""
    return [_row(paper, claim, _judged(claim, results)) for claim in claims_of(paper, full)]


def _row(paper: Paper, claim: Claim, judgement: Judgement) -> Row:
    return {
        "paper": paper.number,
        "claim": claim.text,
        "stated": claim.stated,
        "measured": judgement.measured,
        "verdict": judgement.verdict.value,
        "reason": judgement.reason,
        "bounds": "; ".join(str(check) for check in judgement.checks),
    }


def _judged(claim: Claim, results: Results) -> Judgement:
    """Return the judgement; "not reproduced" after a failed run or an error of the judge."""
    needed: Mapping[str, Result] = {key: results[key] for key in claim.cases}
    failures = [f"{key}: {result.failure}" for key, result in needed.items() if result.failure]
    if failures and not claim.takes_failures:
        return Judgement("-", Verdict.NOT_REPRODUCED, "the run failed: " + "; ".join(failures))
    try:
        return claim.judge(needed)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        reason: Any = f"the runs have no figures to judge ({type(error).__name__}: {error})"
        return Judgement("-", Verdict.NOT_REPRODUCED, "; ".join([*failures, reason]))
