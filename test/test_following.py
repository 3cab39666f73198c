"""Trains behind each other: reports, profile one headway behind, moving end of authority, figures of the gap."""

import json
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from end_law import SeesTheEnd
from engine_runs import no_figure
from plant_trains import line_of
from span_runs import Both

import train_ato as ta
from plant_sim.states import Odometry
from plant_sim.traction import Envelope
from train_ato.api.drive import RunMode
from train_ato.api.following import (
    FollowingResult,
    Preparation,
    first_report,
    follower_figures,
    result_of,
    run_following,
    train_reports,
)
from train_ato.api.run import Run
from train_ato.cli.main import main
from train_ato.cli.run import print_following
from train_ato.log.log_writer import LogFile
from train_ato.log.mcap_records import stream
from train_ato.log.recorded import open_recording
from train_ato.loop.headway import HeadwayProfile
from train_ato.loop.train_ahead import MovingAuthority, ReportReceiver
from train_ato.scenario.following import load_following
from train_ato.scenario.scenario_files import shipped_following
from train_ato.scenario.setup import RunSetup
from train_ato.supervision.limits import BrakingTarget
from train_ato.supervision.odometry import motion_estimate
from train_ato.supervision.train_report import (
    ShortestStop,
    TrainReport,
    TrainReporter,
    parse_reports,
    reports_text,
    stretched_length,
)
from train_ato.view.recorded import RecordedFeed

CRUISE = [{"accelerate_to_kmh": 50}, {"cruise_until": 400}, {"brake_to": 0}]
METRO: dict[str, Any] = {
    "base": "xuzhou_metro", "tick": 0.1, "step": 0.005, "supervision": {"enabled": True},
    "profile": {"phases": CRUISE, "limits": {"jerk": 0.6, "acceleration": 0.8, "deceleration": 0.8}},
}  # fmt: skip
RELATIVE = {"authority": "relative", "timeout": 5}
LEADER: dict[str, Any] = {"headway": 40.0, "smoothing": 10.0}


def report(count: int, time: float, rear: float, stop: float = 200.0, front: float | None = None) -> TrainReport:
    """Return a report of a train of 120 m."""
    return TrainReport(count, time, rear + 120.0 if front is None else front, rear, 15.0, stop)


def metro(reports: list[TrainReport], leader: dict[str, Any] | None = None, **changes: Any) -> RunSetup:
    """Return the run of a metro train from the begin of the line behind reports."""
    block = {"reports": reports_text(reports), **(leader or {})}
    return ta.scenario({**METRO, "leader": block, **changes}).prepare()


def ends(reports: list[TrainReport], times: tuple[float, ...], **leader: Any) -> list[float]:
    """Return the end of authority at some times."""
    setup = metro(reports, leader)
    authority = MovingAuthority(setup, setup.supervisor().track)
    found = []
    for time in times:
        authority.move(round(time * 1e9))
        found.append(authority.end)
    return found


REPORTS = [report(k + 1, 0.4 * k, 1000.0 + 6.0 * k) for k in range(5)]


@pytest.mark.parametrize(
    ("reports", "times", "leader", "expected"),
    [
        pytest.param(REPORTS, (0.0, 0.4, 1.6), {"rear_margin": 10}, [990.0, 996.0, 1014.0], id="rear less margin"),
        # the shortest stop of 200 m counts up to the timeout: 5 s after the last report of 1.6 s
        pytest.param(REPORTS, (1.6, 6.6, 6.7, 60.0), RELATIVE, [1214.0, 1214.0, 1014.0, 1014.0], id="timeout"),
        pytest.param(REPORTS, (1.6, 100.0), {}, [1014.0, 1014.0], id="no more reports"),
        pytest.param([*REPORTS, report(6, 2.0, 1004.0)], (1.6, 2.0), {}, [1014.0, 994.0], id="nearer end"),
        pytest.param(REPORTS, (0.4, 1.1, 1.2), {"link": {"delay": 0.8}}, [990.0, 990.0, 996.0], id="delay"),
    ],
)
def test_the_end_of_authority_follows_the_reports(reports: Any, times: Any, leader: Any, expected: list[float]) -> None:
    """Fails without margin or delay, with the front, or with an end that lasts, moves on alone or waits."""
    assert ends(reports, times, **leader) == expected


def test_the_end_of_authority_is_not_beyond_that_of_the_own_stop() -> None:
    """Fails if the reports extend the authority beyond the stop of the own profile and its overlap of 100 m."""
    setup = metro(REPORTS)
    own = setup.supervisor().track.end
    stop = float(setup.profile.position[-1]) + setup.consist.vehicles[0].length / 2.0
    assert own == pytest.approx(stop + 100.0) and ends([report(1, 0.0, 50_000.0)], (0.0,)) == [own]


@pytest.mark.parametrize(
    "wrong",
    [
        REPORTS[2],  # repetition
        report(2, 2.4, 1200.0),  # a number before the newest one
        report(9, 1.2, 1200.0),  # a time before the newest one
        report(9, 2.4, math.nan, front=1200.0),
        report(9, 2.4, 1200.0, stop=-1.0),
        report(9, 2.4, 1200.0, front=1100.0),
        report(9, 2.4, 2000.0),  # 900 m in 0.8 s
    ],
)
def test_a_wrong_report_is_refused_and_counted(wrong: TrainReport) -> None:
    """Fails if a report of a threat of EN 50159 moves the end of authority."""
    receiver = ReportReceiver(metro(REPORTS), "test")
    for time in (0.0, 0.4, 0.8, 1.2, 1.6):
        receiver.receive(round(time * 1e9))
    receiver._reports = [*REPORTS, wrong]
    assert receiver.receive(2_400_000_000) is None and receiver.newest(2_400_000_000) == REPORTS[-1]
    assert receiver.at(2_400_000_000).refused == 1


def test_reports_keep_their_bits_as_text() -> None:
    """Fails if digits are lost in the scenario of the follower, which `verify` repeats."""
    reports = [TrainReport(1, 0.1 + 0.2, 1.0 / 3.0, -2.0 / 3.0, math.pi, 0.0)]
    assert parse_reports(reports_text(reports)) == tuple(reports)
    header, line = reports_text(reports).splitlines()[:2]
    for text in ("", header, f"{line}\n{line}", f"{header},more\n{line}"):
        with pytest.raises(ValueError, match="the first line has to be number,time"):
            parse_reports(text)


def test_the_safe_rear_is_behind_the_rear_with_the_errors_of_both_odometers() -> None:
    """Fails with the larger position, without the error of SUBSET-041, or with the length of relaxed couplers."""
    setup = metro(REPORTS)
    reporter = TrainReporter(setup.consist, setup.scenario.plant, setup.line, 80.0 / 3.6)
    odometry = Odometry(0, np.array([1002.0, 1000.0]), np.array([3.0, 3.2]), np.array([300.0, 290.0]))
    found = reporter.report(odometry)
    assert found.front == 1001.0
    assert found.rear == pytest.approx(1000.0 - 20.0 - stretched_length(setup.consist))
    shortest = ShortestStop(setup.consist, setup.scenario.plant, setup.line, 80.0 / 3.6)
    slow = shortest.way(3.0 - 2.0 / 3.6, 1021.0, found.rear)
    assert found.stop == pytest.approx(slow)
    consist = ta.scenario("demo").prepare().consist
    by_hand = consist.length
    for gear in consist.gears:
        by_hand += gear.slack / 2 + gear.stroke  # type: ignore[union-attr]
    assert stretched_length(consist) == pytest.approx(by_hand)
    assert stretched_length(consist) > consist.length + 5.0


def test_the_shortest_stop_is_that_of_the_strongest_and_lightest_train() -> None:
    """Fails with 100 % of a quantity, or without the rise; the integral of the test is in steps of 1 mm/s."""
    setup = metro(REPORTS)
    line = line_of(10e3, grades=[{"at": 0, "grade": 0}, {"at": 1500, "grade": 0.02}, {"at": 1600, "grade": -0.02}])
    consist = setup.consist
    stop = ShortestStop(consist, setup.scenario.plant, line, 80.0 / 3.6)
    mass = sum(vehicle.mass * vehicle.rotating_mass_factor for vehicle in consist.vehicles)
    full = sum(consist.friction_forces)

    def by_hand(speed: float, rise: float) -> float:
        v = np.arange(0.0005, speed, 0.001)
        kmh = 3.6 * v
        friction = full * (2.0 * kmh + 150.0) / (3.0 * kmh + 150.0)
        electric = np.zeros_like(v)
        resistance = np.zeros_like(v)
        for vehicle in consist.vehicles:
            c0, c1, c2 = vehicle.resistance.polynomial(vehicle.mass, consist.gravity)
            resistance += c0 + c1 * v + c2 * v * v
            if vehicle.brake:
                electric += [Envelope(vehicle.brake).force(x) for x in v.tolist()]
        a = (1.05 * (friction + electric) + 1.15 * resistance) / (0.97 * mass) + consist.gravity * rise
        return float((v / a).sum() * 0.001)

    assert stop.way(15.0, 800.0, 700.0) == pytest.approx(by_hand(15.0, 0.0), rel=5e-3)
    assert stop.way(15.0, 1550.0, 1450.0) == pytest.approx(by_hand(15.0, 0.02), rel=5e-3)
    assert stop.way(15.0, 1800.0, 1700.0) == pytest.approx(by_hand(15.0, 0.0), rel=5e-3)  # a fall does not count
    assert stop.way(15.0, 1550.0, 1450.0) <= by_hand(15.0, 0.02)


def test_no_train_within_the_safety_data_stops_on_a_shorter_way() -> None:
    """Fails if a brake of the plant is missing in the shortest stop: 97 % mass, 105 % brakes, 115 % resistance."""
    scale = {"mass_scale": 0.97, "resistance_scale": 1.15, "electric_brake_scale": 1.05, "brake_scale": 1.05}
    run = ta.run({
        **METRO, "duration": 40, "plant": {"mismatch": scale},
        "interventions": [{"at": 20.0, "do": "emergency_brake"}],
    })  # fmt: skip
    recording = run.recording
    reports = train_reports(recording, run.setup)
    at = next(found for found in reports if found.time >= 20.0)
    begun = np.interp(at.time, recording.time, recording.front_position)
    assert recording.front_velocity[-1] < 0.01
    assert recording.front_position[-1] - begun >= at.stop > 0.3 * (recording.front_position[-1] - begun)


TWO_STOPS = [
    {"accelerate_to_kmh": 50}, {"cruise_until": 100}, {"brake_to": 0}, {"cruise_for": 15},
    {"accelerate_to_kmh": 50}, {"cruise_until": 220}, {"brake_to": 0},
]  # fmt: skip


@pytest.mark.parametrize(
    ("phases", "held_at", "held", "pace", "until", "behind"),
    [
        pytest.param(TWO_STOPS, 125.0, 30.0, 1.0, None, 0.5, id="leaves a stop late"),
        pytest.param(TWO_STOPS, 125.0, 30.0, 1.1, None, 2.0, id="makes up a delay"),
        pytest.param(TWO_STOPS, 125.0, 60.0, 2.0, None, math.inf, id="makes up a delay at twice the speed"),
        pytest.param(TWO_STOPS, 125.0, 600.0, 1.0, None, 0.5, id="does not leave a stop"),
        pytest.param(TWO_STOPS, 180.0, 30.0, 1.0, None, 20.0, id="waits on the line"),
        pytest.param(TWO_STOPS, 180.0, 600.0, 1.0, None, 20.0, id="stands on the line"),
        pytest.param([*TWO_STOPS[:5], {"cruise_until": 220}], 180.0, 600.0, 1.0, None, 20.0, id="before a rolling end"),
        pytest.param(TWO_STOPS, 180.0, 600.0, 1.0, 250.0, math.inf, id="stands on the line, own profile again"),
        pytest.param(TWO_STOPS, 50.0, 12.0, 1.0, None, 50.0, id="waits at the begin"),
        pytest.param([*TWO_STOPS[:3], *TWO_STOPS[4:]], 121.0, 30.0, 1.0, None, 2.0, id="no stay at the stop"),
    ],
)
def test_a_late_leader_delays_the_own_stops(
    phases: Any, held_at: float, held: float, pace: float, until: float | None, behind: float
) -> None:
    """Fails if the own profile makes up a delay before a stop, or is faster than any train, backwards or not smooth."""
    changes = {"profile": {**METRO["profile"], "phases": phases, "allow_rolling_end": True}, "duration": 400}
    plan = ta.scenario({**METRO, **changes}).prepare()
    half = plan.consist.vehicles[0].length / 2.0
    times = 0.4 * np.arange(1000)
    late = np.minimum(times, held_at + pace * np.maximum(times - held - held_at, 0.0))
    places = plan.profile.at_times(np.where(times < held_at, times, late))[0]
    reports = [
        report(k, each - 40.0, place + half - 120.0, front=place + half)
        for k, (each, place) in enumerate(zip(times.tolist(), places.tolist(), strict=True))
        if each >= 40.0
    ]
    headway = HeadwayProfile(metro(reports, {**LEADER, "until": until}, **changes))
    own, current, found = plan.profile, plan.profile, []
    for stamp in range(0, 380_000_000_000, 400_000_000):
        current = headway.step(stamp) or current
        found.append(current.at(stamp * 1e-9)[:3])
    place, speed, acceleration = np.array(found).T
    assert speed.min() >= -0.5 and speed.max() <= 1.05 * pace * own.velocity.max()
    assert np.abs(acceleration).max() <= 2.5 * np.abs(own.acceleration).max()
    assert np.abs(np.gradient(speed, 0.4) - acceleration)[1:-1].max() <= 0.1
    assert np.abs(place - places[: place.size]).max() <= behind
    assert (place[-1] == own.position[-1]) == (held < 600.0 or until is not None)


@pytest.mark.parametrize(("gap", "drives", "until", "end"), [
    pytest.param((100, 160), [(110, 110), (200, 110), (600, 510)], None, 0.1, id="halts for long"),
    pytest.param((100, 142), [(80, 80), (150, 80), (600, 530)], None, 0.1, id="halted before"),
    pytest.param(
        (100, 210), [(110, 110), (205, 110), (213, 118), (250, 118), (600, 468)], None, 0.1,
        id="halts again within the smoothing time",
    ),
    pytest.param((100, 160), [(110, 110)], 220.0, 0.1, id="stands, own profile again"),
    pytest.param((320, 420), [(325, 325), (450, 325), (600, 475)], None, 0.1, id="at the last own stop"),
    pytest.param((120, 200), [(80, 80), (120, 80), (121, 121), (600, 600)], None, 0.1, id="regains where slow"),
    pytest.param((100, 160), [(110, 110)], None, math.inf, id="stands"),
    pytest.param((600, 600), [(0, -3.5), (600, 596.5)], None, 0.1, id="is 49 m behind at the start"),
])  # fmt: skip
def test_a_profile_behind_late_reports_does_not_run_back(gap: Any, drives: Any, until: Any, end: float) -> None:
    """Fails if the profile runs back or joins the reports with a high speed or acceleration, or leaves its stop."""
    slow = [*CRUISE[:1], {"cruise_until": 130}, {"brake_to_kmh": 18}, {"cruise_until": 300}]
    phases = [*slow, *CRUISE[:1], {"cruise_until": 420}, *CRUISE[2:]]
    changes = {"profile": {**METRO["profile"], "phases": phases}, "duration": 600}
    plan = metro([report(1, 0.0, 0.0)], **changes)
    times = 0.5 * np.arange(1200)
    planned = np.interp(times, *zip((0, 0), *drives, strict=True))
    places = plan.profile.at_times(planned + 40.0)[0] + 59.0
    heard = (times <= gap[0]) | (times >= gap[1])
    reports = [
        report(k, t, p - 120.0, front=p)
        for k, (t, p) in enumerate(zip(times[heard].tolist(), places[heard].tolist(), strict=True))
    ]
    headway, found, current = HeadwayProfile(metro(reports, {**LEADER, "until": until}, **changes)), [], plan.profile
    for stamp in range(0, 600_000_000_000, 100_000_000):
        current = headway.step(stamp) or current
        found.append(current.at(stamp * 1e-9)[:3])
    place, speed, acceleration = np.array(found).T
    own = plan.profile
    nearby = (np.interp(place + way, own.position, own.velocity) for way in (-20.0, 0.0, 20.0))
    assert speed.min() >= -0.05 and (speed / np.maximum.reduce(list(nearby))).max() <= 1.2
    assert np.abs(acceleration).max() <= 2.5 * np.abs(own.acceleration).max()
    assert np.abs(np.gradient(place, 0.1) - speed)[1:-1].max() <= 0.02
    assert abs(place[-1] - own.position[-1]) <= end


def shifted_profile(rate: float) -> tuple[RunSetup, HeadwayProfile, list[Any]]:
    """Return a run behind a leader that leaves its plan with a constant rate [m/s], and the profiles behind it."""
    plan = ta.scenario(METRO).prepare().profile
    half = ta.scenario(METRO).prepare().consist.vehicles[0].length / 2.0
    reports = [
        report(k + 1, 0.4 * k, 0.0, front=plan.at(0.4 * k + 40.0)[0] + half + rate * 0.4 * k) for k in range(500)
    ]
    setup = metro([each._replace(rear=each.front - 120.0) for each in reports], LEADER)
    headway = HeadwayProfile(setup)
    found = [headway.step(stamp) for stamp in range(0, 200_000_000_000, 100_000_000)]
    return setup, headway, [profile for profile in found if profile is not None]


def test_the_profile_follows_the_leader_without_a_lag() -> None:
    """Fails if the average changes the own profile, or is over the past only: with 0.1 m/s and 10 s 0.5 m behind."""
    setup, _, profiles = shifted_profile(0.0)
    assert profiles
    for profile in profiles:
        same = slice(setup.profile.time.size - profile.time.size, None)
        np.testing.assert_allclose(profile.position, setup.profile.position[same], atol=1e-9)
        np.testing.assert_allclose(profile.velocity, setup.profile.velocity[same], atol=1e-9)
    setup, _, profiles = shifted_profile(0.1)
    profile = next(each for each in profiles if each.time[0] > 45.0)
    own, found = setup.profile.at(120.0), profile.at(120.0)
    late = profiles[-1].at(190.0)
    assert late[0] - setup.profile.at(190.0)[0] == pytest.approx(15.0, abs=1e-3)
    assert late[1] - setup.profile.at(190.0)[1] == pytest.approx(0.1, abs=1e-4)
    assert found[1] == pytest.approx(own[1], abs=0.2)


def test_profiles_behind_a_leader_agree_join_and_keep_the_own_stop() -> None:
    """Fails for an error in a derivative, a step of the reference at a new report, or a moved own stop."""
    _, _, profiles = shifted_profile(0.3)
    for profile in profiles:
        period = profile.period
        speed = np.gradient(profile.position, period)
        acceleration = np.gradient(profile.velocity, period)
        np.testing.assert_allclose(speed[1:-1], profile.velocity[1:-1], atol=2e-3)
        np.testing.assert_allclose(acceleration[1:-1], profile.acceleration[1:-1], atol=4e-2)
    _, headway, profiles = shifted_profile(0.3)
    later = [(before, after) for before, after in pairwise(profiles) if after.time[0] > 0.1]
    assert later
    for before, after in later:
        now = after.time[0] + 60.0
        assert after.at(now)[0] == pytest.approx(before.at(now)[0], abs=1e-6)
        assert after.at(now)[1] == pytest.approx(before.at(now)[1], abs=1e-6)
    assert headway.receiver.at(200_000_000_000).refused == 0
    setup, _, profiles = shifted_profile(0.3)
    assert profiles[-1].position[-1] == setup.profile.position[-1]
    assert profiles[-1].velocity[-1] == 0.0


def following_file(folder: Path, **changes: Any) -> Path:
    """Write a following file of two short metro trains; return its path."""
    phases = [{"accelerate_to_kmh": 50}, {"cruise_until": 300}, {"brake_to": 0}]
    base = folder / "metro.yaml"
    base.write_text(yaml.safe_dump({
        "schema": "train_ato/scenario/1", "name": "metro", **METRO, "duration": 70,
        "profile": {"phases": phases, "limits": METRO["profile"]["limits"]},
    }))  # fmt: skip
    data: dict[str, Any] = {
        "schema": "train_ato/following/1", "name": "two",
        "trains": [
            {"name": "t1", "scenario": "metro.yaml", "set": {"profile": {"since": 80}}},
            {"name": "t2", "scenario": "metro.yaml", "set": {
                "profile": {"since": 40, "phases": [*phases[:1], {"cruise_until": 270}, phases[2]]}, "leader": LEADER}},
        ],
    }  # fmt: skip
    path = folder / "two.yaml"
    path.write_text(yaml.safe_dump({**data, **changes}))
    return path


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> tuple[FollowingResult, Path]:
    """Return two recorded trains and their folder."""
    folder = tmp_path_factory.mktemp("following")
    path = following_file(folder)
    with no_figure():
        return run_following(load_following(path), RunMode("engine"), folder / "out", shown=False), folder / "out"


def test_a_page_shows_the_train_of_a_namespace_in_a_log_of_two(two: Any, tmp_path: Path) -> None:
    """Breaks if `view LOG --namespace /t2` shows the first train, or if a wrong namespace shows an empty page."""
    log, known = LogFile(tmp_path), dict[str, int]()
    for name in ("t1", "t2"):
        for message in stream(two[1] / name / "run.mcap"):
            topic = f"/{name}{message.channel.topic}"
            if topic not in known:
                known[topic] = log.copy(replace(message.channel, topic=topic), message.schema)
            log.write(known[topic], message.publish_ns, message.log_ns, message.data)
    log.close()
    for space, name in (("/t2", "t2"), ("/t1", "t1"), ("", "t1")):
        found = RecordedFeed(tmp_path / "run.mcap", space).recording
        assert np.array_equal(found.front_position, open_recording(two[1] / name).front_position), space
    with pytest.raises(ValueError, match="--namespace /t3: is not in the log; its namespaces: /t1, /t2"):
        RecordedFeed(tmp_path / "run.mcap", "/t3")


def test_a_disturbance_of_the_first_train_does_not_grow(tmp_path: Path) -> None:
    """Fails if the string is unstable: the peak of a disturbance of the speed grows from train to train."""
    gust = [{"at": 12, "do": "gust", "acceleration": -1.0, "duration": 20, "ramp": 2}]
    phases = [{"accelerate_to_kmh": 50}, {"cruise_until": 4000}, {"brake_to": 0}]
    trains: list[dict[str, Any]] = [
        {"name": f"t{number}", "scenario": "metro.yaml", "set": {
            "duration": 130, "profile": {"since": 200 - 40 * number, "phases": phases},
            **({"leader": LEADER} if number > 1 else {"interventions": gust})}}
        for number in (1, 2, 3)
    ]  # fmt: skip
    file = load_following(following_file(tmp_path, trains=trains))
    result = run_following(file, RunMode("engine"), shown=False)
    behind = [row["speed_amplification"] for row in result.summary["trains"][1:]]
    assert all(0.1 < found <= 1.0 for found in behind), behind
    for limit, due in ((1.0, 0), (0.9 * max(behind), 1)):
        criteria = file.spec.criteria.model_copy(update={"speed_amplification": limit})
        judged = result_of(file.spec.model_copy(update={"criteria": criteria}), result.runs, None).summary
        assert sum("amplification of the speed" in text for text in judged["broken"]) == due, judged["broken"]


def columns(run: Run) -> tuple[list[float], list[float], list[float]]:
    """Return times, places of the front and places of the rear of a train from its log."""
    table = run["train/vehicles"]
    names = [name for name in table.columns if name.endswith("position_m")]
    first, last = run.setup.consist.vehicles[0].length / 2.0, run.setup.consist.vehicles[-1].length / 2.0
    seconds = [index * run.setup.tick for index in range(len(table))]
    return seconds, (table[names[0]] + first).tolist(), (table[names[-1]] - last).tolist()


def test_the_logs_of_two_trains_have_their_gap_and_headway_errors(two: tuple[FollowingResult, Path]) -> None:
    """Fails with another end, headway or tick, no end of authority in the log, or an unseen contact."""
    result, _ = two
    times, front, _ = columns(result.runs["t2"])
    _, ahead, rear = columns(result.runs["t1"])
    row = result.summary["trains"][1]
    assert row["gap_min_m"] == pytest.approx(min(b - a for a, b in zip(front[:-1], rear[:-1], strict=True)), abs=1e-6)
    shift = 400  # 40 s in ticks of 0.1 s
    errors = [abs(front[k] - ahead[k - shift]) for k in range(shift, len(times) - 1)]
    assert row["headway_error_max_m"] == pytest.approx(max(errors), abs=1e-6)
    assert row["contacts"] == 0 and result.summary["verdict"] == "passed"
    assert row["headway_error_max_m"] < 2.0
    recording = two[0].runs["t2"].recording
    times, values = recording.reported("supervisor", "end_of_authority")
    assert times.size > 60 and np.all(np.diff(values) > 0.0)
    _, ages = recording.reported("supervisor", "leader_age")
    assert ages.max() < 1.0
    ahead, own = two[0].runs["t1"].recording, two[0].runs["t2"].recording
    truth = ahead.topics["train/vehicles"]
    moved = {name: part - 600.0 if name.endswith("_position") else part for name, part in truth.values.items()}
    nearer = replace(ahead, topics={**ahead.topics, "train/vehicles": replace(truth, values=moved)})
    assert follower_figures(nearer, own, own.setup)["contacts"] == 1  # type: ignore[arg-type]


def test_each_train_has_a_log_that_repeats_bit_for_bit(two: tuple[FollowingResult, Path]) -> None:
    """Fails if the follower needs what its folder lacks, or a span has another end of authority or profile."""
    _, folder = two
    assert json.loads((folder / "summary.json").read_text())["following"] == "two"
    for name in ("t1", "t2"):
        found = ta.verify(folder / name)
        assert found.equal, found.first
    Both(two[0].runs["t2"].setup).assert_equal(least=0.7)


@pytest.mark.parametrize(
    ("leader_stops", "authority"), [("stands", "absolute"), ("emergency", "absolute"), ("emergency", "relative")]
)
def test_a_train_stops_behind_a_leader_that_stops(leader_stops: str, authority: str) -> None:
    """Fails if the supervisor does not stop the train before the rear of a leader that stops at once or brakes."""
    changes: dict[str, Any] = {"duration": 60, "profile": {**METRO["profile"], "since": 70}}
    if leader_stops == "emergency":
        changes["interventions"] = [{"at": 5.0, "do": "emergency_brake"}]
    ahead = ta.run({**METRO, **changes})
    reports = train_reports(ahead.recording, ahead.setup)
    if leader_stops == "stands":
        stood = next(found for found in reports if found.time >= 5.0)
        reports = [
            found if found.time < 5.0 else stood._replace(number=found.number, time=found.time, speed=0.0, stop=0.0)
            for found in reports
        ]
    leader = {"reports": reports_text(reports), "authority": authority, "link": {"delay": 0.8, "loss": 0.05}}
    own = ta.run({**METRO, "duration": 60, "profile": {**METRO["profile"], "since": 50}, "leader": leader})
    front = own.recording.front_position[-1] + own.setup.consist.vehicles[0].length / 2.0
    rear = reports[-1].rear if leader_stops == "stands" else float(columns(ahead)[2][-1])
    assert own.recording.front_velocity[-1] < 0.01 and 0.0 < rear - front < 200.0


def end_ahead(**changes: Any) -> tuple[Run, SeesTheEnd]:
    """Return a train of 60 s behind a leader that brakes to a stop, and its law."""
    profile = {**METRO["profile"], "phases": [*CRUISE[:1], {"cruise_until": 900}, *CRUISE[2:]]}
    ahead = ta.run({
        **METRO, "duration": 60, "profile": {**profile, "since": 60},
        "interventions": [{"at": 5.0, "do": "emergency_brake"}],
    })  # fmt: skip
    leader = {"reports": reports_text(train_reports(ahead.recording, ahead.setup)), "link": {"delay": 0.8}}
    law = SeesTheEnd(**changes)
    only = {"enabled": True, "assurance": False}
    own = {**METRO, "duration": 100, "profile": {**profile, "since": 30}, "leader": leader, "supervision": only}
    return ta.run(own, law=law), law


@pytest.mark.parametrize(("sees", "interventions"), [(True, 0), (False, 1)])
def test_a_law_that_sees_the_moving_end_stops_before_it(*, sees: bool, interventions: int) -> None:
    """Fails if the lookahead has no moving end: such a law ends in the supervisor."""
    own, _ = end_ahead(sees=sees)
    assert own.metrics["brake_interventions"] == interventions
    assert own.recording.front_velocity[-1] < 0.05


def test_the_end_of_the_lookahead_is_that_of_the_supervisor() -> None:
    """By hand: the safe rear less 10 m, 5 m and 5 % of the distance since the balise, and half a vehicle."""
    own, law = end_ahead()
    track, half = own.setup.supervisor().track, own.setup.consist.vehicles[0].length / 2.0
    rear, spacing = own.setup.leader_reports[-1].rear, own.setup.scenario.plant.odometry.balise_spacing
    end = rear - own.setup.scenario.leader.rear_margin  # type: ignore[union-attr]
    t, place_max = law.seen[-1][:2]
    assert t > 95.0
    assert place_max == pytest.approx(end - 5.0 - 0.05 * (end % spacing) - half, abs=1e-9)
    track.move_end(BrakingTarget(end, kind="EOA"))
    for _, _, place, _, limit, _ in law.seen[-300::50]:
        front = place + half
        permitted = track.evaluate(front, motion_estimate(0.0, 0.0, front % spacing)).permitted
        line = own.setup.line.restricted_limits
        assert limit == pytest.approx(min([permitted, *(each.speed for each in line)]), abs=1e-9)


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the line of a refused command."""
    assert main(["run", *arguments, "--engine"]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    return lines[0]


def test_bad_input_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Fails if a wrong following file starts a run, or is refused without key and remedy."""
    path = str(following_file(tmp_path))
    out = tmp_path / "out"
    assert "begin the key with a train: all., t1., t2." in refused(capsys, path, "--set", "law=smc")
    assert "write --set all.law=smc" in refused(capsys, path, "--law", "smc")
    assert "the first train has no train ahead" in refused(capsys, path, "--set", "t1.leader.headway=50")
    assert "headway 19 s: shorter than" in refused(capsys, path, "--set", "t2.leader.headway=19")
    late = "t2.leader.headway=200"  # its plan is 60 s behind that of the train ahead
    assert f"--set {late}: leader.headway = 200: after" in (text := refused(capsys, "following_metro", "--set", late))
    assert "1460 m beyond" in text and "write 60 s" in text
    short = "t2.profile.phases=[{cruise_for: 5}, {accelerate_to_kmh: 50}, {stop_at: 1050}]"  # behind the train ahead
    Preparation(load_following(shipped_following()["following_metro"], (short,))).check()
    assert "until 50 s: the first" in refused(capsys, "following_metro", "--set", "t2.leader.until=50")
    assert "inside the train ahead" in refused(capsys, path, "--set", "t2.profile.since=76", "--out", str(out))
    assert "set supervision.enabled: true" in refused(capsys, path, "--set", "all.supervision.enabled=false")
    for change, problem in {
        "t2.leader.headway=x": "leader.headway = 'x': ",
        "t1.base=demo": "base = 'demo': is the key `scenario`",
        "all.seed=3": "seed = 3: is that of the file",
        "t2.leader=5": "leader = 5: is no block",
        "all.duration=-1": "duration = -1: ",
        "t2.plant.line=xuzhou_metro_test": "plant.line: 'xuzhou_metro_test' is not ",
    }.items():
        assert f"train-ato: --set {change}: {problem}" in refused(capsys, path, "--set", change)
    assert "train-ato: --seed -1: seed = -1: " in refused(capsys, path, "--seed", "-1")
    assert not out.exists()
    trains = [{"name": "t1", "scenario": "demo"}] * 2
    assert "2 trains have the name t1" in refused(capsys, str(following_file(tmp_path, trains=trains)))
    for first, problem in {
        '"demoo"': "t1: scenario = 'demoo': unknown scenario",
        '"demo", "set": {"durration": 3}': "t1: durration: unknown key",
        '"demo", "set": {"name": "x"}': "t1: set.name = 'x': ",
        '"demo", "set": {"leader": {}}': "t1: set.leader: the first train has no train ahead",
    }.items():
        trains[0] = json.loads(f'{{"name": "t1", "scenario": {first}}}')
        trains[1] = {"name": "t2", "scenario": "demo"}
        path = str(following_file(tmp_path, trains=trains))
        assert refused(capsys, path).startswith(f"train-ato: {path}: {problem}")
    assert main(["compare", path, "--laws=pid"]) == 2
    assert "holds trains behind each other, no scenario; only `train-ato run` takes it" in capsys.readouterr().err


def test_a_profile_begins_in_motion() -> None:
    """Fails if a profile cut by `since` begins at rest or elsewhere, or the first report has another place."""
    whole = ta.scenario(METRO).prepare().profile
    setup = ta.scenario({**METRO, "profile": {**METRO["profile"], "since": 30}}).prepare()
    assert (setup.scenario.plant.start.position, setup.scenario.plant.start.speed) == whole.at(30.0)[:2]
    assert setup.profile.at(5.0)[:3] == whole.at(35.0)[:3]
    run = ta.run({**METRO, "duration": 1, "profile": {**METRO["profile"], "since": 30}})
    assert first_report(run.setup)[2:4] == pytest.approx(train_reports(run.recording, run.setup)[0][2:4])


def test_a_failed_run_begins_with_its_first_reason(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the text of a failed run begins with a figure that did not fail, or a reason is left out."""
    advice = "pid: late; try --compensation preview --set laws.pid.kp=1"
    trains = [{"name": "t1", "tracking": "tracked"}, {"name": "t2", "advice": advice}]
    for broken in ([], ["t2: gap 3.0 m, at least 20 m", "t2: verdict of its run: failed: speed error"]):
        summary = {"verdict": "failed" if broken else "passed", "contacts": 0, "broken": broken, "trains": trains}
        print_following({**summary, "following": "f"}, Path("f"), as_json=False)
        head = ": ".join([summary["verdict"], "\n  ".join([*broken, "0 contacts"])])
        shown = capsys.readouterr()
        assert shown.out.startswith(f"{head}\n")
        assert shown.err == "train-ato: t2: pid: late; try --set t2.compensation=preview --set t2.laws.pid.kp=1\n"
