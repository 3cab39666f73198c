"""Planned motion of the power units: input of the law, feed-forward of the planned force, written scenario."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from plant_sim.consist import Consist
from plant_sim.library import load_consist
from plant_sim.line import Line
from train_ato.control.compensation.rigid import RigidForce
from train_ato.control.force_distribution import DisplacementAt, PlannedDisplacement
from train_ato.loop.engine import run_engine
from train_ato.loop.metrics import summarise
from train_ato.loop.setup import prepare
from train_ato.messages.types import Measurement
from train_ato.profile.driver import average_speed
from train_ato.profile.trip.driven_run import AVERAGE
from train_ato.profile.trip.planner import TripPlan, TripPlanner
from train_ato.profile.trip.settings import TripSettings
from train_ato.scenario.scenario import load_scenario, raw_scenario
from train_ato.scenario.trip_scenario import write_trip


def two_displacements(*entries: tuple[float, float, float]) -> PlannedDisplacement:
    return PlannedDisplacement([DisplacementAt(at=at, displacement=(a, b)) for at, a, b in entries], 2)


@pytest.fixture(scope="module")
def plan() -> tuple[TripPlan, dict[str, Any]]:
    """Plan of two power units with 60 wagons each over a crest, and its plant."""
    train = load_consist("hxd1_c80_210").model_dump(mode="json", by_alias=True, exclude_defaults=True)
    train["name"] = "short"
    for entry in train["train"]:
        entry["count"] = 60 if entry["type"] == "c80" else 1
    train["couplings"][0]["behind"] = [0, 60, 61]
    grades = [
        {"at_km": 0, "grade": 0.0},
        {"at_km": 2.5, "grade_permille": 8},
        {"at_km": 3.2, "grade_permille": -14},
        {"at_km": 4.2, "grade": 0.0},
    ]
    line = {
        "schema": "train_ato/line/1",
        "name": "crest",
        "end_km": 9,
        "grades": grades,
        "speed_limits": [{"at": 0, "speed_kmh": 60}],
    }
    planner = TripPlanner(Line.model_validate(line), Consist.model_validate(train), TripSettings(end=8_000.0))
    return planner.with_unit_shares(planner.at_price(0.5)), {"consist": train, "line": line}


def test_the_slope_is_the_derivative_of_the_displacement() -> None:
    """Breaks if place and speed of a unit do not agree, or the displacement jumps or goes on beyond the last place."""
    planned = two_displacements((0.0, 0.0, 1.0), (100.0, 1.0, 0.0), (200.0, 4.0, 0.0))
    assert planned.at(100.0)[0] == pytest.approx([1.0, 0.0]) and planned.at(100.0)[1] == pytest.approx([0.02, -0.005])
    assert planned.at(-5.0) == ([0.0, 1.0], [0.0, 0.0])
    assert planned.at(999.0) == ([4.0, 0.0], [0.0, 0.0])
    for place in (10.0, 50.0, 99.9, 130.0, 199.0):
        before, after = planned.at(place - 1e-4)[0], planned.at(place + 1e-4)[0]
        assert planned.at(place)[1] == pytest.approx((np.array(after) - before) / 2e-4, abs=1e-7)
    for place in (100.0, 200.0 - 1e-9):
        near, there = planned.at(place - 1e-6), planned.at(place)
        assert near[0] == pytest.approx(there[0], abs=1e-6)
        assert near[1] == pytest.approx(there[1], abs=1e-6)


def test_a_train_that_moves_as_planned_has_no_error() -> None:
    """Breaks if the sign of the displacement is wrong, or its speed is missing."""
    planned = two_displacements((0.0, 0.0, 0.0), (100.0, 1.0, -2.0), (200.0, 2.0, -4.0))
    place, speed = 100.0, 10.0
    none = np.zeros(0)
    measured = Measurement(
        0, np.array([place + 1.0, place - 2.0]), speed * np.array([1.01, 0.98]), np.zeros(2), none, none, none
    )
    seen = planned.without(measured, place)
    assert seen.position == pytest.approx([place, place])
    assert seen.velocity == pytest.approx([speed, speed], rel=3e-4)  # the slope counts with the speed of vehicle 0


def test_a_run_follows_the_displaced_places() -> None:
    """Breaks if the displacements of a scenario do not reach the law."""
    ahead = [{"at": -1e4, "displacement": [2.0] * 3}]
    changes = {"duration": 120.0, "law": "pid", "laws": {"pid": {"kp": 0.5, "ki": 0.05}}}
    places = [
        run_engine(prepare(*load_scenario("crh380a_gpc", changes={**changes, **more}))).recording.front_position[-1]
        for more in ({}, {"unit_displacements": ahead})
    ]
    assert places[1] - places[0] == pytest.approx(2.0, abs=0.2)


def test_an_observer_of_place_and_speed_follows_the_plan() -> None:
    """Breaks if displaced place and speed do not agree: mpc finds a false -.28 m/s² and pulls with 1.5 MN."""
    changes = {"duration": 95.0, "law": "mpc", "compensation": "none"}
    setup = prepare(*load_scenario("daqin_two_locomotives", changes=changes))
    metrics = summarise(setup, run_engine(setup).recording)
    assert metrics["speed_error_max_kmh"] <= 0.6 and metrics["saturated_s"] == 0.0


def test_the_feedforward_is_the_planned_force(plan: tuple[TripPlan, dict[str, Any]]) -> None:
    """Breaks if the motion of vehicle 0 against the train is in the profile: it then moves the whole train."""
    found, _ = plan
    run = found.run
    time = np.arange(0.0, run.time[-1] - 90.0, 0.1)
    wanted = average_speed(np.interp(time, run.time - 0.5 * run.period, run.force), 0.1, AVERAGE)
    shoes = average_speed(np.interp(time, run.time, run.shoes), 0.1, AVERAGE)
    error = RigidForce(found.model, found.profile).totals(time) + shoes - wanted
    assert error[100:-100].std() < 10e3  # 4 kN from the places of the vehicles on the grades; 27 kN with the motion


def test_the_written_scenario_runs_as_planned(plan: tuple[TripPlan, dict[str, Any]], tmp_path: Path) -> None:
    """Breaks if the motion of the couplings is converted to traction and braking again."""
    found, plant = plan
    path, _ = write_trip(found, tmp_path / "short.yaml", None, plant, "test")
    assert len(raw_scenario(str(path))[1]["unit_displacements"]) == len(found.displacements) > 100
    energy = []
    for changes in ({}, {"unit_displacements": None}):
        setup = prepare(*load_scenario(str(path), changes=changes))
        metrics = summarise(setup, run_engine(setup).recording)
        energy.append(metrics["energy_traction_kwh"])
    planned = found.summary()["energy_kwh"]
    assert energy[0] == pytest.approx(planned, rel=0.01) and energy[1] > 1.015 * planned


@pytest.mark.campaign
@pytest.mark.parametrize(
    "mismatch", [{}, {"mass_scale": 1.03}, {"mass_scale": 0.97}, {"brake_scale": 0.92}, {"resistance_scale": 1.15}]
)
def test_the_shipped_trip_of_two_locomotives_reaches_its_goals(mismatch: dict[str, float]) -> None:
    """Breaks if the law converts the motion of the couplings to force: 644 kN and 747 kWh without displacements."""
    changes = {"plant": {"mismatch": mismatch}} if mismatch else {}
    setup = prepare(*load_scenario("daqin_two_locomotives", changes=changes))
    metrics = summarise(setup, run_engine(setup).recording)
    assert metrics["overspeed_max_kmh"] == 0.0
    assert metrics["coupler_draft_max_kn"] <= 600 and metrics["coupler_buff_max_kn"] >= -600
    assert metrics["speed_rmse_kmh"] <= 0.2
    assert abs(metrics["stop_error_m"]) <= 0.3
    if "resistance_scale" not in mismatch:  # 15 % more resistance need 510 kWh more
        assert metrics["energy_traction_kwh"] <= 660
