"""Predictive policy of the air brake: schedules compared by a forecast, on falls that no plan names."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from plant_sim.library import load_consist
from train_ato.cli import main
from train_ato.control.air_brake.policy import BrakeSpec, make_brake_policy
from train_ato.control.train_model import TrainModel
from train_ato.log.difference import compare_logs
from train_ato.log.run_folder import read_run_folder
from train_ato.loop.engine import run_engine
from train_ato.loop.recording import BRAKE_PIPE_COMMAND, Recording
from train_ato.loop.setup import RunSetup, prepare
from train_ato.messages.codec.codec import Wire
from train_ato.scenario.scenario import load_scenario

CHARGED, APPLIED = 600e3, 550e3


def sets_on_fall(
    folder: Path, brake: dict[str, Any] | None = None, *, duration: float = 420.0, start: float = 2500.0,
    end: float = 7000.0, grade: float = -10.0, **plant: Any,
) -> tuple[str, ...]:  # fmt: skip
    """Return the changes of `demo` for a train at 50 km/h and a fall [per mille] from km 3 to ``end`` [m]."""
    grades = [{"at": 0, "grade": 0}, {"at": 3000, "grade_permille": grade}, {"at": end, "grade": 0}]
    line = folder / "fall.yaml"
    line.write_text(yaml.safe_dump({"schema": "train_ato/line/1", "name": "fall", "end_km": 16, "grades": grades}))
    changes = {
        "duration": duration,
        "plant.line": str(line),
        "plant.start": {"position": start, "speed_kmh": 50},
        **{f"plant.{key}": value for key, value in plant.items()},
        "profile.phases": None,
        "profile.points": [{"time": 0, "speed_kmh": 50}, {"time": 800, "speed_kmh": 50}],
        "profile.start": start,
        "profile.allow_rolling_end": True,
        "brake": {"policy": "predictive", "predictive": brake or {}},
    }
    return tuple(f"{key}={json.dumps(value)}" for key, value in changes.items())


def setup_on_fall(folder: Path, brake: dict[str, Any] | None = None, **changes: Any) -> RunSetup:
    return prepare(*load_scenario("demo", sets_on_fall(folder, brake, **changes)))


def recording_of(setup: RunSetup) -> Recording:
    outcome = run_engine(setup)
    assert outcome.failure is None, outcome.failure
    assert outcome.recording is not None
    return outcome.recording


def changes_of(recording: Recording) -> list[tuple[float, float, float]]:
    """Return time [s], place [m] and reduction [Pa] of every change of the pressure."""
    times, pressure = recording.of(BRAKE_PIPE_COMMAND, "pressure")  # type: ignore[misc]
    pressure = pressure.ravel()
    rows = np.flatnonzero(np.diff(pressure)) + 1
    return [(float(times[i]), float(recording.front_position[i]), 600e3 - float(pressure[i])) for i in rows]


@pytest.mark.parametrize(
    "mismatch",
    [{}, {"mass_scale": 1.03, "brake_scale": 0.92}, {"resistance_scale": 1.15}],
    ids=["nominal", "heavy", "slow"],
)
def test_the_speed_is_kept_on_a_fall_without_a_plan(mismatch: dict[str, float], tmp_path: Path) -> None:
    """Breaks if an application is too late, a release too early, or the shoes act on the level track beyond."""
    recording = recording_of(setup_on_fall(tmp_path, mismatch=mismatch))
    speed = 3.6 * recording.front_velocity
    assert speed.min() > 48.5 and speed.max() < 51.5
    (_, begin, reduction), (_, end, released), *more = changes_of(recording)
    assert (reduction, released, more) == (50e3, 0.0, [])
    assert 3000.0 < begin < 4200.0, "the tail is not yet on the fall"
    assert 6900.0 < end < 8200.0


def policy_of(setup: RunSetup, **rules: Any) -> Any:
    spec = BrakeSpec.model_validate({"policy": "predictive", "predictive": rules})
    return make_brake_policy(spec, setup.model, setup.line, setup.profile)


def first_application(setup: RunSetup, extra: float) -> float:
    """Return the place of the first application at constant speed with a force that the model lacks [m, N]."""
    policy, speed = policy_of(setup), 50 / 3.6
    for t in range(0, 200, 2):
        place = 2000.0 + speed * t
        if policy.step(float(t), place, speed, setup.model.rigid_force(place, speed, 0.0) - extra) == APPLIED:
            return place
    raise AssertionError("no application")


def test_the_unknown_force_moves_the_application(tmp_path: Path) -> None:
    """Breaks if the decision ignores the measured acceleration: all trains apply at the same place."""
    setup = setup_on_fall(tmp_path)
    light, nominal, heavy = (first_application(setup, extra) for extra in (-80e3, 0.0, 80e3))
    assert heavy + 40.0 < nominal < light - 40.0


def test_rules_of_pause_and_duration_are_kept(tmp_path: Path) -> None:
    """Breaks if an application ends before its minimum duration, or the next one begins within the recharge pause."""
    policy = policy_of(setup_on_fall(tmp_path))
    fall, level = (5000.0, 50 / 3.6, -450e3), (12_000.0, 52 / 3.6, 0.0)
    assert policy.step(0.0, *fall) == APPLIED
    pressure = [policy.step(float(t), *(level if t < 40 else fall)) for t in range(1, 121)]
    changed = [t + 1 for t in range(1, 120) if pressure[t] != pressure[t - 1]]
    assert len(changed) == 2
    assert 25 <= changed[0] <= 28, "released as soon as permitted"
    assert 60 <= changed[1] - changed[0] <= 64, "applied as soon as permitted"


def test_no_release_below_the_lowest_speed(tmp_path: Path) -> None:
    """Breaks if a train on level track below 35 km/h releases, which can break a coupler (paper 000)."""
    setup = setup_on_fall(tmp_path)
    policy = policy_of(setup)
    applied = [policy.step(float(t), 4500.0, 14.2, -450e3) for t in range(0, 12, 2)]
    assert applied[-1] == APPLIED
    assert {policy.step(float(t), 9000.0, 9.0, 0.0) for t in range(12, 112)} == {APPLIED}
    assert {policy.step(float(t), 9000.0, 11.0, 0.0) for t in range(112, 116)} == {CHARGED}


def test_a_departure_releases(tmp_path: Path) -> None:
    """Breaks if a train that has stopped with applied brakes cannot depart, or releases at standstill alone."""
    policy = policy_of(setup_on_fall(tmp_path))
    assert [policy.step(float(t), 4500.0, 14.2, -450e3) for t in range(0, 12, 2)][-1] == APPLIED
    assert {policy.step(float(t), 9000.0, 0.0, 0.0) for t in range(12, 40)} == {APPLIED}
    assert {policy.step(float(t), 9000.0, 0.0, 1e5) for t in range(40, 43)} <= {APPLIED, CHARGED}
    assert policy.step(44.0, 9000.0, 0.0, 1e5) == CHARGED


def test_a_deeper_reduction_is_used_where_the_first_is_too_weak(tmp_path: Path) -> None:
    """Breaks if only the first reduction of the list is compared, or the deepest one is always taken."""
    brake = {"reduction": [0, 20e3, 50e3], "braking_factor": [0, 0.07, 0.17]}
    consist = load_consist("hxd1_c80_105")
    assert consist.air_brake is not None
    weak = consist.model_copy(update={"air_brake": consist.air_brake.model_copy(update=brake)})
    spec = BrakeSpec.model_validate({"policy": "predictive", "predictive": {"reductions_kpa": [20, 50]}})
    found = []
    for grade in (-7.0, -10.0):
        setup = setup_on_fall(tmp_path, grade=grade)
        model = TrainModel(weak, setup.line, np.zeros(1), np.zeros(1), 0.0, 0.1)
        policy = make_brake_policy(spec, model, setup.line, setup.profile)
        found.append(CHARGED - policy.step(0.0, 5000.0, 50 / 3.6, -450e3))
    assert found == [20e3, 50e3]


RULES = {"never_below_kmh": 10, "min_application": 10, "pause": 20}
SHORT = {"duration": 110.0, "start": 3300.0, "end": 4300.0}


@pytest.mark.parametrize("way", [[], ["--processes"]], ids=["composed", "processes"])
def test_the_nodes_decide_as_the_engine(way: list[str], tmp_path: Path) -> None:
    """Breaks if a node decides at another stamp than the engine: the logs differ."""
    pytest.importorskip("rclpy")
    sets = [f"--set={text}" for text in sets_on_fall(tmp_path, RULES, **SHORT)]
    for name, options in (("engine", ["--engine"]), ("nodes", way)):
        assert main(["run", "demo", "--json", f"--out={tmp_path / name}", *options, *sets]) == 0
    setup, _ = read_run_folder(tmp_path / "nodes")
    assert len(changes_of(recording_of(setup))) >= 2
    assert compare_logs(tmp_path / "engine", tmp_path / "nodes", Wire(setup.layout)).first is None


@pytest.mark.campaign
@pytest.mark.parametrize("worse", [False, True], ids=["nominal", "mismatch"])
def test_a_trip_plan_is_followed_without_its_places(worse: bool) -> None:
    """Breaks if an application is early or held too long: the drives pull against the shoes, 661 instead of 606 kWh."""
    # The bound on the energy is that of the policy `trip` and 2 %.
    mismatch = {"mass_scale": 1.03, "brake_scale": 0.92, "resistance_scale": 1.15} if worse else {}
    sets = (f"plant.mismatch={json.dumps(mismatch)}",)
    planned, predicted = (
        run_engine(prepare(*load_scenario(f"daqin_heavy_haul:{variant}", sets)))
        for variant in ("trip", "trip+predictive")
    )
    assert predicted.recording is not None and len(changes_of(predicted.recording)) == 8
    summary = predicted.summary
    assert summary["energy_traction_kwh"] < 1.02 * planned.summary["energy_traction_kwh"]
    assert max(summary["coupler_draft_max_kn"], -summary["coupler_buff_max_kn"]) < 600
    assert summary["speed_error_max_kmh"] < 1.0 and summary["overspeed_max_kmh"] == 0
    assert summary["verdict"] == "passed"
