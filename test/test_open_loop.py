"""A driver's run as data: notches, rates and reductions without a law, by hand and on the trains of the example."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from engine_runs import setup_of

import train_ato as ta
from plant_sim.consist import Consist, Notches
from plant_sim.data_text import parse_yaml
from plant_sim.formats.writing import own_yaml
from plant_sim.input_error import build_model
from train_ato.cli import main
from train_ato.control.open_loop import NotchHandle
from train_ato.judge.recording import TRUTH, Recording
from train_ato.messages.types import Array

EXAMPLE = str(Path(__file__).parent.parent / "examples" / "driver" / "scenario.yaml")
NOTCHES = {
    "traction": [{"speed": [0, 20], "force": [40e3, 20e3]}, [{"to": 50, "force": 100e3}]],
    "brake": [[{"to": 50, "force": 30e3}], [{"to": 50, "force": 60e3}]],
    "rise": 10e3, "fall": 20e3,
}  # fmt: skip


AIR_BRAKE = {"charged_kpa": 600, "reduction_kpa": [0, 50, 150], "braking_factor": [0, 0.2, 0.6]}


def engine(mass_t: float = 100, **changes: Any) -> dict[str, Any]:
    """Return a train of one locomotive without resistance."""
    vehicle = {"mass_t": mass_t, "length": 20, "resistance": {"n": [0, 0, 0]}, "notches": NOTCHES} | changes
    parts = {"vehicle_types": {"engine": vehicle}, "train": [{"type": "engine"}]}
    return {"schema": "train_ato/consist/1", "name": "engine", **parts}


def scenario(driver: list[dict[str, Any]], consist: dict[str, Any] | None = None, **changes: Any) -> dict[str, Any]:
    """Return an open-loop scenario on a level line."""
    line = {"schema": "train_ato/line/1", "name": "level", "end": 20_000}
    return {
        "name": "driven", "duration": 40, "tick": 0.1, "plant": {"consist": consist or engine(), "line": line},
        "profile": {"start": 1000, "driver": driver},
    } | changes  # fmt: skip


def recorded(driver: list[dict[str, Any]], **changes: Any) -> Recording:
    """Return the recording of an open-loop run."""
    found: Recording | None = ta.run(scenario(driver, **changes)).recording
    assert found is not None
    return found


def test_a_notch_has_its_own_curve_and_rates() -> None:
    """Breaks if a notch is a part of the envelope, or the rates of rising and falling are exchanged."""
    handle = NotchHandle(Notches.model_validate(NOTCHES))
    handle.wanted = 1
    forces = [handle.step(t, 10.0, 1.0) for t in range(5)]
    assert forces == [10e3, 20e3, 30e3, 30e3, 30e3]  # the middle of 40 and 20 kN at 10 m/s
    handle.wanted = -2  # 30 kN in 1.5 s down to 0, then 0.5 s up with 10 kN/s
    assert [handle.step(5.0 + t, 10.0, 1.0) for t in range(3)] == [10e3, -5e3, -15e3]
    handle.wanted = 0
    assert [handle.step(8.0 + t, 10.0, 1.0) for t in range(2)] == [0.0, 0.0]


def test_the_handle_moves_notch_by_notch() -> None:
    """Breaks if a handle reaches notch 2 at once although a notch takes 3 s."""
    handle = NotchHandle(Notches.model_validate({**NOTCHES, "rise": None, "fall": None, "notch_time": 3}))
    handle.wanted = 2
    seen = []
    for t in range(13):
        if t == 6:
            handle.wanted = -1
        handle.step(float(t), 0.0, 1.0)
        seen.append(handle.notch)
    assert seen == [1, 1, 1, 2, 2, 2, 1, 1, 1, 0, 0, 0, -1]


def test_the_last_notches_are_the_envelopes() -> None:
    """Breaks if a train with notches alone is no power unit, or loses a notch on its way through a file."""
    train = build_model(Consist, engine(), "hand")
    vehicle = train.vehicles[0]
    assert train.power_units == (0,) and vehicle.traction[-1].force == 100e3 and vehicle.brake[-1].force == 60e3
    assert build_model(Consist, parse_yaml(own_yaml(train)), "again") == train


def test_a_run_has_the_speed_of_its_notch_by_hand() -> None:
    """Breaks if the run follows a profile: 100 kN with 10 kN/s on 100 t give 1 m/s² after 10 s."""
    found = recorded([{"time": 0, "notch": 2}, {"place": 1200, "notch": 0}])
    t, v, x = found.time, found.front_velocity, found.front_position
    assert v[t <= 9.9][-1] == pytest.approx(0.1 * 9.9**2 / 2, abs=0.05)
    idle = int(np.flatnonzero(x >= 1200)[0])
    assert v[idle] == pytest.approx(5 + (t[idle] - 10), abs=0.1)
    # 100 kN fall with 20 kN/s: 5 s, and 2.5 m/s more; without resistance the speed stays
    assert v[-1] == pytest.approx(v[idle] + 2.5, abs=0.1) and v[-1] == pytest.approx(v[-50], abs=1e-6)
    assert found.command[-1, 0] == 0 and found.command.max() == pytest.approx(100e3)


def test_a_notch_against_the_air_brake_at_standstill_acts() -> None:
    """Breaks if the rule of a law at rest takes the force of a standing train away."""
    consist = engine(shoes={"count": 16, "force_kn": 25, "friction": 0.48}) | {"air_brake": AIR_BRAKE}
    driver = [{"time": 0, "reduction_kpa": 150}, {"time": 20, "notch": 1}, {"time": 30, "reduction": 0}]
    found = recorded(driver, consist=consist, duration=60)
    held = (found.time > 25) & (found.time < 30)
    assert np.abs(found.front_velocity[held]).max() < 1e-6 and found.command[held].min() == pytest.approx(40e3)
    assert found.front_velocity[-1] > 3


@pytest.mark.parametrize(("changes", "problem"), [
    ({"law": "pid"}, "law: with profile.driver the run has no law"),
    ({"replan": {}}, "replan: with profile.driver"),
    ({"brake": {"policy": "blend"}}, "brake.policy: with profile.driver"),
    ({"profile": {"driver": [{"time": 1, "notch": 3}]}}, "power unit 0 has no notch 3; give -2 ... 2"),
    ({"profile": {"driver": [{"time": 1, "notch": 1, "units": [1]}]}}, "1 is not one of the 1 power units"),
    ({"profile": {"driver": [{"time": 1}]}}, "neither notch nor reduction"),
    ({"profile": {"driver": [{"notch": 1}]}}, "exactly one of time and place"),
    ({"profile": {"driver": [{"time": 1, "reduction": 5e4}]}}, "driver.0.reduction: the consist has no air_brake"),
    ({"plant": {"consist": engine() | {"air_brake": AIR_BRAKE}, "line": "level"},
      "profile": {"driver": [{"time": 1, "reduction_kpa": 900}]}},
     "driver.0.reduction = 900000 Pa: exceeds the charged 600000 Pa; lower it"),
    ({"observer": "eso"}, "observer: with profile.driver"),
    ({"compensation": "preview"}, "compensation: with profile.driver"),
    ({"profile": {"driver": [{"time": 9, "notch": 1}, {"time": 5, "notch": 2}]}}, "driver.1.time = 5: lies"),
    ({"profile": {"driver": [{"place": 9, "notch": 1}, {"place": 5, "notch": 2}]}},
     "driver.1.place = 5: lies before 9,"),
    ({"profile": {"driver": [{"place_km": 999, "notch": 1}]}}, "driver.0.place = 999000: beyond the end"),
    ({"profile": {"driver": [{"time": 1, "notch": 1}], "until": 9}}, "until with driver: "),
    ({"plant": {"consist": engine(notches=None, traction=[{"to": 50, "force": 1e5}]), "line": "level"}},
     "power unit without notches"),
])  # fmt: skip
def test_a_schedule_that_does_not_fit_is_refused(changes: dict[str, Any], problem: str, tmp_path: Path) -> None:
    """Breaks if a law and a driver fight, or a missing notch is left out in silence."""
    path = tmp_path / "driven.yaml"
    data = scenario([{"time": 0, "notch": 1}]) | changes
    path.write_text(yaml.safe_dump({"schema": "train_ato/scenario/1", **data}))
    with pytest.raises(ValueError, match=problem):
        setup_of(str(path))


@pytest.mark.usefixtures("without_figure")
def test_the_recorded_scenario_repeats_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if log and summary lose the actions of the driver: the run of the log is then another one."""
    path = tmp_path / "driven.yaml"
    driver = [{"time": 0, "notch": 2}, {"place_km": 1.1, "notch": -1}]
    path.write_text(yaml.safe_dump({"schema": "train_ato/scenario/1", **scenario(driver, duration=20)}))
    assert main(["run", str(path), "--engine", "--out", str(tmp_path / "run")]) == 0
    assert main(["verify", str(tmp_path / "run")]) == 0
    capsys.readouterr()


CASES = ("head_end", "remote_middle", "remote_rear", "long")


@pytest.fixture(scope="module")
def forces() -> dict[str, tuple[Recording, Array]]:
    """Return recording and coupler forces [N] of the four trains of the example, shape (ticks, couplers)."""
    found = {}
    for case in CASES:
        run = ta.run(f"{EXAMPLE}:{case}", set={"tick": 0.1, "duration": 241})
        assert run.recording is not None
        kept = run.recording.of(TRUTH, "coupler_force")
        assert kept is not None
        drafts = np.maximum(kept[1][:, :-1].max(axis=0), 0) / 1e3
        assert [row["draft_max_kn"] for row in run.metrics["couplers"]] == pytest.approx(drafts, abs=1e-3)
        count = run.recording.time.size
        found[case] = run.recording, kept[1][:count, :-1]
    return found


def test_the_four_trains_behave_as_the_published_ones(forces: dict[str, tuple[Recording, Array]]) -> None:
    """Breaks if waves last, or the forces along the train are not those of the locomotives and masses."""
    # Wu et al. 2018: the largest force decreases from the first wagon to the tail, and in-train forces do not ring.
    recording, head = forces["head_end"]
    draft = head.max(axis=0)[2:]  # behind the third locomotive
    assert np.all(np.diff(draft) < 0.0) and draft[-1] < 0.15 * draft[0]
    for case in CASES[1:]:
        assert forces[case][1].max() < 0.75 * draft[0]
    steady = (recording.time > 200) & (recording.time < 240)  # notch 8 on the level
    for column in (2, 20, 60):
        t, force = recording.time[steady], head[steady, column]
        ringing = force - np.polyval(np.polyfit(t, force, 3), t)
        assert np.abs(ringing).max() < 0.01 * draft[0]
    speed = recording.front_velocity[steady].mean()
    behind = 7600 / (7600 + 3 * 134)  # resistances per mass are nearly those of the locomotives
    assert head[steady, 2].mean() == pytest.approx(3 * 2400e3 / speed * behind, rel=0.03)


def test_the_example_is_a_run_without_a_law() -> None:
    """Breaks if a variant of the example loses its train, or the run gets a law."""
    for case, vehicles in zip(CASES, (83, 83, 83, 124), strict=True):
        setup = setup_of(f"{EXAMPLE}:{case}", "duration=10")
        assert len(setup.consist.vehicles) == vehicles and "open_loop" in setup.scenario.law
        assert not setup.layout.supervised
        assert setup.advice().startswith("profile.driver.1: the run ends at 10 s, before the action at 30 s; ")
