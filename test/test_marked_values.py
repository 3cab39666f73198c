"""Every key, element and attribute of a foreign file is used, refused, or named as lost."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from test_foreign_files import TUNNELS, UNIT_TRAIN, quantity
from test_networks import LOOP, RAIL_LOOP, part
from test_readers import BENCH, NAMED, PATH, TRAIN

from plant_sim.formats.reading import ReadConsist, ReadLine, read_line, read_train

ETCS = {
    "A_brake_emergency": {"units": {"velocity": "km/h", "deceleration": "m/s^2"}, "values": [[100, 0.9]]},
    "T_be": quantity(2.0, "s"), "kdry": 0.7,
}  # fmt: skip
INFRA = LOOP | {
    "speed_sections": [
        {"id": "v", "speed_limit": 20, "speed_limit_by_tag": {"freight": 9}, "on_routes": ["r"], "track_ranges": [
            part("A", 0, 900), part("C", 100, 1900), part("L", 100, 700),
        ]},
        {"id": "out", "speed_limit": 5, "track_ranges": [part("C", 1000, 1100, "START_TO_STOP")]},
    ],
    "signals": [{"id": "s", "position": 4}], "extended_switch_types": [],
}  # fmt: skip
CURVES = {"curvatures": BENCH["curvatures"] | {"values": [[300.0, 800.0, -500.0], [600.0, 700, 700]]}}
TUNNEL = {"tunnels": TUNNELS | {"values": [[1.0, 500, 32]]}}
LINES: dict[str, tuple[dict[str, Any], str]] = {
    "osrd": (INFRA, "A..L"),
    "ttobench": (BENCH | CURVES | TUNNEL | {"altitude": quantity(5, "m")}, ""),
    "railtoolkit": (PATH | {"schema_version": "2022.05", "points_of_interest": [[5, "x"]]}, ""),
    "railtoolkit names": (PATH | {"paths": [{"name": "n", "characteristic_sections": NAMED, "UUID": "4"}]}, ""),
}
TRAINS: dict[str, dict[str, Any]] = {
    "ttobench": UNIT_TRAIN | {"ETCS braking data": ETCS, "max acceleration": quantity(0.6, "m/s^2")},
    "railtoolkit": TRAIN,
}


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


def with_mark(data: Any, place: tuple[Any, ...]) -> Any:
    changed = copy.deepcopy(data)
    target = changed
    for key in place[:-1]:
        target = target[key]
    target[place[-1]] = marked(target[place[-1]])
    return changed


def named(place: tuple[Any, ...], left_out: tuple[str, ...]) -> bool:
    """Return True if a place, or one above it, is named as lost."""
    text, names = "", []
    for key in place:
        text = f"{text}[]" if isinstance(key, int) else f"{text}.{key}" if text else str(key)
        names.append(text)
    return any(name in left_out for name in names)


def silent(data: Any, places: list[tuple[Any, ...]], read: Any) -> list[tuple[Any, ...]]:
    """Return the places whose marked value changes nothing and is not named."""
    base = read(data)
    lost = []
    for place in places:
        try:
            found = read(with_mark(data, place))
        except ValueError as error:
            assert "\n" not in str(error)
            continue
        if replace(found, left_out=()) == replace(base, left_out=()) and not named(place, found.left_out):
            lost.append(place)
    return lost


@pytest.mark.parametrize("name", LINES)
def test_every_key_of_a_line_is_used_or_named(tmp_path: Path, name: str) -> None:
    """Breaks if a reader drops a key, or claims to carry one that has no effect."""
    data, selection = LINES[name]

    def read(changed: Any) -> ReadLine:
        (tmp_path / "line.json").write_text(json.dumps(changed))
        return read_line(tmp_path / "line.json", selection)

    last = len(data["paths"][0]["characteristic_sections"]) - 1 if "paths" in data else None
    places = [place for place in leaves(data) if place[3:4] != (last,)]  # where a path ends, no section begins
    assert silent(data, places, read) == []


@pytest.mark.parametrize("name", TRAINS)
def test_every_key_of_a_train_is_used_or_named(tmp_path: Path, name: str) -> None:
    """Breaks if a reader drops a key of a train, as an efficiency or an electric brake."""

    def read(changed: Any) -> ReadConsist:
        (tmp_path / "train.json").write_text(json.dumps(changed))
        return read_train(tmp_path / "train.json")

    assert silent(TRAINS[name], list(leaves(TRAINS[name])), read) == []


def test_every_attribute_of_a_railml_file_is_used_or_named(tmp_path: Path) -> None:
    """Breaks if an attribute or element of railML is lost without a word; each gets another value, in turn."""
    file = tmp_path / "line.railml"
    arc = '<gradientCurve id="g" curveType="arc" deltaGradient="-8"><linearLocation id="l"><associatedNetElement '
    arc += 'netElementRef="c" posBegin="1500" posEnd="1540"/></linearLocation><valid from="x"/></gradientCurve>'
    text = RAIL_LOOP.replace("</gradientCurves>", f"{arc}</gradientCurves>").replace(
        "</functionalInfrastructure>", '<signals><signal id="s" x="1"/></signals></functionalInfrastructure>'
    )
    root = ElementTree.fromstring(text)
    file.write_text(text)
    base, lost = read_line(file, "a..b"), []
    parents: dict[ElementTree.Element, str] = {root: ""}
    for element in root.iter():
        for entry in element:
            parents[entry] = f"{parents[element]}.{entry.tag}".lstrip(".").removeprefix("infrastructure.")
    for element, place in parents.items():
        for key, value in element.attrib.items():
            number = value.lstrip("-").replace(".", "", 1).isdigit()
            element.set(key, str(marked(float(value))) if number else marked(value))
            file.write_text(ElementTree.tostring(root, encoding="unicode"))
            name = f"{place}.@{key}".lstrip(".").removeprefix("infrastructure.")
            try:
                found = read_line(file, "a..b")
            except ValueError as error:
                assert "\n" not in str(error)
            else:
                above = any(name.startswith(f"{entry}.") or name == entry for entry in found.left_out)
                if found.line == base.line and not above:
                    lost.append((name, value))
            element.set(key, value)
    assert lost == []
