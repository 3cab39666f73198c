"""Readers of other formats: their rules, and one line for every fault of a file."""

import copy
import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from refusals import one_line

from plant_sim.data_text import TextDumper, parse_yaml
from plant_sim.formats import railtoolkit, ttobench
from plant_sim.input_error import build_model
from plant_sim.library import load_consist, load_line, named_line, named_train
from plant_sim.line import Line
from train_ato.profile.planner.settings import find_train
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.scenario_data import scenario_line

TRAIN: dict[str, Any] = {
    "schema": "https://railtoolkit.org/schema/rolling-stock.json",
    "schema_version": "2022.05",
    "trains": [{"name": "A train", "id": "t", "formation": ["loco", "coach", "coach"]}],
    "vehicles": [
        {
            "name": "Loco", "id": "loco", "vehicle_type": "traction unit", "length": 18, "mass": 80,
            "mass_traction": 60, "speed_limit": 120, "rotation_mass": 1.1, "base_resistance": 2.0,
            "rolling_resistance": 1.0, "air_resistance": 6.0, "tractive_effort": [[0, 200e3], [60, 150e3], [120, 60e3]],
        },
        {
            "name": "Coach", "id": "coach", "vehicle_type": "passenger", "length": 26, "mass": 40, "load_limit": 10,
            "speed_limit": 140, "rotation_mass": 1.05, "base_resistance": 1.5, "rolling_resistance": 0.8,
            "air_resistance": 3.0,
        },
    ],
}  # fmt: skip
PATH: dict[str, Any] = {
    "schema": "https://railtoolkit.org/schema/running-path.json",
    "paths": [{"name": "P", "id": "p", "characteristic_sections": [[0, 100, 0.0], [1000, 80, 5.0], [3000, 80, 0.0]]}],
}
BENCH: dict[str, Any] = {
    "metadata": {"id": "bench"},
    "stops": {"unit": "m", "values": [0.0, 5000.0]},
    "speed limits": {"units": {"position": "m", "velocity": "km/h"}, "values": [[0.0, 90], [2000.0, 60]]},
    "gradients": {"units": {"position": "m", "slope": "permil"}, "values": [[0.0, 2.0], [1000.0, -3.5]]},
    "curvatures": {
        "units": {"position": "m", "radius at start": "m", "radius at end": "m"},
        "values": [[0.0, "infinity", "infinity"], [300.0, 800.0, -500.0], [600.0, 0, 0]],
    },
}


def test_resistance_of_the_published_freight_train(open_data: Path) -> None:
    """At 15 m/s: 5461.127 N (locomotive, with 15 km/h of head wind) and 20900.733 N (wagons, without)."""
    consist = find_train(str(open_data / "freight.yaml"))[0]
    force = []
    for vehicle in consist.vehicles:
        a, b, c = vehicle.resistance.polynomial(vehicle.mass, consist.gravity)
        force.append(a + 15 * b + 225 * c)
    assert force[0] == pytest.approx(5461.127, abs=1e-3)
    assert sum(force[1:]) == pytest.approx(20900.733, abs=1e-3)
    assert consist.mass == pytest.approx(920e3)


def test_rules_by_hand() -> None:
    """Full load, wind on coaches, driven and other axles of the locomotive, rotating masses weighted by mass."""
    consist = railtoolkit.train_from(TRAIN, "hand")
    g = 9.80665
    assert consist.mass == 180e3 and consist.length == 70
    limits = consist.plan_limits
    assert limits is not None and (limits.deceleration, limits.speed) == pytest.approx((0.375, 120 / 3.6))
    rotating = (80 * 1.1 + 2 * 40 * 1.05) / 160
    assert consist.vehicles[0].rotating_mass_factor == pytest.approx(rotating)
    for index, speed, expected in (
        (0, 50 / 3.6, g * (60 * 2.0 + 20 * 1.0 + 80 * 6.0 * 0.65**2)),
        (1, 50 / 3.6, g * 50 * (1.5 + 0.8 * 0.5 + 3.0 * 0.65**2)),
    ):
        vehicle = consist.vehicles[index]
        a, b, c = vehicle.resistance.polynomial(vehicle.mass, g)
        assert a + b * speed + c * speed**2 == pytest.approx(expected, rel=1e-12)
    assert consist.power_units == (0,)


def test_tractive_effort_is_linear_between_its_points() -> None:
    from plant_sim.traction import Envelope

    envelope = Envelope(railtoolkit.train_from(TRAIN, "hand").vehicles[0].traction)
    for kmh, force in ((0, 200e3), (30, 175e3), (60, 150e3), (90, 105e3), (119.9, 60150.0), (125, 0)):
        assert envelope.force(kmh / 3.6) == pytest.approx(force, rel=1e-9)


def test_a_path_becomes_a_line() -> None:
    line = railtoolkit.railtoolkit_line(PATH, "hand")
    assert (line.begin, line.end) == (0, 3000)
    assert [(g.at, g.grade) for g in line.grades] == [(0, 0), (1000, 0.005)]
    assert [limit.speed * 3.6 for limit in line.speed_limits] == pytest.approx([100, 80])


RISING = [[0, 100, 0.0], [4000, 40, 12.0], [6000, 100, 0.0], [10000, 100, 0.0]]
FALLING = [[10000, 100, 0.0], [6000, 40, 12.0], [4000, 100, 0.0], [0, 100, 0.0]]
NAMED = [dict(zip(("position", "speed", "resistance"), row, strict=True)) for row in RISING]


@pytest.mark.parametrize("rows", [FALLING, RISING, NAMED])
def test_falling_kilometres_are_the_same_line(rows: list[Any]) -> None:
    """Breaks if sections of falling kilometres are sorted: the 40 km/h would lie on the next section, turned."""
    line = railtoolkit.railtoolkit_line({"paths": [{"id": "p", "characteristic_sections": rows}]}, "hand")
    assert (line.begin, line.end) == (0, 10000)
    assert [(e.at, e.grade) for e in line.grades] == [(0, 0), (4000, 0.012), (6000, 0)]
    assert [(e.at, round(3.6 * e.speed, 9)) for e in line.speed_limits] == [(0, 100), (4000, 40), (6000, 100)]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"grades": [{"at": 9000, "grade": 0}, {"at": 100, "grade": 0.01}]},
            "distance from 10000 m and keep the order",
        ),
        ({"speed_limits": [{"at": 7, "speed": 9}, {"at": 7, "speed": 8}]}, "two entries at 7 m; keep one"),
        ({"stops": [{"at": 100}, {"at": 900}, {"at": 500}]}, "places must rise in the direction of running"),
        ({"begin_km": 11}, "write distances that rise in the direction of running"),
    ],
)
def test_an_own_line_with_falling_places_gets_a_remedy_that_works(change: dict[str, Any], message: str) -> None:
    """Breaks if sorting is advised, which would move every entry to the neighbouring stretch."""
    with pytest.raises(ValueError, match=message) as caught:
        build_model(Line, {"schema": "train_ato/line/1", "name": "x", "end_km": 10, **change}, "own.yaml")
    assert "sort" not in str(caught.value)


def test_one_of_several_paths_and_trains_is_chosen_by_name(tmp_path: Path) -> None:
    """Breaks if the first path or train is read without a word, or another one cannot be chosen."""
    file, branch = tmp_path / "two: files.yaml", {"id": "b", "characteristic_sections": [[0, 60, 0], [9000, 60, 0]]}
    file.write_text(yaml.safe_dump({"paths": [*PATH["paths"], branch]}))
    assert load_line(f"{file}:b").end == 9000
    assert load_line(f"{file}:b:reverse").end == 9000
    assert load_line(f"{file}:P") == load_line(f"{file}:p")
    for name, message in (("", r"holds 2 \(has p, b\)"), (":c", r"holds none with 'c' \(has p, b\)")):
        with pytest.raises(ValueError, match=rf"paths: {message}; name one as FILE:NAME, for example '.*:p'$"):
            load_line(f"{file}{name}")
    file.write_text(yaml.safe_dump({"paths": [branch, branch | {"name": "b"}]}))
    with pytest.raises(ValueError, match=r"holds 2 with 'b' \(has b, b\); give each an id of its own$"):
        load_line(f"{file}:b")
    file.write_text(yaml.safe_dump(TRAIN | {"trains": [*TRAIN["trains"], {"name": "B", "formation": ["loco"]}]}))
    assert (len(find_train(f"{file}:B")[0].vehicles), len(load_consist(f"{file}:t").vehicles)) == (1, 3)
    with pytest.raises(ValueError, match=r"trains: holds 2 \(has t, B\); name one as FILE:NAME"):
        find_train(str(file))
    assert load_consist(f"{file}:B").source.endswith("two: files.yaml")


def test_a_section_without_speed_or_resistance_has_that_before_it(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the schema 2024.07, where only one of both is required, is refused, or a missing value is 0."""
    rows: list[dict[str, float]] = [
        {"position": 0, "speed": 80, "resistance": 1}, {"position": 100, "resistance": 8},
        {"position": 300, "speed": 50}, {"position": 500},
    ]  # fmt: skip

    def line() -> Line:
        return railtoolkit.railtoolkit_line({"paths": [{"id": "p", "characteristic_sections": rows}]}, "hand")

    assert [round(3.6 * e.speed, 9) for e in line().speed_limits] == [80, 80, 50]
    assert [e.grade for e in line().grades] == [0.001, 0.008, 0.008]
    assert "a section without speed or resistance has that of the section before" in capsys.readouterr().err
    rows[0] = {"position": 0, "resistance": 1}
    assert [round(3.6 * e.speed, 9) for e in line().speed_limits] == [50, 50, 50], "the lowest one"
    rows[0] = {"position": 0, "speed": 80}
    with pytest.raises(ValueError, match="no resistance in the first section; add resistance"):
        line()
    rows[0] = {"position": 0}
    with pytest.raises(ValueError, match=r"sections\[0\]: it has neither speed nor resistance"):
        line()


@pytest.mark.parametrize(("name", "text", "line", "train"), [
    ("a.gpx", "<gpx/>", "0 tracks", r"holds a line \(GPX\), no train"),
    ("a.csv", "time_s,speed_kmh\n0,1\n", "unknown column 'time_s'", r"holds a line \(table\), no train"),
    ("a.xlsx", "PK\x03", r"a table \(Excel\) is not read", ""),
    ("a.yaml", "- {offset_meters: 0, elev_meters: 3}\n", "a list of heights of ALTRIOS is not read", ""),
    ("a.yaml", "- {offset: 0, top: 3}\n", "holds a list of entries with offset, top", ""),
    ("a.yaml", "network: [{idx_next: 2}]\n", "no supported line format", "no supported train format"),
    ("a.yaml", "loco_vec: []\n", "consist of ALTRIOS is not read; a train is read from train_ato YAML", ""),
    ("a.json", '{"effort_curves": {}}', r"holds a train \(OSRD\), no line", None),
    ("a.railml", '<railML version="3.2"><rollingstock/></railML>', r"train \(railML\), no line", "0 formations"),
    ("a.yaml", "60\n", "holds one number in place of keys and values", ""),
    ("a.yaml", "", "is empty", ""),
    ("a.yaml", "<gpx/>", "XML is read as railML, in a file that ends in .railml or .xml, and as GPX in .gpx", ""),
    ("a.yaml", yaml.safe_dump(TRAIN), r"holds a train \(railtoolkit\), no line; exchange them", None),
    ("a.yaml", "schema: train_ato/consist/1\n", r"holds a train \(train_ato\), no line; exchange them", None),
    ("a.yaml", yaml.safe_dump(PATH), None, r"holds a line \(railtoolkit\), no train; exchange them"),
    ("a.json", '{"track_sections": []}', None, r"holds a line \(OSRD\), no train; exchange them"),
    ("a.railml", '<railML version="3.2"><infrastructure/></railML>', None, r"a line \(railML\), no train"),
    ("a.yaml", "x: 1\n", "no supported line format .*train_ato/line/1", "no supported train format.*consist/1"),
])  # fmt: skip
def test_a_file_of_another_kind_is_named(tmp_path, name, text, line, train):
    """Breaks if a file of another kind is called a 'str', or the remedy does not help; an empty message is the same."""
    (tmp_path / name).write_text(text)
    for message, read in ((line, load_line), (line if train == "" else train, find_train)):
        if message:
            with one_line(message, name):
                read(str(tmp_path / name))


def test_a_stretch_without_a_limit_is_on_the_safe_side(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a train is not limited before the first limit of a file, without a word."""
    late = BENCH | {"speed limits": BENCH["speed limits"] | {"values": [[700.0, 90], [2000.0, 60]]}}
    line = ttobench.ttobench_line(late, "late.json")
    assert [(e.at, round(3.6 * e.speed, 9)) for e in line.speed_limits] == [(0, 60), (700, 90), (2000, 60)]
    own = tmp_path / "late.yaml"
    own.write_text("{schema: train_ato/line/1, name: y, end_km: 2, speed_limits: [{at: 300, speed: 20}]}")
    load_line(str(own))
    printed = capsys.readouterr().err
    assert "late.json: no speed limit from 0 to 700 m; assumed 60 km/h there, its lowest one" in printed
    assert "speed_limits: none from 0 to 300 m; only the train limits the speed there" in printed


def test_traps_of_an_own_line_are_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if 300 m/s or a grade beyond the end is taken without a word, or a colon in a name hides the file."""
    file = tmp_path / "km 12:300.yaml"
    text = "{schema: train_ato/line/1, name: y, end_km: 12, speed_limits: [{at: 0, speed: 300}], grades: [{at_km: 12,"
    file.write_text(f"{text} grade: 0.01}}, {{at_km: 13, grade: 0}}]}}")
    assert load_line(f"{file}:reverse").end == 12_000
    printed = capsys.readouterr().err
    assert "speed_limits[0]: speed 300 is 1080 km/h; write speed_kmh for km/h" in printed
    assert "grades[1]: 13000 m lies beyond the end of the line, 12000 m" in printed and "grades[0]" not in printed


@pytest.mark.parametrize(("what", "path", "value", "message"), [
    ("bench", ("gradients", "values", 1, 0), 14e3, "grades[1]: 14000 m lies beyond the end of the line, 5000 m"),
    ("bench", ("speed limits", "values", 1, 1), 900, "speed_limits[1]: speed 250 is 900 km/h; check its unit"),
    ("path", ("paths", 0, "characteristic_sections", 1, 2), 400, "grades[1]: grade 0.4 is 400 per mille"),
    ("own", ("grades",), [{"at": 0, "grade_permille": 0.012}], "the steepest is 0.012 per mille; check its unit"),
    ("own", ("stops",), [{"at": -50}], "stops[0]: -50 m lies before the begin of the line, 0 m"),
    ("own", ("neutral_sections",), [{"begin": -9, "end": -3}], "neutral_sections[0]: -9 m lies before the begin"),
    ("own", ("adhesion",), [{"begin": 9, "end": 4000, "factor": 0.5}],
     "adhesion[0]: its end 4000 m lies beyond the end of the line, 3000 m"),
    ("own", ("tunnels",), [{"begin": 9, "end": 4000, "cross_section": 40}], "tunnels[0]: its end 4000 m lies"),
    ("own", ("coordinates",), [{"at": at, "latitude": 48.1, "longitude": 11.5} for at in (0, 4000)],
     "coordinates[1]: 4000 m lies beyond the end"),
    ("own", ("power_limits",), [{"begin": 9, "end": 20, "power": 800}],
     "power_limits[0].power = 800: usual are 20000 to 500000000 W; check its unit"),
    ("own", ("curves",), [{"begin": 0, "end": 9, "radius_km": 300}], "curves[0].radius = 300000: usual are 10 to"),
    ("own", ("curves",), [{"begin": 0, "end": 9, "radius": 300}, {"begin": 5, "end": 20, "radius": 400}],
     "curves: two from 5 to 9 m; their resistances add"),
    ("own", ("speed_limits",), [{"at": 0, "speed": 80}], "speed 80 is 288 km/h; write speed_kmh for km/h"),
    ("bench", ("curvatures", "values"), [[300.0, 100, 100]], "6.25 m/s² to the side at 300 m, with 90 km/h on a"),
    ("own", ("tunnels",), [{"begin": at, "end": at + 9, "resistance_n_per_kn": 1} for at in (0, 5)],
     "tunnels: two from 5 to 9 m; their resistances add"),
    ("train", ("vehicles", 0, "mass"), 80e3, "loco: mass 80000000 kg on 18 m; check its unit"),
    ("train", ("vehicles", 0, "tractive_effort"), [[0, 200], [120, 60]], "traction 199.58 N for 180000 kg"),
    ("consist", ("vehicle_types", "car", "length"), 20e3, "car: mass 40000 kg on 20000 m; check its unit"),
    ("consist", ("vehicle_types", "car", "rotating_mass_factor"), 8, "car: rotating_mass_factor 8; check its unit"),
    ("consist", ("vehicle_types", "car", "traction", 0, "force_kn"), 50e3, "traction 50000000 N for 40000 kg"),
    ("consist", ("vehicle_types", "car", "traction", 1, "power_kw"), 625e3, "traction power 625000000 W for"),
    ("consist", ("vehicle_types", "car", "traction", 1, "power_kw"), 0.625, "from 50000 N to 50 N at 12.5 m/s"),
    ("consist", ("vehicle_types", "car", "brake"), [{"to": 9, "force": 5e4}, {"to": 99, "force": 50}],
     "car: brake changes from 50000 N to 50 N at 9 m/s"),
    ("consist", ("vehicle_types", "car", "resistance", "n"), [0.7, 0.02, 0.002],
     "running resistance 1.9 N at 72 km/h for 40000 kg"),
    ("consist", ("vehicle_types", "car", "brake", 0, "force_kn"), 60e3, "brake 60000000 N for 40000 kg"),
    ("consist", ("vehicle_types", "car", "shoes"), {"count": 8, "force": 25, "friction": 0.4},
     "vehicle_types.car.shoes.force = 25: usual are 500 to 500000 N"),
    ("consist", ("draft_gears", "rigid"), {"kind": "linear", "stiffness": 20}, "rigid.stiffness = 20: usual are"),
    ("consist", ("draft_gears", "rigid"), {"kind": "linear", "stiffness": 2e7, "damping": 60}, "damping = 60: us"),
    ("consist", ("air_brake",), {"apply_wave": 0.2}, "air_brake.apply_wave = 0.2: usual are 60 to 350 m/s"),
    ("consist", ("air_brake",), {"release_wave": 130}, "air_brake.release_wave = 130: usual are 12 to 120 m/s"),
    ("consist", ("air_brake",), {"release_time": 6000}, "air_brake.release_time = 6000: usual are 0.2 to 120 s"),
    ("consist", ("emergency_brake",), {"delay": 0.01}, "emergency_brake.delay = 0.01: usual are 0.05 to 60 s"),
    ("consist", ("air_brake",), {}, "air_brake has no force, because no vehicle of the train has shoes"),
    ("consist", ("vehicle_types", "car", "shoes"), {"count": 8, "force_kn": 25, "friction": 0.4},
     "car: shoes have no effect without an air brake; add air_brake"),
    ("consist", ("vehicle_types", "car", "electric_brake"), [{"to": 9, "force_kn": 70}],
     "car: electric_brake has 70000 N at 9 m/s, more than brake with 60000 N, of which it is a part"),
    ("own", ("stops",), [{"at": 50, "dwell": 0.5}], "stops[0].dwell = 0.5: usual are 2 to 14400 s"),
    ("train", ("vehicles", 1, "a_braking"), -0.1, "vehicles[1]: a_braking: no effect in a vehicle of type"),
])  # fmt: skip
def test_traps_of_every_format_are_noted(tmp_path, what, path, value, message, capsys):
    """Breaks if a figure in another unit, or an entry without effect, is taken without a word in one of the formats."""
    own = {"schema": "train_ato/line/1", "name": "y", "end": 3000}
    car = {"mass": 40e3, "length": 20, "rotating_mass_factor": 1.1, "resistance": {"n": [700, 20, 2]},
           "traction": [{"to": 12.5, "force_kn": 50}, {"to": 45, "power_kw": 625}],
           "brake": [{"to": 45, "force_kn": 60}]}  # fmt: skip
    consist = {"schema": "train_ato/consist/1", "name": "z", "vehicle_types": {"car": car}, "train": [{"type": "car"}],
               "draft_gears": {"rigid": {"kind": "rigid"}}, "default_gear": "rigid"}  # fmt: skip
    base = {"train": TRAIN, "path": PATH, "bench": BENCH, "own": own, "consist": consist}[what]
    file = tmp_path / f"trap.{'json' if what == 'bench' else 'yaml'}"
    data = changed(base, path, value)
    file.write_text(json.dumps(data) if what == "bench" else yaml.safe_dump(data))
    (find_train if what in ("train", "consist") else load_line)(str(file))
    assert message in capsys.readouterr().err


def test_an_empty_list_of_a_bench_is_level_and_straight() -> None:
    """Breaks if a line without a gradient or a curve is refused, or one without a limit is read."""
    none: dict[str, Any] = {key: BENCH[key] | {"values": []} for key in ("gradients", "curvatures")}
    line = ttobench.ttobench_line(BENCH | none, "b.json")
    assert (line.grades, line.curves) == ((), ())
    with pytest.raises(ValueError, match="speed limits: values = "):
        ttobench.ttobench_line(BENCH | {"speed limits": BENCH["speed limits"] | {"values": []}}, "b.json")


def test_values_of_a_scenario_in_another_unit_are_noted(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if 400 for 400 kN is taken without a word, or a shipped scenario has a note."""
    for name in ("demo", "freight_consensus", "crh380a_gpc:free", "xuzhou_metro:disturbed"):
        load_scenario(name)
    assert capsys.readouterr().err == ""
    load_scenario("demo", ("criteria.coupler_draft_kn=0.4", "plant.sensors.position_noise_km=50", "plant.lag=300"))
    told = capsys.readouterr().err
    assert "note: demo: criteria.coupler_draft = 400: usual are 2000 to 20000000 N; check its unit" in told
    assert "plant.sensors.position_noise = 50000: usual are 1e-05 to 20 m" in told
    assert "plant.lag = 300: usual are 0.001 to 60 s" in told
    load_scenario(
        "demo", ("brake={policy: planned, events: [{time: 9, reduction: 0.5}]}", "criteria.jerk=750", "hold_limit=500")
    )
    told = capsys.readouterr().err
    assert "brake.events[0].reduction = 0.5: usual are 10000 to 1000000 Pa" in told and "criteria.jerk = 750" in told
    assert "hold_limit = 500: usual are 0.01 to 120 s" in told


def test_keys_of_sections_that_a_line_does_not_carry_are_named(tmp_path: Path) -> None:
    """Breaks if a key below a carried one is dropped without a word."""
    file = tmp_path / "path.yaml"
    rows = [dict(row, tunnel=30) for row in NAMED]
    file.write_text(yaml.safe_dump({"paths": [{"id": "p", "characteristic_sections": rows}]}))
    assert "paths[].characteristic_sections[].tunnel" in named_line(str(file)).left_out
    bench = tmp_path / "bench.json"
    bench.write_text(json.dumps(BENCH | {"stops": BENCH["stops"] | {"names": ["a"]}}))
    assert "stops.names" in named_line(str(bench)).left_out


def test_the_lost_keys_of_a_line_and_a_train_are_noted_where_they_are_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a plan or a scenario uses a foreign file without a word about its keys without effect."""
    line, train = tmp_path / "path.yaml", tmp_path / "train.yaml"
    line.write_text(yaml.safe_dump(PATH | {"tunnels": [[1, 2]], "schema_version": 3}))
    train.write_text(yaml.safe_dump(TRAIN | {f"extra_{number}": number for number in range(9)}))
    find_train(str(train))
    scenario_line(line.name, tmp_path)
    noted = capsys.readouterr().err
    assert f"note: {line}: read as railtoolkit; without effect: tunnels, paths[].id, schema_version\n" in noted
    told = re.search(rf"note: {train}: read as railtoolkit; without effect: (.*) and (\d+) more, see", noted)
    assert told and told[1].count(", ") + 1 + int(told[2]) == len(named_train(str(train)).left_out) > 9


@pytest.mark.parametrize(("text", "value"), [
    ("0500", 500), ("011000", 11000), ("010", 10), ("-007", -7), ("0o17", 15), ("0x1f", 31), ("1_000", 1000),
    ("8:15", "8:15"), ("1:30:00.5", "1:30:00.5"), ("NO", "NO"), ("on", "on"), ("Yes", "Yes"), ("true", True),
    ("2026-11-24", "2026-11-24"), ("60,5", "60,5"), ("1e-2", 0.01), ("1.e3", 1000.0), (".5", 0.5), ("08", 8),
    ("~", None), ("'08'", "08"), ("0b11", "0b11"), ("-.inf", float("-inf")), ("[60, 5]", [60, 5]),
])  # fmt: skip
def test_scalars_are_those_of_yaml_1_2(text: str, value: Any) -> None:
    """Breaks if a leading zero is octal, a colon is base 60, or NO is false; texts survive writing and reading."""
    found = parse_yaml(text)
    assert found == value and type(found) is type(value)
    assert parse_yaml(yaml.dump({"name": text}, Dumper=TextDumper)) == {"name": text}


@pytest.mark.parametrize(
    "text", ["!!float 190:20:30", "!!int 1:20", "!!int 1.5", "!!float 0x1f", "!!bool yes", "!!bool on", "!!null none"]
)
def test_a_tag_does_not_bring_back_yaml_1_1(text: str) -> None:
    """Breaks if 190:20:30 with its tag is 685230, base 60, or yes is true."""
    with pytest.raises(ValueError, match=rf"line 1: '.*' is no value of the tag {text.split()[0]}; remove the tag or"):
        parse_yaml(f"a: {text}")


def test_other_tags_are_unknown_and_those_of_the_core_schema_are_read() -> None:
    """Breaks if a tag makes bytes, a date or a set, which no key takes, or a merged mapping loses a key."""
    for text in ("!!binary aGk=", "!!timestamp 2026-11-24", "!!set {a, b}", "!!omap [a: 1]", "!!pairs [a: 1]", "!x 1"):
        with pytest.raises(ValueError, match="line 1: unknown tag"):
            parse_yaml(f"a: {text}")
    found = parse_yaml(
        "a: [!!str 5, !!float 5, !!int 0500, !!float 1_0.5, !!bool true, !!null ~, !!map {b: !!seq [1]}]"
    )
    assert found == {"a": ["5", 5.0, 500, 10.5, True, None, {"b": [1]}]} and isinstance(found["a"][1], float)
    assert parse_yaml("base: &b {at: 1, to: 2}\nrow: {<<: *b, to: 3}")["row"] == {"at": 1, "to": 3}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("speed_limits: [{at: 0, speed_kmh: 60,5}]", "'60,5' has a comma; write 60.5;"),
        ("stops: [{at: 1,000}]", "'1,000' has a comma; write 1000, or 1.000;"),
        ("end: 12,000", "not text; write 12000, or 12.000 with a decimal point"),
        ("end_km: 12,5", r"input should be a number, not text; write 12.5 with a decimal point"),
        ("stops: [{at: 8:15}]", "input should be a number, not text"),
        ("end_km: 1e308", r"end_km = 1e\+308: input should be between -1e\+15 and 1e\+15; correct it"),
        ("begin_km: -1e308", r"begin_km = -1e\+308: input should be between -1e\+15"),
        ("stops: [{at: 9, name: 12}]", "input should be text; write it in quotes"),
        ("neutral_sections: [{begin: 1, end: 2, electric_brake: yes}]", "input should be true or false"),
    ],
)
def test_scalars_of_another_kind_are_refused_in_words(tmp_path: Path, text: str, message: str) -> None:
    """Breaks if a decimal comma or a word of YAML 1.1 becomes a number or a truth value."""
    end = "" if text.startswith("end") else "end_km: 12\n"
    (tmp_path / "own.yaml").write_text(f"schema: train_ato/line/1\nname: y\n{end}{text}\n")
    with pytest.raises(ValueError, match=message):
        load_line(str(tmp_path / "own.yaml"))


def test_a_bench_line_with_curves() -> None:
    line = ttobench.ttobench_line(BENCH, "bench.json")
    assert [stop.at for stop in line.stops] == [0, 5000] and line.end == 5000
    assert [g.grade for g in line.grades] == pytest.approx([0.002, -0.0035])
    assert (line.curves[0].begin, line.curves[-1].end) == (300, 600)
    assert all(a.end == pytest.approx(b.begin) for a, b in pairwise(line.curves))
    turned = sum((c.end - c.begin) / c.radius for c in line.curves)  # of 1/800 falling to -1/500, linear with its sign
    assert turned == pytest.approx(300 / 2 * (800**-2 + 500**-2) / (1 / 800 + 1 / 500), rel=0.02)
    plain = BENCH | {"curvatures": BENCH["curvatures"] | {"values": [[300.0, -500.0, -500.0], [600.0, 0, 0]]}}
    assert [(c.begin, c.end, c.radius) for c in ttobench.ttobench_line(plain, "plain").curves] == [(300, 600, 500)]


@pytest.mark.parametrize("name", ["slopes", "limit", "stgallen_wil"])
def test_the_open_bench_lines_are_read_whole(open_data: Path, name: str) -> None:
    path = open_data / f"{name}.json"
    raw, line = json.loads(path.read_text()), load_line(str(path))
    assert len(line.stops) == len(raw["stops"]["values"]) and len(line.grades) == len(raw["gradients"]["values"])
    speeds = [3.6 * limit.speed for limit in line.speed_limits]
    assert np.allclose(speeds, [row[1] for row in raw["speed limits"]["values"]])
    assert line.end == raw["stops"]["values"][-1]


def changed(base: Any, path: tuple[Any, ...], value: Any) -> Any:
    """Return data with another value at a place, or without it for `KeyError`."""
    data = copy.deepcopy(base)
    target: Any = data
    for part in path[:-1]:
        target = target[part]
    if value is KeyError:
        del target[path[-1]]
    else:
        target[path[-1]] = value
    return data


@pytest.mark.parametrize(
    ("what", "path", "value", "message"),
    [
        ("train", ("vehicles",), KeyError, "vehicles: this key is missing"),
        ("train", ("trains",), [], "must be a list of at least 1"),
        ("train", ("trains", 0, "formation"), ["loco", "van"], "formation: 'van' is not in vehicles"),
        ("train", ("trains", 0, "formation"), ["coach"], "no traction unit"),
        ("train", ("vehicles", 0, "mass"), -80, "mass = -80"),
        ("train", ("vehicles", 0, "mass"), "heavy", "mass = 'heavy': must be a finite number"),
        ("train", ("vehicles", 0, "length"), float("nan"), "length = nan"),
        ("train", ("vehicles", 1, "rotation_mass"), 0.5, "rotation_mass = 0.5"),
        ("train", ("vehicles", 1, "vehicle_type"), "bus", "vehicle_type = 'bus': must be one of"),
        ("train", ("vehicles", 0, "tractive_effort"), [[0, 1], [0, 2]], "speeds must rise"),
        ("train", ("vehicles", 0, "tractive_effort"), [[0, 1, 2]], "must be a list of 2"),
        ("train", ("vehicles", 1, "id"), "loco", r"vehicles\[1\]: id = 'loco': two vehicles have this id"),
        ("train", ("vehicles", 0, "mass_traction"), 200, "mass_traction = 200: must lie between 0 and 80"),
        ("path", ("paths",), {}, "must be a list of at least 1"),
        ("path", ("paths", 0, "characteristic_sections"), [[0, 1, 2]], "at least 2"),
        ("path", ("paths", 0, "characteristic_sections", 1, 1), 0, "= 0: must lie between"),
        ("path", ("paths", 0, "characteristic_sections", 1, 0), 0, "two sections begin at 0 m"),
        ("bench", ("stops", "values"), [0], "at least 2"),
        ("bench", ("stops", "unit"), "furlong", "unit of position = 'furlong'"),
        ("bench", ("stops", "units"), {"position": "km"}, "stops: unit and units are the same quantity; keep one of"),
        ("bench", ("speed limits", "values", 1, 0), -5, "places fall; in falling kilometres write every place as"),
        ("bench", ("stops", "values"), [5000, 0], "distance from 5000 m and keep the order of the entries"),
        ("bench", ("stops", "values"), [0, 500, 400], r"values\[2\]: 400 m after 500 m: places must rise"),
        ("bench", ("curvatures", "values", 1, 0), -3, "places must rise in the direction of running"),
        ("path", ("paths", 0, "characteristic_sections", 1, 0), 4000, "3000 m after 4000 m: places must rise"),
        ("path", ("paths", 0, "characteristic_sections", 1), {"position": 1000}, "it has neither speed nor resistance"),
        ("bench", ("speed limits", "values", 1, 0), 0, r"speed limits: values\[1\]: two values at 0 m; keep one"),
        ("bench", ("gradients", "values", 1, 0), 0, r"gradients: values\[1\]: two values at 0 m; keep one"),
        ("bench", ("gradients", "values", 1, 1), 600, r"values\[1\]\[1\] = 600: 600 per mille; correct its unit"),
        ("path", ("path",), {"id": "q"}, r"paths: holds 2 \(has q, p\); name one as FILE:NAME"),
        ("bench", ("gradients", "units"), KeyError, "unit: this key is missing"),
        ("bench", ("curvatures", "values", 1), [1, 2], "must be a list of 3"),
    ],
)
def test_every_fault_is_named_with_file_key_and_value(tmp_path, what, path, value, message):
    base = {"train": TRAIN, "path": PATH, "bench": BENCH}[what]
    file = tmp_path / ("fault.json" if what == "bench" else "fault.yaml")
    data = changed(base, path, value)
    file.write_text(json.dumps(data) if what == "bench" else yaml.safe_dump(data))
    with one_line(message, "fault."):
        (find_train if what == "train" else load_line)(str(file))


@given(st.data())
def test_a_file_with_anything_anywhere_is_read_or_refused_in_one_line(data: st.DataObject) -> None:
    """A value of a valid file is replaced by any YAML value; breaks on any other exception."""
    base = data.draw(st.sampled_from([TRAIN, PATH, BENCH]))
    path: list[Any] = []
    target: Any = base
    while isinstance(target, (dict, list)) and target and (not path or data.draw(st.booleans())):
        part = data.draw(st.sampled_from(sorted(target) if isinstance(target, dict) else range(len(target))))
        path.append(part)
        target = target[part]
    anything = st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8), st.lists(st.integers(), max_size=3),
        st.dictionaries(st.text(max_size=4), st.integers(), max_size=2),
    )  # fmt: skip
    broken = changed(base, tuple(path), data.draw(anything))
    readers = {"trains": railtoolkit.train_from, "paths": railtoolkit.railtoolkit_line}
    try:
        next((readers[key] for key in readers if key in base), ttobench.ttobench_line)(broken, "some file")
    except ValueError as error:
        assert "\n" not in str(error) and "some file" in str(error)


@given(st.binary(max_size=120))
def test_random_bytes_are_refused_in_one_line(tmp_path_factory: pytest.TempPathFactory, noise: bytes) -> None:
    for suffix in ("yaml", "json"):
        file = tmp_path_factory.getbasetemp() / f"noise_{noise.hex()[:40]}.{suffix}"
        file.write_bytes(noise)
        for find in (load_line, find_train):
            with one_line("", file.name):
                find(str(file))
        file.unlink()
