"""States of supervision and ATO on the live page, limits of the supervisor, requests to the ATO."""

import itertools
import json
from pathlib import Path

import pytest
from engine_runs import setup_of

pytest.importorskip("rclpy")

from chromium import browser
from test_view_page import LONG
from view_browser import answer, click, number, opened, strangers, text, viewing
from waiting import wait_for

from train_ato.loop.engine import run_engine
from train_ato.messages.types import Diagnostic
from train_ato.view.feed import protection_history, states_after
from train_ato.view.recorded import RecordedFeed
from train_ato.view.snapshot import LIMIT_NAMES, ProtectionStates, now


@pytest.fixture(scope="module")
def braked(demo_run) -> Path:
    """Record a gust that accelerates the demo train beyond its speed limit."""
    return demo_run("duration=280", "interventions=[{at: 150, do: gust, acceleration: 0.5, duration: 60}]")


@pytest.fixture(scope="module")
def plain(demo_run) -> Path:
    return demo_run("duration=5", "supervision.enabled=false")


def told(time: int, node: str, message: str, **values: str) -> Diagnostic:
    return Diagnostic(time * 10**9, node, 0, message, values)


def test_states_follow_the_diagnostics() -> None:
    """Breaks if a reason outlives its state, or the state of one node is taken from another."""
    reports = [
        told(0, "supervisor", "normal"), told(0, "controller", "engaged", ato_state="engaged", ato_reason="start"),
        told(1, "supervisor", "warning", reason="82 km/h"),
        told(2, "plant", "coast", protection="no command for 0.6 s"),
        told(3, "controller", "failure", ato_state="failure", ato_reason="no force"), told(4, "supervisor", "normal"),
        told(5, "plant", "running"), told(6, "controller", "engaged", ato_state="engaged", ato_reason="request"),
    ]  # fmt: skip
    times, states, marks = protection_history(reports)
    assert times[-1] == 6.0
    assert states[-1] == ProtectionStates("normal", "", "", "", "engaged", "")
    assert states[times.index(3.0)].reasons == "82 km/h; train: no command for 0.6 s; ATO: no force"
    assert [(mark.time, mark.label) for mark in marks] == [
        (1.0, ""), (2.0, "coast"), (3.0, "failure"), (6.0, "engaged"),
    ]  # fmt: skip
    assert states_after(states[-1], told(7, "observer", "observing")) is states[-1]


def test_gains_that_do_not_fit_are_a_message_of_the_page() -> None:
    """Breaks if the page says nothing after a change of law, or repeats the advice every second."""
    fits, poor = {"controller": "pid"}, {"controller": "smc", "advice": "smc: printed gains; try --set laws"}
    reports = [told(at, "controller", "engaged", **value) for at, value in enumerate((fits, poor, poor, fits, poor))]
    _, _, marks = protection_history(reports)
    found = [(mark.time, mark.text, mark.acknowledge) for mark in marks]
    assert found == [(1.0, poor["advice"], False), (4.0, poor["advice"], False)]


def test_a_run_reports_the_advice_of_a_change_of_law_and_of_a_gain_to_the_page() -> None:
    """Breaks if the controller reports only the advice of the start, or keeps it after gains that fit."""
    changes = "{at: 2, law: smc, laws: {smc: {gains: printed}}}, {at: 4, laws: {smc: {gains: model}}}"
    again = "{at: 6, laws: {smc: {gains: printed}}}"
    setup = setup_of("demo", f"law_changes=[{changes}, {again}]", "duration=8")
    recording = run_engine(setup).recording
    assert recording is not None
    _, _, marks = protection_history(recording.reports)
    remedy = "smc: printed gains, not made for this train; try --set laws.smc.gains=model"
    told = [(round(mark.time), mark.text) for mark in marks if "gains" in mark.text]
    assert told == [(2, remedy), (6, remedy)]


def test_a_recorded_run_has_limits_and_states_of_its_time(braked: Path, plain: Path) -> None:
    """Breaks if limits are those of another time, a state is late, or a run without a supervisor has any."""
    feed = RecordedFeed(braked)
    times, limits = feed.recording.of("atp/speeds", "speed")
    feed.seek(193.5)
    shown = feed.frame.now
    row = int((times <= 193.5 + 1e-9).sum()) - 1
    assert [shown[f"{name}_text"][0] for name in LIMIT_NAMES] == [f"{3.6 * speed:.1f}" for speed in limits[row, 1:]]
    angles = [shown[f"{name}_angle"][0] for name in LIMIT_NAMES]
    assert angles == sorted(angles, reverse=True)
    assert len(set(angles)) == len(angles)
    assert shown["supervision_text"] == ["service brake"]
    assert shown["ato_text"] == ["disengaging"]
    assert "limit 85.5 km/h; ATO: service brake in effect" in shown["reason_text"][0]
    feed.seek(280.0)
    assert (feed.frame.now["ato_text"], feed.frame.now["supervision_text"]) == (["ready"], ["normal"])
    labels = [mark.label for mark in feed.marks if mark.label]
    assert {"service brake", "emergency brake", "disengaging", "braking law"} <= set(labels)
    other = RecordedFeed(plain)
    assert not other.facts.layout.supervised
    assert other.frame.now["ato_text"] == other.frame.now["permitted_text"] == ["–"]


def test_equal_limits_are_no_full_ring(braked: Path) -> None:
    """Breaks if limits of 0 km/h, or beyond the dial, are drawn as full rings."""
    feed = RecordedFeed(braked)
    for factor in (0.0, 1e3):
        moment = feed.frame.moment
        row = now(type(moment)(**{**moment.__dict__, "limits": factor * moment.limits}), feed.facts, None, 100.0)
        angles = [row[f"{name}_angle"][0] for name in LIMIT_NAMES]
        assert all(high - low >= 1e-3 - 1e-12 for high, low in itertools.pairwise(angles))


@pytest.mark.graph
def test_the_ato_is_disengaged_and_engaged_by_buttons(tmp_path: Path) -> None:
    """Breaks if a button has no effect on the node, a refusal has no reason, or the state does not follow."""
    folder = tmp_path / "run"
    options = ["--scenario", "demo", "--rate", "10", "--out", str(folder), *(f"--set={change}" for change in LONG)]
    with browser() as page, viewing(*options) as view:
        opened(page, view.url)
        wait_for(lambda: text(page, "ato_text") == "engaged", "the state of the ATO")
        wait_for(lambda: page.evaluate("model('where').data.speed[0]") > 10.0, "a train that needs some time to stop")
        assert 0.0 < number(page, "permitted_text") <= 80.0
        click(page, "engage")
        assert "engage: the ATO is engaged, not ready" in answer(page, "wait for this state")
        click(page, "disengage")
        answer(page, "disengage: from the next step")
        wait_for(lambda: text(page, "ato_text") == "disengaging", "the end of the engagement")
        assert text(page, "reason_text") == "ATO: request"
        click(page, "reset")
        assert "not failure" in answer(page, "reset: the ATO is")
        wait_for(lambda: text(page, "ato_text") == "ready", "the standstill")
        click(page, "engage")
        answer(page, "engage: from the next step")
        wait_for(lambda: text(page, "ato_text") == "engaged", "the new engagement")
        wait_for(lambda: abs(page.evaluate("model('where').data.speed[0]")) > 1.0, "a train that moves again")
        click(page, "EMERGENCY BRAKE")
        answer(page, "emergency brake applied")
        page.wait_for("!!deep(e => e.tagName == 'BUTTON' && e.textContent.trim() == 'release the emergency brake')")
        page.screenshot(tmp_path / "live.png")
        assert page.console == []
        assert strangers(page, view.url) == []
        assert view.end() == 0
    rows = json.loads((folder / "summary.json").read_text())["changes"]
    assert [row["value"] for row in rows if row["name"] == "ato_request"] == ["disengage", "engage"]
