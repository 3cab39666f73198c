"""Readers of other formats: their rules, and one line for every fault of a file."""

from __future__ import annotations

import copy
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from plant_sim.formats import railtoolkit, ttobench
from train_ato.profile.planner.inputs import find_line, find_train

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
    read = railtoolkit.train_from(TRAIN, "hand")
    consist = read.consist
    g = 9.80665
    assert consist.mass == 180e3 and consist.length == 70
    assert read.deceleration == 0.375 and read.speed_max == pytest.approx(120 / 3.6)
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

    envelope = Envelope(railtoolkit.train_from(TRAIN, "hand").consist.vehicles[0].traction)
    for kmh, force in ((0, 200e3), (30, 175e3), (60, 150e3), (90, 105e3), (119.9, 60150.0), (125, 0)):
        assert envelope.force(kmh / 3.6) == pytest.approx(force, rel=1e-9)


def test_a_path_becomes_a_line() -> None:
    line = railtoolkit.railtoolkit_line(PATH, "hand")
    assert (line.begin, line.end) == (0, 3000)
    assert [(g.at, g.grade) for g in line.grades] == [(0, 0), (1000, 0.005)]
    assert [limit.speed * 3.6 for limit in line.speed_limits] == pytest.approx([100, 80])


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
    raw, line = json.loads(path.read_text()), find_line(str(path))
    assert len(line.stops) == len(raw["stops"]["values"]) and len(line.grades) == len(raw["gradients"]["values"])
    speeds = [3.6 * limit.speed for limit in line.speed_limits]
    assert np.allclose(speeds, [row[1] for row in raw["speed limits"]["values"]])
    assert line.end == raw["stops"]["values"][-1]


def changed(base: dict[str, Any], path: tuple[Any, ...], value: Any) -> dict[str, Any]:
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
        ("path", ("paths",), {}, "must be a list of at least 1"),
        ("path", ("paths", 0, "characteristic_sections"), [[0, 1, 2]], "at least 2"),
        ("path", ("paths", 0, "characteristic_sections", 1, 1), 0, "= 0: must lie between"),
        ("path", ("paths", 0, "characteristic_sections", 1, 0), 0, "two sections begin at 0 m"),
        ("bench", ("stops", "values"), [0], "at least 2"),
        ("bench", ("stops", "unit"), "furlong", "unit of position = 'furlong'"),
        ("bench", ("speed limits", "values", 1, 0), -5, "listed by rising distance"),
        ("bench", ("gradients", "units"), KeyError, "unit: this key is missing"),
        ("bench", ("curvatures", "values", 1), [1, 2], "must be a list of 3"),
    ],
)
def test_every_fault_is_named_with_file_key_and_value(
    tmp_path: Path, what: str, path: tuple[Any, ...], value: Any, message: str
) -> None:
    base = {"train": TRAIN, "path": PATH, "bench": BENCH}[what]
    file = tmp_path / ("fault.json" if what == "bench" else "fault.yaml")
    data = changed(base, path, value)
    file.write_text(json.dumps(data) if what == "bench" else yaml.safe_dump(data))
    with pytest.raises(ValueError, match=message) as caught:
        (find_train if what == "train" else find_line)(str(file))
    assert "\n" not in str(caught.value) and "fault." in str(caught.value)


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
    reader = {
        id(TRAIN): railtoolkit.train_from,
        id(PATH): railtoolkit.railtoolkit_line,
        id(BENCH): ttobench.ttobench_line,
    }
    try:
        reader[id(base)](broken, "some file")
    except ValueError as error:
        assert "\n" not in str(error) and "some file" in str(error)


@given(st.binary(max_size=120))
def test_random_bytes_are_refused_in_one_line(tmp_path_factory: pytest.TempPathFactory, noise: bytes) -> None:
    for suffix in ("yaml", "json"):
        file = tmp_path_factory.getbasetemp() / f"noise_{noise.hex()[:40]}.{suffix}"
        file.write_bytes(noise)
        for find in (find_line, find_train):
            with pytest.raises(ValueError) as caught:
                find(str(file))
            assert "\n" not in str(caught.value) and file.name in str(caught.value)
        file.unlink()
