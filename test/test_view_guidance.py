"""Speeds on the dial, targets, delay, brake applications and messages of the driver's display, without a browser."""

import math
from pathlib import Path

import numpy as np
import pytest
from import_files import recorded, take

from train_ato.log.table_loading import load
from train_ato.messages.topic import TrainLayout
from train_ato.messages.types import Diagnostic
from train_ato.supervision.step_function import ceiling_speeds
from train_ato.supervision.supervisor import SupervisionState
from train_ato.view.facts import Facts, ProfileCurve
from train_ato.view.feed import Feed, Mark, ProtectionTracker
from train_ato.view.page import MAX_MESSAGES, message_rows, track_ahead
from train_ato.view.recorded import RecordedFeed
from train_ato.view.snapshot import delay_at, guidance, targets

LINE = Facts(
    "slow section", TrainLayout(2, 1), rear=np.array([0.0, 20.0]), nose=10.0, length=40.0,
    limit_places=np.array([0.0, 1000.0, 1500.0]), limit_speeds=np.array([20.0, 10.0, 25.0]),
    grade_places=np.array([0.0, 400.0, 900.0]), grades=np.array([0.0, -10.0, 5.0]),
)  # fmt: skip


def plan() -> ProfileCurve:
    """Return a plan with two stops: 20 m/s, braking with 0.5 m/s² to 400 m, 30 s there, on to 2000 m."""
    time = np.arange(0.0, 400.0, 0.5)
    velocity = np.interp(time, [0, 40, 80, 120, 160, 290, 330], [0, 20, 0, 0, 20, 20, 0])
    position = np.concatenate(([0.0], np.cumsum(np.diff(time) * (velocity[1:] + velocity[:-1]) / 2)))
    return ProfileCurve(time, position, velocity)


def test_the_plan_has_stops_and_brake_applications() -> None:
    """Breaks if the start is a stop, a stop is missing, or a brake application has another begin or end."""
    curve = plan()
    assert curve.stops.tolist() == pytest.approx([800.0, 4200.0], abs=1.0)
    assert curve.deceleration == pytest.approx(0.5, rel=1e-6)
    assert curve.brakings[:, 0].tolist() == pytest.approx([400.0, 3800.0], abs=10.0)
    assert curve.brakings[:, 1].tolist() == pytest.approx([800.0, 4200.0], abs=10.0)


def test_the_curve_of_the_plan_is_the_permitted_speed_before_a_stop() -> None:
    """Breaks if a stop or a lower limit ahead does not lower the permitted speed, or a far one does."""
    front = 760.0
    found = guidance(LINE, plan(), front, 5.0, limits=None, state="")
    assert (found.target_speed, found.target_distance) == (0.0, pytest.approx(50.0, abs=1.0))
    assert found.permitted == pytest.approx(math.sqrt(2 * 0.5 * found.target_distance))
    assert found.intervention == ceiling_speeds(found.permitted).service
    far = guidance(LINE, plan(), 50.0, 5.0, limits=None, state="")
    assert (far.permitted, far.state) == (20.0, SupervisionState.NORMAL)
    slow = guidance(LINE, plan(), 900.0, 15.0, limits=None, state="")
    assert (slow.target_speed, slow.target_distance) == (10.0, pytest.approx(100.0))


def test_states_follow_the_speed() -> None:
    """Breaks if an indication comes after the overspeed, or a state is skipped."""
    permitted = guidance(LINE, plan(), 700.0, 0.0, limits=None, state="").permitted
    speeds = (1.0, permitted - 0.1, permitted + 0.5, 25.0)
    states = [guidance(LINE, plan(), 700.0, speed, limits=None, state="").state.name for speed in speeds]
    assert states == ["NORMAL", "INDICATION", "OVERSPEED", "SERVICE_BRAKE"]


def test_the_supervisor_replaces_limits_and_plan() -> None:
    """Breaks if a supervised run shows the permitted speed of the plan, or a state of its own."""
    limits = np.array([12.0, 13.0, 14.0, 15.0])
    found = guidance(LINE, plan(), 700.0, 13.5, limits=limits, state="warning")
    assert (found.permitted, found.intervention, found.state) == (12.0, 14.0, SupervisionState.WARNING)
    assert guidance(LINE, None, 0.0, 1.0, limits=limits, state="not known").state is SupervisionState.NORMAL


def test_without_limits_and_plan_nothing_is_permitted_or_forbidden() -> None:
    """Breaks if a line without limits has a number on the dial."""
    found = guidance(Facts("none", TrainLayout(1, 1)), None, 0.0, 50.0, limits=None, state="")
    assert (found.permitted, found.state) == (math.inf, SupervisionState.NORMAL)
    assert math.isnan(found.target_distance)
    assert targets(LINE, None, 1200.0)[0].size == 0


@pytest.mark.parametrize(
    ("time", "position", "delay"),
    [(40.0, 400.0, 0.0), (50.0, 400.0, 10.0), (35.0, 400.0, -5.0), (100.0, 800.0, 0.0), (135.0, 800.0, 15.0)],
)
def test_the_delay_counts_against_the_first_profile(time: float, position: float, delay: float) -> None:
    """Breaks if the sign is wrong, or a dwell time counts as a delay."""
    assert delay_at(plan(), time, position) == pytest.approx(delay, abs=1.5)


def test_the_line_ahead_has_elevations_and_places_of_the_front() -> None:
    """Breaks if stops are those of vehicle 0's centre, or the elevation has the wrong sign or unit."""
    sent = track_ahead(LINE, plan())
    assert [row[2] for row in sent["grades"]] == [0.0, 0.0, -5.0]
    assert sent["stops"] == pytest.approx([810.0, 4210.0], abs=1.0)
    assert sent["limits"][1] == [1000.0, 36.0]
    assert sent["rear"] == [10.0, 30.0]
    assert track_ahead(Facts("none", TrainLayout(1, 1)), None)["grades"] == []


def test_messages_wait_for_the_driver_until_they_are_acknowledged() -> None:
    """Breaks if an intervention is covered by later messages, waits in a recorded run, or comes back."""
    marks = [Mark(1.0, "", "service brake: 90 km/h", acknowledge=True)]
    marks += [Mark(2.0 + i, "", f"event {i}") for i in range(8)]
    rows = message_rows(marks, 100.0, frozenset(), live=True)
    assert (rows["text"][0], rows["waiting"][0], len(rows["text"])) == ("service brake: 90 km/h", 1, MAX_MESSAGES)
    assert rows["text"][1] == "event 7"
    feed = Feed(LINE)
    feed.acknowledge(0)
    assert message_rows(marks, 100.0, feed.acknowledged, live=True)["waiting"] == [0] * MAX_MESSAGES
    assert message_rows(marks, 100.0, frozenset(), live=False)["text"][0] == "event 7"
    assert message_rows(marks, 2.0, frozenset(), live=True)["text"] == ["service brake: 90 km/h", "event 0"]


def test_interventions_and_failures_need_an_acknowledgement() -> None:
    """Breaks if a warning blocks the messages, or an intervention does not."""
    tracker = ProtectionTracker()
    found = []
    for time, node, text, values in (
        (1, "supervisor", "warning", {"reason": "82 km/h"}),
        (2, "supervisor", "service brake", {"reason": "90 km/h"}),
        (3, "controller", "engaged", {"ato_state": "engaged"}),
        (4, "controller", "failure", {"ato_state": "failure", "ato_reason": "no force"}),
    ):
        found += tracker.take(Diagnostic(time * 1_000_000_000, node, 0, text, values))
    assert [(mark.time, mark.acknowledge) for mark in found] == [(1.0, False), (2.0, True), (4.0, True)]


def test_a_measured_run_is_shown_as_it_was_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the display needs true states, or shows the front of the train at its power unit."""
    take(tmp_path, capsys, recorded(0.2, 60.0), train=["--consist", "crh380a_three_units", "--line", "level"])
    feed = RecordedFeed(tmp_path / "imported")
    table = load(tmp_path / "imported")["train/measurement"]
    assert feed.facts.layout.n_vehicles == 1, "no strip of couplers along the train"
    feed.seek(30.0)
    assert feed.frame is not None
    moment, row = feed.frame.moment, table.iloc[300]
    assert moment.speed == pytest.approx(3.6 * row["unit_0_speed_m_s"], abs=1e-9)
    assert moment.applied.sum() == pytest.approx(sum(row[f"unit_{unit}_applied_force_n"] for unit in range(3)))
    assert feed.recording.setup is not None
    offset = feed.recording.setup.model.offsets[0]
    assert moment.position[0] == pytest.approx(row["unit_0_position_m"] + offset, abs=1e-9)
    part = feed.part(0.0, 60.0)
    assert np.isfinite(part["speed"]).all()
    feed.step(1)
    assert feed.time == pytest.approx(30.1)
