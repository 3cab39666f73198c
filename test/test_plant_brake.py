"""Air brake by hand and in closed form: waves, cylinders, reservoirs; the emergency brake of every train."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from plant_trains import CLIP, LINEAR, RIGID, chain, drive, heavy, plain_line, train

from plant_sim import kernel as k
from plant_sim.air_brake import ATMOSPHERE, BrakeForecast, PipePressure, PressureChange, braking_factor
from plant_sim.brake_data import EmergencyBrake
from plant_sim.consist import Consist
from plant_sim.library import consist_names, load_consist
from plant_sim.states import Array
from plant_sim.traction import FullServiceBrake
from plant_sim.train import Train

APPLIED, CHARGED = 550e3, 600e3


def fine(consist: Consist | None = None, *pipe: tuple[float, float]) -> Train:
    """Return the heavy train at 70 km/h with a tick of one step of 5 ms, after pipe demands [Pa] and waits [s]."""
    where, start = plain_line(begin_km=-10), {"speed_kmh": 70}
    plant = train(heavy(RIGID) if consist is None else consist, where, tick_ns=5_000_000, start=start)
    for pressure, seconds in pipe:
        plant.advance(np.zeros((1, len(plant.units))), pressure)
        drive(plant, seconds)
    return plant


def arrivals(plant: Train, seconds: float, braking: bool) -> Array:
    """Return the time of the first cylinder motion of every vehicle [s]; NaN without one."""
    first = np.full(plant.n, np.nan)
    begin, none = plant.time, np.zeros((1, 1))
    before = plant.arrays.state[k.CYLINDER, : plant.n].copy()
    for _ in range(round(seconds / 5e-3)):
        t = plant.time - begin
        plant.advance(none)
        after = plant.arrays.state[k.CYLINDER, : plant.n]
        moved = (after > before) if braking else (after < before)
        first[np.isnan(first) & moved] = t
        before = after.copy()
    return first


def test_waves_reach_the_last_vehicle() -> None:
    """Paper 000: 6.36 s at 200 m/s, 35.32 s at 36 m/s over 1271.6 m, to within a step of 5 ms."""
    plant = fine(None, (APPLIED, 0.0))
    applied = arrivals(plant, 7.0, True) + 5e-3
    assert applied[[-1, 1]] == pytest.approx([6.36, 23.611 / 200], abs=0.005 + 1e-9)
    drive(plant, 30.0)
    plant.advance(np.zeros((1, 1)), CHARGED)
    released = arrivals(plant, 36.0, False) + 5e-3
    assert released[[-1, 53]] == pytest.approx([35.32, (23.611 + 52 * 12) / 36], abs=0.005 + 1e-9)


def test_shoe_forces_by_hand() -> None:
    """743 kN on the whole train at 70 km/h and 50 kPa; 4 s to 63 %, 6 s to release 63 %."""
    # One wagon: 0.17 x 8 x 16.18 kN x .481 x (216.18/264.72) x (290/360) = 6.962 kN.
    plant = fine(None, (APPLIED, 4.0))
    assert plant.arrays.state[k.CYLINDER, 0] == pytest.approx(0.17 * (1 - np.exp(-1.0)), rel=2e-3)
    drive(plant, 60.0)
    plant.arrays.state[k.V] = 70 / 3.6
    shoe = drive(plant, 0.005).shoe_force
    assert (shoe.sum(), shoe[50]) == (pytest.approx(743e3, rel=1e-3), pytest.approx(6.962e3, rel=1e-3))
    plant.advance(np.zeros((1, 1)), CHARGED)
    assert drive(plant, 6.0).arrays.state[k.CYLINDER, 0] == pytest.approx(0.17 * np.exp(-1.0), rel=2e-3)


def test_a_new_application_cancels_a_propagating_release() -> None:
    """The newest event counts: released at 60 s, applied again at 70 s, neither rear nor tail of the pipe release."""
    plant = fine(None, (APPLIED, 60.0), (CHARGED, 10.0))
    front, rear = plant.arrays.state[k.CYLINDER, [0, 105]]
    assert front < 0.04
    plant.advance(np.zeros((1, 1)), APPLIED)
    for _ in range(40):
        for _ in range(200):
            drive(plant, 0.005)
            assert plant.arrays.state[k.CYLINDER, 105] >= rear, "the overtaken release still reached the last wagon"
        assert pressures(plant)[1] == APPLIED
    assert pressures(plant)[0] == APPLIED
    assert plant.arrays.state[k.CYLINDER, 0] > 0.16


def test_factor_table_and_pressure() -> None:
    """Half the reduction gives half the factor; constant beyond the table."""
    brake = load_consist("hxd1_c80_105").air_brake
    assert brake is not None
    assert (braking_factor(brake, 575e3), braking_factor(brake, 500e3)) == (pytest.approx(0.085), 0.17)
    np.testing.assert_allclose(fine(None, (575e3, 60.0)).arrays.state[k.CYLINDER, :106], 0.085, rtol=1e-3)


def pressures(plant: Train) -> tuple[float, float]:
    """Return the brake-pipe pressure at head and tail [Pa]."""
    seen = plant.observe()
    assert seen.brake_pipe is not None and seen.brake_pipe_tail is not None
    return seen.brake_pipe.pressure, seen.brake_pipe_tail.pressure


def test_pipe_pressure_falls_and_rises_as_in_a_pipe() -> None:
    """Breaks if the pressure steps within a tick, or the tail changes before the wave (6.36 s, 35.32 s) is there."""
    plant = fine()
    assert pressures(plant) == (CHARGED, CHARGED)
    plant.advance(np.zeros((1, 1)), APPLIED)
    assert pressures(drive(plant, 1.995)) == (pytest.approx(APPLIED + 50e3 * np.exp(-2.0 / 2.0)), CHARGED)
    tail = APPLIED + 50e3 * np.exp(-(8.0 - 1271.611 / 200) / 2.0)
    assert pressures(drive(plant, 6.0))[1] == pytest.approx(tail)
    assert pressures(drive(plant, 60.0)) == (APPLIED, APPLIED)
    plant.advance(np.zeros((1, 1)), CHARGED)
    assert pressures(drive(plant, 35.0)) == (pytest.approx(CHARGED - 50e3 * np.exp(-35.005 / 6.0)), APPLIED)
    assert pressures(drive(plant, 100.0)) == (CHARGED, CHARGED)


def test_pressure_does_not_depend_on_the_reading_times() -> None:
    """Breaks if waves between two readings are lost, or taken in the order of their numbers."""
    brake = load_consist("hxd1_c80_105").air_brake
    assert brake is not None
    ways = np.full((k.PARTED_DISTANCE + 1, 1), 1200.0)
    changes = [(0.0, APPLIED, 200.0), (60.0, CHARGED, 36.0), (70.0, 530e3, 200.0)]
    new = [PressureChange(*change, 0, vents=False) for change in changes]
    often, once = (PipePressure(brake, ways, (0,), new.copy()) for _ in range(2))
    for time in np.arange(0.0, 100.0, 0.1):
        read = often.at(float(time))
    assert read == pytest.approx(once.at(99.9), abs=2.0)
    assert read == pytest.approx((530e3,), abs=2.0)


def test_second_locomotive_vents_the_pipe_too() -> None:
    """With a second locomotive in the middle the wave starts at both, so the longest distance is half the train."""
    plant = fine(load_consist("hxd1_c80_210"), (APPLIED, 7.0))
    distance = plant.arrays.vehicle[k.PIPE_DISTANCE]
    assert distance[[0, 105, 106, 211]] == pytest.approx([0.0, 23.611, 0.0, 1271.611])
    assert plant.arrays.state[k.CYLINDER, :212].min() > 0.0


def with_brake(**changes: Any) -> Consist:
    data = heavy(RIGID).model_dump(by_alias=True, exclude_none=True)
    data["air_brake"].update(changes)
    return Consist.model_validate(data)


def test_reservoirs_are_used_up_and_recharge() -> None:
    """A second application soon after the first has less air, one after the recharge time not. Off by default."""
    reached = {}
    for wait in (5.0, 600.0):
        plant = train(with_brake(reservoir_use=0.4, recharge_time=60.0), start={"speed_kmh": 70})
        drive(plant, 40.0, 0.0, APPLIED)
        assert plant.arrays.state[k.TARGET, 50] == pytest.approx(0.17)
        drive(plant, 40.0 + wait, 0.0, CHARGED)
        drive(plant, 40.0, 0.0, APPLIED)
        reached[wait] = plant.arrays.state[k.TARGET, 0]
    assert reached[600.0] == pytest.approx(0.17, rel=1e-3)
    expected = 0.17 * (1.0 - 0.4 * np.exp(-45.0 / 60.0))
    assert reached[5.0] == pytest.approx(expected, rel=2e-3)
    plant = train(heavy(RIGID), start={"speed_kmh": 70})
    for pipe in (APPLIED, CHARGED) * 3:
        drive(plant, 2.0, 0.0, pipe)
    assert (plant.arrays.state[k.RESERVOIR, :106] == 1.0).all()


@settings(max_examples=20)
@given(
    gaps=st.lists(st.floats(0.1, 50.0), min_size=1, max_size=6),
    levels=st.lists(st.sampled_from([600e3, 590e3, 575e3, 550e3]), min_size=6, max_size=6),
    ahead=st.floats(0.0, 60.0),
    use=st.sampled_from([0.0, 0.4, 0.9]),
)
@example(gaps=[40.0, 50.0, 40.0, 5.0, 9.0], levels=[550e3, 600e3, 575e3, 550e3, 600e3, 550e3], ahead=50.0, use=0.9)
def test_forecast_equals_the_kernel(gaps: list[float], levels: list[float], ahead: float, use: float) -> None:
    """The closed form equals the kernel at any later time, also with waves that overtake each other and air used up."""
    consist = with_brake(apply_wave=200.0, reservoir_use=use, recharge_time=30.0)
    plant = train(consist, plain_line(begin_km=-10), tick_ns=20_000_000, start={"speed_kmh": 70})
    forecast = BrakeForecast(consist)
    for gap, level in zip(gaps, levels, strict=False):
        forecast.demand(plant.time, level)
        drive(plant, 0.02, 0.0, level)
        drive(plant, 0.02 * round(gap / 0.02))
    later = plant.time + 0.02 * round(ahead / 0.02)
    expected = forecast.factors(later)
    forecast.commit(plant.time)
    np.testing.assert_allclose(forecast.factors(later), expected, atol=1e-12)
    drive(plant, later - plant.time)
    # Waves are noticed at the next step of 5 ms: at most 5 ms / 4 s of the level.
    np.testing.assert_allclose(plant.arrays.state[k.CYLINDER, :106], expected, atol=0.17 * 5e-3 / 4.0 * 2)


def test_forecast_force_and_rest() -> None:
    """The forecast is the 743 kN by hand, idle after a release, and rejected without an air brake."""
    forecast = BrakeForecast(load_consist("hxd1_c80_105"))
    assert forecast.idle
    forecast.demand(0.0, APPLIED)
    assert forecast.forces(100.0, 70 / 3.6).sum() == pytest.approx(743e3, rel=1e-3)
    assert forecast.forces(0.0, 70 / 3.6).sum() == 0.0
    forecast.demand(100.0, CHARGED)
    forecast.commit(300.0)
    assert forecast.idle
    with pytest.raises(ValueError, match="no air brake"):
        BrakeForecast(load_consist("xuzhou_metro_3"))


def test_many_propagating_events() -> None:
    """A new pressure in every tick makes hundreds of waves; all are kept and the last one counts."""
    plant = train(heavy(RIGID), plain_line(begin_km=-10), start={"speed_kmh": 70})
    for pipe in (*(600e3 - 250.0 * np.arange(200)), *(550e3 + 250.0 * np.arange(1, 201))):
        drive(plant, 0.1, 0.0, float(pipe))
    assert not drive(plant, 120.0).shoe_force.any()


def test_air_brake_needs_shoes_to_act() -> None:
    """Vehicles without shoes are not braked; a train without air brake has no cylinder message."""
    plant = drive(train(chain(3, RIGID), start={"speed": 5.0}), 1.0)
    seen = plant.observe()
    assert seen.brake_pipe is None
    assert seen.brake_shoes is None
    assert not plant.shoe_force.any()


HALF = with_brake(
    reservoir_use=0.5, recharge_time=600.0, reduction=(0.0, 50e3, 100e3, 170e3), braking_factor=(0, 0.17, 0.34, 0.6)
)
MOST = with_brake(reservoir_use=0.8, recharge_time=60.0, reduction=(0.0, 100e3, 170e3), braking_factor=(0, 0.34, 0.6))


@pytest.mark.parametrize(("consist", "reductions_kpa", "level"), [
    (HALF, [170], 0.6), (HALF, [50, 100, 170], 0.6), (HALF, [50, 60], 0.204), (HALF, [170, 100], 0.34),
    (MOST, [170, 100, 170], 0.34 + (1.0 - 0.8) / (0.8 / 0.6)), (MOST, [170, 100, 170, 100, 170], 0.34),
])  # fmt: skip
def test_each_rise_uses_its_part_of_the_supply(consist: Consist, reductions_kpa: list[float], level: float) -> None:
    """Breaks if the supply is scaled by the first step (28 % less), or rises without a release find air for ever."""
    plant = train(consist, plain_line(begin_km=-10), start={"speed_kmh": 100})
    for reduction in reductions_kpa:
        drive(plant, 20.0, 0.0, CHARGED - 1e3 * reduction)
    assert plant.arrays.state[k.TARGET, 5] == pytest.approx(level)


@pytest.mark.parametrize("electric", [0.0, 20e3])
def test_rails_limit_the_shoes(electric: float) -> None:
    """Shoe forces are limited by adhesion times weight, less the electric brake of a locomotive."""
    # Empty wagons of 20 t at 70 km/h: shoes of 30 kN, adhesion limit 3.9 kN.
    data = heavy(wagons=10).model_dump(by_alias=True, exclude_none=True)
    data["vehicle_types"]["c80"]["mass"] = 20e3
    data["air_brake"]["braking_factor"] = (0, 0.6)

    def braked(rails: dict[str, Any], force: float) -> Train:
        light, where, start = Consist.model_validate(data), plain_line(begin_km=-10), {"speed_kmh": 70}
        return drive(train(light, where, adhesion=rails, start=start), 15.0, force, APPLIED)

    plant = braked({"kind": "constant", "coefficient": 0.02}, -electric)
    assert plant.shoe_force[1:] == pytest.approx(np.full(10, 0.02 * 20e3 * 9.81))
    assert plant.shoe_force[0] == pytest.approx(0.02 * 184e3 * 9.81 - electric)
    plant = braked({"kind": "curtius_kniffler", "factor": 0.2}, 0.0)
    rail = 0.2 * (0.161 + 7.5 / (3.6 * plant.velocity[3] + 44.0)) * 20e3 * 9.81
    assert plant.shoe_force[3] == pytest.approx(rail, rel=1e-3)


def test_a_fall_of_adhesion_reaches_the_shoes() -> None:
    """A jump for all acts on every wagon; one for listed units acts on their vehicles only."""
    for units, expected in ((None, 0.01), ([0], 0.5)):
        jump = {"at": 20.0, "what": "adhesion", "factor": 0.02}
        plant = train(
            heavy(RIGID, 5), plain_line(begin_km=-10), adhesion={"kind": "constant", "coefficient": 0.5},
            jumps=[jump if units is None else {**jump, "units": units}], start={"speed_kmh": 100},
        )  # fmt: skip
        drive(plant, 25.0, 0.0, APPLIED)
        assert plant.arrays.vehicle[k.RAIL, 3] == pytest.approx(expected)
        assert plant.shoe_force[0] <= 0.01 * 184e3 * 9.81 * (1 + 1e-12)


DEAD: dict[str, Any] = {"mismatch": {"traction_scale": 0.0, "electric_brake_scale": 0.0}}
STEP = 5e-3


def emergency_stop(plant: Train) -> float:
    """Apply the emergency brake without a demand of the drives; return the distance to standstill of vehicle 0 [m]."""
    begin = float(plant.position[0])
    plant.apply_emergency_brake()
    while np.abs(plant.velocity).max() > 0.0:
        drive(plant, 0.1)
        assert plant.time < 300.0
    return float(plant.position[0]) - begin


def slowed(brake: EmergencyBrake, consist: Consist, speed: float) -> float:
    """Return the stopping distance [m] of a point mass with the friction emergency brake: own Runge-Kutta of 1 ms."""
    inertia = sum(v.mass * v.rotating_mass_factor for v in consist.vehicles)
    polynomials = [v.resistance.polynomial(v.mass, consist.gravity) for v in consist.vehicles]
    c0, c1, c2 = (sum(p[i] for p in polynomials) / inertia for i in range(3))

    def rate(t: float, v: float) -> float:
        built = 1.0 - math.exp(-max(t - brake.delay, 0.0) / brake.time_constant)
        shoes = (2.0 * 3.6 * v + 150.0) / (3.0 * 3.6 * v + 150.0)
        return float(-(brake.deceleration * built * shoes + c0 + c1 * v + c2 * v * v))

    t, v, x, h = 0.0, speed, 0.0, 1e-3
    while v > 0.0:
        a1 = rate(t, v)
        a2 = rate(t + h / 2, v + h / 2 * a1)
        a3 = rate(t + h / 2, v + h / 2 * a2)
        a4 = rate(t + h, v + h * a3)
        x += h * v + h * h / 6 * (a1 + a2 + a3)
        v += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        t += h
    return x


@pytest.mark.parametrize("name", consist_names())
def test_dead_drives_stop_and_release(name: str) -> None:
    """Breaks if the emergency brake acts through the drives, its work has no account, or it does not release."""
    plant = train(load_consist(name), start={"position": 4000, "speed_kmh": 80}, **DEAD)
    start = plant.kinetic_energy
    emergency_stop(plant)
    totals = plant.totals
    assert totals.regenerated == totals.traction == 0.0 and totals.air_brake < -0.5 * start
    assert abs(totals.balance) < 1e-9 * start and (plant.shoe_force > 0.0).all()
    plant.release_emergency_brake()
    assert not drive(plant, 200.0).shoe_force.any()


def test_a_train_without_a_block_has_the_documented_default() -> None:
    """Breaks if a consist without data for it has no emergency brake, or wagons without drives need one."""
    wagons = chain(3, LINEAR)
    assert wagons.friction_emergency_brake == EmergencyBrake()
    assert EmergencyBrake().deceleration == pytest.approx(0.0075 * 100 + 0.076, abs=0.005)
    assert EmergencyBrake().delay + EmergencyBrake().time_constant == pytest.approx(2.3)
    emergency_stop(train(wagons, start={"position": 100, "speed": 10.0}))


@pytest.mark.parametrize(("name", "kmh"), [
    ("xuzhou_metro_3", 80), ("crh380a_one_mass", 300), ("crh380a_one_mass", 350), ("crh380a_three_units", 200),
    ("freight_five", 60),
])  # fmt: skip
def test_distance_of_an_independent_integration(name: str, kmh: float) -> None:
    """Breaks if delay, build-up, friction over speed, rotating mass or running resistance is wrong or missing."""
    # The bound is the path of one step at the initial speed: the plant applies the force of a step after the position.
    consist = load_consist(name)
    brake = consist.friction_emergency_brake
    assert brake is not None
    stop = emergency_stop(train(consist, start={"position": 4000, "speed_kmh": kmh}, **DEAD))
    assert stop == pytest.approx(slowed(brake, consist, kmh / 3.6), abs=STEP * kmh / 3.6)


def test_figures_in_the_data_files() -> None:
    """Breaks if the stopping distances that the sources of the files give are not those of the brake."""
    fast = emergency_stop(train(load_consist("crh380a_one_mass"), start={"position": 4000, "speed_kmh": 300}))
    assert fast == pytest.approx(3760, rel=0.01)
    metro = emergency_stop(train(load_consist("xuzhou_metro_3"), start={"position": 4000, "speed_kmh": 80}))
    assert (80 / 3.6) ** 2 / (2 * metro) == pytest.approx(1.2, abs=0.05)
    wagons = load_consist("freight_five").friction_emergency_brake
    assert wagons is not None
    assert wagons.deceleration == pytest.approx(0.0075 * 123 + 0.076, abs=0.005)
    assert 1.0 - np.exp(-4.0 / wagons.time_constant) == pytest.approx(0.95, abs=0.005)


def test_vented_shoes_of_a_stop_without_drives() -> None:
    """Breaks if a vented pipe has another level than 1, another wave speed or another cylinder than the air brake."""
    plant = train(heavy(RIGID), start={"position": 4000, "speed_kmh": 80}, tick_ns=5_000_000, **DEAD)
    plant.apply_emergency_brake()
    last = float(plant.arrays.vehicle[k.PIPE_DISTANCE, -1])
    for _ in range(round(12.0 / STEP)):
        plant.advance(np.zeros((1, 1)))
        since = plant.time - STEP - last / 200.0
        level = float(plant.arrays.state[k.CYLINDER, plant.n - 1])
        assert level == pytest.approx(1.0 - np.exp(-max(since, 0.0) / 4.0), abs=2 * STEP / 4.0)


def test_force_begins_after_the_delay_and_fades_without_one() -> None:
    """Breaks if the delay is not that of the data, or acts on the release too, or a waiting application survives it."""
    plant = train(load_consist("crh380a_one_mass"), start={"speed": 30.0})
    plant.apply_emergency_brake()
    drive(plant, 0.5)
    plant.release_emergency_brake()
    assert not drive(plant, 5.0).shoe_force.any()
    plant.apply_emergency_brake()
    assert not drive(plant, 1.0).shoe_force.any()
    assert drive(plant, 0.8).arrays.state[k.CYLINDER, 0] == pytest.approx(1.0 - np.exp(-1.0), abs=0.01)
    plant.release_emergency_brake()
    faded = (1.0 - np.exp(-1.0)) * np.exp(-1.0)
    assert drive(plant, 1.0).arrays.state[k.CYLINDER, 0] == pytest.approx(faded, abs=0.01)


def test_brake_fade_and_rails_limit_the_emergency_brake() -> None:
    """Breaks if mismatch, a jump of brake or the adhesion does not reach the friction emergency brake."""
    start = {"position": 100, "speed_kmh": 80}
    metro = load_consist("xuzhou_metro_3")
    full = emergency_stop(train(metro, start=start))
    weak = emergency_stop(train(metro, start=start, mismatch={"brake_scale": 0.5}))
    faded = emergency_stop(train(metro, start=start, jumps=[{"at": 0.2, "what": "brake", "factor": 0.5}]))
    assert weak == pytest.approx(faded)
    assert weak > 1.7 * full
    plant = train(metro, start=start, adhesion={"kind": "constant", "coefficient": 0.05})
    plant.apply_emergency_brake()
    drive(plant, 5.0)
    assert plant.shoe_force[0] == pytest.approx(0.05 * 181292.5 * 9.8)


def test_a_demand_has_no_effect_on_a_vented_pipe() -> None:
    """Breaks if a demand closes the vent, or the pipe does not follow the last demand after the release."""
    plant = train(heavy(CLIP, wagons=20), start={"speed_kmh": 70})
    plant.apply_emergency_brake()
    drive(plant, 5.0, 0.0, 600e3)
    drive(plant, 25.0, 0.0, 570e3)
    assert plant.observe().brake_pipe.pressure == ATMOSPHERE  # type: ignore[union-attr]
    assert plant.arrays.state[k.CYLINDER, : plant.n].min() > 0.99
    plant.release_emergency_brake()
    drive(plant, 120.0)
    assert plant.observe().brake_pipe.pressure == 570e3  # type: ignore[union-attr]
    np.testing.assert_allclose(plant.arrays.state[k.CYLINDER, : plant.n], 0.17 * 30 / 50, rtol=1e-4)
    drive(plant, 120.0, 0.0, 600e3)
    assert not plant.shoe_force.any()


@pytest.mark.parametrize("name", ["xuzhou_metro_3", "hxd1_c80_105", "freight_five"])
def test_a_run_without_application_is_unchanged_bit_by_bit(name: str) -> None:
    """Breaks if the data of the emergency brake, or a release without application, changes any number of a run."""
    consist = other = load_consist(name)
    if consist.air_brake is None:
        strong = EmergencyBrake(deceleration=3.0, delay=0.1, time_constant=0.1, release_time=0.1)
        other = consist.model_copy(update={"emergency_brake": strong})
    one, released = (train(made, start={"position": 4000, "speed_kmh": 30}, lag=0.4) for made in (consist, other))
    released.release_emergency_brake()
    for plant in (one, released):
        drive(drive(plant, 20.0, 30e3), 20.0, -30e3)
    for row in ("state", "unit", "gear"):
        np.testing.assert_array_equal(getattr(one.arrays, row), getattr(released.arrays, row))


def test_a_second_application_changes_nothing() -> None:
    """Breaks if a repeated application starts the build-up again."""
    runs = [train(load_consist("freight_five"), start={"position": 4000, "speed_kmh": 60}) for _ in range(2)]
    for tick in range(40):
        for plant in runs[: 2 if tick == 0 else 1]:
            plant.apply_emergency_brake()
        for plant in runs:
            drive(plant, 0.1)
    np.testing.assert_array_equal(runs[0].velocity, runs[1].velocity)


def test_one_emergency_brake_per_train() -> None:
    """Breaks if a consist may declare both a brake pipe and a friction emergency brake."""
    data = heavy(RIGID).model_dump(by_alias=True, exclude_none=True)
    data["emergency_brake"] = {"deceleration": 1.0}
    with pytest.raises(ValueError, match="emergency_brake: the vented pipe of air_brake"):
        Consist.model_validate(data)


def test_full_service_brake_is_that_of_the_envelopes() -> None:
    """Breaks if the demand of a locomotive exceeds its envelope, or a reversing drive accelerates backwards."""
    locomotive = train(heavy(RIGID))
    assert FullServiceBrake(locomotive.consist, locomotive.setup).demand(np.array([20.0]))[0] == pytest.approx(-461e3)
    plant = train(load_consist("freight_five"), start={"position": 4000, "speed": 15.0}, reversing=True, lag=0.3)
    brake = FullServiceBrake(plant.consist, plant.setup)
    for speed, force in ((20.0, -64e3), (0.1, -80e3 * 0.1), (-0.1, 80e3 * 0.1), (0.01, 0.0)):
        assert (brake.demand(np.full(5, speed)) == force).all()
    wagons = train(chain(2, LINEAR))
    assert FullServiceBrake(wagons.consist, wagons.setup).demand(np.zeros(0)).shape == (0,)


def test_a_service_stop_of_a_reversing_train_never_drives_it_back() -> None:
    """Breaks if the full brake force of a drive that can reverse continues at standstill."""
    plant = train(load_consist("freight_five"), start={"position": 4000, "speed": 15.0}, reversing=True, lag=0.1)
    brake, units = FullServiceBrake(plant.consist, plant.setup), list(plant.units)
    lowest = min(float(drive(plant, 0.1, brake.demand(plant.velocity[units])).velocity.min()) for _ in range(600))
    assert np.abs(plant.velocity).max() < 1e-3 and lowest > -0.05
