"""Braking curves of the shipped trains against emergency-brake runs of the plant."""

import json
from typing import Any

import numpy as np
import pytest

from plant_sim import kernel as k
from plant_sim.library import load_consist, load_line
from plant_sim.line import SCHEMA, AdhesionSection, Line
from plant_sim.plant_setup import PlantSetup
from plant_sim.traction import Envelope
from plant_sim.train import Train
from train_ato.cli.main import main
from train_ato.supervision.odometry import MotionEstimate
from train_ato.supervision.plant_line import grades_permille, highest_limit, line_supervision
from train_ato.supervision.track_supervision import ceiling

STEP_NS, TICK_NS = 5_000_000, 100_000_000
LAG: dict[str, Any] = {"lag": 0.4}
RUNS: list[tuple[str, str, dict[str, Any], float, float, tuple[float, ...]]] = [
    # consist, line, plant, maximum speed [km/h], end of authority [m], speeds [km/h]
    ("hxd1_c80_105", "level", LAG, 80, 30e3, (10, 40, 80)),
    ("hxd1_c80_105", "daqin_section", LAG, 80, 22.5e3, (20, 50, 80)),
    ("hxd1_c80_210", "daqin_section", LAG, 80, 36e3, (40, 80)),
    ("xuzhou_metro_3", "xuzhou_metro_test", LAG | {"grade_over_length": True}, 80, 4e3, (20, 80)),
    ("crh380a_three_units", "highspeed_286km", LAG, 350, 60e3, (100, 300)),
    ("crh380a_one_mass", "highspeed_286km", {}, 350, 100e3, (200, 350)),
    ("freight_five", "level", LAG | {"reversing": True}, 80, 10e3, (4, 30, 80)),
    ("xuzhou_metro_3", "level", LAG | {"adhesion": {"kind": "constant", "coefficient": 0.08}}, 80, 4e3, (20, 80)),
    ("freight_five", "level", LAG | {"rate_limit_kn_per_s": 20}, 80, 10e3, (30, 80)),
]


def plant_at(consist: Any, line: Any, plant: dict[str, Any], front: float, speed: float) -> Train:
    """Return a train with its front at a position [m] and a speed [m/s]."""
    start = {"position": front - consist.vehicles[0].length / 2, "speed": speed}
    return Train(consist, line, PlantSetup.model_validate(plant | {"start": start}), step_ns=STEP_NS, tick_ns=TICK_NS)


def acceleration(train: Train, force: float) -> float:
    """Return the mean acceleration of a train over one tick with a part of its traction [m/s²]."""
    before = train.momentum
    demand = [force * max(train.consist.vehicles[i].traction[0].force, 1.0) for i in train.units]
    train.advance(np.tile(demand, (train.substeps, 1)))
    return (train.momentum - before) / float(train.arrays.vehicle[k.MASS].sum()) / (TICK_NS * 1e-9)


def emergency_stop(train: Train) -> float:
    """Apply the emergency brake until standstill; return the final position of the front [m]."""
    train.apply_emergency_brake()
    while np.abs(train.velocity).max() > 0.02:
        train.advance(np.zeros((train.substeps, len(train.units))))
        assert train.time < 900
    return float(train.position[0]) + train.consist.vehicles[0].length / 2


@pytest.mark.parametrize(
    ("consist_name", "line_name", "plant", "top", "end", "kmh"), [(*row[:5], kmh) for row in RUNS for kmh in row[5]]
)
def test_emergency_brake_on_the_intervention_curve_stops_before_the_location(
    consist_name: str, line_name: str, plant: dict[str, Any], top: float, end: float, kmh: float
) -> None:
    """Breaks if the model brakes harder or earlier than the plant, or a gradient is not part of the curve."""
    # The train coasts, and its own acceleration enters the curve as the estimated one.
    consist, line, speed = load_consist(consist_name), load_line(line_name), kmh / 3.6
    limits = line_supervision(consist, line, PlantSetup.model_validate(plant), end, max_speed=top / 3.6).targets[-1]
    front = limits.emergency(speed)
    for _ in range(3):  # the acceleration depends on the position, and this on the acceleration
        coasting = acceleration(plant_at(consist, line, plant, front, speed), 0.0)
        front = limits.emergency(speed, MotionEstimate(coasting))
    stop = emergency_stop(plant_at(consist, line, plant, front, speed))
    assert front < stop < end
    # the step of the model loses up to half the distance of the build-up, and leaves out the running resistance
    build_up = speed * limits.train.brake.emergency_time.to_standstill
    assert end - stop < 0.5 * build_up + 0.2 * (end - front), "the curve is far longer than the brake needs"


def test_traction_at_the_intervention_is_covered_by_the_estimated_acceleration() -> None:
    """Breaks if the traction that fades with the lag of the actuators is not part of the traction time."""
    consist, line = load_consist("xuzhou_metro_3"), load_line("level")
    limits = line_supervision(consist, line, PlantSetup.model_validate(LAG), 10e3, max_speed=80 / 3.6).targets[-1]
    train = plant_at(consist, line, LAG, 0.0, 5.0)
    for _ in range(30):
        driving = acceleration(train, 1.0)
    assert driving > 0.9
    begin = float(train.position[0]) + consist.length / 2
    needed = 10e3 - limits.emergency(float(train.velocity[0]), MotionEstimate(driving))
    stopping = emergency_stop(train) - begin
    assert 0.9 * needed < stopping < needed


@pytest.mark.parametrize("name", ["hxd1_c80_105", "hxd1_c80_210", "crh380a_eight_cars"])
def test_deceleration_is_never_above_that_of_the_full_brakes(name: str) -> None:
    """Breaks if a speed step is above the smallest force inside it or far below, or electric brakes are in the EBD."""
    consist, setup = load_consist(name), PlantSetup.model_validate(LAG)
    brake = line_supervision(consist, load_line("level"), setup, 30e3, max_speed=100 / 3.6).train.brake
    mass = sum(vehicle.mass * vehicle.rotating_mass_factor for vehicle in consist.vehicles)
    for kmh in np.linspace(0.0, 107.0, 215):
        factor = (2 * kmh + 150) / (3 * kmh + 150)
        force = sum(v.shoes.standstill_force * factor for v in consist.vehicles if v.shoes is not None)
        service = sum(Envelope(v.brake).force(kmh / 3.6) for v in consist.vehicles)
        if consist.air_brake is None:
            force = 1.2 * mass * factor
        else:
            service += consist.air_brake.braking_factor[-1] * force
        assert 0.9 * force / mass < brake.safe.at(kmh / 3.6) <= force / mass * (1 + 1e-12)
        if brake.service is not None:
            assert brake.service.at(kmh / 3.6) <= service / mass * (1 + 1e-12)


def test_propagation_wave_and_filling_are_in_the_build_up_time() -> None:
    """Breaks if the wave time, the cylinder time or the two sources of the longer train are not used."""
    setup, line = PlantSetup.model_validate(LAG), load_line("level")
    one = line_supervision(load_consist("hxd1_c80_105"), line, setup, 30e3).train.brake
    two = line_supervision(load_consist("hxd1_c80_210"), line, setup, 30e3).train.brake
    # 105 wagons behind the locomotive: the middle one is 661.6 m behind its centre, 200 m/s and 4 s
    middle = 4.0 + (35.222 + 12) / 2 / 200 + 52 * 12 / 200
    assert one.emergency_time.to_standstill == pytest.approx(middle, rel=0.015)
    assert two.emergency_time.to_standstill < one.emergency_time.to_standstill
    slow = load_consist("hxd1_c80_105").model_copy(
        update={"air_brake": load_consist("hxd1_c80_105").air_brake.model_copy(update={"apply_wave": 100.0})}  # type: ignore[union-attr]
    )
    later = line_supervision(slow, line, setup, 30e3).train.brake.emergency_time.to_standstill
    assert later - one.emergency_time.to_standstill == pytest.approx(52 * 12 / 200, rel=0.06)


def test_times_and_curve_of_the_brakes() -> None:
    """Breaks if a reaction time is missing or shortens a time, or a default of the service brake is exchanged."""
    consist, line, setup = load_consist("xuzhou_metro_3"), load_line("level"), PlantSetup.model_validate(LAG)
    at_once, later = (line_supervision(consist, line, setup, 4e3, reaction=time).train for time in (0.0, 0.75))
    for name in ("emergency_time", "service_time"):
        before, after = getattr(at_once.brake, name), getattr(later.brake, name)
        assert after.to_standstill - before.to_standstill == pytest.approx(0.75)
        assert after.to_speed - before.to_speed == pytest.approx(0.75)
    assert later.t_traction_cut_off - at_once.t_traction_cut_off == pytest.approx(0.75)
    plain = line_supervision(consist, line, setup, 4e3)
    assert plain.train.brake.service is not None and plain.without_service_curve is None
    assert plain.train.service_command is False
    assert line_supervision(consist, line, setup, 4e3, service_brake=True).train.service_command is True
    alone = line_supervision(consist, line, setup, 4e3, service_curve=False)
    assert alone.train.brake.service is None and alone.without_service_curve is not None
    assert alone.train.brake.emergency_time == plain.train.brake.emergency_time


def test_line_gives_its_limits_and_grades_to_the_supervision() -> None:
    """Breaks if a limit or a grade of the line is lost, or the end of authority appears without a target."""
    consist, setup = load_consist("freight_five"), PlantSetup.model_validate(LAG)
    grades = [{"at": 0, "grade": 0.004}, {"at": 900, "grade": -0.009}, {"at": 5000, "grade": 0.02}]
    limits = [{"at": 0, "speed": 15.0}, {"at": 2000, "speed": 20.0}, {"at": 4000, "speed": 10.0}]
    entries = {"name": "short", "begin": 0, "end": 5000, "grades": grades, "speed_limits": limits}
    line = Line.model_validate({"schema": SCHEMA, **entries})
    assert grades_permille(line) == [(0.0, 4.0), (900.0, -9.0), (5000.0, 0.0)]
    assert highest_limit(line) == 20.0 and highest_limit(load_line("level")) == 80 / 3.6
    track = line_supervision(consist, line, setup, None)
    assert track.train.max_speed == 20.0
    targets = [(entry.target.location, entry.target.speed) for entry in track.targets]
    assert targets == [(0.0, 15.0), (4000.0, 10.0)], "a train before the line has the maximum speed"
    permitted = [ceiling(track.records.ceilings, place, place).permitted for place in (1000.0, 3000.0, 4500.0)]
    assert permitted == [15.0, 20.0, 10.0]
    dry, wet = (line_supervision(consist, line, setup, 3000.0, kdry=kdry).targets for kdry in (1.0, 0.8))
    assert [entry.target.location for entry in dry] == [0.0, 3000.0]
    assert dry[-1].target.kind == "EOA" and wet[-1].emergency(10.0) < dry[-1].emergency(10.0)


@pytest.mark.parametrize("factors", [(0.5, 0.8, 1.5), (1.5,)])
@pytest.mark.parametrize(
    ("adhesion", "lowered"),
    [
        ({"kind": "constant", "coefficient": 0.16}, {"kind": "constant", "coefficient": 0.08}),
        ({"kind": "curtius_kniffler", "factor": 0.7}, {"kind": "curtius_kniffler", "factor": 0.35}),
        (None, {"kind": "curtius_kniffler", "factor": 0.5}),
    ],
)
def test_the_curves_have_the_lowest_adhesion_of_the_line(
    factors: tuple[float, ...], adhesion: dict[str, Any] | None, lowered: dict[str, Any]
) -> None:
    """Breaks if sections raise the adhesion, another than the lowest counts, or dry rail has no limit."""
    metro, level = load_consist("xuzhou_metro_3"), load_line("level")
    strong = metro.emergency_brake.model_copy(update={"deceleration": 3.0})  # more than dry rails permit
    consist = metro.model_copy(update={"emergency_brake": strong})
    sections = tuple(AdhesionSection(begin=1e3 * k, end=1e3 * k + 500, factor=f) for k, f in enumerate(factors))
    line = level.model_copy(update={"adhesion": sections})
    if factors == (1.5,):
        lowered = adhesion or {"kind": "curtius_kniffler"}
    speeds = []
    for place, limit in ((line, adhesion), (level, lowered), (level, None)):
        setup = PlantSetup.model_validate(LAG | {"adhesion": limit})
        limits = line_supervision(consist, place, setup, 4e3, max_speed=80 / 3.6).targets[-1]
        speeds.append([limits.emergency(speed) for speed in (2.0, 10.0, 20.0)])
    assert speeds[0] == speeds[1]
    assert all(limited < free - 1.0 for limited, free in zip(speeds[0][1:], speeds[2][1:], strict=True))


def test_command_for_a_scenario(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the scenario's train, line or options do not reach the curves."""
    assert main(["curves", "demo", "--at-km", "22.5", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["inputs"]["length_m"] == pytest.approx(1295.222)
    assert len(found["inputs"]["A_brake_emergency"]) == 7
    exact = {row[0]: row[1] for row in found["curves"]["EBI"]}
    assert main(["curves", "demo", "--at-km", "22.5", "--json", "--balise-m", "500", "--acceleration", "0.05"]) == 0
    wide = {row[0]: row[1] for row in json.loads(capsys.readouterr().out)["curves"]["EBI"]}
    assert all(wide[speed] > exact[speed] + 30.0 for speed in exact)
