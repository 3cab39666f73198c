"""First screen and protection of a report and of a summary: verdict, criteria, states, events, comparison."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from chromium import Page, browser
from report_runs import drive, without

import train_ato as ta
from train_ato.cli.info import print_summary
from train_ato.cli.main import main
from train_ato.judge.protection_record import (
    StateSpan,
    protection_note,
    protection_summary,
    state_spans,
    summary_events,
)
from train_ato.judge.ranking import best_value, difference_from_best, rank_of
from train_ato.log.reading import read_log
from train_ato.log.recorded import open_recording
from train_ato.log.run_folder import read_run_folder
from train_ato.messages.codec import Wire
from train_ato.messages.types import Diagnostic
from train_ato.report.events import detect_events
from train_ato.report.page_data import PageData, empty_page_data, page_data
from train_ato.report.page_sections import run_sections
from train_ato.report.summary_rows import (
    SUPERVISION,
    best_text,
    criterion_cells,
    filled_groups,
    run_groups,
    typeset,
    verdict_texts,
)
from train_ato.report.writing import write_page


def judged(label: str, error: float, verdict: str | None = "passed", **more: object) -> PageData:
    """Return the page of a run without data."""
    failed = [{"criterion": "overspeed", "metric": "x", "value": 2.0, "limit": 0.5, "passed": verdict != "failed"}]
    summary = {"scenario": "demo", "speed_rmse_kmh": error, "status": "done", "criteria": failed, "verdict": verdict}
    return empty_page_data(label, {**summary, **more}, "no log")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory.mktemp("verdict"), "short", "demo", "--set=duration=60")


def test_the_first_screen_has_verdict_criteria_and_speed_against_profile(run: Path) -> None:
    """Breaks if the page begins with anything else, or a criterion is missing."""
    data = page_data(open_recording(run))
    sections, _ = run_sections(data)
    assert sections[0].anchor == "verdict"
    labels = [item.label.value.partition(" (")[0] for item in sections[0].placed[0].figure.above[0].items]
    assert {"train", "profile", "permitted speed"} <= set(labels) and len(labels) == 4
    assert main(["report", str(run)]) == 0
    page = (run / "report.html").read_text()
    first = page[page.index("<main>") : page.index('<section id="summary">')]
    (text,) = re.findall(r'<p class="verdict incomplete">(.*?)</p>', first)
    assert text.startswith("incomplete: no stop was due; overspeed 0 km/h; couplers ")
    assert len(re.findall(r'<div class="card ', first)) == len(criterion_cells([data])) == 6
    assert first.count('<div class="readout"') == 1


def test_a_far_limit_does_not_squash_the_speed(run: Path) -> None:
    """Breaks if the limit of 80 km/h sets the axis of a train at 8 km/h, or the figure does not say where it is."""
    sections, _ = run_sections(page_data(open_recording(run)))
    plot = sections[0].placed[0].figure
    named = {item.label.value: item.renderers[0] for item in plot.above[0].items}
    (limit,) = [renderer for label, renderer in named.items() if label.startswith("speed limit (outside: 80")]
    assert limit not in plot.y_range.renderers
    assert named["train"] in plot.y_range.renderers and named["profile"] in plot.y_range.renderers
    assert plot.y_range.start == 0.0


def test_a_train_that_runs_backwards_has_an_axis_below_zero(tmp_path: Path) -> None:
    """Breaks if a negative speed is cut off."""
    back = drive(tmp_path, "back", "freight_consensus", "--set=duration=22")
    sections, _ = run_sections(page_data(open_recording(back)))
    assert sections[0].placed[0].figure.y_range.start != 0.0


def test_failed_criteria_are_first_with_time_and_place(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a failed criterion is behind a passed one, or the page or ``info`` has no place of its worst value."""
    kept = {"criterion": "stop_window", "metric": "stop_error_max_m", "value": 0.1, "limit": 0.5, "passed": True}
    broken = {"criterion": "jerk", "metric": "jerk_1s_max", "value": 0.2, "limit": 0.1, "passed": False}
    places = {"at_s": 1234.56, "km": 123.4567}
    page = judged("one", 0.1, "failed", criteria=[kept, {**broken, **places}])
    (words, _, first), (_, _, second) = criterion_cells([page, judged("other", 0.2)])[:2]
    assert words == "jerk over 1 s, largest"
    assert first[0] == ("0.2 m/s³", "failed", " at 1234.6 s, km 123.457")
    assert second[0] == ("0.1 m", "passed", "")
    print_summary({**page.summary, "stops": []}, "one")
    printed = capsys.readouterr().out
    assert "jerk over 1 s 0.2 m/s³ (limit 0.1) at 1234.6 s, km 123.457; no stop was due" in printed
    (line,) = [line for line in printed.splitlines() if line.startswith("jerk_1s_max")]
    assert line.split() == ["jerk_1s_max", "0.2", "0.1", "1234.6", "123.457", "failed"]


def test_the_best_run_passes_and_then_has_the_smallest_error() -> None:
    """Breaks if a failed run with a small error is the best, or an unfinished one."""
    good, better, failed = judged("good", 0.3), judged("better", 0.2), judged("failed", 0.1, "failed")
    killed = judged("killed", 0.01, status="interrupted")
    pages = [failed, good, killed, better]
    assert best_text(pages).startswith("Best: better (passed, speed error 0.2 km/h rms)")
    ranked = sorted(pages, key=lambda data: rank_of(data.summary))
    assert [data.label for data in ranked] == ["better", "good", "failed", "killed"]
    lost = judged("lost", 0.05, tracking="lost", tracking_findings=[{"outcome": "lost", "text": "900 m behind"}])
    ranked = sorted([lost, *pages], key=lambda data: rank_of(data.summary))
    assert [data.label for data in ranked][-2:] == ["lost", "killed"]
    assert best_text([good]) == "" and best_text([good, judged("other", 0.4, scenario="metro")]) == ""


def test_the_best_value_has_the_smallest_magnitude() -> None:
    """Breaks if a buff of -900 kN is better than -400 kN, or a metric without a good direction has a best value."""
    runs = [{"coupler_buff_max_kn": -900.0, "wall_s": 1.0}, {"coupler_buff_max_kn": -400.0, "wall_s": 2.0}, {}]
    assert best_value("coupler_buff_max_kn", runs) == 400.0
    assert [difference_from_best("coupler_buff_max_kn", run, runs) for run in runs] == [500.0, 0.0, None]
    assert best_value("wall_s", runs) is None
    for status in ("failed", "interrupted"):
        broken = [{"coupler_buff_max_kn": 0.0, "status": status}, *runs]
        assert [difference_from_best("coupler_buff_max_kn", run, broken) for run in broken] == [None, 500.0, 0.0, None]
    assert best_value("coupler_buff_max_kn", [{**run, "status": "failed"} for run in runs]) == 400.0
    assert best_value("coupler_buff_max_kn", [runs[0], runs[0]]) is None


def test_a_comparison_marks_the_best_values(tmp_path: Path) -> None:
    """Breaks if no value, or that of another run, is marked."""
    pages = [judged("one", 0.25), judged("two", 0.125)]
    write_page(pages, tmp_path / "page.html", compared=True)
    page = (tmp_path / "page.html").read_text()
    row = re.search(r"<tr[^>]*><td>speed error, rms</td>(.*?)</tr>", page, re.DOTALL)
    assert row is not None
    cells = re.findall(r'<td class="value( best)?">([^<]*)<span class="delta">([^<]*)</span>', row[1])
    assert cells == [("", "0.250", "+0.125"), (" best", "0.125", "best")]
    assert [entry["label"] for entry in verdict_texts(pages)] == ["one", "two"]


def test_signs_of_a_page() -> None:
    """Breaks if a hyphen in a word becomes a minus."""
    assert typeset("couplers -413 ... +505 kN (limits -1400)") == "couplers −413 … +505 kN (limits −1400)"
    assert typeset("hxd1-c80 2-3") == "hxd1-c80 2-3"


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    with browser() as opened:
        yield opened


@pytest.mark.campaign
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280, 1920])
def test_the_page_fits_the_screen_and_its_colours(run: Path, page: Page, width: int, scheme: str) -> None:
    """Breaks if the page scrolls sideways, or a figure is white on a dark page; the cursor fills the line above it."""
    assert main(["report", str(run)]) == 0
    page.console.clear()
    page.send("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    page.open((run / "report.html").as_uri(), width, 900)
    page.wait_for("Bokeh.documents.length > 0 && Bokeh.documents[0].is_idle")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    wanted = "#1a2027" if scheme == "dark" else "#ffffff"
    page.wait_for(f"[...Bokeh.index].find(v => v.model.type === 'Figure').model.background_fill_color === '{wanted}'")
    background = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (background == "rgb(18, 23, 28)") == (scheme == "dark")
    left, top, wide, high = page.evaluate(
        "(() => { const box = document.querySelector('.figure').getBoundingClientRect();"
        " return [box.left, box.top, box.width, box.height]; })()"
    )
    page.mouse("mouseMoved", left + wide / 2, top + 0.7 * high)
    readout = "[...document.querySelectorAll('.readout')].map(line => line.textContent).join('')"
    assert "profile" in page.wait_for(readout)
    assert page.console == []


def test_a_run_that_is_not_tracked_is_marked_as_failed() -> None:
    """Breaks if a lost train with passed criteria has a green line, or its line lacks the outcome."""
    lost = judged("lost", 0.05, tracking="lost", tracking_findings=[{"outcome": "lost", "text": "900 m behind"}])
    (text,) = verdict_texts([lost])
    assert text["state"] == "failed" and text["text"].startswith("lost: 900 m behind; passed (1 criterion): ")
    (text,) = verdict_texts([judged("good", 0.05, tracking="tracked", tracking_findings=[])])
    assert text["state"] == "passed" and text["text"].startswith("passed (1 criterion): ")


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


@pytest.mark.usefixtures("without_figure")
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
    assert "inject engage" not in protection_note({**summary, "status": "failed"}, str(folder)), "it is over"
    opened = ta.open_run(folder)
    assert "<td>strongest reaction of the train</td><td>emergency brake</td>" in opened._repr_html_()


@pytest.mark.usefixtures("without_figure")
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


@pytest.mark.usefixtures("without_figure")
def test_a_comparison_names_the_braked_law(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Breaks if a law that the supervisor replaced is compared without a notice."""
    options = ["compare", "demo", "--laws=pid,smc", "--set=duration=6", "--out", str(tmp_path / "both")]
    assert main([*options, "--set=ato_requests=[{at: 2, do: disengage}]"]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "ATO was disengaged at 2.0 s (request)" in line]
    assert [line.split(": ")[1] for line in lines] == ["pid", "smc"]


LIMITS = ("permitted_speed", "warning_speed", "service_brake_speed", "emergency_brake_speed")


@pytest.fixture(scope="module")
def braked_demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run in which a gust accelerates the train beyond its limit; after its stop the ATO is engaged again."""
    gust = "interventions=[{at: 150, do: gust, acceleration: 0.5, duration: 60}]"
    options = (f"--set={gust}", "--set=ato_requests=[{at: 270, do: engage}]")
    return drive(tmp_path_factory.mktemp("braked"), "run", "demo", "--set=duration=290", *options)


def test_the_limits_of_the_supervisor_are_in_the_speed_figure(braked_demo: Path) -> None:
    """Breaks if two limits are exchanged, have another unit, or are drawn at other times."""
    columns = page_data(open_recording(braked_demo)).curves["speed"].columns
    setup, _ = read_run_folder(braked_demo)
    sent = [message for _, _, message in read_log(braked_demo, Wire(setup.layout).decode, ("atp/speeds",))]
    for place, name in enumerate(LIMITS, start=1):
        values = 3.6 * np.array([message.speed[place] for message in sent])
        assert np.nanmax(columns[name]) == pytest.approx(values.max())
        assert columns[name][0] == pytest.approx(values[0])
    low, high = (columns[name] for name in ("permitted_speed", "emergency_brake_speed"))
    assert (low <= high)[np.isfinite(low)].all()
    assert np.isfinite(low).mean() > 0.95


def test_events_have_states_and_reasons(braked_demo: Path) -> None:
    """Breaks if a state has another time or reason, a change of the ATO is lost, or an event is also a fault."""
    found = detect_events(open_recording(braked_demo))
    summary = json.loads((braked_demo / "summary.json").read_text())
    kinds = ("supervision", "protection", "ato", "plan")
    texts = {kind: [event.text for event in found if event.kind == kind] for kind in kinds}
    states = [text.partition(" for ")[0] for text in texts["supervision"]]
    assert states == ["overspeed", "warning", "service brake", "emergency brake"]
    first = next(event for event in found if event.text.startswith("service brake for"))
    assert first.begin == summary["first_intervention_s"]
    assert first.text.endswith(summary["first_intervention"].removeprefix("service brake"))
    assert texts["protection"] == ["train: service brake: supervisor", "train: emergency brake: supervisor"]
    assert [text.partition(": ")[0] for text in texts["ato"] if text.startswith("ATO ")] == [
        "ATO engaged → disengaging", "ATO disengaging → available", "ATO available → ready", "ATO ready → engaged",
    ]  # fmt: skip
    assert [event.end for event in found if event.kind == "protection"][-1] < 270.0
    assert not [event for event in found if event.kind == "fault"]
    assert texts["plan"] == ["profile planned after the engagement"]


def test_a_profile_over_distance_begins_after_the_engagement(braked_demo: Path) -> None:
    """Breaks if the line of the new plan jumps back from the profile before it."""
    first, again = page_data(open_recording(braked_demo)).profiles
    assert all((np.diff(places[0]) >= 0.0).all() for places in (first, again))
    assert again[0][0] == pytest.approx(open_recording(braked_demo).front_position[2700] / 1e3, abs=0.01)


def test_page_and_print_figures_are_written(braked_demo: Path, tmp_path: Path) -> None:
    """Breaks if the page has no line or rows of the intervention, or the legends leave no room in a figure."""
    page = tmp_path / "page.html"
    assert main(["report", str(braked_demo), f"--out={page}", f"--figures={tmp_path / 'figures'}"]) == 0
    text = page.read_text()
    warning = re.search(r'class="warning">([^<]*)<', text)
    assert warning is not None
    assert warning[1].startswith("One brake intervention of the supervisor, at 192.8 s (service brake: 8")
    summary = json.loads((braked_demo / "summary.json").read_text())
    (rows,) = (rows for title, rows in run_groups(summary) if title == SUPERVISION)
    shown = {row.key: (texts[0], row.meaning) for row, texts in rows}
    assert shown["brake_interventions"][0] == "1"
    assert shown["first_intervention_s"] == (f"{summary['first_intervention_s']:.1f}", summary["first_intervention"])
    assert shown["strongest_reaction"][0] == "emergency brake"
    assert shown["ato_state"] == ("engaged", "")
    assert SUPERVISION not in [title for title, _ in filled_groups([summary, summary])]
    assert (tmp_path / "figures" / "speed.png").stat().st_size > 30_000


@pytest.mark.usefixtures("without_figure")
def test_faults_of_the_scenario_and_their_reactions_are_events(tmp_path: Path) -> None:
    """Breaks if a fault has another interval, or the reaction of the train lacks its reason."""
    faults = "{do: drop, topic: ato/command, begin: 20, end: 24}, {do: slow, node: observer, at: 5, delay: 0.2}"
    run = drive(tmp_path, "faulty", "demo", "--set=duration=30", f"--set=faults=[{faults}]")
    found = detect_events(open_recording(run))
    listed = {(event.begin, event.text, event.end) for event in found if event.kind == "fault"}
    assert (20.0, "drop ato/command: probability 1.0", 24.0) in listed
    assert (5.0, "node observer: slow by 0.2 s", None) in listed
    states = [event.text.split(": ")[1] for event in found if event.kind == "protection"]
    assert states[:2] == ["coast", "service brake"]
    assert all("no command for" in event.text for event in found if event.kind == "protection")


@pytest.mark.usefixtures("without_figure")
def test_without_supervision_nothing_is_added(braked_demo: Path, tmp_path: Path) -> None:
    """Breaks if a run or a log without a supervisor has its events, lines or rows."""
    plain = drive(tmp_path, "plain", "demo", "--set=duration=30", "--set=supervision.enabled=false",
                  "--set=interventions=[{at: 20, do: emergency_brake}]")  # fmt: skip
    recording = open_recording(plain)
    assert {event.kind for event in detect_events(recording)} == {"outside", "limit"}
    assert not set(LIMITS) & set(page_data(recording).curves["speed"].columns)
    assert SUPERVISION not in dict(run_groups(json.loads((plain / "summary.json").read_text())))
    cut = without(braked_demo, tmp_path / "cut", {"atp/speeds"})
    assert not set(LIMITS) & set(page_data(open_recording(cut)).curves["speed"].columns)
