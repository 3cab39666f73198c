"""Report of a run with brake interventions: limits of the supervisor, events, summary, line at the top."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from report_runs import drive, without

from train_ato.cli import main
from train_ato.log.reading import read_log
from train_ato.log.recorded import open_recording
from train_ato.log.run_folder import read_run_folder
from train_ato.messages.codec import Wire
from train_ato.report.events import detect_events
from train_ato.report.page_data import page_data
from train_ato.report.summary_rows import SUPERVISION, filled_groups, run_groups

LIMITS = ("permitted_speed", "warning_speed", "service_brake_speed", "emergency_brake_speed")


@pytest.fixture(scope="module")
def braked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run in which a gust accelerates the train beyond its limit; after its stop the ATO is engaged again."""
    gust = "interventions=[{at: 150, do: gust, acceleration: 0.5, duration: 60}]"
    options = (f"--set={gust}", "--set=ato_requests=[{at: 270, do: engage}]")
    return drive(tmp_path_factory.mktemp("braked"), "run", "demo", "--set=duration=290", *options)


def test_the_limits_of_the_supervisor_are_in_the_speed_figure(braked: Path) -> None:
    """Breaks if two limits are exchanged, have another unit, or are drawn at other times."""
    columns = page_data(open_recording(braked)).curves["speed"].columns
    setup, _ = read_run_folder(braked)
    sent = [message for _, _, message in read_log(braked, Wire(setup.layout).decode, ("atp/speeds",))]
    for place, name in enumerate(LIMITS, start=1):
        values = 3.6 * np.array([message.speed[place] for message in sent])
        assert np.nanmax(columns[name]) == pytest.approx(values.max())
        assert columns[name][0] == pytest.approx(values[0])
    low, high = (columns[name] for name in ("permitted_speed", "emergency_brake_speed"))
    assert (low <= high)[np.isfinite(low)].all()
    assert np.isfinite(low).mean() > 0.95


def test_events_have_states_and_reasons(braked: Path) -> None:
    """Breaks if a state has another time or reason, a change of the ATO is lost, or an event is also a fault."""
    found = detect_events(open_recording(braked))
    summary = json.loads((braked / "summary.json").read_text())
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


def test_a_profile_over_distance_begins_after_the_engagement(braked: Path) -> None:
    """Breaks if the line of the new plan jumps back from the profile before it."""
    first, again = page_data(open_recording(braked)).profiles
    assert all((np.diff(places[0]) >= 0.0).all() for places in (first, again))
    assert again[0][0] == pytest.approx(open_recording(braked).front_position[2700] / 1e3, abs=0.01)


def test_page_and_print_figures_are_written(braked: Path, tmp_path: Path) -> None:
    """Breaks if the page has no line or rows of the intervention, or the legends leave no room in a figure."""
    page = tmp_path / "page.html"
    assert main(["report", str(braked), f"--out={page}", f"--figures={tmp_path / 'figures'}"]) == 0
    text = page.read_text()
    warning = re.search(r'class="warning">([^<]*)<', text)
    assert warning is not None
    assert warning[1].startswith("One brake intervention of the supervisor, at 192.8 s (service brake: 8")
    summary = json.loads((braked / "summary.json").read_text())
    (rows,) = (rows for title, rows in run_groups(summary) if title == SUPERVISION)
    shown = {row.key: (texts[0], row.meaning) for row, texts in rows}
    assert shown["brake_interventions"][0] == "1"
    assert shown["first_intervention_s"] == (f"{summary['first_intervention_s']:.1f}", summary["first_intervention"])
    assert shown["strongest_reaction"][0] == "emergency brake"
    assert shown["ato_state"] == ("engaged", "")
    assert SUPERVISION not in [title for title, _ in filled_groups([summary, summary])]
    assert (tmp_path / "figures" / "speed.png").stat().st_size > 30_000


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


def test_without_supervision_nothing_is_added(braked: Path, tmp_path: Path) -> None:
    """Breaks if a run or a log without a supervisor has its events, lines or rows."""
    plain = drive(tmp_path, "plain", "demo", "--set=duration=30", "--set=supervision.enabled=false",
                  "--set=interventions=[{at: 20, do: emergency_brake}]")  # fmt: skip
    recording = open_recording(plain)
    assert {event.kind for event in detect_events(recording)} == {"outside", "limit"}
    assert not set(LIMITS) & set(page_data(recording).curves["speed"].columns)
    assert SUPERVISION not in dict(run_groups(json.loads((plain / "summary.json").read_text())))
    cut = without(braked, tmp_path / "cut", {"atp/speeds"})
    assert not set(LIMITS) & set(page_data(open_recording(cut)).curves["speed"].columns)
