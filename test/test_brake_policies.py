"""Air-brake policies and the driver of a profile."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from train_ato.cli import main
from train_ato.control.air_brake.policy import BrakeSpec, make_brake_policy
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.compensation.rigid import RigidForce
from train_ato.control.registry import COMPENSATIONS
from train_ato.loop.engine import run_engine
from train_ato.loop.result import RunResult
from train_ato.loop.setup import prepare
from train_ato.messages.types import Measurement, Reference
from train_ato.profile.driver import average_speed
from train_ato.scenario.scenario import load_scenario, shipped_scenarios


@pytest.fixture
def long_fall(tmp_path: Path) -> Path:
    """Return a line of 16 km with -10 per mille from km 3 to km 12."""
    grades = [{"at": 0, "grade": 0}, {"at_km": 3, "grade_permille": -10}, {"at_km": 12, "grade": 0}]
    line = {"schema": "train_ato/line/1", "name": "fall", "end_km": 16, "grades": grades}
    path = tmp_path / "fall.yaml"
    path.write_text(yaml.safe_dump(line))
    return path


def at_50_kmh(line: Path, policy: str) -> dict[str, Any]:
    """Return the changes for a start at 50 km/h before the fall, and a reference that holds it."""
    points = [{"time": 0, "speed_kmh": 50}, {"time": 760, "speed_kmh": 50}]
    return {
        "duration": 700,
        "plant": {"line": str(line), "start": {"position": 1500, "speed_kmh": 50}},
        "profile": {"phases": None, "points": points, "start": 1500, "allow_rolling_end": True},
        "brake": {"policy": policy},
    }


def run(line: Path, policy: str) -> RunResult:
    """Start at 50 km/h before the fall and hold it."""
    return run_engine(prepare(*load_scenario("demo", (), at_50_kmh(line, policy))))


def test_electric_brake_alone_runs_away(long_fall: Path) -> None:
    """461 kN hold about -6.3 per mille; the remaining 3.7 per mille accelerate at 0.04 m/s²."""
    outcome = run(long_fall, "none")
    assert outcome.recording is not None
    assert outcome.recording.velocity.max() * 3.6 > 90


def test_blended_air_holds_the_speed(long_fall: Path) -> None:
    """Breaks if the air brake is not applied, not released, or cycles."""
    outcome = run(long_fall, "blend")
    recording = outcome.recording
    assert recording is not None
    on_fall = (recording.front_position > 5000) & (recording.front_position < 11000)
    speed = 3.6 * recording.front_velocity[on_fall]
    assert speed.min() > 35
    assert speed.max() < 65
    assert abs(outcome.summary["coupler_buff_max_kn"]) < 1000


def test_blending_rules_on_the_share_of_the_electric_brake() -> None:
    """A part of .95 for 5 s applies, .2 for 5 s releases, and then no application for 60 s."""
    model = prepare(*load_scenario("demo")).model
    policy = make_brake_policy(BrakeSpec.model_validate({"policy": "blend"}), model, model.line)
    there = -float(model.force_limits(np.array([15.0]))[0].sum())

    def pressures(begin: int, end: int, share: float) -> list[float]:
        return [policy.step(float(t), 0.0, 15.0, -share * there) for t in range(begin, end)]

    assert pressures(0, 5, 0.95) == [600e3] * 5
    assert pressures(5, 20, 0.95) == [550e3] * 15
    assert pressures(20, 24, 0.2) == [550e3] * 4
    assert pressures(24, 25, 0.6) == [550e3]
    assert pressures(25, 31, 0.2)[-2:] == [550e3, 600e3]
    assert set(pressures(31, 90, 0.95)) == {600e3}
    assert pressures(90, 97, 0.95)[-1] == 550e3


def test_blending_in_the_simulated_copy_has_the_force_of_its_units(long_fall: Path) -> None:
    """Without that force `train_predictor` never applies the air brake of its copy."""
    setup = prepare(*load_scenario("demo", (), at_50_kmh(long_fall, "blend")))
    model = setup.model
    layer = COMPENSATIONS.make("train_predictor", {}, model, model.tick)
    layer.set_profile(RigidForce(model, setup.profile))
    layer.set_brake_policy(make_brake_policy(BrakeSpec.model_validate({"policy": "blend"}), model, model.line))
    speed, none = np.array([50 / 3.6]), np.zeros(0)
    low, high = model.force_limits(speed)
    shoes = []
    for k in range(300):
        t, stamp = k * model.tick, round(k * model.tick * 1e9)
        measured = Measurement(stamp, np.array([1500.0 + speed[0] * t]), speed, low, none, none, none)
        reference = Reference(stamp, *setup.profile.at(t)[:3])
        seen = CompensationInput(measured, reference, np.zeros(1), np.array([low] * 5), 600e3, low, high)
        shoes.append(layer.step(seen).train_shoe_force)
        layer.on_command_sent(low)
    assert shoes[0] == 0.0
    assert shoes[-1] > 50e3


def test_air_is_not_released_below_the_limit() -> None:
    """Paper 000: a release below 35 km/h can break a coupler."""
    model = prepare(*load_scenario("demo")).model
    policy = make_brake_policy(BrakeSpec.model_validate({"policy": "blend"}), model, model.line)
    there = -float(model.force_limits(np.array([15.0]))[0].sum())
    for t in range(10):
        policy.step(float(t), 0.0, 15.0, -there)
    assert {policy.step(float(t), 0.0, 9.0, 0.0) for t in range(10, 100)} == {550e3}


def test_air_is_released_before_a_train_that_stood_departs() -> None:
    """Breaks if the air brake stays applied after a departure, or is released by standstill alone."""
    model = prepare(*load_scenario("demo")).model
    policy = make_brake_policy(BrakeSpec.model_validate({"policy": "blend"}), model, model.line)
    there = -float(model.force_limits(np.array([15.0]))[0].sum())
    for t in range(10):
        policy.step(float(t), 0.0, 15.0, -there)
    assert {policy.step(float(t), 0.0, 5.0, 1e5) for t in range(10, 30)} == {550e3}, (
        "a train that rolls is not released"
    )
    assert {policy.step(float(t), 0.0, 0.0, 0.0) for t in range(30, 90)} == {550e3}
    assert [policy.step(float(t), 0.0, 0.0, 1e5) for t in range(90, 96)][-2:] == [550e3, 600e3]


@pytest.mark.parametrize(
    ("brake", "deepest"),
    [
        ({}, 0.0),
        ({"policy": "planned", "events": [{"time": 5, "reduction": 3e4}, {"time": 9, "reduction": 0}]}, 30e3),
        ({"policy": "trigger", "trigger": {"reduction": 4e4}}, 40e3),
        ({"policy": "blend"}, 50e3),
    ],
)
def test_a_plan_counts_on_no_more_air_than_the_policy_applies(brake: dict[str, Any], deepest: float) -> None:
    """Breaks if a plan with the full air brake is run without it: 1136 m past the stop."""
    changes = {
        "duration": 100,
        "profile": {"phases": None, "limits": None, "plan": {"end_km": 4, "deceleration": None}},
        "brake": brake,
    }
    setup = prepare(*load_scenario("demo", ("plant.consist=hxd1_c80_105", "plant.line=level"), changes))
    model, profile = setup.model, setup.profile
    braking = np.flatnonzero((profile.acceleration < 0) & (profile.velocity > 2))
    motion = np.stack((profile.position, profile.velocity, profile.acceleration), axis=1)[braking].tolist()
    electric = [-float(model.force_limits(np.array([velocity]))[0].sum()) for _, velocity, _ in motion]
    wanted = [-model.rigid_force(*state) for state in motion]
    air = max(force / 0.9 - there for force, there in zip(wanted, electric, strict=True))
    full = 0.17e3 * (32 * 6.93 * 0.441 * 206.93 / 227.72 + 840 * 16.18 * 0.481 * 216.18 / 264.72)
    assert 0.8 * deepest / 50e3 * full - 50e3 < air <= deepest / 50e3 * full + 1.0


SHIPPED = shipped_scenarios()["daqin_heavy_haul"]


@pytest.mark.campaign
def test_shipped_profile_is_what_the_command_makes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if plant, line or driver change and the shipped reference or its brake events do not."""
    out = tmp_path / "driver.csv"
    arguments = ["driver", "daqin_section", "hxd1_c80_105", "--until-km", "45", "--out", str(out), "--json"]
    assert main(arguments) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["events"] == yaml.safe_load(SHIPPED.read_text())["brake"]["events"]
    made, shipped = (
        np.loadtxt(path, delimiter=",", comments=("#", "time")) for path in (out, SHIPPED.parent / "daqin_driver.csv")
    )
    np.testing.assert_allclose(made, shipped, rtol=0, atol=1e-5)


def test_reference_keeps_the_limits_of_the_line() -> None:
    """At most 79.3 km/h of 80, four applications, from rest to 45 km."""
    profile = np.loadtxt(SHIPPED.parent / "daqin_driver.csv", delimiter=",", comments=("#", "time"))
    events = yaml.safe_load(SHIPPED.read_text())["brake"]["events"]
    assert 70 < 3.6 * profile[:, 2].max() < 79.3
    assert profile[0, 2] == 0
    assert profile[-1, 1] == pytest.approx(45_000, abs=50)
    assert [event["reduction_kpa"] for event in events] == [50, 0] * 4
    assert np.diff([event["time"] for event in events[::2]]).min() >= 160


def test_average_keeps_a_ramp_and_spreads_a_step_over_three_windows() -> None:
    """Breaks if the average shifts in time or is taken once instead of three times."""
    ramp = np.arange(300) * 0.1
    np.testing.assert_allclose(average_speed(ramp, 0.1, 5.0)[80:-80], ramp[80:-80], atol=1e-9)
    step = np.where(np.arange(400) < 200, 0.0, 1.0)
    smooth = average_speed(step, 0.1, 5.0)
    moving = np.flatnonzero((smooth > 1e-9) & (smooth < 1 - 1e-9))
    assert 140 <= moving.size <= 153
    assert smooth[199] + smooth[200] == pytest.approx(1.0, abs=1e-9)


def test_a_train_without_an_air_brake_is_driven(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the driver needs an air brake, or names brake events of a train without one."""
    out = tmp_path / "metro.csv"
    assert main(["driver", "xuzhou_metro_test", "xuzhou_metro_3", "--until-km", "1", f"--out={out}"]) == 0
    assert "brake" not in capsys.readouterr().out
    made = np.loadtxt(out, delimiter=",", comments=("#", "time"))
    assert made[0, 2] == 0 and made[-1, 1] == pytest.approx(1000, abs=20)
    assert 3.6 * made[:, 2].max() < 75
