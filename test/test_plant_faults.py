"""Faults of the plant during a run: train separation, a dead unit, brake fade, slippery rails."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from plant_trains import CLIP, GEARS, LINEAR, RIGID, chain, drive, heavy, train

from plant_sim import kernel as k
from plant_sim.brake_events import ATMOSPHERE
from plant_sim.library import consist_names, load_consist
from plant_sim.plant_setup import PlantSetup
from plant_sim.states import Array
from plant_sim.train import Train
from train_ato.cli.main import main

STEP_NS = 5_000_000
PARTS_AT = 2.0


def parts(*vehicles: int, at: float = PARTS_AT) -> dict[str, Any]:
    """Return the jump that parts the couplers behind some vehicles."""
    return {"at": at, "what": "coupler", "vehicles": vehicles}


def parting(name: str, *jumps: dict[str, Any], **start: Any) -> Train:
    """Return a shipped train with jumps and with ticks of one step."""
    begin = {"position": 4000, "speed_kmh": 60, **start}
    return train(load_consist(name), start=begin, jumps=jumps, tick_ns=STEP_NS)


def first_levels(plant: Train, seconds: float) -> Array:
    """Return the time of the first cylinder motion of every vehicle [s]; NaN without one."""
    first = np.full(plant.n, np.nan)
    for _ in range(round(seconds * 1e9 / STEP_NS)):
        drive(plant, STEP_NS * 1e-9)
        first[np.isnan(first) & (plant.arrays.state[k.CYLINDER, : plant.n] > 0.0)] = plant.time
    return first


@pytest.mark.parametrize("gear", [name for name in GEARS if name != "rigid"])
def test_a_parted_coupler_has_no_force_and_energies_close(gear: str) -> None:
    """Breaks if any kind of draft gear still transmits a force, or the run before the parting changes in any bit."""
    plants = [
        train(heavy(GEARS[gear], 6), start={"position": 1000, "speed_kmh": 20}, jumps=jumps)
        for jumps in ([], [parts(2)])
    ]
    for plant in plants:
        drive(plant, PARTS_AT, 300e3)
    np.testing.assert_array_equal(plants[0].arrays.state, plants[1].arrays.state)
    assert abs(plants[0].coupler_force[2]) > 1e3
    for plant in plants:
        drive(plant, 3.0, 300e3)
    assert plants[1].coupler_force[2] == 0.0
    assert abs(plants[1].totals.balance) < 1e-9 * plants[1].kinetic_energy


def test_the_wave_runs_from_the_gap_in_both_directions() -> None:
    """Breaks if the wave starts at the locomotive, at the wrong end of the vehicle, or at one part only."""
    plant = parting("hxd1_c80_105", parts(40))
    first = first_levels(plant, 8.0) - PARTS_AT
    offsets = np.array(plant.consist.offsets)
    gap = offsets[40] + 6.0
    np.testing.assert_allclose(first, np.abs(offsets - gap) / 200.0 + 0.005, atol=0.0051)
    assert np.nanargmin(first) in (40, 41)


def test_a_second_gap_shortens_the_way_of_the_wave() -> None:
    """Breaks if a second gap has no wave, moves the first one, or a vehicle that is reached is forgotten."""
    plant = parting("hxd1_c80_105", parts(10), parts(90, at=PARTS_AT + 1.0))
    first = first_levels(plant, 8.0) - PARTS_AT
    offsets = np.array(plant.consist.offsets)
    ways = [np.abs(offsets - offsets[i] - 6.0) / 200.0 + later for i, later in ((10, 0.0), (90, 1.0))]
    np.testing.assert_allclose(first, np.minimum(*ways) + 0.005, atol=0.0051)


def test_the_vent_of_the_locomotive_adds_to_the_gap() -> None:
    """Breaks if an emergency brake after the parting is ignored, or releases the wagons that the gap has braked."""
    plant = parting("hxd1_c80_105", parts(100))
    drive(plant, PARTS_AT + 0.5)
    plant.apply_emergency_brake()
    offsets = np.array(plant.consist.offsets)
    first = first_levels(plant, 6.0) - PARTS_AT
    gap = np.abs(offsets - offsets[100] - 6.0) / 200.0
    fresh = np.minimum(gap, offsets / 200.0 + 0.5) > 0.51
    expected = np.minimum(gap, offsets / 200.0 + 0.5) + 0.005
    np.testing.assert_allclose(first[fresh], expected[fresh], atol=0.0051)
    drive(plant, 30.0)
    assert plant.arrays.state[k.CYLINDER, : plant.n].min() > 0.99


def test_nothing_releases_a_parted_train() -> None:
    """Breaks if a demand or a release of the emergency brake charges an open pipe, or the head shows a charged one."""
    plant = parting("hxd1_c80_105", parts(60))
    drive(plant, PARTS_AT + 2.0, 0.0, 600e3)
    arrival = PARTS_AT + (plant.consist.offsets[60] + 6.0) / 200.0
    assert plant.time < arrival
    assert plant.observe().brake_pipe.pressure == 600e3  # type: ignore[union-attr]
    drive(plant, 1.0, 0.0, 550e3)
    drive(plant, arrival - plant.time + 0.01, 0.0, 600e3)
    assert ATMOSPHERE < plant.observe().brake_pipe.pressure < 600e3  # type: ignore[union-attr]
    plant.apply_emergency_brake()
    plant.release_emergency_brake()
    drive(plant, 60.0, 0.0, 600e3)
    assert plant.arrays.state[k.CYLINDER, : plant.n].min() > 0.99
    assert plant.observe().brake_pipe.pressure == ATMOSPHERE  # type: ignore[union-attr]
    assert not plant.velocity.any()


def test_traction_is_cut_off_where_the_wave_arrives() -> None:
    """Breaks if a locomotive pulls on after its pipe is empty, or is cut off before the wave has reached it."""
    plant = parting("hxd1_c80_210", parts(150), speed_kmh=20)
    offsets = np.array(plant.consist.offsets)
    ways = [(offsets[150] + 6.0 - offsets[i]) / 200.0 for i in plant.units]
    for unit, way in ((1, ways[1]), (0, ways[0])):
        drive(plant, PARTS_AT + way - plant.time - 0.02, 200e3)
        assert plant.applied[unit] == pytest.approx(200e3)
        drive(plant, 0.04, 200e3)
        assert plant.applied[unit] == 0.0
    assert ways[0] > ways[1] + 6.0


@pytest.mark.parametrize("name", ["crh380a_eight_cars", "crh380a_three_units", "freight_five"])
def test_parts_of_a_train_with_a_loop_stop_by_themselves(name: str) -> None:
    """Breaks if a train without brake pipe keeps its traction or its speed after a separation, or is released."""
    plant = parting(name, parts(1))
    brake = plant.consist.friction_emergency_brake
    assert brake is not None
    first = first_levels(plant, 6.0)
    np.testing.assert_allclose(first, PARTS_AT + brake.delay + 0.005, atol=0.0051)
    plant.apply_emergency_brake()
    drive(plant, 2.0, 20e3)
    plant.release_emergency_brake()
    drive(plant, 60.0, 20e3)
    assert not plant.applied.any()
    assert not plant.velocity.any()
    assert (plant.shoe_force > 0.0).all()


def test_parting_uphill_opens_a_gap_that_grows() -> None:
    """Breaks if the parts still move together: without the rear part, the front one is faster under traction."""
    plant = train(heavy(CLIP, 30), start={"position": 1000, "speed_kmh": 30}, jumps=[parts(4)])
    drive(plant, PARTS_AT, 500e3)
    before = plant.position[4] - plant.position[5]
    drive(plant, 6.0, 500e3)
    assert plant.position[4] - plant.position[5] > before + 0.5


def test_a_coupler_parts_at_a_place() -> None:
    """Breaks if the place is ignored or is not that of vehicle 0."""
    jump = {"place": 1100.0, "what": "coupler", "vehicles": [1]}
    plant = train(heavy(CLIP, 5), start={"position": 1000, "speed": 10.0}, jumps=[jump])
    drive(plant, 9.5)
    assert not plant.shoe_force.any()
    drive(plant, 1.5)
    assert (plant.shoe_force > 0.0).all()


@pytest.mark.parametrize(
    ("consist", "vehicles", "text"),
    [
        (chain(3, RIGID), [1], "jumps: the coupler behind vehicle 1 is rigid; list one with a draft gear"),
        (chain(3, LINEAR), [2], "jumps: no coupler is behind vehicle 2; give 0 ... 1"),
        (chain(3, LINEAR), [-1], "jumps: no coupler is behind vehicle -1; give 0 ... 1"),
        (load_consist("xuzhou_metro_3"), [0], "jumps: no coupler is behind vehicle 0; the train is one vehicle"),
    ],
)
def test_couplers_that_cannot_part_are_refused(consist: Any, vehicles: list[int], text: str) -> None:
    """Breaks if a rigid or missing coupler is accepted, or the message has no vehicle."""
    with pytest.raises(ValueError, match=text.replace("...", r"\.\.\.")):
        train(consist, jumps=[{"at": 1.0, "what": "coupler", "vehicles": vehicles}])


def test_a_run_with_a_separation(tmp_path: Path) -> None:
    """Breaks if a scenario cannot part a train."""
    jump = "plant.jumps=[{at: 5, what: coupler, vehicles: [20]}]"
    words = ["run", "demo", "--engine", "--set", "duration=30", "--set"]
    assert main([*words, jump, "--out", str(tmp_path / "parted")]) == 0


PAGE = Path(__file__).resolve().parents[1] / "msgs_docs" / "plant.md"


def documented() -> list[dict[str, Any]]:
    """Return the jumps of the example in plant.md."""
    (block,) = [part for part in PAGE.read_text().split("```yaml\n")[1:] if "what: coupler" in part]
    plant = yaml.safe_load(block.split("```")[0])["plant"]
    return list(PlantSetup.model_validate(plant).model_dump(exclude_none=True)["jumps"])


@pytest.mark.parametrize("name", consist_names())
@pytest.mark.parametrize("what", ["gain", "brake", "adhesion", "coupler"])
def test_every_documented_fault_acts_on_every_train(name: str, what: str) -> None:
    """Breaks if a fault of the page is refused for a train with the part concerned, or has no effect during the run."""
    consist = load_consist(name)
    if what == "coupler" and len(consist.vehicles) == 1:
        pytest.skip("one vehicle has no coupler")
    (jump,) = [entry for entry in documented() if entry["what"] == what]
    jump["at"] = 1.0
    if what == "coupler":
        jump["vehicles"] = [1]
    rails = {"kind": "constant", "coefficient": 0.1}
    speeds = []
    for jumps in ([], [jump]):
        plant = train(consist, start={"position": 4000, "speed_kmh": 60}, adhesion=rails, jumps=jumps)
        drive(plant, 1.0)
        braking = what in ("brake", "adhesion")
        if braking:
            plant.apply_emergency_brake()
        drive(plant, 15.0, 0.0 if braking else 200e3)
        speeds.append(plant.velocity)
    difference = np.abs(speeds[1] - speeds[0]).max()
    assert difference > 0.05, f"{what} has no effect: {difference:g} m/s"
