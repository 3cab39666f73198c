"""Parts of the live page and of the driver's display without a browser: texts, targets, limits, strips, playback."""

import asyncio
import dataclasses
import math
import socket
import sys
from pathlib import Path

import numpy as np
import pytest
from engine_runs import record_run, setup_of
from import_files import recorded, take
from waiting import wait_for

from train_ato.cli import main
from train_ato.cli.main import command_line
from train_ato.cli.view import _command, _Started, _waiting
from train_ato.log.run_folder import next_beside
from train_ato.log.table_loading import load
from train_ato.messages.topic import TrainLayout
from train_ato.messages.types import Diagnostic
from train_ato.program.arguments import rate_of
from train_ato.program.errors import RunFailed
from train_ato.program.interrupt import Interrupt
from train_ato.ros.graph.environment import applied, variables
from train_ato.scenario.interventions import EmergencyBrakeNow, GustNow, planned_for
from train_ato.supervision.step_function import ceiling_speeds
from train_ato.supervision.supervisor import SupervisionState
from train_ato.view import snapshot
from train_ato.view.controls import Tunable, coerced, slider_scale
from train_ato.view.facts import Facts, ProfileCurve, facts_of
from train_ato.view.feed import KEPT_S, Ending, Feed, Mark, ProtectionTracker, Strip, WholeRun, ending_of
from train_ato.view.feed import MAX_POINTS as POINTS_OF_OVERVIEW
from train_ato.view.live import WAITING_RATE
from train_ato.view.page import MAX_MESSAGES, Along, _summary, message_rows, track_ahead
from train_ato.view.recorded import MAX_POINTS, RecordedFeed
from train_ato.view.server import PageServer
from train_ato.view.snapshot import delay_at, guidance, targets

LINE = Facts(
    "two limits", TrainLayout(3, 1), nose=10.0, length=60.0, limit_places=np.array([0.0, 1000.0, 1500.0]),
    limit_speeds=np.array([20.0, 10.0, 25.0]),
)  # fmt: skip
PROFILE = ProfileCurve(np.array([0.0, 100.0]), np.array([0.0, 2000.0]), np.array([15.0, 0.0]))


def moment(front, speed=15.0, **more):
    values = {
        "time": 3725.04, "position": np.array([front - 10.0, front - 30.0, front - 50.0]),
        "velocity": np.full(3, speed), "coupler": np.array([12e3, -340e3, 0.0]), "shoe": None,
        "applied": np.array([-45e3]), "command": np.array([-50e3]), "estimate": np.array([0.0]),
        "reference": (front - 12.5, 14.5, 0.0),
    }  # fmt: skip
    return snapshot.Snapshot(**{**values, **more})


@pytest.mark.parametrize(
    ("front", "speed", "text"), [(209.7, 0.0, "arrived"), (209.7, 0.2, "+3326 s"), (209.4, 0.0, "+3326 s")]
)
def test_the_delay_ends_with_the_arrival(front: float, speed: float, text: str) -> None:
    """Breaks if the delay grows at the last stop, or a train that is short of the stop window has arrived."""
    timetable = ProfileCurve(np.array([0.0, 398.0, 400.0]), np.array([0.0, 199.0, 200.0]), np.array([1.0, 1.0, 0.0]))
    assert snapshot.delay_text(timetable, moment(front, speed), 0.5) == text


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Record 90 s of the demo with a gust and an emergency brake."""
    setup = setup_of("demo", "duration=90", "law_changes=[{at: 50, law: smc}]")
    done = (GustNow(acceleration=-0.03, duration=10.0), EmergencyBrakeNow())
    planned = tuple(planned_for(at * 1_000_000_000, entry) for at, entry in zip((40, 70), done, strict=True))
    scenario = setup.scenario.model_copy(update={"interventions": planned})
    setup = dataclasses.replace(setup, scenario=scenario)
    return record_run(setup, tmp_path_factory.mktemp("view") / "run")


def test_a_limit_holds_for_the_whole_train_and_a_lower_one_is_braked_for():
    """Breaks if the limit rises with the rear still in a slow section, or the next lower one is a higher one."""
    assert [LINE.limit_now(front) for front in (999.0, 1000.0, 1550.0, 1561.0)] == [20.0, 10.0, 10.0, 25.0]
    assert Facts("none", TrainLayout(1, 1)).limit_now(5.0) == math.inf
    assert (LINE.next_lower_limit(300.0), LINE.next_lower_limit(1200.0)) == ((1000.0, 10.0), None)


def test_what_the_driver_reads():
    """Breaks if a sign, a unit or a reference point of the display is wrong, or an overspeed leaves the needle."""
    row = {name: value[0] for name, value in snapshot.now(moment(300.0), LINE, PROFILE, 100.0).items()}
    read = "speed 54, profile 52.2, error +1.80, position_error +2.5, limit 72, target 36 in 700 m, stop 1.71 km, "
    read += "place 0.300, applied -45, draft 12 @ 0, buff 340 @ 1, pipe –, clock 1:02:05.0"
    for name, _, text in (part.partition(" ") for part in read.split(", ")):
        assert row[f"{name}_text"] == text
    needles = [snapshot.now(moment(300.0, speed), LINE, None, 100.0)["needle"][0] for speed in (20.2, 20.4)]
    assert needles[0] != needles[1]


def test_the_dial_goes_clockwise_from_its_begin_to_its_end():
    """Breaks if the needle turns in the wrong direction or leaves the dial."""
    begin, end = snapshot.DIAL_BEGIN, snapshot.DIAL_BEGIN - snapshot.DIAL_SWEEP
    most, more, middle, little, back = (snapshot.angle(speed, 100.0) for speed in (1e9, 80.0, 50.0, 10.0, -5.0))
    assert middle == pytest.approx((begin + end) / 2)
    assert end < most < more < middle < little < back < begin
    assert LINE.scale(PROFILE) == 100
    assert Facts("fast", TrainLayout(1, 1)).scale(ProfileCurve(np.zeros(2), np.zeros(2), np.array([0.0, 80.0]))) == 350


@pytest.mark.parametrize(
    ("value", "text"), [(1523, "1.52 km"), (999.6, "1.00 km"), (420.4, "420 m"), (3.456, "3.46 m"), (-0.12, "-0.12 m")]
)
def test_distances_in_words(value, text):
    """Breaks if the last metres before a stop have no decimals."""
    assert (snapshot.distance(value), snapshot.distance(math.nan)) == (text, "–")


def test_the_clock_carries():
    """Breaks if 59.96 s are shown as 60 s."""
    assert snapshot.full_clock(59.96) == "0:01:00.0"
    assert snapshot.full_clock(3599.99) == "1:00:00.0"


def test_strips_keep_the_newest_rows_and_give_each_browser_what_it_lacks():
    """Breaks if a row is lost or sent twice when the oldest rows are dropped."""
    strip = Strip(rows=10)
    seen, number = [], 0
    for time in range(57):
        strip.add((float(time), *[0.0] * (len(snapshot.STRIP) - 1)))
        if time % 4 == 0:
            seen += strip.since(number)["time"].tolist()
            number = strip.added
    assert seen == [float(time) for time in range(57)]
    assert strip.since(0)["time"].tolist() == [float(time) for time in range(47, 57)]
    assert strip.since(strip.added)["time"].size == 0


def test_a_strip_row_is_in_the_units_of_its_columns():
    """Breaks if two columns are exchanged."""
    row = dict(zip(snapshot.STRIP, snapshot.strip_row(moment(300.0), LINE), strict=True))
    names = ("speed", "profile", "limit", "place", "applied", "demand", "draft", "buff")
    assert [row[name] for name in names] == pytest.approx([54.0, 52.2, 72.0, 0.3, -45.0, -50.0, 12.0, -340.0])
    assert math.isnan(row["most"])


def test_axes_of_the_forces_shrink_after_a_peak_and_never_clip():
    """Breaks if an axis clips a force, shrinks between two frames, or keeps the end of an old peak."""
    feed = Feed(LINE)
    feed.show(moment(300.0, time=0.0))
    wide = feed.frame.now["coupler_reach"][0]
    assert wide > 340.0
    feed.show(moment(301.0, time=1.0, coupler=np.full(3, 50e3)))
    assert feed.frame.now["coupler_reach"][0] == wide
    feed.show(moment(400.0, time=KEPT_S + 2.0, coupler=np.full(3, 120e3)))
    assert 120.0 < feed.frame.now["coupler_reach"][0] < wide
    feed.show(moment(301.0, time=1.0, coupler=np.full(3, 500e3)))
    assert feed.frame.now["coupler_reach"][0] > 500.0
    assert feed.frame.number == 4


def test_the_page_opens_with_the_forces_of_the_first_frame():
    """Breaks if the columns of couplers and shoes share one array: the page of a log opened without coupler forces."""
    forces = Along(LINE, {})
    forces.show({"coupler": np.array([12.0, -340.0, 0.0]), "shoe": np.array([0.0, 1.0, 2.0])})
    assert [forces.source.data[name].tolist() for name in ("coupler", "shoe")] == [[12.0, -340.0, 0.0], [0.0, 1.0, 2.0]]


def test_the_page_of_a_log_names_every_law(demo_run):
    """Breaks if the table beside the display has only the first law of a run."""
    run = demo_run("duration=5", "law_changes=[{at: 2, law: smc}]")
    assert "pid → smc at 2 s" in _summary(RecordedFeed(run))


def test_the_page_closes_slow_connections_at_the_end():
    """Breaks if the look for the end stops the loop again meanwhile, which ends the command with a traceback."""

    class Slow(PageServer):
        async def _settle(self) -> None:
            await asyncio.sleep(0.3)  # three looks
            await super()._settle()

    Slow(Feed(LINE)).run(lambda: True)


def test_the_end_has_a_verdict_as_soon_as_the_summary_is_written(tmp_path):
    """Breaks if an end without metrics has a link to a report, or half a summary is an error."""
    assert ending_of("finished", None) == ending_of("finished", tmp_path) == Ending("finished")
    (tmp_path / "summary.json").write_text('{"overspeed_max')
    assert ending_of("run ended", tmp_path) == Ending("run ended")
    (tmp_path / "summary.json").write_text('{"overspeed_max_kmh": 0.0}')
    assert ending_of("finished", tmp_path).report == "/report"


def test_a_tooltip_has_name_meaning_and_range():
    """Breaks if the descriptor of a parameter is not shown, or an infinite end is."""
    assert Tunable("pid.kp", 0.05, "gain [1/s]", low=0.0).explanation == "pid.kp: gain [1/s]; from 0"
    assert Tunable("plant.paused", True, "only single steps", 0.0, 1.0).explanation == "plant.paused: only single steps"


def test_another_run_has_a_free_folder_beside_the_first(tmp_path):
    """Breaks if the next run of a page overwrites the last one, or its name grows with every run."""
    assert next_beside(tmp_path / "run") == tmp_path / "run-2"
    (tmp_path / "run-2").mkdir()
    assert next_beside(tmp_path / "run") == next_beside(tmp_path / "run-2") == tmp_path / "run-3"


@pytest.mark.parametrize(
    ("tunable", "expected"),
    [
        (Tunable("pid.kp", 0.05, low=0.0, high=1e9), (0.0, 0.2, 0.001)),
        (Tunable("pid.kd", 0.0, low=0.0, high=1e9), (0.0, 1.0, 0.005)),
        (Tunable("smc.c", 0.4, low=0.0, high=1.0), (0.0, 1.0, 0.005)),
        (Tunable("smc.w", -3.0, low=-100.0, high=500.0), (-12.0, 12.0, 0.1)),
        (Tunable("funnel.rbf_centers", 11, low=1.0, high=101.0), (1.0, 101.0, 1.0)),
        (Tunable("x.free", 2.0), (0.0, 8.0, 0.02)),
        (Tunable("x.offset", 0.0, low=-5.0, high=5.0), (-5.0, 5.0, 0.05)),
        (Tunable("x.wide", 0.0, low=-1e9, high=1e9), (-1.0, 1.0, 0.01)),
    ],
)
def test_a_slider_covers_a_sensible_part_of_the_range(tunable, expected):
    """Breaks if the slider of a gain of 0.05 ends at 1e9 or outside of the permitted range."""
    assert tuple(slider_scale(tunable).values()) == pytest.approx(expected)


def test_widgets_give_back_the_parameters_own_type():
    """Breaks if an int is sent for a double, which the node rejects, or a title has the unit 1."""
    assert isinstance(coerced(Tunable("a.b", 1.0), 2), float) and isinstance(coerced(Tunable("a.b", 1), 2.0), int)
    assert coerced(Tunable("a.b", True), [0]) is True
    texts = ("gain [1/s²]", "ki in 1/s²"), ("exponent [1]", "ki"), ("gain [1/s]", "ki in 1/s")
    assert [Tunable("pid.ki", 0.1, text).title for text, _ in texts] == [title for _, title in texts]


def test_facts_come_from_the_scenario():
    """Breaks if grades, limits or the envelope of the display are not those of the run."""
    setup = setup_of()
    facts = facts_of(setup)
    assert facts.layout.n_vehicles == 106
    assert facts.length == pytest.approx(1295.0, abs=1.0)
    assert (facts.envelope(0.0)[1], facts.envelope(50 / 3.6)[0]) == pytest.approx((760e3, -461e3))
    assert facts.limit_now(500.0) == pytest.approx(80 / 3.6)
    inside = np.flatnonzero(facts.grade_places <= 2000.0)[-1]
    there = [entry.grade for entry in setup.line.grades if entry.at <= 2000.0][-1]
    assert facts.grades[inside] == pytest.approx(1e3 * there)


def test_a_recorded_run_shows_any_moment(run):
    """Breaks if a snapshot is a tick off, or law and emergency brake of the log are missing."""
    feed = RecordedFeed(run)
    assert feed.span == (0.0, 90.0)
    assert [mark.time for mark in feed.marks if "gust" in mark.text] == [40.0]
    feed.seek(45.03)
    assert (feed.frame.moment.time, feed.frame.moment.law) == (pytest.approx(45.0), "pid")
    feed.step(1)
    assert feed.frame.moment.time == pytest.approx(45.1)
    feed.seek(71.0)
    assert (feed.frame.moment.law, feed.frame.moment.state) == ("smc", "emergency brake")
    feed.seek(82.0)
    assert feed.frame.now["pipe_text"] == ["101"]
    feed.seek(1e9)
    assert feed.time == 90.0


def test_the_overview_has_the_whole_run_and_the_page_opens_at_its_event(run):
    """Breaks if a band begins at another time, too many points are sent, or the page opens on an empty run."""
    feed = RecordedFeed(run)
    whole = feed.whole()
    assert whole["span"] == [0.0, 90.0] and 300 < len(whole["points"]) <= POINTS_OF_OVERVIEW
    assert [text for _, text in whole["law"]] == ["pid", "smc"]
    assert whole["law"][1][0] == pytest.approx(next(mark.time for mark in feed.marks if "smc" in mark.text), abs=0.25)
    error = feed.part(0.0, 90.0)["error"]
    moment = feed.frame.moment
    assert abs(moment.error) == pytest.approx(np.abs(error).max(), rel=1e-6) and moment.time > 0
    longest = WholeRun((0.0, 0.0))  # a run of unknown duration
    for tick in range(5000):
        longest.add(0.1 * tick, float(tick), math.nan, law="pid", ato="")
    points = longest.columns()["points"]
    assert POINTS_OF_OVERVIEW / 2 <= len(points) <= POINTS_OF_OVERVIEW and points[-1][0] > 498.0
    assert np.diff([time for time, _, _ in points]).max() < 1.5 and points[0] == [0.0, 0.0, None]


def test_a_live_run_fills_its_overview(run):
    source = RecordedFeed(run)
    feed = Feed(source.facts)
    for at in (10.0, 20.0, 71.0):
        source.seek(at)
        feed.show(source.frame.moment)
    feed.marks = [Mark(20.0, "gust", "a gust"), Mark(30.0, "", "not in the charts")]
    found = feed.whole()
    assert [time for time, _, _ in found["points"]] == [10.0, 20.0, 71.0]
    assert (found["law"], found["marks"]) == ([[10.0, "pid"], [71.0, "smc"]], [[20.0, "a gust", 0]])


def test_playing_goes_on_until_the_end_and_begins_again(run, monkeypatch):
    """Breaks if the rate is wrong, time passes the end, or does not restart after the end."""
    feed = RecordedFeed(run)
    clock_now = [1000.0]
    monkeypatch.setattr("train_ato.view.recorded.time.monotonic", lambda: clock_now[0])
    feed.seek(30.0)
    feed.speed = 10.0
    feed.set_playing(playing=True)
    clock_now[0] += 2.0
    feed.advance()
    feed.advance()
    assert feed.time == pytest.approx(50.0)
    clock_now[0] += 60.0
    feed.advance()
    assert (feed.time, feed.playing) == (90.0, False)
    feed.set_playing(playing=True)
    assert (feed.time, feed.playing) == (0.0, True)


def test_the_strip_of_a_recorded_run_is_that_of_the_log(run):
    """Breaks if the charts are shifted against the time, or too many points are sent."""
    feed = RecordedFeed(run)
    part = feed.part(20.0, 30.0)
    assert part["time"][0] == pytest.approx(20.0)
    assert set(part) == set(snapshot.STRIP)
    feed.seek(25.0)
    row = int(np.searchsorted(part["time"], 25.0 - 1e-6))
    live = dict(zip(snapshot.STRIP, snapshot.strip_row(feed.frame.moment, feed.facts), strict=True))
    for name in snapshot.STRIP:
        assert part[name][row] == pytest.approx(live[name], rel=1e-3, abs=1e-3), name
    assert feed.part(-1e9, 1e9)["time"].size <= MAX_POINTS


def test_a_run_that_starts_slowly_is_waited_for_until_it_ends(tmp_path, monkeypatch, capfd):
    """Breaks if view does not wait for a starting run, prints no note, or waits for a run that has ended."""
    clock_now, interrupt, word = [0.0], Interrupt(), tmp_path / "word"
    monkeypatch.setattr("train_ato.ros.graph.wait_note.time.monotonic", lambda: clock_now[0])
    code = f"import pathlib, sys\nwhile not pathlib.Path({str(word)!r}).exists(): pass\nsys.exit('train-ato: no room')"
    run = _Started([sys.executable, "-c", code])
    try:
        wait = _waiting(run.check, interrupt)
        for clock_now[0] in (0.0, 1.0, 3600.0, 5000.0, 7201.0):
            wait("the run to start")
        for clock_now[0] in (7202.0, 7206.0):
            wait("node plant to answer")
        assert capfd.readouterr().err == (
            "waiting for the run to start (3600 s)\nwaiting for the run to start (7201 s)\n"
            "waiting for node plant to answer (4 s)\n"
        )
        interrupt.asked = True
        with pytest.raises(KeyboardInterrupt):
            wait("the run to start")
        word.touch()
        wait_for(lambda: run._process.poll() is not None)
        with pytest.raises(RunFailed, match=r"^no room$"):
            wait("the run to start")
    finally:
        run.end()


def test_a_note_of_a_started_run_is_not_its_error(capfd):
    """Breaks if view hides a note of the run, or takes it for the reason of the end."""
    lines = ("train-ato: other hosts may join this run (X)", "ROS domain 7", "train-ato: no space")
    run = _Started(
        [sys.executable, "-c", f"import sys\nfor line in {lines}: print(line, file=sys.stderr)\nsys.exit(1)"]
    )
    wait_for(lambda: run._process.poll() is not None)
    with pytest.raises(RunFailed, match=r"^no space$"):
        run.check()
    assert sorted(capfd.readouterr().err.splitlines()) == ["ROS domain 7", lines[0]]
    done = _Started([sys.executable, "-c", "pass"])
    wait_for(lambda: done._process.poll() is not None)
    with pytest.raises(RunFailed, match="the run ended before the page was ready; show its record"):
        done.check()


def test_a_started_run_has_no_limit_of_its_start():
    """Breaks if a run started by view fails after 30 s of discovery on a slow machine."""
    parser = command_line()

    def started(*words):
        return parser.parse_args(_command(parser.parse_args(["view", "--scenario", "demo", *words]), 42)[3:])

    run = started("--rate", "5", "--law", "smc", "--foxglove")
    assert (run.start_limit, run.rate, run.law, run.domain) == (math.inf, 5.0, "smc", 42)
    assert rate_of(started("--rate", "max", "--foxglove")) is None
    for rate in ([], ["--rate", "max"], ["--rate", "5"]):
        assert started(*rate).rate == WAITING_RATE, "the run waits for its first page"


class Enough(Exception):
    """End of a wait in a test."""


def test_the_awaited_nodes_are_named(domain, tmp_path):
    """Breaks if the wait for a graph does not name the nodes that are missing."""
    heard = []

    def wait(awaited):
        heard.append(awaited)
        raise Enough

    from train_ato.view.live import LiveFeed

    with applied(variables(domain, tmp_path)), pytest.raises(Enough):
        LiveFeed(domain, wait)
    assert heard == [f"node controller to start and node plant to start on domain {domain}"]


def test_a_port_in_use_is_refused_in_one_line(run, capfd):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(["view", str(run), "--port", str(port), "--no-browser"]) == 2
    said = capfd.readouterr().err
    assert said == f"train-ato: --port {port}: already in use; give another port, or 0 for a free one\n"


SLOW_LINE = Facts(
    "slow section", TrainLayout(2, 1), rear=np.array([0.0, 20.0]), nose=10.0, length=40.0,
    limit_places=np.array([0.0, 1000.0, 1500.0]), limit_speeds=np.array([20.0, 10.0, 25.0]),
    grade_places=np.array([0.0, 400.0, 900.0]), grades=np.array([0.0, -10.0, 5.0]),
)  # fmt: skip


def two_stops() -> ProfileCurve:
    """Return a plan with two stops: 20 m/s, braking with 0.5 m/s² to 400 m, 30 s there, on to 2000 m."""
    time = np.arange(0.0, 400.0, 0.5)
    velocity = np.interp(time, [0, 40, 80, 120, 160, 290, 330], [0, 20, 0, 0, 20, 20, 0])
    position = np.concatenate(([0.0], np.cumsum(np.diff(time) * (velocity[1:] + velocity[:-1]) / 2)))
    return ProfileCurve(time, position, velocity)


def test_the_plan_has_stops_and_brake_applications() -> None:
    """Breaks if the start is a stop, a stop is missing, or a brake application has another begin or end."""
    curve = two_stops()
    assert curve.stops.tolist() == pytest.approx([800.0, 4200.0], abs=1.0)
    assert curve.deceleration == pytest.approx(0.5, rel=1e-6)
    assert curve.brakings[:, 0].tolist() == pytest.approx([400.0, 3800.0], abs=10.0)
    assert curve.brakings[:, 1].tolist() == pytest.approx([800.0, 4200.0], abs=10.0)


def test_the_curve_of_the_plan_is_the_permitted_speed_before_a_stop() -> None:
    """Breaks if a stop or a lower limit ahead does not lower the permitted speed, or a far one does."""
    front = 760.0
    found = guidance(SLOW_LINE, two_stops(), front, 5.0, limits=None, state="")
    assert (found.target_speed, found.target_distance) == (0.0, pytest.approx(50.0, abs=1.0))
    assert found.permitted == pytest.approx(math.sqrt(2 * 0.5 * found.target_distance))
    assert found.intervention == ceiling_speeds(found.permitted).service
    far = guidance(SLOW_LINE, two_stops(), 50.0, 5.0, limits=None, state="")
    assert (far.permitted, far.state) == (20.0, SupervisionState.NORMAL)
    slow = guidance(SLOW_LINE, two_stops(), 900.0, 15.0, limits=None, state="")
    assert (slow.target_speed, slow.target_distance) == (10.0, pytest.approx(100.0))


def test_states_follow_the_speed() -> None:
    """Breaks if an indication comes after the overspeed, or a state is skipped."""
    permitted = guidance(SLOW_LINE, two_stops(), 700.0, 0.0, limits=None, state="").permitted
    speeds = (1.0, permitted - 0.1, permitted + 0.5, 25.0)
    states = [guidance(SLOW_LINE, two_stops(), 700.0, speed, limits=None, state="").state.name for speed in speeds]
    assert states == ["NORMAL", "INDICATION", "OVERSPEED", "SERVICE_BRAKE"]


def test_the_supervisor_replaces_limits_and_plan() -> None:
    """Breaks if a supervised run shows the permitted speed of the plan, or a state of its own."""
    limits = np.array([12.0, 13.0, 14.0, 15.0])
    found = guidance(SLOW_LINE, two_stops(), 700.0, 13.5, limits=limits, state="warning")
    assert (found.permitted, found.intervention, found.state) == (12.0, 14.0, SupervisionState.WARNING)
    assert guidance(SLOW_LINE, None, 0.0, 1.0, limits=limits, state="not known").state is SupervisionState.NORMAL


def test_without_limits_and_plan_nothing_is_permitted_or_forbidden() -> None:
    """Breaks if a line without limits has a number on the dial."""
    found = guidance(Facts("none", TrainLayout(1, 1)), None, 0.0, 50.0, limits=None, state="")
    assert (found.permitted, found.state) == (math.inf, SupervisionState.NORMAL)
    assert math.isnan(found.target_distance)
    assert targets(SLOW_LINE, None, 1200.0)[0].size == 0


@pytest.mark.parametrize(
    ("time", "position", "delay"),
    [(40.0, 400.0, 0.0), (50.0, 400.0, 10.0), (35.0, 400.0, -5.0), (100.0, 800.0, 0.0), (135.0, 800.0, 15.0)],
)
def test_the_delay_counts_against_the_first_profile(time: float, position: float, delay: float) -> None:
    """Breaks if the sign is wrong, or a dwell time counts as a delay."""
    assert delay_at(two_stops(), time, position) == pytest.approx(delay, abs=1.5)


def test_a_train_that_runs_back_has_the_delay_and_the_stops_of_its_way() -> None:
    """Breaks if its delay is that of the way on, its next stop lies behind it, or a limit is that of the front."""
    out = two_stops()
    back = ProfileCurve(out.time, 5000.0 - out.position, -out.velocity)
    assert delay_at(back, 50.0, 4600.0) == pytest.approx(10.0, abs=1.5)
    row = snapshot.now(moment(1610.0, -15.0, time=200.0), LINE, back, 100.0)
    # the front at 1610, the rear at 1550 m leads: 25 m/s here, 10 m/s from 1500 m on; the stop of vehicle 0 at 800 m
    assert (row["stop_text"], row["target_text"]) == (["800 m"], ["36 in 50 m"])
    both = ProfileCurve(np.append(out.time, out.time + 400.0), np.append(out.position, out.position[::-1]),
                        np.append(out.velocity, -out.velocity[::-1]))  # fmt: skip
    sign, way = both.way(out.time[-1] + 100.0)
    assert (sign, way.end) == (-1.0, pytest.approx(0.0)) and both.way(40.0)[1].end == pytest.approx(4200.0, abs=1.0)
    assert delay_at(both, 40.0, 400.0) == pytest.approx(0.0, abs=1.5)


def test_the_line_ahead_has_elevations_and_places_of_the_front() -> None:
    """Breaks if stops are those of vehicle 0's centre, or the elevation has the wrong sign or unit."""
    sent = track_ahead(SLOW_LINE, two_stops())
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
    feed = Feed(SLOW_LINE)
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


def test_without_a_limit_the_dial_has_no_hook():
    """Breaks if a line without limits shows a limit at the end of the dial."""
    row = snapshot.now(moment(300.0), Facts("none", TrainLayout(3, 1)), None, 60.0)
    assert (row["limited"], row["limit_text"]) == ([0.0], ["–"])


@pytest.mark.parametrize(("value", "digits", "shown"), [(-0.004, 2, "+0.00"), (-0.04, 1, "+0.0"), (-1.25, 1, "-1.2")])
def test_nothing_has_no_minus(value, digits, shown):
    """Breaks if an error that rounds to zero is shown as -0.0."""
    assert snapshot.signed(value, digits) == shown
