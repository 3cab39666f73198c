"""Foreign lines and trains in scenarios, TTOBench trains, and conversion."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from engine_runs import setup_of
from plant_trains import plain_line, train
from refusals import one_line
from test_brought_lines import LINKS, ORE, RAIL_STOCK_2, TABLE, gpx, track
from test_networks import RAIL_2
from test_readers import BENCH, PATH, TRAIN

from plant_sim.consist import Consist
from plant_sim.formats.fields import keys_not_carried
from plant_sim.formats.osrd_stock import osrd_stock_json, osrd_train
from plant_sim.formats.ttobench import ttobench_train
from plant_sim.formats.writing import own_yaml
from plant_sim.input_error import build_model
from plant_sim.library import load_consist, load_line
from plant_sim.traction import Envelope
from train_ato.cli.main import main
from train_ato.profile.planner.planner import plan_profile
from train_ato.profile.planner.settings import find_train
from train_ato.profile.planner.train_tables import TrainTables


def quantity(value: float, unit: str) -> dict[str, Any]:
    return {"unit": unit, "value": value}


UNIT_TRAIN: dict[str, Any] = {
    "metadata": {"id": "hand", "library version": "TTOBench v1.5", "license": "none"},
    "num seats": quantity(100, "-"),
    "length": quantity(74, "m"),
    "mass": quantity(122, "t"),
    "rho": quantity(10, "%"),
    "max traction power": quantity(2.6, "MW"),
    "max reg braking power": quantity(2600, "kW"),
    "max traction force": quantity(200, "kN"),
    "max reg braking force": quantity(100, "kN"),
    "max pn braking force": quantity(80, "kN"),
    "max deceleration": quantity(1.0, "m/s^2"),
    "max speed": quantity(160, "km/h"),
    "rolling resistance r0": quantity(2.4, "kN"),
    "rolling resistance r1": quantity(0.017, "kN/(km/h)"),
    "rolling resistance r2": quantity(12.0, "N/(m/s)^2"),
    "efficiency traction": quantity(90, "%"),
    "efficiency reg brake": quantity(0.8, "-"),
    "tunnel resistance": {
        "units": {"cross section": "m^2", "coefficient": "kg/m"}, "values": [[24, 15.16], [40, 7.23]],
    },
}  # fmt: skip
"""Train in the layout 1.5 of TTOBench."""
TUNNELS = {"units": {"position": "km", "length": "m", "cross section": "m^2"}, "values": [[1.0, 500, 32], [2.0, 0, 32]]}


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """Return a folder with a foreign train and line of each kind."""
    (tmp_path / "unit.json").write_text(json.dumps(UNIT_TRAIN))
    (tmp_path / "bench.json").write_text(json.dumps(BENCH | {"tunnels": TUNNELS, "altitude": quantity(5, "m")}))
    (tmp_path / "train.yaml").write_text(yaml.safe_dump(TRAIN))
    (tmp_path / "path.yaml").write_text(yaml.safe_dump(PATH))
    for name, data in (("stock.json", STOCK), ("ore.yaml", ORE), ("net.yaml", [{}, LINKS])):
        (tmp_path / name).write_text(json.dumps(data))
    (tmp_path / "line.csv").write_text(TABLE)
    (tmp_path / "stock.railml").write_text(RAIL_STOCK_2)
    (tmp_path / "net.railml").write_text(RAIL_2)
    (tmp_path / "way.gpx").write_text(gpx(track(), {"A": track()[0], "B": track()[-1]}))
    return tmp_path


def test_a_bench_train_by_hand() -> None:
    """Breaks if a unit, the rotating masses, the hyperbola, the pneumatic part or its bound is read wrongly."""
    read = ttobench_train(UNIT_TRAIN, "hand.json")
    vehicle = read.vehicles[0]
    assert (read.mass, read.length, vehicle.inertia) == pytest.approx((122e3, 74, 134.2e3))
    assert vehicle.resistance.polynomial(122e3, 9.81) == pytest.approx((2400, 61.2, 12.0))
    traction, brake = Envelope(vehicle.traction), Envelope(vehicle.brake)
    assert [traction.force(v) for v in (1, 13, 26, 45)] == pytest.approx([200e3, 200e3, 100e3, 0])
    assert [brake.force(v) for v in (1, 26, 40)] == pytest.approx([180e3, 180e3, 80e3 + 2.6e6 / 40])
    strong = ttobench_train(UNIT_TRAIN | {"max pn braking force": quantity(1220, "kN")}, "hand.json")
    assert Envelope(strong.vehicles[0].brake).largest() == pytest.approx(134.2e3 + 0.05 * 9.81 * 122e3)
    limits = read.plan_limits
    assert (limits.deceleration, limits.acceleration, limits.speed) == (1.0, None, pytest.approx(160 / 3.6))
    assert (limits.traction_efficiency, limits.recovery_efficiency) == pytest.approx((0.9, 0.8))
    assert Envelope(vehicle.electric_brake).force(1.0) == 100e3
    assert [vehicle.tunnel_coefficient(area) for area in (10, 24, 32, 99)] == pytest.approx(
        [15.16, 15.16, 11.195, 7.23]
    )
    assert strong.emergency_brake.deceleration == 0.83


def test_former_layout_and_etcs_data_of_a_bench_train(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if layout 1.4 is refused, an assumed length is silent, or the emergency brake exceeds its data."""
    former = {key: value for key, value in UNIT_TRAIN.items() if key != "length"} | {
        "num coaches": quantity(4, "-"), "tunnel resistance": {
            "unit": "kg/m", "cross section unit": "m^2", "values": [{"cross section": 24, "value": 15}],
        },
        "ETCS braking data": {"T_be": quantity(2.0, "s"), "A_brake_emergency": {
            "units": {"velocity": "km/h", "deceleration": "m/s^2"}, "values": [[0, 1.2], [100, 0.9]],
        }},
    }  # fmt: skip
    consist = ttobench_train(former, "former.json")
    assert consist.length == 100 and "former.json: length is missing; assumed 100 m" in capsys.readouterr().err
    brake = consist.emergency_brake
    assert brake.delay + brake.time_constant == pytest.approx(2.0)
    for kmh, most in ((0, 1.2), (99, 1.2), (100, 0.9), (160, 0.9)):
        assert brake.deceleration * (2 * kmh + 150) / (3 * kmh + 150) <= most * (1 + 1e-12)


def test_a_point_mass_needs_no_length(tmp_path: Path) -> None:
    """Breaks if a point mass needs a length or uses an assumed one, or the efficiencies of the file are lost."""
    file = tmp_path / "unit.json"
    file.write_text(json.dumps({key: value for key, value in UNIT_TRAIN.items() if key != "length"}))
    consist, settings = find_train(str(file), point_mass=True)
    whole = find_train(_written(tmp_path / "whole.json", UNIT_TRAIN), point_mass=True)[0]
    point = settings.model_copy(update={"point_mass": True, "end": 3000.0})
    times = [plan_profile(load_line("xuzhou_metro_test"), train, point).running_time for train in (consist, whole)]
    assert times[0] == times[1]
    settings = find_train(_written(tmp_path / "unit.json", UNIT_TRAIN))[1]
    assert (settings.efficiency, settings.recovered) == pytest.approx((0.9, 0.8))


def test_electric_and_friction_part_of_a_brake() -> None:
    """Breaks if friction counts as regenerated, or a neutral section takes it away or leaves the electric brake."""
    consist = ttobench_train(UNIT_TRAIN, "hand.json")
    made = train(consist, plain_line(), start={"position": 100, "speed": 30}, holding_speed=0.0)
    for _ in range(200):
        made.advance(np.full((made.substeps, 1), -100e3 - 80e3))
    totals = made.totals
    speed, step, work = 30.0, 1e-3, 0.0
    for _ in range(20_000):
        electric = min(100e3, 2.6e6 / speed)
        work += electric * speed * step
        speed -= step * (electric + 80e3 + 2400 + 61.2 * speed + 12 * speed**2) / 134.2e3
        if speed < 0.01:
            break
    assert totals.regenerated == pytest.approx(work, rel=3e-3)
    assert totals.balance == pytest.approx(0.0, abs=1.0)
    _, part, rest = TrainTables(consist, 160 / 3.6).forces_at(np.array([1.0, 26.0, 40.0]))
    assert part == pytest.approx([100e3, 100e3, 65e3]) and rest == pytest.approx([80e3] * 3)
    line = plain_line(neutral_sections=[{"begin": 0, "end": 5000}])
    made = train(consist, line, start={"position": 100, "speed": 40}, holding_speed=0.0)
    for _ in range(20):
        made.advance(np.full((made.substeps, 1), -200e3))
    assert float(made.applied.sum()) == pytest.approx(-80e3, rel=1e-6)
    assert made.totals.regenerated == pytest.approx(0.0, abs=1e-3)


def _written(path: Path, data: dict[str, Any]) -> str:
    path.write_text(json.dumps(data))
    return str(path)


@pytest.mark.parametrize(("consist", "line"), [
    ("unit.json", "bench.json:reverse"), ("train.yaml", "path.yaml"), ("ore.yaml", "net.yaml:1..4"),
    ("stock.json:thermal", "line.csv"), ("stock.json", "way.gpx"), ("stock.railml", "net.railml:West..t2"),
])  # fmt: skip
def test_a_scenario_takes_every_file_that_plan_reads(files: Path, consist: str, line: str) -> None:
    """Breaks if a scenario reads own YAML only, or another line or train than plan; its folder is the base."""
    scenario = {
        "schema": "train_ato/scenario/1", "name": "foreign", "duration": 2, "plant": {"consist": consist, "line": line},
        "profile": {"steps": [{"at": 0, "speed": 0}], "until": 1},
    }  # fmt: skip
    setup = setup_of(_written(files / "s.yaml", scenario))
    assert setup.consist == find_train(str(files / consist))[0] and setup.line == load_line(str(files / line))
    resolved = files / "resolved.yaml"
    resolved.write_text(setup.resolved_yaml())
    again = setup_of(str(resolved))
    assert (again.consist, again.line) == (setup.consist, setup.line)


def test_the_plan_of_a_run_keeps_the_limits_of_its_train(tmp_path: Path) -> None:
    """Breaks if a run exceeds the largest speed of its train, which plan keeps, or a recorded limit is another one."""
    train = load_consist("xuzhou_metro_3").model_dump(mode="json", by_alias=True, exclude_defaults=True)
    limits = {"speed": 12.0, "acceleration": 0.6, "deceleration": 0.4}
    scenario = {
        "schema": "train_ato/scenario/1", "name": "limited", "duration": 2,
        "plant": {"consist": train | {"plan_limits": limits}, "line": "level"},
        "profile": {"plan": {"begin": 1000, "end": 2000, "acceleration": 1.0}},
    }  # fmt: skip
    setup = setup_of(_written(tmp_path / "s.yaml", scenario))
    found = [setup.profile.velocity.max(), setup.profile.acceleration.max(), -setup.profile.acceleration.min()]
    assert found[0] == pytest.approx(12.0) and found[2] == pytest.approx(0.4) and found[1] > 0.61
    (tmp_path / "again.yaml").write_text(setup.resolved_yaml())
    assert setup_of(str(tmp_path / "again.yaml")).profile.velocity.tobytes() == setup.profile.velocity.tobytes()


def test_tunnels_of_a_bench_line_are_read_and_without_train_data_named(files, capsys):
    """Breaks if tunnels are dropped silently, as they were, or a train without figures for them is not named."""
    line = load_line(str(files / "bench.json"))
    assert [(entry.begin, entry.end, entry.cross_section) for entry in line.tunnels] == [(1000, 1500, 32)]
    arguments = ["--from-km", "0", "--to-km", "0.9", "--json"]
    assert main(["plan", str(files / "bench.json"), str(files / "train.yaml"), *arguments]) == 0
    assert "tunnel_resistance" in capsys.readouterr().err
    assert main(["plan", str(files / "bench.json"), str(files / "unit.json"), *arguments]) == 0
    assert "tunnel_resistance" not in capsys.readouterr().err


@pytest.mark.parametrize("name", ["unit.json", "bench.json", "train.yaml", "path.yaml", "path.yaml:reverse"])
def test_convert_keeps_every_value_and_names_the_others(files, name, capsys):
    """Breaks if a value changes on the way to own YAML, or a lost key is not named on stderr."""
    source, target = str(files / name), files / "own.yaml"
    assert main(["convert", source, str(target), "--json"]) == 0
    printed = capsys.readouterr()
    result = json.loads(printed.out)
    if result["kind"] == "train":
        assert load_consist(str(target)) == find_train(source)[0]
    else:
        assert load_line(str(target)) == load_line(source)
    raw = yaml.safe_load((files / name.partition(":")[0]).read_text())
    lost = {"unit.json": "num seats", "bench.json": "altitude", "train.yaml": "vehicles[].name"}.get(
        name, "schema_version"
    )
    assert lost in result["left_out"] or lost not in raw
    assert [row.rpartition(": ")[2] for row in printed.err.splitlines() if row.startswith("not carried")] == result[
        "left_out"
    ]
    assert main(["convert", source, str(target)]) == 2, "an existing file stays"


def test_lines_as_bench_files_are_read_back(tmp_path: Path) -> None:
    """Breaks if a grade, limit, curve or stop of a shipped line moves on the way through TTOBench JSON."""
    for name in ("daqin_section", "xuzhou_metro_test"):
        file = tmp_path / f"{name}.json"
        assert main(["convert", name, str(file)]) == 0
        line, again = load_line(name), load_line(str(file))
        assert [(e.at, pytest.approx(e.grade)) for e in line.grades] == [(e.at, e.grade) for e in again.grades]
        assert [(e.begin, e.end, e.radius) for e in line.curves] == [
            (e.begin, e.end, pytest.approx(e.radius)) for e in again.curves
        ]
        assert [e.speed for e in line.speed_limits] == [e.speed for e in again.speed_limits]


def test_keys_below_carried_ones_need_an_entry_of_their_own() -> None:
    """Breaks if a carried key carries an unknown one below it, or an unknown one in a list is missed or repeated."""
    data = {"stops": {"unit": "m"}, "altitude": 3, "rows": [{"a": [[1]], "b": 2}, {"b": 3}], "none": [], "": {"": 1}}
    assert keys_not_carried(data, ("stops", "rows[].a")) == ("stops.unit", "altitude", "rows[].b", "")
    assert keys_not_carried({"p": {"x": {"at": 1, "by": 2}, "y": 3}}, ("p.*.at",)) == ("p.x.by", "p.y")


def effort(scale: float) -> dict[str, list[float]]:
    return {"speeds": [0.0, 10.0, 25.0, 40.0], "max_efforts": [scale * f for f in (200e3, 200e3, 80e3, 50e3)]}


STOCK: dict[str, Any] = {
    "railjson_version": "3.2", "locked": False, "name": "two_supplies", "mass": 120e3, "length": 75.0,
    "max_speed": 44.0, "startup_time": 10.0, "startup_acceleration": 0.05, "comfort_acceleration": 0.6,
    "inertia_coefficient": 1.1, "const_gamma": 0.7, "loading_gauge": "G1", "base_power_class": "5",
    "power_restrictions": {"C1": "3"}, "metadata": {"series": "own"}, "energy_sources": [],
    "rolling_resistance": {"type": "davis", "A": 2000.0, "B": 30.0, "C": 6.5},
    "effort_curves": {"default_mode": "25000V", "modes": {
        "thermal": {"curves": [], "default_curve": effort(0.5), "is_electric": False},
        "25000V": {"is_electric": True, "default_curve": effort(1.0), "curves": [
            {"cond": {"comfort": "HEATING", "electrical_profile_level": None, "power_restriction_code": "C1"},
             "curve": effort(0.7)},
            {"cond": {"comfort": "HEATING", "electrical_profile_level": None, "power_restriction_code": None},
             "curve": effort(0.9)},
            {"cond": {"comfort": None, "electrical_profile_level": "22500V", "power_restriction_code": None},
             "curve": effort(0.8)},
        ]},
    }},
    "etcs_brake_params": {"gamma_emergency": {"boundaries": [20.0], "values": [1.2, 0.9]}, "t_be": 2.0, "t_bs1": 3.0},
}  # fmt: skip
"""Rolling stock in the layout of OSRD of 2025, with made-up figures."""


@pytest.mark.parametrize(
    ("conditions", "scale", "diesel"),
    [
        ("", 1.0, False),
        ("thermal", 0.5, True),
        ("25000V,comfort=HEATING", 0.9, False),
        ("comfort=HEATING,power_restriction=C1", 0.7, False),
        ("comfort=HEATING,electrical_level=22500V", 0.9, False),  # the first one that holds
        ("electrical_level=22500V,power_restriction=C1", 0.8, False),
    ],
)
def test_an_osrd_train_has_the_curve_of_its_conditions(
    tmp_path: Path, conditions: str, scale: float, diesel: bool
) -> None:
    """Breaks if a condition, the order of the curves, Davis, gamma or the ETCS brake is read wrongly; also in YAML."""
    _written(tmp_path / "stock.json", STOCK)
    assert main(["convert", str(tmp_path / "stock.json"), str(tmp_path / "own.yaml")]) == 0
    for name in ("stock.json", "own.yaml"):
        consist, settings = find_train(f"{tmp_path / name}{':' if conditions else ''}{conditions}")
        vehicle = consist.vehicles[0]
        traction = Envelope(vehicle.traction)
        forces = [traction.force(v) for v in (0.0, 5.0, 17.5, 25.0, 43.0, 44.1)]
        assert forces == pytest.approx([scale * f for f in (200e3, 200e3, 140e3, 80e3, 50e3, 0.0)])
        assert vehicle.independent_power is diesel
        assert vehicle.resistance.polynomial(120e3, 9.81) == (2000.0, 30.0, 6.5) and vehicle.inertia == 132e3
        assert Envelope(vehicle.brake).force(44.0) == pytest.approx(132e3 * 0.7 + 0.05 * 9.81 * 120e3)
        assert (settings.deceleration, settings.acceleration, settings.speed_max) == (0.7, 0.6, 44.0)
        brake = consist.emergency_brake
        assert brake.delay + brake.time_constant == pytest.approx(2.0)
        for kmh, most in ((0, 1.2), (71, 1.2), (72, 0.9), (158, 0.9)):
            assert brake.deceleration * (2 * kmh + 150) / (3 * kmh + 150) <= most * (1 + 1e-12)
    bounded = STOCK | {"gamma": {"type": "MAX", "value": 0.5}, "const_gamma": None}
    assert Envelope(osrd_train(bounded, "x").vehicles[0].brake).largest() == pytest.approx(66e3)


def test_an_osrd_train_goes_back_unchanged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a key of the file is lost on its way through the own file, or has no effect without a word."""
    stock, own, back = tmp_path / "stock.json", tmp_path / "own.yaml", tmp_path / "back.json"
    _written(stock, STOCK)
    assert main(["convert", str(stock), str(own)]) == 0 and main(["convert", str(own), str(back)]) == 0
    assert json.loads(back.read_text()) == STOCK
    assert "startup_time, startup_acceleration: no effect here" in capsys.readouterr().err


def test_a_train_of_several_vehicles_becomes_rolling_stock(tmp_path: Path) -> None:
    """Breaks if mass, Davis or traction of the vehicles are not summed, or a lost key is not named."""
    data = load_consist("hxd1_c80_105").model_dump(by_alias=True, mode="json", exclude_unset=True)
    data |= {"plan_limits": {"deceleration": 0.9, "speed_kmh": 80}}
    text, left_out = osrd_stock_json(build_model(Consist, data, "x"))
    found = json.loads(text)
    consist, again = load_consist("hxd1_c80_105"), osrd_train(found, "back.json")
    assert (again.mass, again.length) == pytest.approx((consist.mass, consist.length))
    whole = [sum(Envelope(v.traction).force(speed) for v in consist.vehicles) for speed in (0.5, 9.0, 14.0, 20.0)]
    traction = Envelope(again.vehicles[0].traction)
    assert [traction.force(speed) for speed in (0.5, 9.0, 14.0, 20.0)] == pytest.approx(whole, rel=1e-3)
    davis = [v.resistance.polynomial(v.mass, consist.gravity) for v in consist.vehicles]
    assert again.vehicles[0].resistance.n == pytest.approx([sum(row) for row in zip(*davis, strict=True)])
    assert any(key.startswith("train: ") for key in left_out) and "draft_gears" in left_out
    assert "added startup_time = 0.0" in left_out
    data["vehicle_types"]["hxd1"] |= {"notches": {"traction": [[{"to": 30.0, "force": 1e5}]]}}
    data["vehicle_types"]["c80"] |= {"traction": [{"to": 1.0, "force": 1.0}], "independent_power": True}
    left_out = osrd_stock_json(build_model(Consist, data | {"gravity": 9.7}, "x"))[1]
    assert "gravity = 9.7 (now 9.81)" in left_out and "vehicle_types.hxd1.notches" in left_out
    assert "vehicle_types: independent_power of some units (now all from the line)" in left_out
    with pytest.raises(ValueError, match=r"plan_limits\.deceleration: this key is missing, and OSRD needs it"):
        osrd_stock_json(consist)


@pytest.mark.parametrize(("train", "change", "message"), [
    (UNIT_TRAIN, {"length": None}, "length: this key is missing"),
    (UNIT_TRAIN, {"mass": quantity(122, "lb")}, "mass: unit = 'lb': must be kg or t"),
    (UNIT_TRAIN, {"max speed": quantity(-1, "km/h")}, "max speed: value in SI = -0.277778: must lie between"),
    (UNIT_TRAIN, {"rho": 10}, "rho: holds 10"),
    (UNIT_TRAIN, {"tunnel resistance": {"units": {}, "values": []}}, "tunnel resistance"),
    (STOCK, {"const_gamma": None}, "const_gamma: this key is missing"),
    (STOCK, {"rolling_resistance": {"type": "other"}}, "type = 'other': only davis is read"),
    (STOCK, {"effort_curves": {"default_mode": "x", "modes": {}}}, "default_mode = 'x': not in modes"),
    (STOCK, {"effort_curves": STOCK["effort_curves"] | {"more": 1}}, "unknown key 'more'"),
    (STOCK, {"etcs_brake_params": {"gamma_emergency": {"boundaries": [1], "values": [1]}}}, "1 boundaries need 2"),
    (STOCK, {"etcs_brake_params": {"gamma_emergency": {"boundaries": [9, 5], "values": [1, 1, 1]}}}, "must rise"),
    (STOCK, {"rolling_resistance": STOCK["rolling_resistance"] | {"D": 1}}, "rolling_resistance: unknown key 'D'"),
    (STOCK, {"gamma": 0.5}, "const_gamma and gamma are the same quantity"),
    (STOCK, {"name": ["a"]}, r"name = \['a'\]: must be one text"),
    (STOCK, {"effort_curves": {"default_mode": "a", "modes": {"a": {"is_electric": "no", "curves": []}}}},
     "true or false"),
])  # fmt: skip
def test_a_faulty_train_is_refused_in_one_line(
    tmp_path: Path, train: dict[str, Any], change: dict[str, Any], message: str
) -> None:
    """Breaks if a fault of a train of TTOBench or OSRD is a traceback, or names neither file nor key."""
    with one_line(message, "fault.json"):
        find_train(_written(tmp_path / "fault.json", train | change))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"mass": 900}, "traction 200000 N for 900 kg; check its unit"),
        ({"max_speed": 160}, "speed 160 m/s is 576 km/h; check its unit"),
        ({"comfort_accelerations": 1}, "kept without effect; did you mean 'comfort_acceleration'?"),
    ],
)
def test_a_doubtful_osrd_train_is_told(tmp_path: Path, change: dict[str, Any], told: str, capsys: Any) -> None:
    """Breaks if a figure in another unit, or a misspelt key, is read without a word."""
    find_train(_written(tmp_path / "doubt.json", STOCK | change))
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("wrong", ["1500V", "comfort=COLD", "speed=3", "25000V,thermal2", "25000V,mode=thermal"])
def test_an_unknown_condition_is_refused(tmp_path: Path, wrong: str) -> None:
    """Breaks if a misspelt supply is taken as the default one."""
    with pytest.raises(ValueError, match=r"not in its effort curves; |mode has two values"):
        find_train(f"{_written(tmp_path / 'stock.json', STOCK)}:{wrong}")


def test_an_envelope_as_points_has_the_forces_between_them(tmp_path: Path) -> None:
    """Breaks if points of speed and force are refused, take a wrong unit, or bend between the points."""
    data = yaml.safe_load(own_yaml(load_consist("xuzhou_metro_3")))
    name, kind = next((name, kind) for name, kind in data["vehicle_types"].items() if kind.get("traction"))
    kind["traction"] = {"speed_kmh": [0, 36, 72], "force_kn": [100, 90, 30]}
    vehicle = build_model(Consist, data, "x").vehicle_types[name]
    forces = [Envelope(vehicle.traction).force(v) for v in (0.0, 5.0, 15.0, 19.99, 20.1)]
    assert forces == pytest.approx([100e3, 95e3, 60e3, 30.06e3, 0.0])
    for points, message in (
        ({"speed": [5, 0], "force": [1.0, 2.0]}, "traction: speeds must rise"),
        ({"speed_kmh": [0], "force": [1.0]}, r"traction: speed_kmh = \[0\]: needs at least 2 entries; add them"),
        ({"speed": [0, 5]}, "traction: force: this key is missing; add it"),
        ({"speeds": [5, 0], "force": [1.0, 2.0]}, "traction: speed"),
    ):
        kind["traction"] = points
        with one_line(message):
            build_model(Consist, data, "x")
