"""Every key, element and attribute of a foreign file is used, refused, or named as lost."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from import_files import metro, text_of
from test_brought_lines import ORE, RAIL_STOCK, RAIL_STOCK_2, geojson, gpx, limited, link, track
from test_foreign_files import STOCK, TUNNELS, UNIT_TRAIN, quantity
from test_networks import LOOP, RAIL_2, RAIL_LOOP, located, part, with_profile
from test_readers import BENCH, NAMED, PATH, TRAIN

from plant_sim.formats.railml_collection import Entry
from plant_sim.formats.reading import ReadConsist, ReadLine, read_line, read_train
from plant_sim.library import load_consist, load_line
from train_ato.api.import_csv.recording import MeasuredCheck
from train_ato.api.import_csv.run import measured_setup, series_of
from train_ato.api.import_csv.smoothing import measured_profile
from train_ato.api.import_csv.table import read_table

INFRA = LOOP | {
    "speed_sections": [
        {"id": "v", "speed_limit": 20, "speed_limit_by_tag": {"freight": 9}, "on_routes": ["r"], "track_ranges": [
            part("A", 0, 900), part("C", 100, 1900), part("L", 100, 700),
        ]},
        {"id": "out", "speed_limit": 5, "track_ranges": [part("C", 1000, 1100, "START_TO_STOP")]},
    ],
    "signals": [{"id": "s", "position": 4}], "extended_switch_types": [],
    "neutral_sections": [{"id": "n", "lower_pantograph": True, "track_ranges": [{
        "track": "C", "begin": 300, "end": 400, "direction": "START_TO_STOP"}]}],
    "electrifications": [{"id": "e", "voltage": "25000V", "track_ranges": [part("A", 100, 900), part("C", 100, 600)]}],
}  # fmt: skip
LINES: dict[str, tuple[Any, str]] = {
    "osrd": (INFRA, "A..L"),
    "ttobench": (BENCH | {
        "curvatures": BENCH["curvatures"] | {"values": [[300.0, 800.0, -500.0], [600.0, 700, 700]]},
        "tunnels": TUNNELS | {"values": [[1.0, 500, 32]]}, "altitude": quantity(5, "m"),
    }, ""),
    "railtoolkit": (PATH | {"schema_version": "2022.05", "points_of_interest": [[5, "x"]]}, ""),
    "geojson feature": (geojson(track(length=300.0), {})["features"][0], ""),
    "geojson": (geojson(track(length=300.0), {"A": [11.001, 48.0]}) | {"crs": "none"}, ""),
    "altrios": ([link(1, 0, 2, 0, speed_sets=limited(20, 15)), link(2, 0, 0, 1, speed_sets=limited(30, 25))], "1..2"),
    "railtoolkit names": (PATH | {"paths": [{"name": "n", "characteristic_sections": NAMED, "UUID": "4"}]}, ""),
}  # fmt: skip
TRAINS: dict[str, dict[str, Any]] = {
    "ttobench": UNIT_TRAIN | {"max acceleration": quantity(0.6, "m/s^2"), "ETCS braking data": {
        "A_brake_emergency": {"units": {"velocity": "km/h", "deceleration": "m/s^2"}, "values": [[100, 0.9]]},
        "T_be": quantity(2.0, "s"), "kdry": 0.7,
    }},
    "ttobench 1.4": UNIT_TRAIN | {"tunnel resistance": {
        "unit": "kg/m", "cross section unit": "m^2", "values": [{"cross section": 24, "value": 15}],
    }},
    "railtoolkit": TRAIN, "osrd": STOCK, "altrios": ORE,
}  # fmt: skip


def leaves(data: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the place of every value."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    below = [leaf for key, value in items for leaf in leaves(value, (*place, key))]
    yield from below or [place]


def marked(value: Any) -> Any:
    """Return another value of the same kind."""
    if isinstance(value, bool) or value in ("true", "false"):
        return {True: False, False: True, "true": "false", "false": "true"}[value]
    if isinstance(value, (int, float)):
        return value * 0.5 + 0.01
    return "marked" if isinstance(value, str) else ["marked"]


def named(place: tuple[Any, ...], left_out: tuple[str, ...]) -> bool:
    """Return True if a place, or one above it, is named as lost."""
    text = ""
    for key in place:
        text = f"{text}[]" if isinstance(key, int) else f"{text}.{key}" if text else str(key)
        if text in left_out:
            return True
    return False


def reader(tmp_path: Path, name: str) -> tuple[Any, Any]:
    """Return a line or a train, and the function that reads it after changes."""
    data, selection = LINES[name[5:]] if name.startswith("line ") else (TRAINS[name], None)
    file = tmp_path / "data.json"

    def read(changed: Any) -> ReadLine | ReadConsist:
        file.write_text(json.dumps(changed))
        return read_train(file) if selection is None else read_line(file, selection)

    return data, read


def silent(data: Any, places: list[tuple[Any, ...]], read: Any) -> list[tuple[Any, ...]]:
    """Return the places whose marked value changes nothing and is not named."""
    base = read(data)
    lost = []
    for place in places:
        changed = target = copy.deepcopy(data)
        for key in place[:-1]:
            target = target[key]
        target[place[-1]] = marked(target[place[-1]])
        try:
            found = read(changed)
        except ValueError as error:
            assert "\n" not in str(error)
            continue
        if replace(found, left_out=()) == replace(base, left_out=()) and not named(place, found.left_out):
            lost.append(place)
    return lost


@pytest.mark.parametrize("name", [*(f"line {name}" for name in LINES), *TRAINS])
def test_every_key_is_used_or_named(tmp_path: Path, name: str) -> None:
    """Breaks if a reader drops a key, or claims to carry one that has no effect, as an efficiency or a brake."""
    data, read = reader(tmp_path, name)
    last = len(data["paths"][0]["characteristic_sections"]) - 1 if "paths" in data else None
    places = [place for place in leaves(data) if place[3:4] != (last,)]  # where a path ends, no section begins
    if name == "line altrios":
        given = {("idx_prev",), ("idx_prev_alt",), ("idx_flip",), ("idx_next_alt",)}  # by idx_next; the other direction
        lowest = (0, "speed_sets", "Freight", "speed_limits", 1, "offset_end_meters")  # a gap has the lowest limit
        places = [place for place in places if place[1:] not in given and place != lowest]
    assert silent(data, places, read) == []


def planted(data: Any) -> Iterator[tuple[str, Any]]:
    """Yield, for every mapping in data, the name of an unknown key in it and the data with this key."""
    mappings: list[tuple[str, Any]] = [("", data)]
    for place, entry in mappings:
        items = entry.items() if isinstance(entry, dict) else enumerate(entry) if isinstance(entry, list) else ()
        for key, value in items:
            mappings.append((f"{place}[]" if isinstance(key, int) else f"{place}.{key}".lstrip("."), value))
        if isinstance(entry, dict):
            entry["planted"] = 7
            yield f"{place}.planted".lstrip("."), copy.deepcopy(data)
            del entry["planted"]


def unnamed(data: Any, read: Any) -> list[str]:
    """Return the planted keys that are neither refused in words nor named as lost."""
    lost, count, base = [], 0, replace(read(data), left_out=())
    for name, changed in planted(copy.deepcopy(data)):
        count += 1
        try:
            found = read(changed)
            told = any(f"{name}.".startswith((f"{entry}.", f"{entry}[")) for entry in found.left_out)
            if not told and replace(found, left_out=()) == base:  # a category may have any name
                lost.append(name)
        except ValueError as error:
            assert "planted" in str(error) and "\n" not in str(error)
    assert count > 1
    return lost


@pytest.mark.parametrize("name", [*(f"line {name}" for name in LINES), *TRAINS])
def test_an_unknown_key_in_any_mapping_is_named(tmp_path: Path, name: str) -> None:
    """Breaks if a key carries all keys below it, as ports or units did, or is kept for the way back in silence."""
    assert unnamed(*reader(tmp_path, name)) == []


@pytest.mark.parametrize("name", ["line.railml", "stock.railml", "way.gpx"])
def test_an_unknown_attribute_and_element_anywhere_in_xml_is_named(tmp_path: Path, name: str) -> None:
    """Breaks if a name has to be unknown everywhere to be lost, or an attribute of GPX is silent."""
    text = {"line.railml": RAIL_LOOP, "stock.railml": RAIL_STOCK, "way.gpx": gpx(track(length=300.0), {"A": [11, 48]})}
    root, file, silent_in = ElementTree.fromstring(text[name]), tmp_path / name, []
    for element in list(root.iter()):
        element.set("planted", "7")
        added = ElementTree.SubElement(element, "sown")
        file.write_text(ElementTree.tostring(root, encoding="unicode"))
        try:
            left = (
                read_train(file).left_out
                if name == "stock.railml"
                else read_line(file, "a..b"[: 4 * (name[0] == "l")]).left_out
            )
            if not all(any(key.endswith(end) for key in left) for end in ("@planted", "sown")):
                silent_in.append(element.tag)
        except ValueError as error:
            assert "\n" not in str(error)
        element.remove(added)
        del element.attrib["planted"]
    assert silent_in == []


ARC = (
    '<gradientCurve id="g" curveType="arc" deltaGradient="-8"><linearLocation id="l"><associatedNetElement '
    'netElementRef="c" posBegin="1500" posEnd="1540"/></linearLocation><valid from="x"/></gradientCurve>'
)
PROFILE = '<load axleLoad="16"/><braking minimumBrakePercentage="90" position="P"/>'
RAIL_3 = with_profile(
    RAIL_LOOP.replace("</gradientCurves>", f"{ARC}</gradientCurves>").replace(
        "</functionalInfrastructure>", '<signals><signal id="s" x="1"/></signals></functionalInfrastructure>'
    ),
    'influence="increasing"', PROFILE, located("speedSection", 'maxSpeed="80"', 'netElementRef="c">'),
)  # fmt: skip
"""Network of railML 3 with every element of its reader."""


@pytest.mark.parametrize(("text", "selections"), [(RAIL_3, ["a..b"]), (RAIL_2, ["West..t3", "t3..West", "t1..t2"])])
def test_every_attribute_of_a_railml_file_is_used_or_named(tmp_path: Path, text: str, selections: list[str]) -> None:
    """Breaks if an attribute or element of railML is lost without a word; each gets another value, in turn."""
    file = tmp_path / "line.railml"
    root = ElementTree.fromstring(text)
    file.write_text(text)
    base, lost = [read_line(file, selection) for selection in selections], []
    parents: dict[ElementTree.Element, str] = {root: ""}
    for element in root.iter():
        for entry in element:
            parents[entry] = f"{parents[element]}.{Entry(entry, '').tag}".lstrip(".").removeprefix("infrastructure.")
    for element, place in parents.items():
        for key, value in element.attrib.items():
            number = value.lstrip("-").replace(".", "", 1).isdigit()
            element.set(key, str(marked(float(value))) if number else marked(value))
            file.write_text(ElementTree.tostring(root, encoding="unicode"))
            name = f"{place}.@{key}".lstrip(".").removeprefix("infrastructure.")
            try:
                found = [read_line(file, selection) for selection in selections]
            except ValueError as error:
                assert "\n" not in str(error)
            else:
                above = any(name.startswith(f"{entry}.") or name == entry for entry in found[0].left_out)
                if [one.line for one in found] == [one.line for one in base] and not above:
                    lost.append((name, value))
            element.set(key, value)
    # A gap has the lowest limit, which a note says; radius 0 follows no curve; every contact line has power.
    without = {("speedChange.@pos", "1100"), ("speedChange.@pos", "0"), ("radiusChange.@pos", "200"),
               ("radiusChange.@pos", "500"), ("electrificationChange.@type", "overhead"),
               ("radiusChange.@radius", "0")}  # fmt: skip
    assert [(name, value) for name, value in lost if (".".join(name.split(".")[-2:]), value) not in without] == []


@pytest.mark.parametrize("stock", [RAIL_STOCK, RAIL_STOCK_2])
def test_every_attribute_of_a_railml_train_is_used_or_named(tmp_path: Path, stock: str) -> None:
    """Breaks if an attribute of rolling stock is lost without a word; each gets another value, in turn."""
    file = tmp_path / "stock.railml"
    root = ElementTree.fromstring(stock.replace("<engine>", '<vehiclePart id="p" category="locomotive"/><engine>'))
    file.write_text(ElementTree.tostring(root, encoding="unicode"))
    base, lost = read_train(file), []
    for element in root.iter():
        for key, value in element.attrib.items():
            number = value.replace(".", "", 1).isdigit()
            element.set(key, str(float(value) * 0.9 + 0.2) if number else marked(value))
            file.write_text(ElementTree.tostring(root, encoding="unicode"))
            try:
                found = read_train(file)
            except ValueError as error:
                assert "\n" not in str(error)
            else:
                tag = element.tag.rpartition("}")[2]
                if found.consist == base.consist and not any(
                    f"{tag}.@{key}" in name or tag in name.split(".")[-1:] for name in found.left_out
                ):
                    lost.append((tag, key, value))
            element.set(key, value)
    # Notes name the tare weight and the drag of vehicles without effect; this order and this speed change nothing.
    without = {"tareWeight", "airDragCoefficient", "crossSectionArea", "rollingResistance", "orderNumber", "version",
               "resistanceFactor", "power", "vehicleCount"}  # fmt: skip  # a count of 2 stays 2
    assert [entry for entry in lost if entry[1] not in without] == [("vehicle", "speed", "160")]


def test_every_element_of_a_gpx_file_is_used_or_named(tmp_path: Path) -> None:
    """Breaks if an element or attribute of GPX is lost without a word; each gets another value, in turn."""
    file = tmp_path / "way.gpx"
    more = "<desc>x</desc></trkpt><trkpt"
    text = gpx(track(length=400.0), {"A": [11.001, 48.0]}).replace("</trkpt><trkpt", more, 1)
    root = ElementTree.fromstring(text)
    file.write_text(text)
    base, lost = read_line(file), []
    for element in root.iter():
        tag = element.tag.rpartition("}")[2]
        for key, value in [*element.attrib.items(), *([("", element.text)] if element.text else [])]:
            changed = str(float(value) + 0.002) if value.replace(".", "", 1).isdigit() else marked(value)
            element.set(key, changed) if key else setattr(element, "text", changed)
            file.write_text(ElementTree.tostring(root, encoding="unicode"))
            found = read_line(file)
            told = any(f"{entry}.".endswith((f"{tag}.", f"{tag}.@{key}.")) for entry in found.left_out)
            if found.line == base.line and not told and (tag, key) != ("gpx", "version"):
                lost.append((tag, key))
            element.set(key, value) if key else setattr(element, "text", value)
    assert lost == []


@pytest.mark.parametrize(
    "columns",
    [
        {"position_m": 1.0, "force_kn": 1e-3},
        {"front_position_km": 1e-3, "traction_force_n": 1.0, "brake_force_kn": 1e-3},
        {"position_km": 1e-3, "unit_0_force_n": 1.0, "unit_1_force_kn": 1e-3},
    ],
    ids=" ".join,
)
def test_every_column_of_a_recorder_is_used_or_refused(tmp_path: Path, columns: dict[str, float]) -> None:
    """Breaks if a column of a recorder file, or one of a single power unit, is read and dropped."""
    time = np.arange(0.0, 120.1, 1.0)
    v, x, f = metro(time)
    x, f = 10_000 + (x - 500) / 4, 4 * f / (2 if "unit_0_force_n" in columns else 1)
    si = {
        "time": time, "speed": v / 4, "position": x, "front": x, "reference": v / 4, "traction": np.maximum(f, 0.0),
        "force": f, "command": f, "brake_force": np.maximum(-f, 0.0),
        "brake_pipe": np.interp(time, [0, 30, 40], [6e5, 6e5, 5.5e5]),
    }  # fmt: skip
    # columns of a recorder with the number of their units in one SI unit
    units = {"time_s": 1.0, "speed_m_s": 1.0, "unit_1_speed_m_s": 1.0, "unit_0_position_m": 1.0}
    units |= {"reference_speed_kmh": 3.6, "command_force_kn": 1e-3, "brake_pipe_pressure_bar": 1e-5}
    values = {}
    for name, scale in (units | columns).items():
        quantity = next(key for key in si if re.sub(r"^unit_._", "", name).startswith(key))
        values[name] = scale * si[quantity]
    consist, line, setups = load_consist("hxd1_c80_210"), load_line("daqin_section"), []

    def read(changed: dict[str, Any]) -> list[Any]:
        (tmp_path / "r.csv").write_text(text_of(changed))
        found = MeasuredCheck(read_table(tmp_path / "r.csv", {}, frozenset()), consist, line).run()
        profile = measured_profile(found, 0.5, 10_000.0, 1.0)
        setups.append(measured_setup(found, profile, "hxd1_c80_210", "daqin_section", "x") if not setups else setups[0])
        block = series_of(found, replace(setups[0], profile=profile))
        return [values for _, row in block.rows for values in row.values()] + [block.between]

    base, used = read(values), 0
    for name in values:
        try:
            changed = read(values | {name: values[name] * np.where(time > 20, 1.0 + 1e-4, 1.0)})
        except ValueError as error:
            assert "\n" not in str(error) and name in str(error)
            continue
        used += 1
        assert any(not np.array_equal(*pair) for pair in zip(base, changed, strict=True)), name
    assert used >= len(values) - 1
    with pytest.raises(ValueError, match="unknown column 'door'"):
        read(values | {"door": time})


@pytest.mark.parametrize("key", sorted(UNIT_TRAIN.keys() - {"metadata", "num seats", "tunnel resistance"}))
def test_a_key_beside_unit_and_value_is_named(tmp_path: Path, key: str) -> None:
    """Breaks if a train of TTOBench carries all that is below a quantity, such as its range."""
    data = UNIT_TRAIN | {key: UNIT_TRAIN[key] | {"range": 3}}
    (tmp_path / "train.json").write_text(json.dumps(data))
    assert f"{key}.range" in read_train(tmp_path / "train.json").left_out
