"""What the live page shows, without a browser: the moment in words, limits ahead, strips, parameters, playing back."""

from __future__ import annotations

import json
import math
import socket
import subprocess
import sys
import xml.etree.ElementTree as ET
from importlib.resources import files

import numpy as np
import pytest

from train_ato.engine import run_engine
from train_ato.interventions import EmergencyBrakeNow, GustNow, planned_for
from train_ato.run_folder import RunFolder
from train_ato.run_setup import prepare
from train_ato.scenario import load
from train_ato.shape import Shape
from train_ato.topics import BY_NAME
from train_ato.view.facts import Facts, Profile, facts_of
from train_ato.view.feed import Feed
from train_ato.view.moment import DIAL_BEGIN, DIAL_SWEEP, STRIP, Moment, angle, clock, distance, now, strip_row
from train_ato.view.recorded import MOST_POINTS, RecordedFeed
from train_ato.view.strip import Strip
from train_ato.view.tuning import Tunable, coerced, slider_scale

LINE = Facts(
    "two limits",
    Shape(3, 1),
    nose=10.0,
    length=60.0,
    limit_places=np.array([0.0, 1000.0, 1500.0]),
    limit_speeds=np.array([20.0, 10.0, 25.0]),
)
PROFILE = Profile(np.array([0.0, 100.0]), np.array([0.0, 2000.0]), np.array([15.0, 0.0]))


def moment(front, speed=15.0, **more):
    values = {
        "time": 3725.04,
        "position": np.array([front - 10.0, front - 30.0, front - 50.0]),
        "velocity": np.full(3, speed),
        "coupler": np.array([12e3, -340e3, 0.0]),
        "shoe": None,
        "applied": np.array([-45e3]),
        "command": np.array([-50e3]),
        "estimate": np.array([0.0]),
        "reference": (front - 12.5, 14.5, 0.0),
    }
    return Moment(**{**values, **more})


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Record a minute and a half of the demo, with a gust and an emergency brake in it."""
    setup = prepare(*load("demo", ("duration=90", "swaps=[{at: 50, controller: smc}]")))
    done = (GustNow(acceleration=-0.03, duration=10.0), EmergencyBrakeNow())
    planned = tuple(planned_for(at * 1_000_000_000, entry) for at, entry in zip((40, 70), done, strict=True))
    scenario = setup.scenario.model_copy(update={"interventions": planned})
    setup = type(setup)(**{**setup.__dict__, "scenario": scenario})
    folder = RunFolder.make(tmp_path_factory.mktemp("view") / "run", "demo")
    folder.begin(setup)
    with folder.sink(setup) as sink:
        outcome = run_engine(setup, sink=sink)
    folder.finish(setup, outcome)
    return folder.path


def test_a_limit_holds_for_the_whole_train():
    """Breaks if the limit rises when the front passes the end of a slow stretch and the rear is still in it."""
    assert LINE.limit_now(999.0) == 20.0
    assert LINE.limit_now(1000.0) == 10.0
    assert LINE.limit_now(1550.0) == 10.0
    assert LINE.limit_now(1561.0) == 25.0
    assert Facts("none", Shape(1, 1)).limit_now(5.0) == math.inf


def test_the_next_lower_limit_is_the_one_to_brake_for():
    """Breaks if a higher limit ahead is announced, or one that is already in force."""
    assert LINE.next_lower_limit(300.0) == (1000.0, 10.0)
    assert LINE.next_lower_limit(1200.0) is None


def test_what_the_driver_reads():
    """Breaks if a sign, a unit or a reference point of the display is wrong."""
    row = {name: value[0] for name, value in now(moment(300.0), LINE, PROFILE, 100.0).items()}
    assert row["speed_text"] == "54"
    assert row["profile_text"] == "52.2"
    assert row["error_text"] == "+1.80"
    assert row["lag_text"] == "+2.5"
    assert row["limit_text"] == "72"
    assert row["target_text"] == "36 in 700 m"
    assert row["stop_text"] == "1.71 km"
    assert row["place_text"] == "0.300"
    assert row["applied_text"] == "-45"
    assert row["draft_text"] == "12 @ 0"
    assert row["buff_text"] == "340 @ 1"
    assert row["pipe_text"] == "–"
    assert row["clock_text"] == "1:02:05.0"


def test_an_overspeed_changes_the_needle():
    """Breaks if a speed within the tolerance is alarmed, or a higher one is not."""
    needles = [now(moment(300.0, speed), LINE, PROFILE, 100.0)["needle"][0] for speed in (20.2, 20.4)]
    assert needles[0] != needles[1]


def test_the_dial_goes_clockwise_from_its_begin_to_its_end():
    """Breaks if the needle turns the wrong way or leaves the dial."""
    assert angle(50.0, 100.0) == pytest.approx(DIAL_BEGIN - DIAL_SWEEP / 2)
    assert DIAL_BEGIN - DIAL_SWEEP < angle(1e9, 100.0) < angle(10.0, 100.0) < angle(-5.0, 100.0) < DIAL_BEGIN
    assert LINE.scale(PROFILE) == 100
    assert Facts("fast", Shape(1, 1)).scale(Profile(np.zeros(2), np.zeros(2), np.array([0.0, 80.0]))) == 350


@pytest.mark.parametrize(
    ("value", "text"),
    [(1523.0, "1.52 km"), (999.6, "1.00 km"), (420.4, "420 m"), (3.456, "3.46 m"), (-0.12, "-0.12 m"), (math.nan, "–")],
)
def test_distances_in_words(value, text):
    """Breaks if the last metres before a stop are told in whole ones."""
    assert distance(value) == text


def test_the_clock_carries():
    """Breaks if 59.96 s are shown as 60 s."""
    assert clock(59.96) == "0:01:00.0"
    assert clock(3599.99) == "1:00:00.0"


def test_strips_keep_the_newest_rows_and_give_each_browser_what_it_lacks():
    """Breaks if a row is lost or sent twice when the oldest are forgotten."""
    strip = Strip(rows=10)
    seen, number = [], 0
    for time in range(57):
        strip.add((float(time), *[0.0] * (len(STRIP) - 1)))
        if time % 4 == 0:
            seen += strip.since(number)["time"].tolist()
            number = strip.added
    assert seen == [float(time) for time in range(57)]
    assert strip.since(0)["time"].tolist() == [float(time) for time in range(47, 57)]
    assert strip.since(strip.added)["time"].size == 0


def test_a_strip_row_is_in_the_units_of_its_columns():
    """Breaks if a column is exchanged with its neighbour."""
    row = dict(zip(STRIP, strip_row(moment(300.0), LINE), strict=True))
    assert row["speed"] == pytest.approx(54.0)
    assert row["profile"] == pytest.approx(52.2)
    assert row["limit"] == pytest.approx(72.0)
    assert (row["applied"], row["demand"], row["draft"], row["buff"]) == (-45.0, -50.0, 12.0, -340.0)
    assert row["place"] == pytest.approx(0.3)
    assert math.isnan(row["most"])


def test_axes_of_the_forces_only_grow():
    """Breaks if the force strip shrinks and jumps with every frame, or cuts a force off."""
    feed = Feed(LINE)
    feed.show(moment(300.0))
    wide = feed.frame.now["coupler_reach"][0]
    assert wide > 340.0
    feed.show(moment(301.0, coupler=np.zeros(3)))
    assert feed.frame.now["coupler_reach"][0] == wide
    assert feed.frame.number == 2


@pytest.mark.parametrize(
    ("tunable", "expected"),
    [
        (Tunable("pid.kp", 0.05, low=0.0, high=1e9), (0.0, 0.2, 0.001)),
        (Tunable("pid.kd", 0.0, low=0.0, high=1e9), (0.0, 1.0, 0.005)),
        (Tunable("smc.c", 0.4, low=0.0, high=1.0), (0.0, 1.0, 0.005)),
        (Tunable("smc.w", -3.0, low=-100.0, high=500.0), (-12.0, 12.0, 0.1)),
        (Tunable("funnel.bells", 11, low=1.0, high=101.0), (1.0, 101.0, 1.0)),
        (Tunable("x.free", 2.0), (0.0, 8.0, 0.02)),
    ],
)
def test_a_slider_covers_a_sensible_part_of_the_range(tunable, expected):
    """Breaks if a gain of 0.05 gets a slider that ends at 1e9, or one that leaves the allowed range."""
    scale = slider_scale(tunable)
    assert (scale.low, scale.high, scale.step) == pytest.approx(expected)


def test_widgets_give_back_the_parameters_own_type():
    """Breaks if an int goes out for a double: the node refuses that."""
    assert isinstance(coerced(Tunable("a.b", 1.0), 2), float)
    assert isinstance(coerced(Tunable("a.b", 1), 2.0), int)
    assert coerced(Tunable("a.b", True), [0]) is True
    assert Tunable("pid.ki", 0.1, "gain [1/s²]").title == "ki in 1/s²"


def test_facts_come_from_the_scenario():
    """Breaks if grades, limits or the envelope of the display are not those of the run."""
    setup = prepare(*load("demo"))
    facts = facts_of(setup)
    assert facts.shape.n_vehicles == 106
    assert facts.length == pytest.approx(1295.0, abs=1.0)
    assert facts.envelope(0.0)[1] == pytest.approx(760e3)
    assert facts.envelope(50 / 3.6)[0] == pytest.approx(-461e3)
    assert facts.limit_now(500.0) == pytest.approx(80 / 3.6)
    inside = np.flatnonzero(facts.grade_places <= 2000.0)[-1]
    assert facts.grades[inside] == pytest.approx(1e3 * grade_at(setup.line, 2000.0))


def grade_at(line, place):
    return [entry.grade for entry in line.grades if entry.at <= place][-1]


def test_a_recorded_run_shows_any_moment(run):
    """Breaks if a moment is a tick off, or the law and the emergency brake of the log are not told."""
    feed = RecordedFeed(run)
    assert feed.span == (0.0, 90.0)
    assert [mark.time for mark in feed.marks if "gust" in mark.text] == [40.0]
    feed.seek(45.03)
    assert feed.frame.moment.time == pytest.approx(45.0)
    assert feed.frame.moment.law == "pid"
    feed.step(1)
    assert feed.frame.moment.time == pytest.approx(45.1)
    feed.seek(71.0)
    assert feed.frame.moment.law == "smc"
    assert feed.frame.moment.state == "emergency brake"
    assert feed.frame.now["pipe_text"] == ["101"]
    feed.seek(1e9)
    assert feed.time == 90.0


def test_playing_goes_on_until_the_end_and_begins_again(run, monkeypatch):
    """Breaks if time runs at another pace, beyond the end, or stands still after the end was reached."""
    feed = RecordedFeed(run)
    clock_now = [1000.0]
    monkeypatch.setattr("train_ato.view.recorded.time.monotonic", lambda: clock_now[0])
    feed.seek(30.0)
    feed.speed = 10.0
    feed.set_playing(True)
    clock_now[0] += 2.0
    feed.advance()
    feed.advance()
    assert feed.time == pytest.approx(50.0)
    clock_now[0] += 60.0
    feed.advance()
    assert (feed.time, feed.playing) == (90.0, False)
    feed.set_playing(True)
    assert (feed.time, feed.playing) == (0.0, True)


def test_the_strip_of_a_recorded_run_is_that_of_the_log(run):
    """Breaks if the charts are shifted against the time, or too many points are sent."""
    feed = RecordedFeed(run)
    part = feed.part(20.0, 30.0)
    assert part["time"][0] == pytest.approx(20.0)
    assert set(part) == set(STRIP)
    feed.seek(25.0)
    row = int(np.searchsorted(part["time"], 25.0 - 1e-6))
    live = dict(zip(STRIP, strip_row(feed.frame.moment, feed.facts), strict=True))
    for name in STRIP:
        assert part[name][row] == pytest.approx(live[name], rel=1e-3, abs=1e-3), name
    assert feed.part(-1e9, 1e9)["time"].size <= MOST_POINTS


def test_a_run_without_the_truth_is_refused_in_one_line(tmp_path):
    """Breaks if a log that the page cannot show ends in a traceback."""
    answer = subprocess.run(
        [sys.executable, "-m", "train_ato", "view", str(tmp_path)], capture_output=True, text=True, timeout=60
    )
    assert answer.returncode == 2
    assert answer.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--port", "70000"), "--port 70000"),
        (("--pace", "-1"), "--pace -1.0"),
        (("--controller", "smc"), "--controller: only for a run that is started here"),
        (("--domain", "555"), "--domain 555"),
        (("--scenario", "dmo", "--no-browser"), "unknown scenario 'dmo'"),
    ],
)
def test_bad_input_is_refused_before_anything_starts(arguments, text):
    """Breaks if a mistake on the command line starts a server or ends in a traceback."""
    answer = subprocess.run(
        [sys.executable, "-m", "train_ato", "view", *arguments], capture_output=True, text=True, timeout=60
    )
    assert answer.returncode == 2
    assert text in answer.stderr
    assert answer.stderr.count("\n") == 1


def test_a_port_in_use_is_refused_in_one_line(run):
    """Breaks if two pages fight for a port, or the user sees a traceback."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        answer = subprocess.run(
            [sys.executable, "-m", "train_ato", "view", str(run), "--port", str(port), "--no-browser"],
            capture_output=True,
            text=True,
            timeout=60,
        )
    assert answer.returncode == 2
    assert answer.stderr == f"train-ato: --port {port}: in use already; name another one, or 0 for a free one\n"


def topics_named(text):
    """Return the topics of the table that paths such as /train/cars.velocity[0] or /train/cars/car_0/effort name."""
    known = sorted(BY_NAME, key=len, reverse=True)
    return {next((name for name in known if text.lstrip("/").startswith(name.lstrip("/"))), text)}


def test_the_foxglove_layout_names_our_topics_and_arranges_every_panel():
    """Breaks if a topic is renamed and the layout is forgotten, or a panel is configured that is not shown."""
    layout = json.loads((files("train_ato") / "view" / "layouts" / "foxglove.json").read_text(encoding="utf-8"))
    series = [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", ())]
    assert {name for path in series for name in topics_named(path)} <= set(BY_NAME)

    def panels(node):
        return {node} if isinstance(node, str) else panels(node["first"]) | panels(node["second"])

    assert panels(layout["layout"]) == set(layout["configById"])


def test_the_plotjuggler_layout_names_our_topics():
    """Breaks if a topic is renamed and the layout is forgotten, or a curve is named that no equation makes."""
    root = ET.fromstring((files("train_ato") / "view" / "layouts" / "plotjuggler.xml").read_text(encoding="utf-8"))
    made = {snippet.get("name") for snippet in root.iter("snippet")}
    curves = {curve.get("name") for curve in root.iter("curve")}
    sources = {node.text for node in root.iter("linked_source")}
    sources |= {node.text for more in root.iter("additional_sources") for node in more}
    assert made <= curves
    assert {name for path in (curves - made) | sources for name in topics_named(path)} <= set(BY_NAME)
