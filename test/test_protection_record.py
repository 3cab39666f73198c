"""States of supervision, train and ATO in the summary, the printed table and the line on stderr."""

import json
from pathlib import Path

import pytest

import train_ato as ta
from train_ato.cli.main import main
from train_ato.judge.protection_record import (
    StateSpan,
    protection_note,
    protection_summary,
    state_spans,
    summary_events,
)
from train_ato.messages.types import Diagnostic

pytestmark = pytest.mark.usefixtures("without_figure")


def report(time: float, node: str, message: str, **values: str) -> Diagnostic:
    return Diagnostic(round(time * 1e9), node, 0, message, values)


def supervised(*states: tuple[float, str, str]) -> list[Diagnostic]:
    return [report(at, "supervisor", state, **({"reason": reason} if reason else {})) for at, state, reason in states]


def test_equal_states_are_one_span_with_the_first_reason() -> None:
    """Breaks if a report of every second begins a new state, or a span ends at its own last report."""
    found = state_spans(
        [
            report(0.0, "plant", "running"),
            report(1.0, "plant", "coast", protection="no command for 0.6 s"),
            report(2.0, "plant", "coast", protection="no command for 1.5 s"),
            report(2.5, "controller", "engaged", ato_state="engaged", ato_reason="request"),
            report(3.0, "plant", "running"),
            report(4.0, "plant", "running"),
        ],
        "plant",
    )
    assert found == [
        StateSpan(0.0, 1.0, "running", ""),
        StateSpan(1.0, 3.0, "coast", "no command for 0.6 s"),
        StateSpan(3.0, 4.0, "running", ""),
    ]


@pytest.mark.parametrize(
    ("states", "count", "first"),
    [
        ([(0, "normal", ""), (9, "warning", "82 km/h")], 0, None),
        ([(0, "normal", ""), (9, "service brake", "84 km/h"), (12, "emergency brake", "88 km/h")], 1, 9.0),
        ([(0, "emergency brake", "a"), (8, "normal", ""), (9, "service brake", "b"), (10, "normal", "")], 2, 0.0),
    ],
)
def test_an_intervention_ends_with_the_release(states: list[tuple[float, str, str]], count: int, first: float) -> None:
    """Breaks if a rising reaction counts twice, a warning counts, or a second intervention is left out."""
    found = protection_summary(supervised(*states))
    assert (found["brake_interventions"], found["first_intervention_s"]) == (count, first)
    reasons = [f"{state}: {why}" for _, state, why in states if "brake" in state]
    assert found["first_intervention"] == (reasons[0] if reasons else None)


def test_the_end_of_the_last_engagement_counts() -> None:
    """Breaks if an earlier disengagement, or the last change of the state, is taken for the end of the engagement."""
    states = [(0, "engaged", "start"), (5, "disengaging", "a"), (9, "engaged", "request"), (20, "failure", "b")]
    rows = [report(at, "controller", "x", ato_state=state, ato_reason=why) for at, state, why in states]
    found = protection_summary([*supervised((0, "normal", "")), *rows])
    assert (found["ato_state"], found["ato_disengaged_s"], found["ato_disengaged"]) == ("failure", 20.0, "b")
    found = protection_summary([*supervised((0, "normal", "")), *rows[:3]])
    assert (found["ato_state"], found["ato_disengaged_s"]) == ("engaged", None)
    assert summary_events(found) == ""


def test_a_braked_run_has_the_reason_in_summary_table_and_line(tmp_path, capsys):
    """Breaks if an intervention is not counted, the strongest reaction is that of the end, or the line is missing."""
    folder = tmp_path / "run"
    gust = "--set=interventions=[{at: 150, do: gust, acceleration: 0.5, duration: 60}]"  # faster than the limit
    assert main(["run", "demo", "--engine", "--set=duration=280", gust, "--out", str(folder)]) == 0
    printed = capsys.readouterr()
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["brake_interventions"] == 1
    assert summary["first_intervention"].startswith("service brake: 8")
    assert summary["strongest_reaction"] == "emergency brake"
    assert summary["ato_state"] == "ready"
    assert summary["first_intervention_s"] < summary["ato_disengaged_s"] < 210.0
    assert "interventions of the supervisor" in printed.out
    (line,) = (line for line in printed.err.splitlines() if line.startswith("train-ato: "))
    assert line == f"train-ato: {protection_note(summary, str(folder))}"
    for part in (summary["first_intervention"], "service brake in effect", f"report {folder}", "inject engage"):
        assert part in line
    opened = ta.open_run(folder)
    assert "<td>strongest reaction of the train</td><td>emergency brake</td>" in opened._repr_html_()


def test_a_run_without_events_has_no_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if every supervised run has the line, or a run without a supervisor has new entries."""
    options = ["run", "demo", "--engine", "--set=duration=3", "--json"]
    assert main([*options, "--out", str(tmp_path / "a")]) == 0
    printed = capsys.readouterr()
    assert "train-ato: " not in printed.err
    summary = json.loads(printed.out)
    new = {"brake_interventions": 0, "strongest_reaction": "none", "ato_state": "engaged"}
    assert new.items() <= summary.items()
    assert main([*options, "--set=supervision.enabled=false", "--out", str(tmp_path / "b")]) == 0
    plain = json.loads(capsys.readouterr().out)
    others = "first_intervention first_intervention_s takeovers first_takeover first_takeover_s ato_disengaged"
    assert set(summary) - set(plain) == {*new, *others.split(), "ato_disengaged_s"}


def test_a_comparison_names_the_braked_law(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Breaks if a law that the supervisor replaced is compared without a notice."""
    options = ["compare", "demo", "--laws=pid,smc", "--set=duration=6", "--out", str(tmp_path / "both")]
    assert main([*options, "--set=ato_requests=[{at: 2, do: disengage}]"]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "ATO was disengaged at 2.0 s (request)" in line]
    assert [line.split(": ")[1] for line in lines] == ["pid", "smc"]
