"""Framework of ``train-ato reproduce``: cases run once in workers, failures become verdicts, no process remains."""

import json
import multiprocessing
import os
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

from train_ato.cli.main import main
from train_ato.papers import claims, paper_packages, session
from train_ato.papers import claims as c
from train_ato.papers.drawing import HELD, panels, save, trace
from train_ato.papers.p002_freight import checks as p002
from train_ato.papers.p003_funnel import claims as p003
from train_ato.papers.p004_gpc import checks as p004
from train_ato.scenario.scenario import load_scenario

SHORT = c.Case("demo", {"duration": 2})


def measure(log: str, value: float) -> tuple[dict[str, Any], dict[str, Any]]:
    """Append a line to a file and return a figure, so that the calls can be counted."""
    with Path(log).open("a", encoding="utf-8") as file:
        file.write(f"{os.getpid()}\n")
    return {"value": value}, {"squares": [value, value**2]}


def counted(folder: Path, value: float = 1.0, full_only: bool = False) -> c.Calculation:
    return c.Calculation(measure, {"log": str(folder / "calls"), "value": value}, full_only=full_only)


def die() -> tuple[dict[str, Any], dict[str, Any]]:
    os._exit(7)


def _holds(results: c.Results) -> c.Judgement:
    value = next(iter(results.values())).summary["value"]
    verdict = c.Verdict.REPRODUCED if value < 2 else c.Verdict.NOT_REPRODUCED
    return c.Judgement(f"{value}", verdict, "below 2", (c.Bound("value", 2.0, "", "test").check(value),))


def _paper(cases: Mapping[str, c.Case | c.Calculation], *claims: c.Claim, **more: Any) -> c.Paper:
    return c.Paper("999", "a paper", dict(cases), claims, more.pop("figures", lambda results, folder: []), **more)


def _run(papers: list[c.Paper], folder: Path, full: bool = False) -> list[session.Judged]:
    done: list[session.Judged] = []
    session.reproduce(papers, folder, full=full, jobs=2, done=done.append, progress=lambda event, total: None)
    return done


def test_equal_cases_of_several_papers_run_once(tmp_path: Path) -> None:
    """Breaks if a case is run for every claim or key that names it, or one failed figure loses the verdicts."""
    log, case = tmp_path / "calls", counted(tmp_path)
    claims = [c.Claim("first", "1", ("a",), _holds), c.Claim("second", "1", ("b",), _holds)]
    fails = Mock(side_effect=KeyError("gone"))
    done = _run([_paper({"a": case, "b": case}, *claims, figures=fails), _paper({"c": case})], tmp_path)
    assert "gone" in done[0].complaints[0]
    assert len(log.read_text().split()) == 1
    assert str(os.getpid()) not in log.read_text().split()
    assert [row["verdict"] for row in done[0].rows] == ["reproduced", "reproduced"]
    assert done[1].results["c"].series["squares"] == [1.0, 1.0]


def test_an_engine_case_brings_summary_and_series_without_supervision() -> None:
    """Breaks if an overlay is not applied, series are lost, or the supervisor brakes an inaccurate law of a paper."""
    assert not SHORT.setup().scenario.supervision.enabled
    result = session.carry_out(SHORT)
    assert result.failure is None and result.summary["simulated_s"] == 2
    assert result.recording is not None and result.recording.time.size == 20


@pytest.mark.parametrize(
    ("case", "says"),
    [
        (c.Case("no_such_scenario"), "no_such_scenario"),
        (c.Case("demo", {"duration": -1}), "duration"),
        (c.Case("demo", {"laws": {"pid": {"kq": 1}}}), "kq"),
        (c.Calculation(measure, {"wrong": 1}), "TypeError"),
        (c.Calculation(die), "exit code 7"),
    ],
)
def test_a_failing_case_is_not_reproduced_with_its_reason(case: Any, says: str, tmp_path: Path) -> None:
    """Breaks if a failure ends the whole reproduction, or is judged as if it had run."""
    claims = [c.Claim("bad", "-", ("bad",), _holds), c.Claim("good", "-", ("good",), _holds)]
    (done,) = _run([_paper({"bad": case, "good": counted(tmp_path)}, *claims)], tmp_path)
    bad, fine = done.rows
    assert bad["verdict"] == "not reproduced" and says in bad["reason"]
    assert "\n" not in bad["reason"] and "Traceback" not in bad["reason"]
    assert fine["verdict"] == "reproduced"


def test_a_judge_may_ask_for_failed_runs() -> None:
    """Breaks if a claim that a law diverges cannot be judged because its run ended early."""

    def diverged(results: c.Results) -> c.Judgement:
        return c.Judgement(results["a"].failure or "", c.Verdict.REPRODUCED, "it diverged")

    results = {"a": c.Result({}, None, "controller: too far")}
    strict, lenient = (c.Claim("x", "-", ("a",), diverged, takes_failures=taken) for taken in (False, True))
    rows = session.judge_paper(_paper({"a": SHORT}, strict, lenient), results, full=False)
    assert [row["verdict"] for row in rows] == ["not reproduced", "reproduced"]


def test_a_judge_that_cannot_work_with_the_figures_is_no_traceback() -> None:
    """Breaks if a missing figure ends the command."""
    row = session.judge_paper(
        _paper({"a": SHORT}, c.Claim("x", "-", ("a",), _holds)), {"a": c.Result({}, None)}, full=False
    )[0]
    assert row["verdict"] == "not reproduced" and "value" in row["reason"]


def test_long_cases_and_their_claims_wait_for_full(tmp_path: Path) -> None:
    """Breaks if a long case is run, a claim is judged without its case, or ``--claim`` runs or judges others."""
    cases = {"short": counted(tmp_path), "long": counted(tmp_path, 2.0, full_only=True)}
    claims = (c.Claim("s", "-", ("short",), _holds), c.Claim("l", "-", ("short", "long"), _holds))
    paper = _paper(cases, *claims)
    assert [claim.text for claim in session.claims_of(paper, full=False)] == ["s"]
    (quick,) = _run([paper], tmp_path)
    assert list(quick.results) == ["short"] and len(quick.rows) == 1
    (whole,) = _run([paper], tmp_path, full=True)
    assert list(whole.results) == ["short", "long"] and len(whole.rows) == 2
    (done,) = _run(session.with_claim([replace(paper, number="998")], "S"), tmp_path, full=True)
    assert list(done.results) == ["short"] and [row["claim"] for row in done.rows] == ["s"]
    assert not done.complaints and not done.figures
    with pytest.raises(ValueError, match="--claim 'wild': in no claim of 999"):
        session.with_claim([paper], "wild")


def test_a_judged_paper_is_not_run_again(tmp_path: Path) -> None:
    """Breaks if a resumed command runs a judged paper again, loses its rows, or takes those of other code or claims."""
    log, case = tmp_path / "calls", counted(tmp_path)
    paper = _paper({"a": case}, c.Claim("tracks", "-", ("a",), _holds))
    other = replace(paper, number="998")
    assert len(_run([paper], tmp_path)) == 1
    assert [done.paper.number for done in _run([paper, other], tmp_path)] == ["998"]
    assert len(log.read_text().splitlines()) == 2
    rows = json.loads((tmp_path / "reproduce.json").read_text())
    assert [row["paper"] for row in rows] == ["998", "999"]
    assert "998" in (page := (tmp_path / "reproduce.md").read_text()) and "999" in page
    file = tmp_path / "paper999.json"
    file.write_text(file.read_text().replace('"code": "', '"code": "0'))
    assert [done.paper.number for done in _run([paper, other], tmp_path)] == ["999"]
    asked = replace(paper, claims=[c.Claim("stays calm", "-", ("a",), _holds)])
    assert [row["claim"] for done in _run([asked], tmp_path) for row in done.rows] == ["stays calm"]


def test_figures_are_for_print(tmp_path: Path) -> None:
    """Breaks if a figure has no PDF, fewer than 300 dpi, no letters, or its caption is drawn or lost."""
    figure, (first, second) = panels(2, "speed over time")
    time = np.arange(1e5)
    spike = np.where(time == 54_321, 7.0, 0.0)
    trace(first, [("run", time, spike)], "speed in m/s", minutes=False)
    trace(second, [("run", time, spike)], "speed in m/s", minutes=False, **HELD)
    drawn = save(figure, tmp_path / "speed.png")
    assert drawn == c.FigureFile(tmp_path / "speed.png", "Speed over time")
    assert (tmp_path / "speed.pdf").read_bytes().startswith(b"%PDF")
    with Image.open(drawn.path) as picture:
        assert picture.info["dpi"] == pytest.approx((300, 300), abs=1)
    assert [panel.get_title(loc="left") for panel in (first, second)] == ["a", "b"]
    assert first.lines[0].get_ydata().max() == 7.0 and first.lines[0].get_ydata().size < 1e4
    assert second.lines[0].get_drawstyle() == "steps-post"
    paper = _paper({"a": SHORT}, c.Claim("s", "-", ("a",), _holds))
    assert "| `speed` | Speed over time |" in session.section(paper, [], {}, [drawn])


def test_leaving_the_pool_ends_its_workers(tmp_path: Path) -> None:
    """Breaks if Ctrl-C in the middle of a run leaves a process behind."""
    cases = [(str(number), c.Case("demo", {"seed": number})) for number in range(4)]
    with pytest.raises(KeyboardInterrupt), closing(session.run_cases(cases, 2)) as events:
        for _ in events:
            processes = multiprocessing.active_children()
            raise KeyboardInterrupt
    assert len(processes) == 2
    assert not any(process.is_alive() for process in processes)


def test_progress_comes_while_a_case_runs() -> None:
    """Breaks if a case reports no progress before its end."""
    events = list(session.run_cases([("a", c.Case("demo", {"duration": 400}))], 1))
    assert isinstance(events[-1], session.Finished) and events[-1].result.failure is None
    fractions = [event.fraction for event in events if not isinstance(event, session.Finished)]
    assert fractions and fractions == sorted(fractions) and 0 < fractions[-1] <= 1


@pytest.mark.parametrize("number", paper_packages())
def test_every_paper_is_consistent(number: str) -> None:
    """Breaks if a claim names a missing case, a case cannot be prepared, a table has none, or a paper no claim."""
    paper = session.load_paper(number)
    assert paper.number == number and paper.claims and paper.title
    assert len({claim.text for claim in paper.claims}) == len(paper.claims)
    for claim in paper.claims:
        assert claim.cases and set(claim.cases) <= set(paper.cases), claim.text
        assert "\n" not in claim.text + claim.stated
    for key, case in paper.cases.items():
        if isinstance(case, c.Case):
            scenario, _ = load_scenario(case.scenario, changes=dict(case.changes))
            assert scenario.duration > 0, key
    assert all(isinstance(table, c.CaseTable) for table in paper.tables)
    columns = {"002": (p002.LAWS, p002.DELAYS), "003": (p003.LAWS, ("nominal",)), "004": (p004.LAWS, p004.TRAINS)}
    assert {f"{law} {column}" for law, column in product(*columns.get(number, ((), ())))} <= set(paper.cases)


def test_a_run_of_a_paper_that_is_named_twice_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the later of two runs with one name replaces the earlier without a word."""
    (tmp_path / "cases.yaml").write_text("laws: {}\nprinted_forms: []\nsingle:\n" + "  a: {scenario: demo}\n" * 2)
    monkeypatch.setattr(claims, "files", lambda package: tmp_path)
    with pytest.raises(ValueError, match="line 5: key 'a' is repeated"):
        claims.read_paper_runs("papers")


def test_an_unknown_paper_is_refused_by_name() -> None:
    """Breaks if a wrong number ends in a traceback."""
    with pytest.raises(ValueError, match="paper '017': unknown"):
        session.load_paper("017")


def _command(monkeypatch: pytest.MonkeyPatch, paper: c.Paper, folder: Path, *options: str) -> int:
    monkeypatch.setattr("train_ato.papers.session.load_paper", lambda number: paper)
    monkeypatch.setattr("train_ato.cli.reproduce.note_compilation", lambda: None)
    return main(["reproduce", "000", "--out", str(folder), "--jobs", "1", *options])


def test_the_command_writes_rows_page_and_tables_and_prints_one_json_value(tmp_path, monkeypatch, capsys):
    """Breaks if a row lacks a documented key, the page a claim, count or table, a bar breaks it, or stdout has more."""
    table = c.CaseTable("squares", ("law", "square"), lambda results: [("pid", results["a"].summary["value"])])
    broken = c.CaseTable("lost", ("law",), lambda results: [(results["b"],)])
    case, folder = counted(tmp_path, 3.0), tmp_path / "out"
    paper = _paper({"a": case}, c.Claim("[small] | fast", "below 2", ("a",), _holds), tables=(table, broken))
    assert _command(monkeypatch, paper, folder, "--json") == 0
    rows = json.loads(capsys.readouterr().out)
    assert rows == json.loads((folder / "reproduce.json").read_text()) == [
        {
            "paper": "999", "claim": "[small] | fast", "stated": "below 2", "measured": "3.0",
            "verdict": "not reproduced", "reason": "below 2", "bounds": "value <= 2 (test): 3",
        }
    ]  # fmt: skip
    assert json.loads((folder / "cases.json").read_text())["999"]["a"] == {"value": 3.0}
    page, printed = ((folder / name).read_text(encoding="utf-8") for name in ("reproduce.md", "paper999.txt"))
    for text in (
        "| [small] \\| fast | below 2 | 3.0 | value <= 2 (test): 3 | not reproduced | below 2 |",
        f"| {paper.number}: {paper.title} | 0 | 0 | 1 | - |", "| pid | 3 |", "not available: KeyError",
    ):  # fmt: skip
        assert text in page, text
    assert "[small] | fast" in printed and "squares" in printed


def test_an_interrupted_command_leaves_no_empty_folder(tmp_path, monkeypatch, capsys):
    """Breaks if Ctrl-C before the first verdict leaves a folder, a traceback or exit status 0."""
    monkeypatch.setattr("train_ato.papers.session.reproduce", Mock(side_effect=KeyboardInterrupt))
    folder = tmp_path / "out"
    assert _command(monkeypatch, _paper({"a": SHORT}), folder) == 1
    assert capsys.readouterr().err == "train-ato: interrupted\n"
    assert not folder.exists()
