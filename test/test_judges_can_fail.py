"""Every judge of every paper with absurd and borderline results: each of its verdicts is reached, none by nonsense."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from judge_trials import ABSURD, APART, BAD, ELSEWHERE, EVERY, GOOD, TRIALS, Trial

from train_ato.papers import paper_packages
from train_ato.papers.claims import CLOSE, Bound, Check, Claim, Paper, Result, Verdict
from train_ato.papers.session import claims_of, judge_paper, load_paper

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "msgs_docs" / "reproduction.md").read_text(encoding="utf-8")
PAPERS = {number: load_paper(number) for number in paper_packages()}
CLAIMS = [
    pytest.param(paper, claim, id=f"{number} {claim.text}")
    for number, paper in PAPERS.items()
    for claim in paper.claims
]


def only(number: str, claim: Claim) -> Trial:
    """Return the one trial of a claim."""
    (trial,) = (trial for trial in TRIALS.get(number, ()) if claim.text.startswith(trial.claim))
    return trial


def verdict(paper: Paper, claim: Claim, results: dict[str, Result]) -> Verdict:
    """Return the verdict as on the page: failed runs and errors of the judge included."""
    (row,) = judge_paper(replace(paper, claims=[claim]), results, full=True)
    return Verdict(row["verdict"])


@pytest.mark.parametrize(("paper", "claim"), CLAIMS)
def test_every_claim_has_one_trial(paper: Paper, claim: Claim) -> None:
    """Breaks if a claim has no made-up results or shares them, or is removed and its trial remains."""
    trial = only(paper.number, claim)
    assert len(TRIALS[paper.number]) == len(paper.claims), "a trial of a claim that was removed"
    assert trial.others <= set(claim.cases), "others that are no cases of the claim"
    assert sum(entry.text.startswith(trial.claim) for entry in paper.claims) == 1
    named = {*trial.good, *(trial.elsewhere or {}), *(key for entry in trial.edges for key in entry.keys)}
    assert named <= set(claim.cases), "figures of a missing case"


@pytest.mark.parametrize(("paper", "claim"), CLAIMS)
def test_declared_verdicts_are_reached_and_no_other(paper: Paper, claim: Claim) -> None:
    """Breaks if a judge cannot say no or yes, returns another verdict, raises, or reproduces lost runs or NaN."""
    trial = only(paper.number, claim)
    good = trial.results(claim)
    found = {kind: verdict(paper, claim, {key: spoil(result) for key, result in good.items()})
             for kind, spoil in EVERY.items()}  # fmt: skip
    assert set(found.values()) <= claim.verdicts and {found[kind] for kind in ABSURD} == {BAD}
    assert verdict(paper, claim, good) is GOOD
    there = set()
    if trial.elsewhere is not None:
        there = {verdict(paper, claim, trial.results(claim, elsewhere=True))}
        assert there == {ELSEWHERE}
    assert claim.verdicts == {GOOD, BAD} | there


@pytest.mark.parametrize(("paper", "claim"), CLAIMS)
def test_nonsense_in_one_run_of_the_law_is_not_reproduced(paper: Paper, claim: Claim) -> None:
    """Breaks if a judge ignores one of the runs of the judged law, such as a train or a delay."""
    trial = only(paper.number, claim)
    good = trial.results(claim)
    for key in set(claim.cases) - trial.others:
        for kind, nonsense in ABSURD.items():
            found = verdict(paper, claim, {**good, key: nonsense(good[key])})
            assert found is not GOOD, f"{kind} in {key}"
        apart = {verdict(paper, claim, {**good, key: nonsense(good[key])}) for nonsense in APART.values()}
        assert apart != {GOOD}, f"neither position nor speed nor force in {key} matters"


@pytest.mark.parametrize(("paper", "claim"), CLAIMS)
def test_a_verdict_changes_at_its_bounds(paper: Paper, claim: Claim) -> None:
    """Breaks if a figure just beyond a bound is reproduced, one within is not, or a bound has no source or trial."""
    sides: dict[Bound, set[bool]] = {}
    for entry, *pair in only(paper.number, claim).at_edges(claim):
        expected = ELSEWHERE if entry.elsewhere else GOOD
        assert [verdict(paper, claim, results) is expected for results in pair] == [True, False], entry
        for results in pair:
            for check in claim.judge(results).checks:
                sides.setdefault(check.bound, set())
                if check.close:
                    sides[check.bound].add(check.holds)
    assert sides, "no bounds"
    untried = [f"{bound.quantity} {bound.limit:g}: {tried}" for bound, tried in sides.items() if len(tried) < 2]
    assert not untried and all(bound.source for bound in sides)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("least", [False, True])
def test_no_bound_is_met_without_a_finite_figure(value: float, least: bool) -> None:
    """Breaks if NaN or infinity pass a comparison."""
    assert not Bound("error", 1.0, "m", "test", least=least).check(value).holds


def test_a_close_figure_is_marked() -> None:
    """Breaks if a figure within 3 % of its bound is shown without a note."""
    bound = Bound("error", 1.0, "m", "paper")
    assert "within 3 %: no reason given" in str(Check(bound, 1.0 - 0.9 * CLOSE))
    assert "within 3 %: by design" in str(Check(replace(bound, note="by design"), 1.0 + 0.9 * CLOSE))
    assert "within" not in str(Check(bound, 1.0 - 1.1 * CLOSE))


def test_both_pages_count_the_same_verdicts_and_explain_close_figures() -> None:
    """Breaks if a figure within 3 % of its bound has no note, or the table of the papers keeps old counts."""
    assert "(paper): " in PAGE
    assert [line for line in PAGE.splitlines() if "no reason given" in line] == []
    pattern = re.compile(r"^\| (\d{3})[,:].*?((?: \| \d+){3}) (?=\|)", re.MULTILINE)
    measured = (ROOT / "msgs_docs" / "measured.md").read_text(encoding="utf-8")
    page, table = (dict(pattern.findall(text)) for text in (PAGE, measured))
    assert page.keys() == set(PAPERS) and table == page


@pytest.mark.parametrize("number", PAPERS)
def test_the_page_has_every_claim(number: str) -> None:
    texts = [claim.text for claim in claims_of(PAPERS[number], full=False)]
    assert [text for text in texts if f"| {text.replace('|', chr(92) + '|')} |" not in PAGE] == []
