"""Lines from networks of tracks: OSRD and railML 3.

The files are written here in the layouts of the two formats. Length and gradients of the track TD0 are those of
``tests/data/infras/etcs_infra`` of OSRD (Open Rail Association, LGPL-3.0), 25 km; all other figures are chosen here.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from plant_sim.formats import osrd
from plant_sim.library import load_line, named_line
from plant_sim.line_direction import reversed_line
from train_ato.cli.main import main


def ends(*names: str) -> dict[str, Any]:
    """Return ports A, B, ... of a switch: ``track/END``."""
    found = {}
    for port, name in zip(("A", "B1", "B2") if len(names) > 2 else ("A", "B"), names, strict=True):
        track, endpoint = name.split("/")
        found[port] = {"track": track, "endpoint": endpoint}
    return found


def track(name: str, length: float, slopes: Any = (), curves: Any = ()) -> dict[str, Any]:
    return {
        "id": name, "length": length, "geo": {"type": "LineString", "coordinates": [[0, 0], [1, 0]]},
        "slopes": [dict(zip(("gradient", "begin", "end"), row, strict=True)) for row in slopes],
        "curves": [dict(zip(("radius", "begin", "end"), row, strict=True)) for row in curves],
    }  # fmt: skip


def part(name: str, begin: float, end: float, direction: str = "BOTH") -> dict[str, Any]:
    return {"track": name, "begin": begin, "end": end, "applicable_directions": direction, "direction": direction}


def station(name: str, *spots: tuple[str, float]) -> dict[str, Any]:
    parts = [{"track": where, "position": position, "local_track_name": "1"} for where, position in spots]
    return {"id": f"op.{name}", "parts": parts, "extensions": {"identifier": {"name": name, "uic": 0}}}


HILL = [(3, 6000, 7000), (6, 7000, 8000), (3, 8000, 9000), (-3, 14000, 15000), (-6, 15000, 16000), (-3, 16000, 17000)]
INFRA: dict[str, Any] = {
    "version": "3.5.0",
    "track_sections": [
        track("TA", 2000), track("TB", 1950), track("TD0", 25000, HILL), track("TE", 1500, (), [(-600, 200, 500)]),
    ],
    "switches": [
        {"id": "p", "switch_type": "point_switch", "ports": ends("TD0/BEGIN", "TA/END", "TB/END"), "extensions": {}},
        {"id": "l", "switch_type": "link", "ports": ends("TD0/END", "TE/END")},
    ],
    "speed_sections": [
        {"id": "s0", "speed_limit": 40.0, "track_ranges": [
            part("TA", 0, 2000), part("TD0", 0, 25000), part("TE", 0, 1500),
        ]},
        {"id": "s1", "speed_limit": 20.0, "track_ranges": [part("TD0", 1000, 2000, "START_TO_STOP")]},
        {"id": "s2", "speed_limit": 10.0, "track_ranges": [part("TD0", 3000, 4000, "STOP_TO_START")]},
        {"id": "s3", "speed_limit": None, "speed_limit_by_tag": {"freight": 5.0}, "track_ranges": [part("TA", 0, 9)]},
    ],
    "neutral_sections": [
        {"id": "n", "lower_pantograph": True, "track_ranges": [part("TE", 100, 150, "STOP_TO_START")]},
    ],
    "operational_points": [station("West", ("TA", 500), ("TB", 450)), station("East", ("TE", 1000))],
    "signals": [], "routes": [],
}  # fmt: skip
"""Station West with two tracks, a line of 25 km, and a track TE that is driven against its direction."""


@pytest.fixture
def infra(tmp_path: Path) -> Path:
    file = tmp_path / "infra.json"
    file.write_text(json.dumps(INFRA))
    return file


def test_a_path_of_an_osrd_network_by_hand(infra: Path) -> None:
    """Breaks if a track against the path keeps signs or places, or a limit of the other direction holds."""
    line = load_line(f"{infra}:TA..East")
    assert (line.begin, line.end) == (0, 28500)
    assert [(e.at, round(1e3 * e.grade, 9)) for e in line.grades] == [
        (0, 0), (8000, 3), (9000, 6), (10000, 3), (11000, 0), (16000, -3), (17000, -6), (18000, -3), (19000, 0),
    ]  # fmt: skip
    assert [(e.begin, e.end, e.radius, e.side) for e in line.curves] == [(28000, 28300, 600, "right")]
    assert [(e.at, e.speed) for e in line.speed_limits] == [(0, 40), (3000, 20), (4000, 40)]
    assert [(e.begin, e.end) for e in line.neutral_sections] == [(28350, 28400)]
    assert [(e.at, e.name) for e in line.stops] == [(500, "West"), (27500, "East")]
    assert load_line(f"{infra}:West..East").end == 28450, "the shorter of two tracks"


def test_the_path_back_is_the_reversed_line_of_what_holds_in_both_directions(infra: Path) -> None:
    """Breaks if the direction of the path changes more than the directed entries."""
    there, back = load_line(f"{infra}:East..TA"), reversed_line(load_line(f"{infra}:TA..East"))
    assert [(e.at, e.grade) for e in there.grades] == [(e.at, e.grade) for e in back.grades]
    assert there.curves == back.curves and there.stops == back.stops
    assert (22500, 10) in [(e.at, e.speed) for e in there.speed_limits] and there.neutral_sections == ()


def test_gaps_and_keys_that_are_not_carried_are_named(infra: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if an assumed speed limit or a lost key is silent."""
    assert main(["convert", f"{infra}:TB..East", str(infra.with_suffix(".yaml")), "--json"]) == 0
    printed = capsys.readouterr()
    assert "no speed limit from 0 m of the path on; assumed 144 km/h" in printed.err
    left = json.loads(printed.out)["left_out"]
    for key in ("track_sections[].geo", "speed_sections[].speed_limit_by_tag", "neutral_sections[].lower_pantograph"):
        assert key in left and f"{key}\n" in printed.err
    assert load_line(str(infra.with_suffix(".yaml"))) == load_line(f"{infra}:TB..East")


@pytest.mark.parametrize(
    ("selection", "message"),
    [
        ("", "a network of 4 tracks with branches; name the line as FILE:FROM..TO"),
        ("TA..North", "'North' is no track or station; it has West, East, TA"),
        ("TA..TB", "no path between these tracks"),
        ("TA", "write FROM..TO"),
    ],
)
def test_a_wrong_selection_is_refused_with_the_names(infra: Path, selection: str, message: str) -> None:
    """Breaks if a train could turn back at a switch, or a wrong name ends in a traceback."""
    with pytest.raises(ValueError, match=message) as caught:
        load_line(f"{infra}:{selection}" if selection else str(infra))
    assert "\n" not in str(caught.value) and str(infra) in str(caught.value)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("switches", [{"id": "x", "switch_type": "turntable", "ports": {}}], "type = 'turntable': must be one of link"),
        ("switches", [{"id": "x", "switch_type": "link", "ports": ends("TX/END", "TA/END")}], "not an end of a track"),
        ("track_sections", [{"id": "TA"}], "length: this key is missing"),
        ("operational_points", [station("A", ("TX", 0))], "track 'TX' is not in track_sections"),
    ],
)
def test_a_faulty_network_is_refused_in_one_line(key: str, value: Any, message: str) -> None:
    """Breaks if a fault is a traceback, or names neither file nor key."""
    with pytest.raises(ValueError, match=message) as caught:
        osrd.osrd_line(INFRA | {key: value}, "infra.json", "TA..East")
    assert "\n" not in str(caught.value) and str(caught.value).startswith("infra.json: ")


def net_element(name: str, begin: float, end: float, length: str = "") -> str:
    spots = ""
    for place, measure in ((0, begin), (1, end)):
        linear = f'<linearCoordinate positioningSystemRef="lps" measure="{measure}"/>'
        spots += f'<intrinsicCoordinate intrinsicCoord="{place}">{linear}</intrinsicCoordinate>'
    system = f"<associatedPositioningSystem>{spots}</associatedPositioningSystem>"
    return f'<netElement id="{name}"{length}>{system}</netElement>'


def relation(one: str, at_one: int, other: str, at_other: int, navigability: str = "Both") -> str:
    return (
        f'<netRelation positionOnA="{at_one}" positionOnB="{at_other}" navigability="{navigability}">'
        f'<elementA ref="{one}"/><elementB ref="{other}"/></netRelation>'
    )


def located(tag: str, values: str, *parts: str, direction: str = "both") -> str:
    inner = "".join(f"<associatedNetElement {entry}</associatedNetElement>" for entry in parts)
    return f'<{tag} {values}><linearLocation applicationDirection="{direction}">{inner}</linearLocation></{tag}>'


def measured(name: str, begin: float, end: float) -> str:
    return (
        f'netElementRef="{name}"><linearCoordinateBegin positioningSystemRef="lps" measure="{begin}"/>'
        f'<linearCoordinateEnd positioningSystemRef="lps" measure="{end}"/>'
    )


def point(name: str, element: str, where: str) -> str:
    spot = f'<spotLocation netElementRef="{element}" {where}</spotLocation>'
    return f'<operationalPoint id="op_{name}"><name name="{name}" language="en"/>{spot}</operationalPoint>'


RAILML = f"""<?xml version="1.0" encoding="UTF-8"?>
<railML xmlns="https://www.railml.org/schemas/3.2" version="3.2"><infrastructure id="is">
<topology><netElements>
{net_element("n1", 0, 500)}{net_element("n2", 0, 500)}{net_element("n3", 500, 700)}
{net_element("n4", 700, 4300, ' length="3600.0"')}
<netElement id="g1"><elementCollectionUnordered><elementPart ref="n1"/></elementCollectionUnordered></netElement>
</netElements><netRelations>
{relation("n1", 1, "n2", 1, "None")}{relation("n1", 1, "n3", 0)}{relation("n2", 1, "n3", 0)}
{relation("n3", 1, "n4", 0)}{relation("g1", 0, "n4", 0)}
</netRelations></topology>
<geometry><gradientCurves>
{located("gradientCurve", 'curveType="straight" gradient="12.5"', 'netElementRef="n4" posBegin="300" posEnd="900">')}
</gradientCurves><horizontalCurves>
{located("horizontalCurve", 'radius="-400"', 'netElementRef="n4" intrinsicCoordBegin="0.5" intrinsicCoordEnd="0.75">')}
</horizontalCurves></geometry>
<functionalInfrastructure><speeds>
{located("speedSection", 'vMax="80"', measured("n3", 600, 700), measured("n4", 700, 4300), direction="normal")}
{located("speedSection", 'maxSpeed="60" isTemporary="false"', measured("n4", 1000, 700), direction="reverse")}
{located("speedSection", 'maxSpeed="20" isTemporary="true"', measured("n4", 2400, 2550), direction="normal")}
</speeds><operationalPoints>
{point("Alder", "g1", '><linearCoordinate positioningSystemRef="lps" measure="300.0"/>')}
{point("Birch", "n4", 'pos="3500.0">')}
</operationalPoints><signals/></functionalInfrastructure></infrastructure></railML>
"""


@pytest.fixture
def railml(tmp_path: Path) -> Path:
    file = tmp_path / "line.railml"
    file.write_text(RAILML)
    return file


def test_a_railml_path_by_hand(railml: Path) -> None:
    """Breaks if one of the three forms of a location, a sign, a unit or the direction of a limit is read wrongly."""
    line = load_line(f"{railml}:Alder..Birch")
    assert line.end == 4300
    assert [(e.at, e.grade) for e in line.grades] == [(0, 0), (1000, 0.0125), (1600, 0)]
    assert [(e.begin, e.end, e.radius, e.side) for e in line.curves] == [(2500, 3400, 400, "left")]
    assert [(e.at, 3.6 * e.speed) for e in line.speed_limits] == [(0, pytest.approx(80))]
    assert [(e.begin, e.end, 3.6 * e.speed) for e in line.temporary_restrictions] == [(2400, 2550, pytest.approx(20))]
    assert [(e.at, e.name) for e in line.stops] == [(300, "Alder"), (4200, "Birch")]
    back = load_line(f"{railml}:Birch..n2")
    assert [(e.at, e.grade) for e in back.grades] == [(0, 0), (2700, -0.0125), (3300, 0)]
    assert [(e.begin, e.side) for e in back.curves] == [(900, "right")] and back.temporary_restrictions == ()
    assert {round(3.6 * e.speed) for e in back.speed_limits} == {60}
    assert "functionalInfrastructure.signals" in named_line(f"{railml}:n1..n4").left_out
    with pytest.raises(ValueError, match="no path between these tracks"):
        load_line(f"{railml}:n1..n2")


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("<railML", '<!DOCTYPE railML [<!ENTITY a "b">]><railML', "document types and entities are refused"),
        ("</railML>", "", "not valid XML"),
        ('version="3.2"', 'version="2.4"', "version = '2.4': must be 3"),
        ("<railML", "<kml", "not valid XML"),
        ("infrastructure", "interlocking", "infrastructure: this element is missing"),
        ('gradient="12.5"', 'gradient="steep"', "gradient = 'steep': must be a number"),
        ('posBegin="300"', 'posBegin="9999"', "posBegin = 9999: must lie between"),
        ('measure="2400"', 'measure="24000"', "outside its linear coordinates"),
    ],
)
def test_a_faulty_railml_file_is_refused_in_one_line(railml: Path, before: str, after: str, message: str) -> None:
    """Breaks if an entity is expanded, or a fault ends in a traceback."""
    railml.write_text(RAILML.replace(before, after))
    with pytest.raises(ValueError, match=message) as caught:
        load_line(f"{railml}:n1..n4")
    assert "\n" not in str(caught.value) and str(railml) in str(caught.value)


def with_tunnels_and_power(tunnel: str = 'crossSection="42.5"') -> str:
    """Return the file with a tunnel over two net elements, a bridge, and power but for 400 m on the element n4."""
    tun = located(
        "overCrossing", 'id="tun" constructionType="tunnel"', measured("n3", 650, 700), measured("n4", 700, 1200)
    ).replace("</overCrossing>", f"<tunnelResistance {tunnel}><resistanceFactor/></tunnelResistance></overCrossing>")
    bridge = located("overCrossing", 'id="brd" constructionType="bridge"', measured("n4", 3000, 3020))
    live = located("electrificationSection", 'id="e1"', measured("n1", 0, 500), measured("n3", 500, 700))
    dead = located("electrificationSection", 'id="e3" isInsulatedSection="true"', measured("n4", 2000, 2060))
    none = located("electrificationSection", 'id="e4" contactLineType="none"', measured("n4", 4000, 4300))
    rest = [
        located("electrificationSection", 'contactLineType="overhead"', measured("n4", *extent))
        for extent in ((700, 2000), (2060, 3000), (3400, 4000))
    ]
    rest[0] = rest[0].replace("</electr", '<energyCatenary allowsRegenerativeBraking="false"/></electr')
    power = f"<electrifications>{live}{dead}{none}{''.join(rest)}</electrifications>"
    return RAILML.replace("<signals/>", f"<signals/><overCrossings>{tun}{bridge}</overCrossings>{power}")


def test_tunnels_and_electrification_of_railml(railml: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a tunnel is dropped, a bridge is one, a piece without power is driven, or a loss has no name."""
    railml.write_text(with_tunnels_and_power())
    read = named_line(f"{railml}:n1..Birch")
    assert [(e.begin, e.end, e.cross_section) for e in read.line.tunnels] == [(650, 1200, 42.5)]
    neutral = [(e.begin, e.end, e.electric_brake) for e in read.line.neutral_sections]
    assert neutral == [(2000, 2060, False), (3000, 3400, False), (4000, 4300, False)]
    assert "no electrificationSection from 3000 to 3400 m of the path" in capsys.readouterr().err
    lost = [key.rpartition(".")[2] for key in read.left_out]
    assert lost == ["signals", "resistanceFactor", "energyCatenary"]
    back = load_line(f"{railml}:Birch..n1")
    assert [(e.begin, e.end) for e in back.tunnels] == [(3100, 3650)]
    own = railml.with_suffix(".yaml")
    assert main(["convert", f"{railml}:n1..Birch", str(own)]) == 0
    assert load_line(str(own)) == read.line
    railml.write_text(with_tunnels_and_power('wallConstructionType="rock"'))
    assert [(e.cross_section, e.resistance_n_per_kn) for e in load_line(f"{railml}:n1..Birch").tunnels] == [(None, 0)]
    assert "tunnel tun: it has no cross section" in capsys.readouterr().err
    railml.write_text(with_tunnels_and_power('crossSection="-3"'))
    with pytest.raises(ValueError, match="tunnelResistance: crossSection = -3: must lie between 1 and 1000"):
        load_line(f"{railml}:n1..Birch")
    railml.write_text(RAILML)
    assert load_line(f"{railml}:n1..Birch").neutral_sections == ()


def test_a_chain_of_tracks_needs_no_selection(tmp_path: Path) -> None:
    """Breaks if a network without branches is refused, or its tracks are not in order."""
    chain = INFRA | {"switches": [{"id": "l", "switch_type": "link", "ports": ends("TD0/END", "TE/END")}]}
    chain["track_sections"] = INFRA["track_sections"][2:]
    chain["operational_points"] = []
    file = tmp_path / "chain.json"
    file.write_text(json.dumps(chain))
    assert load_line(str(file)).end == 26500 and load_line(f"{file}:reverse").end == 26500
