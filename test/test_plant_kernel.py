"""The compiled kernel against plain numpy, half the step, conservation laws, and in batches of trains."""

import platform
import re
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit
from plant_trains import GEARS, LINEAR, RIGID, SLACK, TICK_NS, chain, drive, heavy, plain_line, run_ramps, train

from plant_sim import kernel as k
from plant_sim.batch import advance_trains
from plant_sim.consist import Consist
from plant_sim.library import load_consist, load_line
from plant_sim.states import Array
from plant_sim.train import Train

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench"))
from plain_numpy_train import PlainTrain

BARS = heavy(wagons=20).model_dump(by_alias=True, exclude_none=True)
BARS["draft_gears"]["bar"] = RIGID
BARS["couplings"] = [{"behind": [0, 3, 4, 5], "gear": "bar"}, {"behind": [10], "gear": "qkx100_mt2"}]
"""Train with rigid couplings behind the locomotive and between wagons 3 to 6."""


@pytest.mark.parametrize(
    ("consist", "setup"),
    [
        (heavy(), {"lag": 0.4}),
        (heavy(LINEAR, 30), {"rate_limit_kn_per_s": 80, "dead_band": 50}),
        (heavy(SLACK, 10), {"force_limit_kn": 300}),
        (Consist.model_validate(BARS), {"adhesion": {"kind": "constant", "coefficient": 0.2}}),
        (heavy(wagons=0), {}),
    ],
    ids=["daqin", "linear", "slack", "partly rigid", "locomotive alone"],
)
def test_kernel_equals_plain_numpy(consist: Consist, setup: dict[str, Any]) -> None:
    """12 s over grades and curves with traction, brake and air; breaks if the step changes in one of the two."""
    line = load_line("daqin_section")
    compiled = train(consist, line, start={"position_km": 20.15, "speed_kmh": 30}, **setup)
    plain = PlainTrain(compiled.arrays, compiled.step_ns * 1e-9)
    event, events = np.zeros((k.EVENT_ROWS, 1)), 0
    for tick in range(120):
        demand = np.full((compiled.substeps, 1), 500e3 if tick < 40 else -300e3)
        if tick == 20:
            event[:, 0], events = (compiled.time, 200.0, 0.17, 0.0, 1.0, 0.0), 1
        plain.advance(compiled.time, event, events, demand)
        compiled.advance(demand, 550e3 if tick >= 20 else None)
    ours, theirs = compiled.arrays, plain.arrays
    assert compiled.totals.air_brake < 0.0
    for name in ("state", "unit", "gear"):
        got, wanted = getattr(ours, name), getattr(theirs, name)
        if name == "state":  # the kernel has these for some vehicles or within a step only
            own = (k.FRICTION_SHARE, k.SPEED_BEFORE, k.SPEED_AFTER, k.VISCOUS, k.GRADE_FORCE)
            got, wanted = (np.delete(array, own, axis=0) for array in (got, wanted))
        scale = 1.0 + np.abs(wanted).max(axis=1, keepdims=True)
        assert np.abs((got - wanted) / scale).max() < 1e-11, name


@pytest.mark.parametrize("name", GEARS)
def test_energy_closes_for_every_draft_gear(name: str) -> None:
    """The works equal the change of kinetic energy to 1e-9; a missing force gives a much larger error."""
    line = plain_line(
        begin_km=-5,
        grades=[{"at": -5000, "grade_permille": 4}, {"at": 300, "grade_permille": -6}],
        curves=[{"begin": 100, "end": 900, "radius": 500}],
    )
    gust = {"kind": "gust", "begin": 20, "end": 60, "acceleration": -0.02}
    plant = run_ramps(train(heavy(GEARS[name], 30), line, start={"speed_kmh": 40}, lag=0.4, disturbances=[gust]))
    totals = plant.totals
    parts = (totals.traction, totals.regenerated, totals.air_brake, totals.curve, totals.grade, totals.outside)
    assert min(map(abs, parts)) > 1e4
    assert abs(totals.balance) < 1e-9 * (totals.traction + totals.regenerated)
    assert totals.couplers <= 1e-6 * totals.traction, "draft gears give energy"


@pytest.mark.parametrize("name", GEARS)
def test_momentum_without_outer_forces(name: str) -> None:
    """Newton's third law: colliding vehicles keep their momentum to rounding."""
    speeds = [3.0, 2.0, 2.0, -1.0, 0.5, 4.0] if name != "rigid" else [2.0] * 6
    plant = train(chain(6, GEARS[name]), start={"speeds": speeds}, holding_brake_ratio=0.0)
    before = plant.momentum
    drive(plant, 5.0)
    assert abs(plant.momentum - before) < 1e-9 * 6e5


def test_linear_spring_and_damper_energy() -> None:
    """Kinetic + elastic + dissipated energy is constant; the error halves with the step (first order)."""
    missing = []
    for step_ns in (1_000_000, 500_000, 250_000):
        gear = {"kind": "linear", "stiffness": 5e6, "damping": 2e4}
        plant = train(
            chain(4, gear), step_ns=step_ns, tick_ns=step_ns, start={"speeds": [1.0, 0.0, 0.0, -1.0]},
            holding_brake_ratio=0,
        )  # fmt: skip
        start, dissipated, none = plant.kinetic_energy, 0.0, np.zeros((1, 0))
        for _ in range(round(2e9 / step_ns)):
            rate = -np.diff(plant.velocity)
            plant.advance(none)
            mean = 0.5 * (rate - np.diff(plant.velocity))
            dissipated += float((2e4 * rate * mean).sum()) * step_ns * 1e-9
        stretch = -np.diff(plant.position) - 12.0
        elastic = 0.5 * 5e6 * float((stretch**2).sum())
        missing.append(abs(plant.kinetic_energy + elastic + dissipated - start) / start)
    assert missing[0] < 2e-3
    assert missing[2] < 0.3 * missing[0]


def test_rigid_train_is_one_mass() -> None:
    """A rigid train moves like one vehicle with all masses and resistances."""
    parts = heavy(RIGID, 40)
    whole = np.sum([v.resistance.polynomial(v.mass, parts.gravity) for v in parts.vehicles], axis=0)
    data = heavy(wagons=0).model_dump(by_alias=True, exclude_none=True)
    data["vehicle_types"]["hxd1"].update(mass=parts.mass, resistance={"n": whole.tolist()}, shoes=None)
    single, rigid = (
        run_ramps(train(Consist.model_validate({**each, "air_brake": None}), start={"speed_kmh": 30}))
        for each in (data, parts.model_dump(by_alias=True))
    )
    assert rigid.velocity[0] > 1.0
    np.testing.assert_allclose(rigid.velocity, single.velocity[0], rtol=1e-10)
    np.testing.assert_allclose(rigid.position[0], single.position[0], rtol=1e-10)


@pytest.mark.parametrize(
    ("name", "fine_ns"),
    [("", 2_500_000), *(pytest.param(g, 500_000, marks=pytest.mark.campaign) for g in GEARS if g != "rigid")],
)
def test_convergence_of_the_largest_coupler_force(name: str, fine_ns: int) -> None:
    """Smaller steps than 5 ms move the largest force of 106 vehicles by under 1 % (0.01 % measured at 2.5 ms)."""
    # 100 s with traction, brake, air application and release; too large a step chatters at 400 kN instead of exploding,
    # which this catches (20 ms: +43 %).
    gear = GEARS.get(name)
    coarse = run_ramps(train(heavy(gear), start={"speed_kmh": 50})).totals
    fine = run_ramps(train(heavy(gear), step_ns=fine_ns, start={"speed_kmh": 50})).totals
    assert abs(coarse.draft_max / fine.draft_max - 1.0) < 0.01
    if not name:
        assert abs(coarse.buff_max / fine.buff_max - 1.0) < 0.01
        assert np.abs(coarse.draft - fine.draft).max() < 5e3


def test_same_seed_same_bits_other_seed_other_noise() -> None:
    setup: dict[str, Any] = {"disturbances": [{"kind": "turbulence", "acceleration_rms": 0.01}]}
    runs = [run_ramps(train(heavy(wagons=5), **setup)) for _ in range(2)]
    assert runs[0].arrays.state.tobytes() == runs[1].arrays.state.tobytes()
    undisturbed = run_ramps(train(heavy(wagons=5)))
    assert undisturbed.position[0] != runs[0].position[0]


def test_tick_length_changes_nothing() -> None:
    """Integration in ticks of 0.1 s and of 0.02 s is the same computation, brake waves included, to rounding."""
    long = run_ramps(train(heavy(wagons=20), start={"speed_kmh": 50}))
    short = run_ramps(train(heavy(wagons=20), tick_ns=20_000_000, start={"speed_kmh": 50}))
    assert long.position[-1] == pytest.approx(short.position[-1], abs=1e-6)
    assert long.totals.air_brake == pytest.approx(short.totals.air_brake, rel=1e-9)


@given(
    forces=st.lists(st.floats(-8e5, 8e5), min_size=4, max_size=12),
    gear=st.sampled_from(["slack", "clip", "printed clip", "smoothed", "table", "linear"]),
    grade=st.floats(-12, 12),
)
def test_no_drive_creates_energy(forces: list[float], gear: str, grade: float) -> None:
    """For any demand draft gears and resistance create no energy, and the balance closes."""
    line = plain_line(begin_km=-5, grades=[{"at_km": -5, "grade_permille": grade}])
    plant = train(heavy(GEARS[gear], 6), line, start={"speed_kmh": 20})
    for force in forces:
        drive(plant, 1.0, force)
        totals = plant.totals
        assert totals.couplers <= 1.0
        assert totals.running <= 0.0
        assert abs(totals.balance) < 1e-6 * (1.0 + totals.traction + totals.regenerated + abs(totals.grade))


def test_a_thousand_vehicles() -> None:
    """From 1 to 1000 vehicles: all start together."""
    plant = drive(train(heavy(wagons=999)), 30.0, 700e3)
    assert plant.velocity.shape == (1000,)
    assert 0.0 < plant.velocity[0] < 3.0
    assert np.isfinite(plant.coupler_force).all()


def test_demand_is_checked() -> None:
    """A wrong shape or a NaN is rejected before the state changes."""
    plant = train(heavy(wagons=2))
    with pytest.raises(ValueError, match="shape"):
        plant.advance(np.zeros((plant.substeps, 2)))
    with pytest.raises(ValueError, match="not finite"):
        plant.advance(np.full((plant.substeps, 1), np.nan))
    with pytest.raises(ValueError, match="no air brake"):
        train(load_consist("xuzhou_metro_3")).advance(np.zeros((20, 1)), 550e3)
    assert plant.stamp == 0
    assert not plant.arrays.state[k.V].any()


def test_equal_draft_gears_are_found() -> None:
    """Breaks if two different draft gears count as equal: the second would have the constants of the first."""
    other = {**GEARS["clip"], "stroke": 0.1}
    data = heavy(wagons=6).model_dump(by_alias=True, exclude_none=True)
    data["draft_gears"].update(other=other, same=dict(data["draft_gears"]["mt2_mt2"]))
    for gear, equal in (("other", 0), ("same", 1)):
        data["couplings"] = [{"behind": [0], "gear": "qkx100_mt2"}, {"behind": [3], "gear": gear}]
        runs = train(Consist.model_validate(data)).arrays.run
        assert runs[:, k.EQUAL].tolist() == [1, equal]


def test_constants_of_equal_draft_gears_change_nothing() -> None:
    """Breaks if the loop that reads the constants once has other bits than the one that reads them per coupler."""
    plants = [train(heavy(wagons=20), load_line("daqin_section"), start={"position_km": 20.15}) for _ in range(2)]
    plants[1].arrays.run[:, k.EQUAL] = 0
    first, second = ((run_ramps(plant).arrays.state.tobytes(), plant.arrays.gear.tobytes()) for plant in plants)
    assert first == second


@pytest.mark.parametrize(
    "speeds", [(0.9, 0.9), (1.1, 1.1), (3.0, 3.0), (-3.0, -3.0), (-3.0, 3.1), (0.0, 1.9), (0.5, 2.5)]
)
def test_standing_is_the_mean_speed_below_the_limit(speeds: tuple[float, float]) -> None:
    """Breaks if the shortcut for fast trains decides another case, for example that of two directions."""
    plant = train(heavy(wagons=1), start={"speeds": list(speeds)})
    mass = plant.arrays.vehicle[k.MASS]
    mean = float((mass * speeds).sum() / mass.sum())
    assert k._standing(plant.arrays.state, plant.arrays.vehicle, 1.0) == (abs(mean) < 1.0)


@pytest.mark.parametrize("braked", [False, True])
@pytest.mark.parametrize("slowest", [19.0, 1e-4, 0.0, -3.0], ids=["forward", "stops", "rests", "two directions"])
def test_short_loops_have_the_bits_of_the_long_one(slowest: float, braked: bool) -> None:
    """Breaks if the loops for a train that runs forward change a bit, or include a vehicle that stops or runs back."""
    speeds = [slowest, *np.linspace(18.0, 22.0, 9).tolist()]
    line = load_line("daqin_section")
    a = train(heavy(wagons=9), line, start={"position_km": 20.15, "speeds": speeds}).arrays
    a.state[k.COUPLER, 1:10] = np.linspace(1e5, -4e5, 9)
    a.state[k.BRAKE_CAPACITY, 0] = 2e5
    a.state[k.SHOE_FORCE, :10] = np.linspace(0.0, 5e4, 10) * braked
    whole, single = a.state.copy(), a.state.copy()
    (k._braked_speeds if braked else k._speeds)(0.005, whole, a.vehicle)
    for i in range(10):
        shoes = single[k.SHOE_FORCE, i]
        dry = k._capacity(i, single, a.vehicle)
        sliding, moved = k._speed(np.uint64(i), 0.005, dry + shoes if braked else dry, single, a.vehicle)
        if braked:
            single[k.WORK_AIR, i] += shoes * sliding * moved
        k._position(i, 0.005, single[k.V, i], single)
    assert whole[: k.SPEED_AFTER].tobytes() == single[: k.SPEED_AFTER].tobytes()
    assert (single[k.V, 0] > 0.0) == (slowest == 19.0)


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="names of the instructions of x86")
@pytest.mark.parametrize(
    "name",
    ["_linear", "_clip", "_smoothed", "_speeds", "_braked_speeds", "_held_speeds", "_cylinders", "_slide_protection"],
)
def test_loops_over_vehicles_are_vectorised(name: str) -> None:
    """Breaks if a loop takes one vehicle at a time, or stores under a mask, which takes twice as long on some CPUs."""
    # Reasons are for example an index with a sign, more than 128 pairs of rows to compare, a conditional store.
    a = train(heavy()).arrays
    couplers = (a.state[k.X], a.state[k.V], a.state, a.vehicle, a.gear)
    arguments: dict[str, tuple[Any, ...]] = {
        "_clip": (1, 105, True, *couplers), "_speeds": (0.005, a.state, a.vehicle),
        "_braked_speeds": (0.005, a.state, a.vehicle), "_held_speeds": (0.005, 1.0, a.state, a.vehicle),
        "_cylinders": (a.state, a.vehicle, a.setting), "_slide_protection": (a.state, a.vehicle, True),
    }  # fmt: skip
    fresh = njit(error_model="numpy")(getattr(k, name).py_func)  # the cache keeps no instructions
    fresh(*arguments.get(name, (1, 105, *couplers)))
    (instructions,) = fresh.inspect_asm().values()
    assert re.search(r"\sv?(mul|add|sub)pd\s", instructions)
    assert "maskmov" not in instructions


WIND = {"kind": "turbulence", "acceleration_rms": 0.01}
CASES: dict[str, dict[str, Any]] = {
    "released": {},
    "mass": {"mismatch": {"mass_scale": 1.1}, "lag": 0.4},
    "wind": {"disturbances": [WIND, {"kind": "eq40", "vehicles": [0, 3, 7]}], "adhesion": {"kind": "curtius_kniffler"}},
    "cubes": {"disturbances": [{"kind": "eq40", "vehicles": [0, 2], "speed_power": 3, "scale": 0.01}]},
    "jump": {"jumps": [{"at": 2.05, "what": "mass", "factor": 1.1, "vehicles": [3]}]},
    "parting": {"jumps": [{"at": 1.0, "what": "coupler", "vehicles": [4]}]},
}


def plant(name: str, pipe_pa: float | None = None) -> Train:
    """Return a short train of a case after its first tick, optionally with a demand of the brake pipe."""
    start = {"position_km": 20.15, "speed_kmh": 40}
    made = train(heavy(wagons=9), load_line("daqin_section"), start=start, **CASES[name])
    made.advance(np.zeros((made.substeps, 1)), pipe_pa)
    return made


def demands(ticks: int) -> Array:
    """Return commands [N] of shape (ticks, substeps, 1) with traction and electric brake."""
    return (400e3 * np.sin(np.arange(ticks * 20) * 2e-3)).reshape(ticks, 20, 1)


@pytest.mark.parametrize("pipe_pa", [None, 550e3], ids=["released", "braked"])
def test_batch_has_the_bits_of_single_ticks(pipe_pa: float | None) -> None:
    """Breaks if a jump, wave, disturbance or the end of their block is lost between two compiled calls."""
    single = [plant(name, pipe_pa) for name in CASES]
    batch = [plant(name, pipe_pa) for name in CASES]
    commands = [demands(90 + 7 * number) for number in range(len(CASES))]
    for one, demand in zip(single, commands, strict=True):
        for due in demand:
            one.advance(due)
    advance_trains(batch, commands, threads=2)
    for name, one, other in zip(CASES, single, batch, strict=True):
        assert one.stamp == other.stamp, name
        for part in ("state", "gear", "unit", "setting"):
            assert getattr(one.arrays, part).tobytes() == getattr(other.arrays, part).tobytes(), (name, part)
        np.testing.assert_array_equal(one.outside_force, other.outside_force)
        one.advance(demands(1)[0])
        other.advance(demands(1)[0])
        assert one.arrays.state.tobytes() == other.arrays.state.tobytes(), name


def test_quiet_ticks_are_one_call() -> None:
    """Breaks if quiet ticks are integrated one by one, which holds the lock of the interpreter."""
    quiet = plant("released")
    assert quiet.is_quiet and quiet.advance_quiet(demands(50)) == 50 and quiet.stamp == 51 * TICK_NS
    assert not any(busy.is_quiet for busy in (plant("released", 550e3), plant("jump"), plant("cubes")))


@pytest.mark.skipif(not hasattr(k.advance_ticks, "targetoptions"), reason="without compiler")
def test_compiled_ticks_release_the_lock_of_the_interpreter() -> None:
    """Breaks if threads wait for each other: another thread then sees the train at the begin and at the end only."""
    moving, long = plant("released"), demands(50_000)
    moving.advance_quiet(demands(2))  # compiled or loaded from the cache
    worker = threading.Thread(target=moving.advance_quiet, args=(long,))
    positions = {float(moving.arrays.state[k.X, 0])}
    worker.start()
    while worker.is_alive():
        positions.add(float(moving.arrays.state[k.X, 0]))
    assert len(positions) > 3


def test_batch_is_checked_before_the_first_step() -> None:
    """Breaks if a bad demand of the last train is found after the others have moved."""
    trains, good = [plant("released"), plant("mass")], demands(3)
    for bad, text in (
        ([good], "2 trains have 1 demands"),
        ([good, good[:, :5]], r"demand of train 1 has the shape \(3, 5, 1\)"),
        ([good, np.full_like(good, np.nan)], "demand of train 1 is not finite"),
    ):
        with pytest.raises(ValueError, match=text):
            advance_trains(trains, bad)
    with pytest.raises(ValueError, match="listed twice"):
        advance_trains([trains[0], trains[0]], [good, good])
    assert trains[0].stamp == TICK_NS
