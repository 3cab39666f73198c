"""Power units: envelopes, limits, lag, rate, dead band, faults, adhesion; and jumps of parameters."""

from typing import Any

import numpy as np
import pytest
from plant_trains import RIGID, drive, heavy, plain_line, slope, train

from plant_sim import kernel as k
from plant_sim.consist import Consist
from plant_sim.input_error import build_model
from plant_sim.library import load_consist
from plant_sim.plant_setup import PlantSetup
from plant_sim.track import Track
from plant_sim.train import Train

LEVEL = plain_line(begin_km=-10)


def locomotive(speed_kmh: float, **setup: Any) -> Train:
    """Return a train of one HXD1 with a tick of one step of 1 ms."""
    setup = {"start": {"speed_kmh": speed_kmh}, **setup}
    return train(heavy(wagons=0), LEVEL, step_ns=1_000_000, tick_ns=1_000_000, **setup)


def applied(speed_kmh: float, demand: float, **setup: Any) -> float:
    """Return the force applied in the first step [N]."""
    return float(drive(locomotive(speed_kmh, **setup), 0.001, demand).applied[0])


@pytest.mark.parametrize(("speed", "traction", "brake"), [
    (0.0, 760, 0), (3.0, 760, 276.6), (4.99, 760, 460.1), (5.01, 760.0, 461), (40.0, 627, 461), (64.9, 532.4, 461),
    (75.1, 460.2, 460.2), (100.0, 345.6, 345.6), (121.0, 0, 0),
])  # fmt: skip
def test_envelopes_of_the_hxd1(speed: float, traction: float, brake: float) -> None:
    """Eqs. (1) and (2) of paper 000 at the ends of the segments, by hand in kN; 0 beyond 120 km/h."""
    assert applied(speed, 1e6) == pytest.approx(1e3 * traction, rel=1e-3)
    assert applied(speed, -1e6) == pytest.approx(-1e3 * brake, rel=1e-3, abs=1.0)


def test_first_order_lag_is_exact() -> None:
    """A step of 100 kN through a lag of 0.4 s is 1 - exp(-t/0.4) at any plant step; a lag of 0 has no effect."""
    for step_ns in (1_000_000, 20_000_000):
        plant = train(heavy(wagons=0), LEVEL, step_ns=step_ns, tick_ns=20_000_000, start={"speed_kmh": 30}, lag=0.4)
        drive(plant, 0.4, 100e3)
        assert plant.applied[0] == pytest.approx(100e3 * (1 - np.exp(-1.0)), rel=1e-9)
    assert applied(30.0, 100e3) == 100e3


def test_rate_limit_dead_band_and_gain() -> None:
    """50 kN/s gives 5 kN after 0.1 s; 900 N in a dead band of 1 kN give 0; a gain of 0.8 gives 0.8."""
    plant = drive(locomotive(30.0, rate_limit_kn_per_s=50), 0.1, 100e3)
    assert plant.applied[0] == pytest.approx(5e3, rel=1e-9)
    assert applied(30.0, 900.0, dead_band_kn=1) == 0.0
    assert applied(30.0, 1100.0, dead_band_kn=1) == 1100.0
    assert applied(30.0, 100e3, mismatch={"actuator_gain": 0.8}) == pytest.approx(80e3)


def test_force_limit_is_shared() -> None:
    """200 kN on a train of three units is 75, 50 and 75 kN; on one mass 200 kN; time at the limit is counted."""
    single = drive(train(load_consist("crh380a_one_mass"), LEVEL, force_limit_kn=200), 1.0, 230e3)
    assert single.applied[0] == 200e3
    moving = {"speed_kmh": 30}
    three = drive(train(load_consist("crh380a_three_units"), LEVEL, force_limit_kn=200, start=moving), 0.3, 90e3)
    assert three.applied == pytest.approx([75e3, 50e3, 75e3])
    drive(three, 0.7, 10e3)
    assert three.totals.saturated == pytest.approx([0.3, 0.3, 0.3])
    assert three.totals.saturated_any == pytest.approx(0.3)
    free = drive(train(load_consist("crh380a_one_mass"), LEVEL), 1.0, 230e3)
    assert free.totals.saturated_any == 0.0


def test_adhesion() -> None:
    """A coefficient of 0.2 on 184 t limits to 361 kN; Curtius-Kniffler at 40 km/h gives 0.161 + 7.5/84 = 0.2503."""
    assert applied(40.0, 1e6, adhesion={"kind": "constant", "coefficient": 0.2}) == pytest.approx(0.2 * 184e3 * 9.81)
    by_speed = {"kind": "curtius_kniffler", "factor": 0.7}
    assert applied(40.0, 1e6, adhesion=by_speed) == pytest.approx(0.7 * (0.161 + 7.5 / 84) * 184e3 * 9.81)
    assert applied(40.0, -1e6, adhesion={"kind": "constant", "coefficient": 0.1}) == pytest.approx(-0.1 * 184e3 * 9.81)


def test_unlimited_and_reversing() -> None:
    """The ideal actuator has no limit; with reversing a negative force drives backwards (paper 002)."""
    assert applied(100.0, 1e7, ideal_actuator=True) == 1e7
    freight = load_consist("freight_five")
    back = drive(train(freight, LEVEL, reversing=True, holding_brake_ratio=0.0), 5.0, -30e3)
    assert back.velocity.max() < -1.0
    stays = drive(train(freight, LEVEL, holding_brake_ratio=0.0), 5.0, -30e3)
    assert not stays.velocity.any()
    assert back.totals.traction > 0.0


def test_lag_per_unit() -> None:
    """One lag per unit; a wrong number of lags is rejected."""
    plant = drive(train(load_consist("crh380a_three_units"), LEVEL, lag=[0.0, 0.4, 0.8]), 0.4, 50e3)
    assert plant.applied == pytest.approx([50e3, 50e3 * (1 - np.exp(-1)), 50e3 * (1 - np.exp(-0.5))], rel=1e-6)
    with pytest.raises(ValueError, match="lag has 2 entries"):
        train(load_consist("crh380a_three_units"), LEVEL, lag=[0.1, 0.2])
    for lag in (-0.1, 601.0):
        with pytest.raises(ValueError, match=f"lag {lag:g} s: give 0 to 600 s"):
            train(load_consist("crh380a_three_units"), LEVEL, lag=[0.1, lag, 0.2])


def test_mismatch_changes_the_plant() -> None:
    """Mass, resistance, envelopes, shoes and gears of the plant are scaled, each by its own factor."""
    scales = {"mass_scale": 1.03, "resistance_scale": 1.5, "traction_scale": 0.9, "brake_scale": 0.92}
    other = {"kind": "linear", "stiffness": 3e7}
    true = train(heavy(), mismatch={**scales, "electric_brake_scale": 0.5, "gears": {"mt2_mt2": other}})
    nominal = train(heavy())
    ratio = true.arrays.vehicle / np.where(nominal.arrays.vehicle == 0, 1, nominal.arrays.vehicle)
    assert ratio[k.MASS] == pytest.approx(1.03)
    assert ratio[k.C0] == pytest.approx(1.03 * 1.5)
    assert ratio[k.SHOE] == pytest.approx(0.92)
    assert drive(true, 0.1, 1e6).applied[0] == pytest.approx(0.9 * 760e3)
    assert [entry[2] for entry in true.arrays.run] == [k.SMOOTHED, k.LINEAR]
    alias = train(heavy(), mismatch={"gears": {"mt2_mt2": "qkx100_mt2"}})
    assert [entry[2] for entry in alias.arrays.run] == [k.SMOOTHED]
    with pytest.raises(ValueError, match="draft gear 'nosuch'"):
        train(heavy(), mismatch={"gears": {"nosuch": other}})


def test_rotating_mass() -> None:
    """Rotating masses change the inertia only: 192.17 kN accelerate the metro at 1.0 m/s² less its resistance."""
    dry, metro = 0.11e-3 * 181292.5 * 9.8, load_consist("xuzhou_metro_3")
    for where, demand, force in ((LEVEL, 1e6, 192.17e3), (slope(-20), 0.0, 0.02 * 181292.5 * 9.8)):
        plant = train(metro, where, step_ns=1_000_000, tick_ns=1_000_000, holding_brake_ratio=0.0)
        speed = drive(plant, 0.001, demand).velocity[0]
        assert speed / 1e-3 == pytest.approx((force - dry) / 192170.05, rel=1e-6)


@pytest.mark.parametrize(("what", "factor", "change"), [("mass", 2.0, 0.5), ("gain", 0.5, 0.5), ("adhesion", 0.5, 0.5)])
def test_jumps_in_time_act_at_their_step(what: str, factor: float, change: float) -> None:
    """A jump at 0.53 s, inside a tick, changes the acceleration from that step on and not before."""
    data = heavy(wagons=0).model_dump(by_alias=True, exclude_none=True)
    data["vehicle_types"]["hxd1"]["resistance"] = {"n": (0, 0, 0)}
    setup = {"jumps": [{"at": 0.53, "what": what, "factor": factor}], "start": {"speed_kmh": 10}}
    if what == "adhesion":
        setup["adhesion"] = {"kind": "constant", "coefficient": 0.05}
    plant = train(Consist.model_validate(data), LEVEL, **setup)
    force = 200e3 if what == "adhesion" else 50e3
    drive(plant, 1.0, force)
    first = (0.05 * 184e3 * 9.81 if what == "adhesion" else force) / 184e3
    gained = first * 0.53 + change * first * 0.47
    assert plant.velocity[0] - 10 / 3.6 == pytest.approx(gained, rel=1e-9)
    assert abs(plant.totals.balance) < 1e-3


def test_jump_at_a_place_and_of_lag() -> None:
    """A jump at 10 m of vehicle 0; a doubled lag; effects on the listed vehicles only."""
    jumps = [{"place": 10.0, "what": "mass", "factor": 1.5, "vehicles": [3]}]
    plant = train(heavy(RIGID, 5), LEVEL, jumps=jumps, start={"speed_kmh": 36})
    mass = plant.arrays.vehicle[k.MASS].copy()
    drive(plant, 0.9)
    assert (plant.arrays.vehicle[k.MASS] == mass).all()
    drive(plant, 0.4)
    assert plant.arrays.vehicle[k.MASS, 3] == 1.5 * mass[3]
    assert plant.arrays.vehicle[k.MASS, 2] == mass[2]
    slow = locomotive(30.0, lag=0.2, jumps=[{"at": 0.0, "what": "lag", "factor": 2.0}])
    assert drive(slow, 0.4, 1e5).applied[0] == pytest.approx(1e5 * (1 - np.exp(-1.0)), rel=1e-9)


@pytest.mark.parametrize("place", [300.0, 1000.0, 2222.0])
def test_grade_under_every_vehicle_of_its_own(place: float) -> None:
    """The work of the grade is weight times height for every vehicle, also over breaks and backwards."""
    # Within 0.4 mm of height: the work uses the mean speed of a step, the position the new one.
    grades = [{"at": at, "grade_permille": g} for at, g in ((0, 2), (250, -7.5), (700, 11), (1500, 0.5), (1600, -3))]
    line = plain_line(begin_km=-3, grades=grades)
    plant = train(
        heavy({"kind": "linear", "stiffness": 2e7, "damping": 1e6}, 8), line, start={"position": place, "speed": 8}
    )
    track, start = Track(line), plant.position
    for force in (0.0, -3e5):
        drive(plant, 20.0, force)
        height = track.elevation(plant.position) - track.elevation(start)
        wanted = -float((plant.arrays.vehicle[k.WEIGHT] * height).sum())
        assert plant.totals.grade == pytest.approx(wanted, abs=4e-4 * float(plant.arrays.vehicle[k.WEIGHT].sum()))


def test_grade_averaged_over_the_length() -> None:
    """For a train as one mass: force = weight (h(front) - h(rear)) / length."""
    line = plain_line(
        begin_km=-3,
        grades=[{"at": 300, "grade_permille": 8}, {"at": 340, "grade_permille": -20}, {"at": 700, "grade_permille": 0}],
        curves=[{"begin": 320, "end": 420, "radius": 400}],
    )
    track = Track(line)
    plant = train(load_consist("xuzhou_metro_3"), line, grade_over_length=True, start={"position": 200, "speed": 15})
    weight = plant.arrays.vehicle[k.WEIGHT, 0]
    for _ in range(300):
        drive(plant, 0.1, 2e4)
        x = plant.position
        slope_here = (track.elevation(x + 59) - track.elevation(x - 59)) / 118
        a, b = plant.arrays.state[[k.GRADE_A, k.GRADE_B], 0]
        assert a + b * x[0] == pytest.approx(-weight * slope_here[0], abs=1e-6 * weight)
    inside = train(load_consist("xuzhou_metro_3"), line, grade_over_length=True, start={"position": 370, "speed": 1})
    assert inside.arrays.state[k.CURVE, 0] == pytest.approx(weight * 0.6 / 400 * 100 / 118, rel=0.03)


def test_curve_and_tunnel_resistance() -> None:
    """600/R N/kN in curves and the value of the tunnel, at the position of each vehicle; 0 elsewhere."""
    line = plain_line(
        curves=[{"begin": 100, "end": 200, "radius": 300}],
        tunnels=[{"begin": 150, "end": 300, "resistance_n_per_kn": 0.5}],
    )
    for place, wanted in ((50, 0.0), (120, 2.0), (170, 2.5), (250, 0.5), (350, 0.0)):
        plant = train(heavy(wagons=0), line, start={"position": place})
        assert plant.arrays.state[k.CURVE, 0] == pytest.approx(wanted * 184 * 9.81, abs=1e-9)


def test_a_jump_of_mass_changes_adhesion_but_not_air_resistance() -> None:
    """Half the mass halves the adhesion limit; a resistance in N does not change."""
    data = heavy(wagons=0).model_dump(by_alias=True, exclude_none=True)
    rails = {"kind": "constant", "coefficient": 0.05}
    for form, stays in (({"n": (900, 20, 5)}, True), ({"n_per_kg": (0.01, 1e-3, 1e-4)}, False)):
        data["vehicle_types"]["hxd1"]["resistance"] = form
        jumps = [{"at": 0.5, "what": "mass", "factor": 0.5}]
        plant = train(Consist.model_validate(data), LEVEL, adhesion=rails, jumps=jumps, start={"speed_kmh": 20})
        before = plant.arrays.vehicle[[k.C0, k.C1, k.C2], 0].copy()
        assert drive(plant, 0.4, 1e6).applied[0] == pytest.approx(0.05 * 184e3 * 9.81)
        assert drive(plant, 0.4, 1e6).applied[0] == pytest.approx(0.05 * 92e3 * 9.81)
        after = plant.arrays.vehicle[[k.C0, k.C1, k.C2], 0]
        assert after == pytest.approx(before if stays else before / 2)


@pytest.mark.parametrize(
    ("setup", "says"),
    [
        ({"jumps": [{"at": 1, "what": "mass", "factor": 2, "units": [0]}]}, "list vehicles"),
        ({"jumps": [{"at": 1, "what": "gain", "factor": 2, "vehicles": [0]}]}, "list units"),
        ({"jumps": [{"at": 1, "what": "lag", "factor": 2}]}, "give a lag"),
        ({"jumps": [{"at": 1, "what": "adhesion", "factor": 0.5}]}, "give an adhesion"),
        ({"jumps": [{"at": 1, "what": "mass", "factor": 1.1, "vehicles": [9]}]}, r"jumps lists .* not in the train"),
        ({"jumps": [{"at": 1, "what": "gain", "factor": 1.1, "units": [1]}]}, r"jumps lists .* not in the train"),
        ({"sensors": {"freeze": [{"begin": 5, "end": 2}]}}, "end 2 s must be after begin 5 s"),
        ({"sensors": {"wheel_slip": [{"begin": 5, "end": 9, "slip": -5}]}}, "greater than or equal to -1"),
    ],
)
def test_a_fault_that_would_do_nothing_is_refused(setup: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        train(heavy(wagons=3), **build_model(PlantSetup, setup, "plant").model_dump(exclude_unset=True))
