"""Emergency brake: a path of its own beside drives, commands and brake-pipe demands, on every train."""

from typing import Any

import numpy as np
import pytest
from plant_trains import CLIP, LINEAR, RIGID, chain, drive, heavy, train

from plant_sim import kernel as k
from plant_sim.air_brake import ATMOSPHERE
from plant_sim.brake_data import EmergencyBrake
from plant_sim.consist import Consist
from plant_sim.library import consist_names, load_consist
from plant_sim.traction import FullServiceBrake
from plant_sim.train import Train

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
        built = 1.0 - np.exp(-max(t - brake.delay, 0.0) / brake.time_constant)
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


@pytest.mark.parametrize(
    ("name", "kmh"),
    [("xuzhou_metro_3", 80), ("crh380a_one_mass", 300), ("crh380a_one_mass", 350), ("crh380a_three_units", 200),
     ("freight_five", 60)],
)  # fmt: skip
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
    plant = train(load_consist("crh380a_one_mass"), start={"speed": 30.0}, tick_ns=5_000_000)
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
