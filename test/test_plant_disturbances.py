"""Disturbances and sensors: values by hand, seeds; faults of the plant: parted trains, dead units, slippery rails."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from plant_trains import CLIP, GEARS, LINEAR, RIGID, STEP_NS, chain, drive, heavy, plain_line, train
from pydantic import TypeAdapter

from plant_sim import kernel as k
from plant_sim.air_brake import ATMOSPHERE
from plant_sim.disturbances import DisturbanceSource
from plant_sim.elementary import random_stream
from plant_sim.library import consist_names, load_consist
from plant_sim.plant_setup import PlantSetup
from plant_sim.states import Array
from plant_sim.train import Train
from train_ato.cli.main import main

LEVEL = plain_line(begin_km=-10)
_SOURCE: TypeAdapter[Any] = TypeAdapter(DisturbanceSource)


def acting(t: float, mass: list[float], **data: Any) -> tuple[Array, Array, Array]:
    """Return force, force per speed and drift at one time."""
    parts = _SOURCE.validate_python(data).tick(np.array([t]), np.array(mass))
    force, per_speed, drift, _ = (np.zeros((1, len(mass))) if part is None else part for part in parts)
    return force[0], per_speed[0], drift[0]


def test_equation_40_by_hand() -> None:
    """Paper 000, eq. (40) with the first power of speed, at t = 2 s on 100 t: 214.1 N, and 14.2 N s/m."""
    force, per_speed, drift = acting(2.0, [1e5], kind="eq40")
    assert force[0] == pytest.approx(1e5 * (0.002 + 0.001 * np.sin(3.0)))
    assert per_speed[0] == pytest.approx(1e5 * 0.0003 * (np.sin(6.0) + np.cos(7.0)))
    assert (force[0], per_speed[0]) == (pytest.approx(214.1, abs=0.1), pytest.approx(14.2, abs=0.1))
    assert not drift.any()
    default = _SOURCE.validate_python({"kind": "eq40"})
    assert default.listed(106) == (0, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100)


def test_equation_40_as_printed() -> None:
    """The third power of the speed: a rigid train gains the impulse of 1 s; 1 % of (40), almost constant speed."""
    t = np.arange(200) / 200  # begins of the plant steps
    steady, growing = 0.002 + 0.001 * np.sin(t + 1), 0.0003 * (np.sin(2 * t + 2) + np.cos(3 * t + 1))
    for power in (1, 3):
        disturbance = {"kind": "eq40", "speed_power": power, "scale": 0.01, "vehicles": [0, 1, 2, 3]}
        plant, still = (
            drive(train(heavy(RIGID, 3), LEVEL, start={"speed": 20}, disturbances=found), 1.0)
            for found in ([disturbance], [])
        )
        part = 0.01 * growing.mean() * 20**power
        gain = plant.velocity[0] - still.velocity[0]
        assert gain == pytest.approx(0.01 * steady.mean() + part, abs=0.01 * abs(part))


def test_paper_002_by_hand() -> None:
    """The printed set at t = 15 s, 80 t: d21 has changed sign; drift and force have their own units."""
    force, _, drift = acting(15.0, [8e4] * 5, kind="paper002", unmatched_scale=0.05, matched_scale=0.02)
    t = 15.0
    d21 = -6 * np.sin(3 * t) * np.cos(t)
    unmatched = [3 * np.sin(t + np.pi / 6), d21, np.sin(t) * np.cos(t), np.tanh(np.sin(t)), 2 * np.tanh(t) * np.sin(t)]
    matched = [d21, -d21, 5 * np.sin(3 * t), 3 * np.cos(4 * t), 6 * np.sin(np.cos(t))]
    assert drift == pytest.approx(0.05 * np.array(unmatched))
    assert force == pytest.approx(0.02 * 8e4 * np.array(matched))


@pytest.mark.parametrize(
    ("t", "wanted"),
    [(30.0, 0.03 * np.sin(15.0)), (70.0, 0.10 + 0.03 * np.sin(35.0)), (305.0, -0.12 + 0.03 * np.sin(152.5))],
)
def test_paper_001_by_hand(t: float, wanted: float) -> None:
    """D > 0 opposes: the force is -M D."""
    assert acting(t, [192170.0], kind="paper001")[0][0] == pytest.approx(-192170.0 * wanted)


def test_gust_and_travelling_load() -> None:
    """A trapezoid with 1 s of ramp; a load that reaches the second vehicle 5 s after the first."""
    gust = {"kind": "gust", "begin": 10, "end": 20, "acceleration": 0.1, "force_kn": 2}
    assert [acting(t, [1e5], **gust)[0][0] for t in (9.9, 10.5, 15, 19.5, 20)] == pytest.approx([0, 6e3, 12e3, 6e3, 0])
    load = {"kind": "travelling_load", "acceleration": -0.1, "begin": 10, "duration": 4, "interval": 5}
    assert acting(12.0, [1e5, 1e5], **load)[0] == pytest.approx([-1e4, 0.0])
    assert acting(17.0, [1e5, 1e5], **load)[0] == pytest.approx([0.0, -1e4])
    again = {**load, "period": 20}
    assert acting(37.0, [1e5, 1e5], **again)[0] == pytest.approx([0.0, -1e4])
    terms = [{"acceleration": 0.01, "omega": 0.5}, {"force_kn": 1, "omega": 0, "phase": np.pi / 2}]
    assert acting(3.0, [1e5], kind="harmonic", terms=terms)[0][0] == pytest.approx(1e3 * np.sin(1.5) + 1e3)


def test_a_gust_reaches_its_acceleration_with_long_ramps() -> None:
    """Breaks if ramps longer than half of a gust cut it: `inject gust duration=1` reached a quarter of its value."""
    gust = {"kind": "gust", "begin": 0, "end": 1, "ramp": 2, "acceleration": 0.1}
    assert acting(0.5, [1e5], **gust)[0][0] == pytest.approx(1e4)


def test_forces_act_in_the_plant() -> None:
    """0.1 m/s² on every vehicle for 2 s gives 0.2 m/s; the work is accounted; sources add up."""
    gusts = [{"kind": "gust", "begin": 1, "end": 3, "ramp": 0, "acceleration": a} for a in (0.06, 0.04)]
    plant = drive(train(chain(4, RIGID), LEVEL, disturbances=gusts, start={"speed": 5.0}), 5.0)
    assert plant.velocity == pytest.approx(5.2)
    assert plant.totals.outside == pytest.approx(0.5 * 4e5 * (5.2**2 - 25.0))
    drive(plant, 0.1)
    assert not plant.outside_force.any()


def test_drift_moves_without_speed() -> None:
    """Paper 002: x' = v + d1. The drift alone moves a train at rest with its holding brake."""
    setup = {"disturbances": [{"kind": "paper002", "matched_scale": 0.0}], "holding_brake_ratio": 1.0}
    plant = train(load_consist("freight_five"), LEVEL, **setup)
    drive(plant, 1.0)
    expected = 3 * (np.cos(np.pi / 6) - np.cos(1 + np.pi / 6))
    assert plant.position[0] == pytest.approx(expected, rel=5e-3)
    with pytest.raises(ValueError, match="rigidly joined"):
        train(chain(5, RIGID), LEVEL, disturbances=[{"kind": "paper002"}])


def test_unmodelled_grade_is_line() -> None:
    """An extra grade adds to that of the line under every vehicle, in its section only."""
    grade = {"kind": "grade", "pieces": [{"begin": 0, "end": 100, "grade_permille": 10}]}
    for place, force in ((50, -0.01 * 184e3 * 9.81), (150, 0.0)):
        plant = train(heavy(wagons=0), LEVEL, start={"position": place}, disturbances=[grade])
        assert plant.arrays.state[7, 0] == pytest.approx(force)


def test_turbulence() -> None:
    """Random wind has the configured rms and correlation time, and depends on the seed of the run."""
    wind = {"kind": "turbulence", "acceleration_rms": 0.05, "correlation": 2.0, "vehicles": [0]}
    plant = train(heavy(RIGID, 3), LEVEL, disturbances=[wind], start={"speed": 20})
    values = np.array([drive(plant, 0.1).outside_force[0] / 184e3 for _ in range(3000)])
    assert values.std() == pytest.approx(0.05, rel=0.2)
    assert np.corrcoef(values[:-20], values[20:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.15)


@pytest.mark.parametrize(
    ("disturbance", "message"),
    [
        ({"kind": "eq40"}, "lists vehicle 10"),
        ({"kind": "gust", "begin": 3, "end": 2}, "end 2 s must be after begin 3 s; correct it"),
        ({"kind": "gust", "begin": 0, "end": 5, "force": 1e3, "vehicles": [1, 1]}, "lists a vehicle twice"),
    ],
)
def test_a_disturbance_of_no_vehicle_or_time_is_refused(disturbance: dict[str, Any], message: str) -> None:
    """Breaks if a disturbance of vehicle 10 in a train of 6 is accepted, or acts once on a vehicle listed twice."""
    with pytest.raises(ValueError, match=message):
        train(heavy(wagons=5), disturbances=[disturbance])


def test_streams_are_named_and_seeded() -> None:
    """Key (seed, crc32(name)): equal for equal, different for another name or seed."""
    keys = ((3, "sensor/position"), (3, "sensor/position"), (4, "sensor/position"), (3, "sensor/velocity"))
    first, same, *others = (random_stream(*key).standard_normal(4) for key in keys)
    assert (same == first).all() and all((other != first).any() for other in others)


def measured(ticks: int, **sensors: Any) -> tuple[Train, Array, Array]:
    """Return the errors of measured position and speed of unit 0 at 10 m/s, one row per tick."""
    plant = train(heavy(RIGID, 3), LEVEL, start={"speed": 10}, sensors=sensors)
    x, v = [], []
    for _ in range(ticks):
        seen = plant.observe()
        x.append(seen.measurement.position[0] - seen.vehicles.position[0])
        v.append(seen.measurement.velocity[0] - seen.vehicles.velocity[0])
        drive(plant, 0.1)
    return plant, np.array(x), np.array(v)


def test_noise_and_bias() -> None:
    """Errors have the configured rms and mean; without errors the measurement is the true state."""
    _, x, v = measured(2000, position_noise=0.5, velocity_noise=0.02, velocity_bias=0.1)
    assert x.std() == pytest.approx(0.5, rel=0.08)
    assert v.std() == pytest.approx(0.02, rel=0.08)
    assert v.mean() == pytest.approx(0.1, abs=2e-3)
    assert not np.any(measured(10)[1:])


def test_one_noise_does_not_change_another() -> None:
    """With position noise every speed error is unchanged."""
    _, _, alone = measured(50, velocity_noise=0.02)
    _, _, both = measured(50, velocity_noise=0.02, position_noise=1.0, couplers=[0], force_noise=10.0)
    np.testing.assert_array_equal(alone, both)


def test_quantisation_freeze_and_slip() -> None:
    """Speeds in steps of 0.1 m/s; a frozen channel repeats; 10 % slip for 2 s adds 2 m to the odometer."""
    plant = train(heavy(RIGID, 3), LEVEL, start={"speed": 9.97}, sensors={"velocity_quantum": 0.1})
    assert plant.observe().measurement.velocity[0] == pytest.approx(10.0)
    _, x, v = measured(60, freeze=[{"begin": 1.0, "end": 2.0, "quantity": "position"}])
    assert x[10:20].min() < -8.0
    assert not x[20:].any()
    assert not v.any()
    frozen = {"sensors": {"freeze": [{"begin": 0.0, "end": 1.0}]}, "start": {"position": 480.0, "speed": 5.0}}
    plant = train(heavy(RIGID, 3), LEVEL, **frozen)
    assert plant.observe().measurement.position[0] == 480.0, "frozen from the start: the first value, not km 0"
    assert drive(plant, 0.5).observe().measurement.position[0] == 480.0
    _, x, v = measured(60, wheel_slip=[{"begin": 1.0, "end": 3.0, "slip": 0.1}])
    assert v[15] == pytest.approx(1.0, rel=0.01)
    assert x[-1] == pytest.approx(2.0, rel=0.02)
    assert v[-1] == 0.0


def test_coupler_sensors() -> None:
    """A sensor behind vehicle i measures deflection, rate and force of that coupling."""
    plant = train(heavy(wagons=4), LEVEL, sensors={"couplers": [0, 2]})
    drive(plant, 3.0, 3e5)
    seen = plant.observe()
    x, v, force = seen.vehicles.position, seen.vehicles.velocity, seen.vehicles.coupler_force
    assert seen.measurement.force.tolist() == force[[0, 2]].tolist()
    assert seen.measurement.deflection == pytest.approx([x[0] - x[1] - 23.611, x[2] - x[3] - 12.0])
    assert seen.measurement.rate.tolist() == [v[0] - v[1], v[2] - v[3]]
    assert seen.measurement.force[0] > 1e5
    for wrong in ({"couplers": [4]}, {"freeze": [{"unit": 1, "begin": 0, "end": 1}]}):
        with pytest.raises(ValueError, match=r"lists vehicle 4|names unit 1"):
            train(heavy(wagons=4), LEVEL, sensors=wrong)


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
    start = {"position": 1000, "speed_kmh": 20}
    whole, parted = (
        drive(train(heavy(GEARS[gear], 6), start=start, jumps=jumps), PARTS_AT, 300e3) for jumps in ([], [parts(2)])
    )
    np.testing.assert_array_equal(whole.arrays.state, parted.arrays.state)
    assert abs(whole.coupler_force[2]) > 1e3 and drive(parted, 3.0, 300e3).coupler_force[2] == 0.0
    assert abs(parted.totals.balance) < 1e-9 * parted.kinetic_energy


def ways(plant: Train, *gaps: tuple[int, float]) -> Array:
    """Return the time of the first wave at every vehicle [s], from the gaps behind vehicles after a time each."""
    offsets = np.array(plant.consist.offsets)
    return np.min([np.abs(offsets - offsets[i] - 6.0) / 200.0 + later for i, later in gaps], axis=0)


@pytest.mark.parametrize("gaps", [[(40, 0.0)], [(10, 0.0), (90, 1.0)]], ids=["one", "two"])
def test_the_wave_runs_from_every_gap_in_both_directions(gaps: list[tuple[int, float]]) -> None:
    """Breaks if the wave starts elsewhere or at one part only, or a second gap has none or moves the first one."""
    plant = parting("hxd1_c80_105", *(parts(behind, at=PARTS_AT + later) for behind, later in gaps))
    first = first_levels(plant, 8.0) - PARTS_AT
    np.testing.assert_allclose(first, ways(plant, *gaps) + 0.005, atol=0.0051)


def test_the_vent_of_the_locomotive_adds_to_the_gap() -> None:
    """Breaks if an emergency brake after the parting is ignored, or releases the wagons that the gap has braked."""
    plant = parting("hxd1_c80_105", parts(100))
    drive(plant, PARTS_AT + 0.5)
    plant.apply_emergency_brake()
    first = first_levels(plant, 6.0) - PARTS_AT
    expected = np.minimum(ways(plant, (100, 0.0)), np.array(plant.consist.offsets) / 200.0 + 0.5)
    fresh = expected > 0.51
    np.testing.assert_allclose(first[fresh], expected[fresh] + 0.005, atol=0.0051)
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


def test_a_run_with_a_separation(tmp_path: Path, without_figure: None) -> None:
    """Breaks if a scenario cannot part a train."""
    jump = "plant.jumps=[{at: 5, what: coupler, vehicles: [20]}]"
    assert main(["run", "demo", "--engine", "--set=duration=30", f"--set={jump}", f"--out={tmp_path / 'parted'}"]) == 0


@pytest.mark.parametrize("name", consist_names())
@pytest.mark.parametrize("what", ["gain", "brake", "adhesion", "coupler"])
def test_every_documented_fault_acts_on_every_train(name: str, what: str) -> None:
    """Breaks if a fault of plant.md is refused for a train with the part concerned, or has no effect during the run."""
    consist = load_consist(name)
    if what == "coupler" and len(consist.vehicles) == 1:
        pytest.skip("one vehicle has no coupler")
    page = Path(__file__).resolve().parents[1] / "msgs_docs" / "plant.md"
    (block,) = [part for part in page.read_text().split("```yaml\n")[1:] if "what: coupler" in part]
    setup = PlantSetup.model_validate(yaml.safe_load(block.split("```")[0])["plant"])
    (jump,) = [entry for entry in setup.model_dump(exclude_none=True)["jumps"] if entry["what"] == what]
    jump |= {"at": 1.0} | ({"vehicles": [1]} if what == "coupler" else {})
    rails, braking, speeds = {"kind": "constant", "coefficient": 0.1}, what in ("brake", "adhesion"), []
    for jumps in ([], [jump]):
        plant = train(consist, start={"position": 4000, "speed_kmh": 60}, adhesion=rails, jumps=jumps)
        drive(plant, 1.0)
        if braking:
            plant.apply_emergency_brake()
        speeds.append(drive(plant, 15.0, 0.0 if braking else 200e3).velocity)
    difference = np.abs(speeds[1] - speeds[0]).max()
    assert difference > 0.05, f"{what} has no effect: {difference:g} m/s"
