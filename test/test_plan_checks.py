"""Planner results against closed forms, hand calculations and published numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from case_costs import sampled
from plan_cases import broken_promises

from plant_sim.consist import Consist
from plant_sim.library import load_consist, load_line
from plant_sim.line import Line
from train_ato.profile.planner.planner import Plan, plan_profile
from train_ato.profile.planner.settings import PlanSettings, find_line, find_train
from train_ato.profile.planner.train_tables import balancing_speed, holding_force, steepest_start

BARE = {"jerk": None, "acceleration": None, "deceleration": None, "force_margin": 0}


def train(**vehicle: Any) -> Consist:
    base = {"mass": 1000, "length": 1, "resistance": {"n": [0, 0, 0]}}
    data = {
        "schema": "train_ato/consist/1",
        "name": "t",
        "vehicle_types": {"t": base | vehicle},
        "train": [{"type": "t"}],
    }
    return Consist.model_validate(data)


def line(end: float, **parts: Any) -> Line:
    return Line.model_validate({"schema": "train_ato/line/1", "name": "l", "end": end} | parts)


STRONG = train(
    mass=100e3, length=100, traction=[{"to": 40, "force": 150e3}], brake=[{"to": 44, "force": 150e3}]
)  # fmt: skip


def test_closed_form_of_constant_power() -> None:
    """300 m, a = +-3/v, 1 m/s at both ends: (1351^(2/3) - 1)/3 = 40.403 s."""
    power = [{"to": 100, "power": 3000}]
    asked = PlanSettings(begin_speed=1, end_speed=1, **BARE)
    result = plan_profile(line(300), train(traction=power, brake=power), asked)
    assert result.running_time == pytest.approx((1351 ** (2 / 3) - 1) / 3, abs=0.01)
    assert result.profile.velocity.max() == pytest.approx(1351 ** (1 / 3), abs=0.05)


def test_closed_form_with_limited_jerk() -> None:
    """Level, no resistance, 1 m/s² and 0.5 m/s³ both ways, 20 m/s: s/v + v/a + a/j."""
    asked = PlanSettings(acceleration=1.0, deceleration=1.0, jerk=0.5, force_margin=0)
    result = plan_profile(line(2000, speed_limits=[{"at": 0, "speed": 20}]), STRONG, asked)
    assert result.running_time == pytest.approx(2000 / 20 + 20 / 1.0 + 1.0 / 0.5, abs=0.02)


@pytest.mark.parametrize(
    ("name", "time"), [("freight", 745.07), ("local", 391.62), ("longdistance", 330.75)]
)  # fmt: skip
def test_railtoolkit_running_times(open_data: Path, name: str, time: float) -> None:
    """Published times of the railtoolkit project on its 10 km level path, +-1 %."""
    consist, asked = find_train(str(open_data / f"{name}.yaml"))
    path = find_line(str(open_data / "level.yaml"))
    assert plan_profile(path, consist, asked).running_time == pytest.approx(time, rel=0.01)


@pytest.mark.parametrize(
    ("name", "time"), [("freight", 748.4), ("local", 393.9), ("longdistance", 330.9)]
)  # fmt: skip
def test_railtoolkit_times_of_a_fine_integration(open_data: Path, name: str, time: float) -> None:
    """A 1 ms integration of the same rules: +-0.1 %, tighter than the published 20 m steps."""
    consist, asked = find_train(str(open_data / f"{name}.yaml"))
    path = find_line(str(open_data / "level.yaml"))
    assert plan_profile(path, consist, asked).running_time == pytest.approx(time, rel=0.001)


@pytest.mark.parametrize(("grade", "kmh"), [(0, 110.0), (1, 94.0), (2, 79.9), (4, 52.5)])
def test_balancing_speeds_of_the_heavy_haul_train(grade: float, kmh: float) -> None:
    assert 3.6 * balancing_speed(load_consist("hxd1_c80_105"), grade / 1e3) == pytest.approx(kmh, abs=0.2)


def test_steepest_start_and_the_descent_that_needs_air() -> None:
    consist = load_consist("hxd1_c80_105")
    assert 1e3 * steepest_start(consist) == pytest.approx(6.3, abs=0.05)
    assert holding_force(consist, 70 / 3.6, -0.012) == pytest.approx(-1060e3, abs=5e3)


def test_a_limit_holds_until_the_tail_has_left() -> None:
    """A 100 m train on a 10 m/s stretch of 300 m must keep it over 400 m of its front; a point mass over 300 m."""
    path = line(3000, speed_limits=[{"at": 0, "speed": 25}, {"at": 1000, "speed": 10}, {"at": 1300, "speed": 25}])
    for point, left in ((False, 1400.0), (True, 1300.0)):
        result = plan_profile(path, STRONG, PlanSettings(point_mass=point, **BARE), 0.01)
        slow = result.front[(result.profile.velocity <= 10 + 1e-9) & (result.front > 900) & (result.front < 1500)]
        assert slow.min() == pytest.approx(1000, abs=0.5)
        assert slow.max() == pytest.approx(left, abs=0.5)


def test_grade_counts_where_every_vehicle_is() -> None:
    """Two equal vehicles 100 m apart: with one of them on 10 per mille the train has a mean grade of 5."""
    consist = Consist.model_validate(
        {
            "schema": "train_ato/consist/1",
            "name": "pair",
            "vehicle_types": {
                "unit": {
                    "mass": 50e3, "length": 100, "resistance": {"n": [0, 0, 0]},
                    "traction": [{"to": 30, "force": 50e3}], "brake": [{"to": 30, "force": 50e3}],
                }
            },
            "train": [{"type": "unit", "count": 2}],
            "draft_gears": {"rigid": {"kind": "rigid"}},
            "default_gear": "rigid",
        }
    )  # fmt: skip
    path = line(2000, grades=[{"at": 1000, "grade": 0.01}], speed_limits=[{"at": 0, "speed": 10}])
    result = plan_profile(path, consist, PlanSettings())
    for front, grade in ((1040, 0), (1060, 0.005), (1140, 0.005), (1160, 0.01)):
        knot = int(np.searchsorted(result.front, front))
        assert result.force[knot] == pytest.approx(100e3 * 9.81 * grade, abs=1.0)


def test_stops_with_dwell_and_front_convention() -> None:
    path = line(3000, stops=[{"at": 100, "name": "a"}, {"at": 1500, "dwell": 20}, {"at": 2900, "name": "b"}])
    result = plan_profile(path, STRONG, PlanSettings(departure=5))
    (_, _, departure), (middle, arrival, on), (end, last, _) = result.arrivals
    assert (departure, middle, end) == (5.0, 1500.0, 2900.0)
    assert on - arrival == pytest.approx(20) and last > on
    profile = result.profile
    assert profile.at(0.0)[:2] == (50.0, 0.0)
    assert profile.at(arrival + 10)[:2] == (pytest.approx(1450, abs=1e-9), 0.0)
    assert profile.position[-1] == pytest.approx(2850, abs=1e-9)
    through = plan_profile(path, STRONG, PlanSettings(calling=False))
    assert len(through.arrivals) == 2 and through.running_time < result.running_time - 20


@pytest.mark.parametrize(
    ("consist", "path"),
    [
        ("crh380a_one_mass", "highspeed_286km"),
        ("xuzhou_metro_3", "xuzhou_metro_test"),
        ("hxd1_c80_105", "daqin_section"),
    ],
)
def test_shipped_trains_run_their_lines(consist: str, path: str) -> None:
    who, where, asked = load_consist(consist), load_line(path), PlanSettings()
    result = plan_profile(where, who, asked)
    assert broken_promises(where, who, asked, result, 0.1) == []
    assert result.profile.velocity.max() == pytest.approx(max(limit.speed for limit in where.speed_limits), rel=0.02)


@pytest.mark.parametrize("slack", sampled([1.02, 1.1, 1.3], every=3))
def test_a_timetable_saves_energy_by_coasting(open_data: Path, slack: float) -> None:
    """2, 10 and 30 % more time on St. Gallen - Wil save 25.7, 41.3 and 62.4 %; slower cruising alone 10 % at 2 %."""
    consist, _ = find_train(str(open_data / "longdistance.yaml"))
    path = find_line(str(open_data / "stgallen_wil.json"))
    fastest = plan_profile(path, consist)
    slower = plan_profile(path, consist, PlanSettings(time=slack * fastest.running_time))
    assert slower.running_time == pytest.approx(slack * fastest.running_time, abs=0.1)
    saved = 1 - slower.summary()["energy_kwh"] / fastest.summary()["energy_kwh"]
    assert saved > {1.02: 0.25, 1.1: 0.40, 1.3: 0.61}[slack]


def test_grades_are_averaged_over_the_vehicle_length_on_request() -> None:
    path = line(3000, grades=[{"at": 1000, "grade": 0.01}], speed_limits=[{"at": 0, "speed": 10}])
    result = plan_profile(path, STRONG, PlanSettings(grade_over_length=True))
    knot = int(np.searchsorted(result.front, 1025))
    assert result.force[knot] == pytest.approx(100e3 * 9.81 * 0.0025, rel=0.05)


@pytest.mark.parametrize(
    ("parts", "asked", "message"),
    [
        ({"grades": [{"at": 0, "grade": 0.2}]}, {"begin": 300}, r"cannot start at km 0\.\d+: .* need \d+ kN, traction"),
        ({"grades": [{"at": 500, "grade": 0.5}]}, {}, r"stalls at km 0\.\d+"),
        ({"grades": [{"at": 500, "grade": -0.5}]}, {}, r"cannot brake for the stop at km 2\.000: .* per mille"),
        (
            {"grades": [{"at": 500, "grade": -0.2}, {"at": 1200, "grade": 0}],
             "speed_limits": [{"at": 0, "speed": 30}, {"at": 1000, "speed": 8}]},
            {}, r"cannot brake for the limit of 29 km/h at km \d\.\d+",
        ),
        ({}, {"end": 2500}, r"end of the plan at km 2\.500 lies beyond line 'l'"),
        ({"stops": [{"at": 2400, "name": "far"}]}, {}, r"stop 'far' at km 2\.400 lies beyond line 'l'"),
        ({}, {"time": 30}, r"timetable too tight: .* at least \d+\.\d s are needed"),
        ({}, {"begin_speed": 30, "end": 100}, r"begin_speed 108\.0 km/h at km 0\.000 is too high"),
        ({}, {"begin": 1999.99}, "has no length"),
    ],
)  # fmt: skip
def test_an_impossible_plan_is_refused_with_place_and_reason(parts, asked, message):
    with pytest.raises(ValueError, match=message) as caught:
        plan_profile(line(2000, **parts), STRONG, PlanSettings(**asked))
    assert "\n" not in str(caught.value)


def test_a_train_without_brakes_is_refused() -> None:
    with pytest.raises(ValueError, match="neither an electric brake nor an air brake"):
        plan_profile(line(1000), train(traction=[{"to": 20, "force": 1000}]))


def test_the_same_request_gives_the_same_bits() -> None:
    path, asked = line(3000, stops=[{"at": 0}, {"at": 1000, "dwell": 10}, {"at": 3000}]), PlanSettings(time=240)
    first, second = (plan_profile(path, STRONG, asked) for _ in range(2))
    assert isinstance(first, Plan) and first.profile == second.profile


def test_the_maximum_speed_is_below_the_end_of_the_brakes() -> None:
    """Breaks if a plan uses the full envelope: at 0.1 km/h of overspeed the tram has no brake force."""
    ends = {"traction": [{"to_kmh": 80, "force_kn": 50}], "brake": [{"to_kmh": 80, "force_kn": 60}]}
    tram = {"mass_t": 38, "length": 30, "resistance": {"n": [600, 20, 5]}}
    data = {"schema": "train_ato/consist/1", "name": "tram", "train": [{"type": "tram"}]}
    line = load_line("level")
    fastest = []
    for brake_to in (80, 100):
        ends["brake"] = [{"to_kmh": brake_to, "force_kn": 60}]
        consist = Consist.model_validate(data | {"vehicle_types": {"tram": tram | ends}})
        fastest.append(3.6 * plan_profile(line, consist, PlanSettings(end=line.begin + 3000)).profile.velocity.max())
        assert 3.6 * balancing_speed(consist, 0.0) == pytest.approx(80.0, abs=0.1)
    assert fastest == pytest.approx([0.98 * 80, 80], abs=0.05)


@pytest.mark.parametrize("grade", [60, 80])
def test_a_refusal_names_the_place_that_is_too_steep(grade: int) -> None:
    """Breaks if the message has the section before the stop with the impossible start."""
    weak = train(mass=176e3, length=80, traction=[{"to": 30, "force": 110e3}], brake=[{"to": 35, "force": 108e3}])
    grades = [{"at": 0, "grade": 0.005}, {"at": 300, "grade": -0.025}, {"at": 1100, "grade": 1e-3 * grade}]
    stops = [{"at": 100}, {"at": 1300}, {"at": 2500}]
    with pytest.raises(ValueError, match=rf"cannot start at km 1\.300: grade and curves of {grade}\.0 per mille"):
        plan_profile(line(3000, grades=grades, stops=stops), weak)
