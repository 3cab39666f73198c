"""Air-brake policies, the driver of a profile, and predictive schedules on falls that no plan names."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from engine_runs import compared, setup_of

from plant_sim.library import load_consist
from train_ato.cli import main
from train_ato.control.air_brake.policy import BrakeSpec, make_brake_policy
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.compensation.rigid import RigidForce
from train_ato.control.registry import COMPENSATIONS
from train_ato.control.train_model import TrainModel
from train_ato.judge.recording import BRAKE_PIPE_COMMAND, Recording
from train_ato.log.run_folder import read_run_folder
from train_ato.loop.engine import run_engine
from train_ato.loop.observer import ObserverStage
from train_ato.messages.types import Measurement, Reference
from train_ato.profile.driver import average_speed
from train_ato.scenario.scenario_files import shipped_scenarios
from train_ato.scenario.setup import RunSetup

CHARGED, APPLIED = 600e3, 550e3


def sets_on_fall(
    folder: Path, brake: dict[str, Any] | None = None, *, duration: float = 420.0, start: float = 2500.0,
    end: float = 7000.0, grade: float = -10.0, policy: str = "predictive", **plant: Any,
) -> tuple[str, ...]:  # fmt: skip
    """Return the changes of `demo` for a train at 50 km/h and a fall [per mille] from km 3 to ``end`` [m]."""
    grades = [{"at": 0, "grade": 0}, {"at": 3000, "grade_permille": grade}, {"at": end, "grade": 0}]
    line = folder / "fall.yaml"
    line.write_text(yaml.safe_dump({"schema": "train_ato/line/1", "name": "fall", "end_km": 16, "grades": grades}))
    changes = {
        "duration": duration, "plant.line": str(line), "plant.start": {"position": start, "speed_kmh": 50},
        **{f"plant.{key}": value for key, value in plant.items()}, "profile.phases": None,
        "profile.points": [{"time": 0, "speed_kmh": 50}, {"time": 800, "speed_kmh": 50}], "profile.start": start,
        "profile.allow_rolling_end": True, "brake": {"policy": policy, "predictive": brake or {}},
    }  # fmt: skip
    return tuple(f"{key}={json.dumps(value)}" for key, value in changes.items())


def setup_on_fall(folder: Path, brake: dict[str, Any] | None = None, **changes: Any) -> RunSetup:
    return setup_of("demo", *sets_on_fall(folder, brake, **changes))


def recording_of(setup: RunSetup) -> Recording:
    outcome = run_engine(setup)
    assert outcome.failure is None, outcome.failure
    return outcome.recording


def on_long_fall(folder: Path, policy: str) -> RunSetup:
    return setup_on_fall(folder, policy=policy, duration=700.0, start=1500.0, end=12_000.0)


def blending() -> tuple[Any, float]:
    """Return the policy of the demo, and the force of its electric brake at 15 m/s [N]."""
    model = setup_of("demo").model
    policy = make_brake_policy(BrakeSpec.model_validate({"policy": "blend"}), model, model.line)
    return policy, -float(model.force_limits(np.array([15.0]))[0].sum())


def test_a_fall_of_9_km_runs_away_without_and_is_kept_with_blended_air(tmp_path: Path) -> None:
    """461 kN hold -6.3 of -10 per mille; breaks if the air brake is not applied, not released, or cycles."""
    assert recording_of(on_long_fall(tmp_path, "none")).velocity.max() * 3.6 > 90
    outcome = run_engine(on_long_fall(tmp_path, "blend"))
    recording = outcome.recording
    speed = 3.6 * recording.front_velocity[(recording.front_position > 5000) & (recording.front_position < 11000)]
    assert speed.min() > 35 and speed.max() < 65
    assert abs(outcome.summary["coupler_buff_max_kn"]) < 1000


def test_blending_rules_on_the_share_of_the_electric_brake() -> None:
    """A part of .95 for 5 s applies, .2 for 5 s releases, and then no application for 60 s."""
    policy, there = blending()

    def pressures(begin: int, end: int, share: float) -> list[float]:
        return [policy.step(float(t), 0.0, 15.0, -share * there) for t in range(begin, end)]

    assert pressures(0, 5, 0.95) == [600e3] * 5 and pressures(5, 20, 0.95) == [550e3] * 15
    assert pressures(20, 24, 0.2) == [550e3] * 4 and pressures(24, 25, 0.6) == [550e3]
    assert pressures(25, 31, 0.2)[-2:] == [550e3, 600e3] and set(pressures(31, 90, 0.95)) == {600e3}
    assert pressures(90, 97, 0.95)[-1] == 550e3


def test_blending_in_the_simulated_copy_has_the_force_of_its_units(tmp_path: Path) -> None:
    """Without that force `train_predictor` never applies the air brake of its copy."""
    setup = on_long_fall(tmp_path, "blend")
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
    assert shoes[0] == 0.0 and shoes[-1] > 50e3


@pytest.mark.parametrize(
    ("then", "released"),
    [
        ([(9.0, 0.0, 90)], False),
        ([(5.0, 1e5, 20), (0.0, 0.0, 60)], False),
        ([(0.0, 0.0, 60), (0.0, 1e5, 6)], True),
        ([(0.0, 0.0, 2), (0.4, 1e5, 30)], False),
        ([(0.0, 0.0, 2), (0.4, 1e5, 5), (1.6, 1e5, 6)], True),
        ([(0.0, 0.0, 60), (0.0, 0.1, 20)], False),
        ([(0.0, 0.0, 60), (0.0, 1.0, 6)], True),
    ],
    ids=["below 35 km/h", "rolls, then stands", "departs", "wagons run in", "early", "lag", "downhill"],
)
def test_air_is_released_above_the_limit_and_at_a_departure_only(then, released) -> None:
    """Paper 000: a release below 35 km/h can break a coupler.  Each row is speed, demand and number of seconds."""
    policy, there = blending()
    steps = [(15.0, -there, 10), *then]
    each = [(speed, force) for speed, force, count in steps for _ in range(count)]
    found = [policy.step(float(t), 0.0, speed, force) for t, (speed, force) in enumerate(each)]
    assert set(found[10:-1]) == {550e3} and found[-1] == (600e3 if released else 550e3)


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
    setup = setup_of("demo", "plant.consist=hxd1_c80_105", "plant.line=level", changes=changes)
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


def test_driver_keeps_the_limits_and_averages_the_speed() -> None:
    """At most 79.3 km/h of 80, four applications to 45 km; the average shifts nothing and is taken three times."""
    profile = np.loadtxt(SHIPPED.parent / "daqin_driver.csv", delimiter=",", comments=("#", "time"))
    events = yaml.safe_load(SHIPPED.read_text())["brake"]["events"]
    assert 70 < 3.6 * profile[:, 2].max() < 79.3 and profile[0, 2] == 0
    assert profile[-1, 1] == pytest.approx(45_000, abs=50)
    assert [event["reduction_kpa"] for event in events] == [50, 0] * 4
    assert np.diff([event["time"] for event in events[::2]]).min() >= 160
    ramp = np.arange(300) * 0.1
    np.testing.assert_allclose(average_speed(ramp, 0.1, 5.0)[80:-80], ramp[80:-80], atol=1e-9)
    step = np.where(np.arange(400) < 200, 0.0, 1.0)
    smooth = average_speed(step, 0.1, 5.0)
    moving = np.flatnonzero((smooth > 1e-9) & (smooth < 1 - 1e-9))
    assert 140 <= moving.size <= 153 and smooth[199] + smooth[200] == pytest.approx(1.0, abs=1e-9)


def test_a_train_without_an_air_brake_is_driven(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the driver needs an air brake, or names brake events of a train without one."""
    out = tmp_path / "metro.csv"
    assert main(["driver", "xuzhou_metro_test", "xuzhou_metro_3", "--until-km", "1", f"--out={out}"]) == 0
    printed = capsys.readouterr()
    assert "brake" not in printed.out and "limits" not in printed.err
    assert "xuzhou_metro_3 --until-km 1 --speed-kmh 70 --spacing 0.5\n" in out.read_text()
    made = np.loadtxt(out, delimiter=",", comments=("#", "time"))
    assert made[0, 2] == 0 and made[-1, 1] == pytest.approx(1000, abs=20)
    assert 3.6 * made[:, 2].max() < 75


def test_a_driver_above_the_limits_is_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a profile above the limits of the line is written without a word, or cannot be made again."""
    line, out = tmp_path / "line.yaml", tmp_path / "driven.csv"
    limits = "speed_limits: [{at_km: 0, speed_kmh: 90}, {at_km: 0.4, speed_kmh: 30}, {at_km: 0.5, speed_kmh: 90}]"
    line.write_text(f"{{schema: train_ato/line/1, name: slow_place, end_km: 2, {limits}}}")
    arguments = ["--until-km=1", "--speed-kmh=65.25", "--spacing=0.25", f"--out={out}"]
    assert main(["driver", str(line), "xuzhou_metro_3", *arguments]) == 0
    made = np.loadtxt(out, delimiter=",", comments=("#", "time"))
    slow = (made[:, 1] + 59 >= 400) & (made[:, 1] - 59 <= 500)  # the train of 118 m covers the slow place
    note = f"keep speed limits: {3.6 * made[slow, 2].max():.1f} km/h at km 0.61"
    assert note in capsys.readouterr().err
    assert "--until-km 1 --speed-kmh 65.25 --spacing 0.25\n" in out.read_text()


def test_a_driver_begins_at_the_begin_of_the_line(tmp_path: Path) -> None:
    """Breaks if the train starts at km 0 of a line that begins at km 3: 3.2 km in place of 200 m."""
    line, out = tmp_path / "line.yaml", tmp_path / "driven.csv"
    line.write_text("{schema: train_ato/line/1, name: from_km_3, begin_km: 3, end_km: 5}")
    assert main(["driver", str(line), "xuzhou_metro_3", "--until-km", "3.2", f"--out={out}"]) == 0
    places = np.loadtxt(out, delimiter=",", comments=("#", "time"))[:, 1]
    assert places[0] == 3000 and places[-1] == pytest.approx(3200, abs=20)


def changes_of(recording: Recording) -> list[tuple[float, float, float]]:
    """Return time [s], place [m] and reduction [Pa] of every change of the pressure."""
    times, pressure = recording.of(BRAKE_PIPE_COMMAND, "pressure")  # type: ignore[misc]
    pressure = pressure.ravel()
    rows = np.flatnonzero(np.diff(pressure)) + 1
    return [(float(times[i]), float(recording.front_position[i]), 600e3 - float(pressure[i])) for i in rows]


def own_train(folder: Path, *parts: tuple[str, int]) -> str:
    """Write a train of vehicles of `demo`, or `pulls`, its locomotive without electric brake; return the file."""
    data = load_consist("hxd1_c80_105").model_dump(mode="json", by_alias=True, exclude_none=True)
    kinds = data["vehicle_types"]
    kinds["pulls"] = {key: value for key, value in kinds["hxd1"].items() if key != "brake"}
    data["train"] = [{"type": name, "count": count} for name, count in parts]
    (folder / "own.yaml").write_text(yaml.safe_dump(data))
    return str(folder / "own.yaml")


def with_weak_electric_brake(folder: Path) -> RunSetup:
    """Return a train whose plan needs the air brake up to its stop."""
    plan = {"end_km": 4, "acceleration": 0.2, "deceleration": 0.2}
    changes = {
        "duration": 360, "plant": {"consist": own_train(folder, ("hxd1", 1), ("c80", 30)), "line": "level"},
        "brake": {"policy": "predictive"}, "profile": {"phases": None, "limits": None, "plan": plan},
    }  # fmt: skip
    return setup_of("demo", changes=changes)


def test_a_train_with_a_weak_electric_brake_stops_with_applied_brakes(tmp_path: Path) -> None:
    """Breaks if the brakes are released at 35 km/h, at the first halt of the locomotive, or by the lag of its force."""
    outcome = run_engine(with_weak_electric_brake(tmp_path))
    ((_, _, reduction),) = changes_of(outcome.recording)
    assert reduction == 50e3 and abs(outcome.summary["stop_error_m"]) < 2.0


def to_km_4(folder: Path, policy: str, speed_kmh: float, *parts: tuple[str, int]) -> RunSetup:
    consist = own_train(folder, *parts)
    changes = {
        "duration": 560, "plant": {"consist": consist, "line": "level"}, "brake": {"policy": policy},
        "profile": {"phases": None, "limits": None, "plan": {"end_km": 4, "speed_max_kmh": speed_kmh}},
    }  # fmt: skip
    return setup_of("demo", changes=changes)


@pytest.mark.parametrize(("speed_kmh", "wagons"), [(80, 30), (34, 30)])
def test_a_train_with_the_air_brake_alone_stops_by_it(speed_kmh: float, wagons: int, tmp_path: Path) -> None:
    """Breaks if it brakes too late, never from below 35 km/h, or is released there for a stop beyond the horizon."""
    outcome = run_engine(to_km_4(tmp_path, "predictive", speed_kmh, ("pulls", 1), ("c80", wagons)))
    ((_, _, reduction),) = changes_of(outcome.recording)
    assert reduction == 50e3 and abs(outcome.summary["stop_error_m"]) < 1.0


def test_blending_without_an_electric_brake_is_refused(tmp_path: Path) -> None:
    """Breaks if a policy that never applies the brakes is accepted, or refused for a train with one electric brake."""
    with pytest.raises(ValueError, match=r"blend: train 'hxd1_c80_105' has no electric brake.*; set brake.policy: pre"):
        to_km_4(tmp_path, "blend", 60, ("pulls", 1), ("c80", 10))
    model = to_km_4(tmp_path, "blend", 60, ("pulls", 1), ("hxd1", 1)).model
    assert [brake.rows.size > 0 for brake in model.brake] == [False, True]


@pytest.mark.parametrize(("speed", "demanded"), [(15.0, APPLIED), (8.0, CHARGED)])
def test_no_application_begins_below_35_km_h(speed: float, demanded: float, tmp_path: Path) -> None:
    """Breaks if released brakes are applied for the last metres of a stop, below ``never_below``."""
    setup = with_weak_electric_brake(tmp_path)
    at = int(np.flatnonzero(setup.profile.velocity > speed)[-1])
    now = setup.profile.time.item(at), setup.profile.position.item(at), setup.profile.velocity.item(at)
    assert setup.brake_policy().step(*now, -461e3) == demanded


def test_the_policy_of_the_observer_has_the_place_of_the_first_vehicle(tmp_path: Path) -> None:
    """Breaks if the forecast of the observer brakes at another place than the controller."""
    pushed = own_train(tmp_path, ("c80", 20), ("hxd1", 1))
    setup = setup_of("demo", changes={"plant": {"consist": pushed}, "observer": "ndo"})
    stack, seen = ObserverStage(setup).stack, []
    stack.policy.step = lambda t, position, *motion: seen.append(position) or CHARGED  # type: ignore[method-assign]
    one = np.ones(1)
    none = np.zeros(0)
    stack.step(Measurement(0, 3000.0 * one - setup.model.offsets, 14.0 * one, 0.0 * one, none, none, none))
    assert seen == [pytest.approx(3000.0)]


@pytest.mark.parametrize("compiled", [False, True])
def test_a_place_is_that_of_the_first_vehicle_of_a_pushed_train(compiled: bool, tmp_path: Path) -> None:
    """Breaks if a policy takes the place of the locomotive behind 20 wagons: the train brakes 240 m too late."""
    brake = {"policy": "planned", "events": [{"place": 3000, "reduction_kpa": 50}]}
    changes = {"plant": {"consist": own_train(tmp_path, ("c80", 20), ("hxd1", 1))}, "brake": brake, "observer": "ndo"}
    setup = setup_of("demo", *sets_on_fall(tmp_path, duration=60.0), changes=changes)
    ((_, place, reduction),) = changes_of(run_engine(setup, compiled=compiled).recording)
    assert reduction == 50e3 and 2999.0 <= place < 3003.0, "the couplers of a pushed train are compressed"


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


def test_pause_duration_and_release_follow_the_rules(tmp_path: Path) -> None:
    """Breaks if an application or a pause is too short, or a slow or standing train releases, or cannot depart."""
    policy = policy_of(setup_on_fall(tmp_path))
    fall, level = (5000.0, 50 / 3.6, -450e3), (12_000.0, 52 / 3.6, 0.0)
    assert policy.step(0.0, *fall) == APPLIED
    pressure = [policy.step(float(t), *(level if t < 40 else fall)) for t in range(1, 121)]
    changed = [t + 1 for t in range(1, 120) if pressure[t] != pressure[t - 1]]
    assert len(changed) == 2
    assert 25 <= changed[0] <= 28, "released as soon as permitted"
    assert 60 <= changed[1] - changed[0] <= 64, "applied as soon as permitted"
    setup = setup_on_fall(tmp_path)
    for slow, then in ((9.0, (11.0, 0.0)), (0.0, (0.0, 1e5))):
        policy = policy_of(setup)
        assert [policy.step(float(t), 4500.0, 14.2, -450e3) for t in range(0, 12, 2)][-1] == APPLIED
        assert {policy.step(float(t), 9000.0, slow, 0.0) for t in range(12, 112)} == {APPLIED}
        assert [policy.step(float(t), 9000.0, *then) for t in range(112, 117)][-1] == CHARGED


def test_a_deeper_reduction_is_used_where_the_first_is_too_weak(tmp_path: Path) -> None:
    """Breaks if only the first reduction of the list is compared, or the deepest one is always taken."""
    brake = {"reduction": [0, 20e3, 50e3], "braking_factor": [0, 0.07, 0.17]}
    consist = load_consist("hxd1_c80_105")
    weak = consist.model_copy(update={"air_brake": consist.air_brake.model_copy(update=brake)})
    spec = BrakeSpec.model_validate({"policy": "predictive", "predictive": {"reductions_kpa": [20, 50]}})
    found = []
    for grade in (-7.0, -10.0):
        setup = setup_on_fall(tmp_path, grade=grade)
        model = TrainModel(weak, setup.line, np.zeros(1), np.zeros(1), 0.0, 0.1)
        policy = make_brake_policy(spec, model, setup.line, setup.profile)
        found.append(CHARGED - policy.step(0.0, 5000.0, 50 / 3.6, -450e3))
    assert found == [20e3, 50e3]


@pytest.mark.graph
def test_the_nodes_decide_as_the_engine(tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    rules = {"never_below_kmh": 10, "min_application": 10, "pause": 20}
    short = sets_on_fall(tmp_path, rules, duration=110.0, start=3300.0, end=4300.0)
    sets = [f"--set={text}" for text in short]
    for name, options in (("engine", ["--engine"]), ("nodes", [])):
        assert main(["run", "demo", "--json", f"--out={tmp_path / name}", *options, *sets]) == 0
    setup, _ = read_run_folder(tmp_path / "nodes")
    assert len(changes_of(recording_of(setup))) >= 2
    assert compared(tmp_path / "engine", tmp_path / "nodes").first is None


@pytest.mark.campaign
@pytest.mark.parametrize("worse", [False, True], ids=["nominal", "mismatch"])
def test_a_trip_plan_is_followed_without_its_places(worse: bool) -> None:
    """Breaks if an application is early or held too long: the drives pull against the shoes, 661 instead of 606 kWh."""
    # The bound on the energy is that of the policy `trip` and 2 %.
    mismatch = {"mass_scale": 1.03, "brake_scale": 0.92, "resistance_scale": 1.15} if worse else {}
    sets = (f"plant.mismatch={json.dumps(mismatch)}",)
    planned, predicted = (
        run_engine(setup_of(f"daqin_heavy_haul:{variant}", *sets)) for variant in ("trip", "trip+predictive")
    )
    assert len(changes_of(predicted.recording)) == 8
    summary = predicted.summary
    assert summary["energy_traction_kwh"] < 1.02 * planned.summary["energy_traction_kwh"]
    assert max(summary["coupler_draft_max_kn"], -summary["coupler_buff_max_kn"]) < 600
    assert summary["speed_error_max_kmh"] < 1.0 and summary["overspeed_max_kmh"] == 0
    assert summary["verdict"] == "passed"
