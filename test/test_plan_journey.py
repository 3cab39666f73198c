"""Journeys: every window kept at the least energy, or the first lost one is named; late trains catch up."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_plan_command import options
from test_plan_energy import hills, metro

from train_ato.cli.plan import plan_from_options
from train_ato.loop.engine import run_engine
from train_ato.loop.setup import prepare
from train_ato.messages.types import Measurement
from train_ato.profile.planner.plan_from_state import TrainState, catch_up, timetable_points
from train_ato.profile.planner.planner import Plan, plan_profile
from train_ato.profile.planner.settings import PlanSettings
from train_ato.profile.planner.timing_points import SpeedWindow, TimeWindow, TimingPoint, check_points, read_journey
from train_ato.scenario.scenario import load_scenario

KEPT = 0.06
"""Tolerance of a window: that of the planner, and the time between two knots at the speed's change within it [s]."""
LATEST = 452.4
"""Arrival on the hills, 15 % above the least time [s]."""


def journey(*between: TimingPoint, latest: float = LATEST, **settings: Any) -> Plan:
    """Return the plan of a journey over the hills."""
    points = (TimingPoint(at=0, stop=True), *between, TimingPoint(at=8000, arrival=TimeWindow(latest=latest)))
    return plan_profile(hills(), metro(), PlanSettings(points=points, **settings))


def passed(result: Plan, place: float) -> tuple[float, float]:
    """Return time [s] and speed [m/s] of the front at a place."""
    time = float(np.interp(place, result.front, result.profile.time))
    return time, float(np.interp(time, result.profile.time, result.profile.velocity))


@pytest.fixture(scope="module")
def free() -> Plan:
    """Return the journey without windows between its ends."""
    return journey()


@pytest.mark.parametrize("place", [0.0, -1.0])
def test_a_timing_point_is_beyond_the_one_before_it(place: float) -> None:
    """Breaks if two points share a place: one of them has no section of its own."""
    points = (TimingPoint(at=0, stop=True), TimingPoint(at=place, arrival=TimeWindow(latest=100.0)))
    with pytest.raises(ValueError, match=r"timing point km .* is not beyond km 0.000"):
        check_points(points)


def test_a_journey_without_windows_has_the_energy_of_the_timetable(free: Plan) -> None:
    """Breaks if the prices of a journey differ without a reason: energy above that of --time."""
    timetabled = plan_profile(hills(), metro(), PlanSettings(time=LATEST))
    assert LATEST - 0.2 <= free.running_time <= LATEST + KEPT
    assert free.energy <= 1.005 * timetabled.energy


def test_a_passing_window_is_kept_and_costs_energy(free: Plan) -> None:
    """Breaks if a window within a section is not read: 15 s too early."""
    earliest = passed(free, 4200)[0] + 15.0
    held = journey(TimingPoint(at=4200, passing=TimeWindow(earliest=earliest)))
    assert passed(held, 4200)[0] >= earliest - KEPT
    assert held.arrivals[-1][1] <= LATEST + KEPT
    assert free.energy < held.energy < plan_profile(hills(), metro()).energy


def test_speed_windows_are_kept() -> None:
    """Breaks without the traction below the least speed (47 km/h there), or without the limit at the other point."""
    fast = TimingPoint(at=2600, speed=SpeedWindow(least=70 / 3.6))
    slow = TimingPoint(at=5500, speed=SpeedWindow(most=30 / 3.6))
    held = journey(fast, slow, latest=491.7)
    assert passed(held, 2600)[1] >= 70 / 3.6 - 0.03
    assert passed(held, 5500)[1] <= 30 / 3.6 + 0.03
    assert held.arrivals[-1][1] <= 491.7 + KEPT


def test_the_reserve_before_a_waiting_stop_is_used() -> None:
    """Breaks if the train runs fast and then waits for its departure: arrival at 170 s, 47.5 kWh."""
    stop = TimingPoint(at=3000, arrival=TimeWindow(latest=220), departure=TimeWindow(earliest=260), dwell=20)
    held = journey(stop, latest=629.4)
    _, arrival, departure = held.arrivals[1]
    assert 219.0 <= arrival <= 220 + KEPT and departure == pytest.approx(260, abs=KEPT)
    assert held.energy < 0.7 * 47.5 * 3.6e6


@pytest.mark.parametrize(
    ("point", "message"),
    [
        (TimingPoint(at=3000, passing=TimeWindow(latest=120)), "km 3.000: latest passing 120.0 s cannot be kept"),
        (TimingPoint(at=3000, passing=TimeWindow(earliest=400)), "km 8.000: latest arrival 452.4 s cannot be kept"),
        (TimingPoint(at=3000, speed=SpeedWindow(least=25)), "km 3.000: least speed 90.0 km/h cannot be kept"),
    ],
)
def test_the_first_window_that_cannot_be_kept_is_named(point: TimingPoint, message: str) -> None:
    """Breaks if a later window, or none, is named."""
    with pytest.raises(ValueError, match=message):
        journey(point)


def ttobench(folder: Path, rows: list[list[float | None]], **changes: Any) -> Path:
    """Return a journey file with the keys of TTOBench 1.5."""
    names = ["lower time constraint", "upper time constraint", "lower speed constraint", "upper speed constraint"]
    units = {"position": "km"} | dict(zip(names, ["s", "s", "km/h", "km/h"], strict=True)) | changes
    data = {
        "metadata": {"id": "hills_01", "associated track": "hills", "library version": "TTOBench v1.5"},
        "timing points": {"units": units, "values": rows},
    }
    path = folder / "hills_01.json"
    path.write_text(json.dumps(data))
    return path


ROWS: list[list[float | None]] = [[0, 0, 0, 0, 0], [3, 150, 170, 10, None], [5, None, None, 0, 0], [8, 500, 520, 0, 0]]


def test_ttobench_journeys_are_read(tmp_path: Path) -> None:
    """Breaks if units, null or a stop within the journey are read in another way."""
    points = read_journey(str(ttobench(tmp_path, ROWS)), hills()).points
    assert [point.at for point in points] == [0, 3000, 5000, 8000]
    assert [point.stops for point in points] == [True, False, True, True]
    assert points[1].passing == TimeWindow(earliest=150, latest=170)
    assert points[1].speed == SpeedWindow(least=10 / 3.6)
    assert points[3].arrival == TimeWindow(earliest=500, latest=520)


@pytest.mark.parametrize(
    ("rows", "changes", "message"),
    [
        ([[0, 0, 0, 0, 0], [9, None, 500, 0, 0]], {}, "km 9.000 lies beyond line 'hills'"),
        (ROWS, {"position": "mile"}, "position = 'mile': must be one of m, km"),
        ([[0, 0, 0, 0, 0], [3, 170, 150, 0, None], [8, None, 520, 0, 0]], {}, "is after latest"),
        ([[0, 0, 0, 0, 0], [8, None, None, 0, 0]], {}, "no arrival: latest"),
    ],
)
def test_bad_journeys_are_refused_in_one_line(tmp_path, rows, changes, message):
    """Breaks if a bad window reaches the planner."""
    path = ttobench(tmp_path, rows, **changes)
    with pytest.raises(ValueError, match=message) as refused:
        read_journey(str(path), hills())
    assert str(path) in str(refused.value) and "\n" not in str(refused.value)


def test_the_command_reads_a_journey(tmp_path: Path) -> None:
    """Breaks if the option does not reach the plan, or is combined with a second timetable."""
    path = tmp_path / "day.yaml"
    path.write_text(
        "schema: train_ato/journey/1\nname: day\npoints:\n"
        "  - {at: 0, departure: {earliest: 10}}\n  - {at_km: 2, arrival: {latest_min: 3}}\n"
    )
    words = ("xuzhou_metro_test", "xuzhou_metro_3", "--journey", str(path))
    result = plan_from_options(options(*words))
    assert result["stops"][0]["departure_s"] == 10 and result["stops"][1]["arrival_s"] <= 180 + KEPT
    with pytest.raises(ValueError, match="--time with --journey"):
        plan_from_options(options(*words, "--time", "150"))


@pytest.mark.parametrize("delay", [35.0, 100.0])
def test_a_late_train_catches_up_or_reports_the_lost_window(free: Plan, delay: float) -> None:
    """Breaks if a late train keeps the old speeds, or if a lost window is not reported (100 s exceed the reserve)."""
    points = timetable_points(hills(), PlanSettings(time=LATEST))
    now = 100.0
    x, v, a, _ = free.profile.at(now)
    rest, lost = catch_up(TrainState(now + delay, x, v, a), points, hills(), metro(), PlanSettings(), period=0.1)
    arrival = rest.arrivals[-1][1]
    if delay < 50:
        assert lost is None and LATEST - 0.5 <= arrival <= LATEST + KEPT
    else:
        assert lost is not None and lost.window == "arrival" and arrival == pytest.approx(lost.possible, abs=1.0)
    joined = free.profile.until(now + delay).followed_by(rest.profile)
    assert np.abs(rest.profile.jerk()).max() <= 0.5 * (1 + 1e-5) and joined.end == rest.profile.end


def test_a_run_returns_to_its_timetable_after_low_adhesion() -> None:
    """Breaks if the first profile stays a ceiling after the traction has returned: some seconds late at the end."""
    low = "plant.adhesion={kind: constant, coefficient: 0.3}"
    back = "plant.jumps=[{at: 10, what: adhesion, factor: 0.2}, {at: 25, what: adhesion, factor: 5}]"
    late = []
    for catching in ("false", "true"):
        changes = (low, back, "profile={plan: {end_km: 2, time: 150}}", "duration=200",
                   f"replan={{retry: 10, catch_up: {catching}}}")  # fmt: skip
        outcome = run_engine(prepare(*load_scenario("xuzhou_metro", changes)))
        assert outcome.failure is None and abs(outcome.summary["stop_error_m"]) < 0.05
        late.append(outcome.summary["running_time_s"] - 150.0)
    assert late[1] < 1.0 < late[0] - 3.0


def test_a_late_train_starts_a_plan_without_a_lack_of_force() -> None:
    """Breaks if ``lateness`` is not compared: no decision at 5 s, or already one at 2 s; 150 s are kept again."""
    changes = ("profile={plan: {end_km: 2, time: 150}}", "replan={catch_up: true, lateness: 3}")
    setup = prepare(*load_scenario("xuzhou_metro", changes))
    model, profile = setup.model, setup.profile
    place, speed, acceleration, _ = profile.at(20.0)
    force = model.rigid_force(place, speed, acceleration) / model.n_units
    position, none = place - model.offsets, np.zeros(model.n_units)
    decisions = []
    for late in (2.0, 5.0):
        replanner = setup.replanner()
        assert replanner is not None
        stamp = round((20.0 + late) * 1e9)
        velocity, applied = np.full(model.n_units, speed), np.full(model.n_units, force)
        decisions.append(replanner.step(Measurement(stamp, position, velocity, none, applied, none, none)))
    assert decisions[0] is None and decisions[1] is not None
    rest = decisions[1].profile
    assert rest is not None and decisions[1].reason == "5.0 s late"
    assert rest.end < profile.end + 1.0 and rest.position[-1] == pytest.approx(profile.position[-1], abs=1e-6)
