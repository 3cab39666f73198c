"""Lines from networks of tracks in the layouts of OSRD and railML; all figures but those of TD0 are chosen here.

Length and gradients of TD0 are those of ``tests/data/infras/etcs_infra`` of OSRD (Open Rail Association, LGPL-3.0).
"""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import yaml
from engine_runs import setup_of
from refusals import one_line

from plant_sim.formats import osrd
from plant_sim.library import load_consist, load_line, named_line
from plant_sim.line import Rating, line_for, reversed_line
from train_ato.api.converting import convert
from train_ato.api.planning import plan
from train_ato.cli.main import main


def ends(*names: str) -> dict[str, Any]:
    """Return ports A, B, ... of a switch: ``track/END``."""
    ports = ("A", "B1", "B2") if len(names) > 2 else ("A", "B")
    parts = (name.partition("/") for name in names)
    return {port: {"track": part[0], "endpoint": part[2]} for port, part in zip(ports, parts, strict=True)}


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
    """Breaks if a track against the path keeps signs or places, or a limit or section of the other direction holds."""
    line = load_line(f"{infra}:TA..East")
    there, back = load_line(f"{infra}:East..TA"), reversed_line(line)
    assert (there.grades, there.curves, there.stops) == (back.grades, back.curves, back.stops)
    assert (22500, 10) in [(e.at, e.speed) for e in there.speed_limits] and there.neutral_sections == ()
    assert (line.begin, line.end) == (0, 28500)
    assert [(e.at, round(1e3 * e.grade, 9)) for e in line.grades] == [
        (0, 0), (8000, 3), (9000, 6), (10000, 3), (11000, 0), (16000, -3), (17000, -6), (18000, -3), (19000, 0),
    ]  # fmt: skip
    assert [(e.begin, e.end, e.radius, e.side) for e in line.curves] == [(28000, 28300, 600, "right")]
    assert [(e.at, e.speed) for e in line.speed_limits] == [(0, 40), (3000, 20), (4000, 40)]
    assert [(e.begin, e.end) for e in line.neutral_sections] == [(28350, 28400)]
    assert [(e.at, e.name) for e in line.stops] == [(500, "West"), (27500, "East")]
    assert load_line(f"{infra}:West..East").end == 28450, "the shorter of two tracks"


def test_limits_by_train_category_are_those_of_the_train(infra: Path, tmp_path: Path) -> None:
    """Breaks if a limit by tag is lost, holds for all trains, or is that of another direction or place."""
    found = load_line(f"{infra}:TA..East")
    freight = line_for(found, ["D4", "freight"])
    assert [(e.at, e.speed) for e in freight.speed_limits] == [(0, 5), (9, 40), (3000, 20), (4000, 40)]
    assert line_for(found, ["D4"]) == found == line_for(found, [])
    back = line_for(reversed_line(found), ["freight"])
    assert [(e.at, e.speed) for e in back.speed_limits] == [(0, 40), (24500, 20), (25500, 40), (28491, 5)]
    own = tmp_path / "own.yaml"
    assert main(["convert", f"{infra}:TA..East", str(own)]) == 0 and load_line(str(own)) == found


def test_a_plan_and_a_run_have_the_limits_of_the_category(tmp_path: Path) -> None:
    """Breaks if the categories of a train have no effect in a plan or in a run, or one of another train has."""
    data = load_consist("xuzhou_metro_3").model_dump(by_alias=True, mode="json", exclude_unset=True)
    line = {
        "schema": "train_ato/line/1", "name": "l", "end": 2000.0, "speed_limits": [{"at": 0, "speed": 20.0}],
        "category_limits": [
            {"category": "freight", "speed_limits": [{"at": 0, "speed": 5.0}]},
            {"category": "light", "needs": {"axle_load_t": 18}, "speed_limits": [{"at": 0, "speed": 19.0}]},
        ],
    }  # fmt: skip
    (tmp_path / "line.yaml").write_text(yaml.safe_dump(line))
    times = {}
    for name, change, limit in (
        ("any", {}, 20), ("freight", {"categories": ["freight"]}, 5), ("light", {"rating": {"axle_load_t": 16}}, 19),
    ):  # fmt: skip
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(data | change))
        times[name] = plan(tmp_path / "line.yaml", tmp_path / f"{name}.yaml").running_time
        scenario = {
            "schema": "train_ato/scenario/1", "name": name, "duration": 8,
            "plant": {"consist": f"{name}.yaml", "line": "line.yaml", "start": {"position": 200}},
            "profile": {"phases": [{"cruise_for": 2}, {"accelerate_to": 2}, {"brake_to": 0}]},
        }  # fmt: skip
        (tmp_path / "s.yaml").write_text(yaml.safe_dump(scenario))
        assert setup_of(str(tmp_path / "s.yaml")).line.speed_limits[0].speed == limit
    assert times["any"] < times["light"] < 160 and times["freight"] > 2000 / 5


def test_tracks_without_electrification_have_no_traction_power(infra: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a train draws power where the file has no overhead line, or its voltage is lost without a word."""
    power = {"id": "e", "voltage": "25000V", "track_ranges": [part("TA", 0, 2000), part("TD0", 0, 24000)]}
    infra.write_text(json.dumps(INFRA | {"electrifications": [power]}))
    for selection, sections in (("TA..East", [(26000, 28500), (28350, 28400)]), ("TE..TA", [(0, 2500)])):
        read = named_line(f"{infra}:{selection}")
        assert [(e.begin, e.end) for e in read.line.neutral_sections] == sections
        assert "electrifications[].voltage" in read.left_out
    assert "no electrification from 26000 to 28500 m of the path; assumed to have no" in capsys.readouterr().err


def test_gaps_and_keys_that_are_not_carried_are_named(infra: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if an assumed speed limit or a lost key is silent."""
    assert main(["convert", f"{infra}:TB..East", str(infra.with_suffix(".yaml")), "--json"]) == 0
    printed = capsys.readouterr()
    assert "no speed limit from 0 to 1950 m of the path; assumed 72 km/h" in printed.err
    left = json.loads(printed.out)["left_out"]
    for key in ("track_sections[].geo", "neutral_sections[].lower_pantograph"):
        assert key in left and f"{key}\n" in printed.err
    assert load_line(str(infra.with_suffix(".yaml"))) == load_line(f"{infra}:TB..East")


def test_limits_in_km_h_are_told(infra: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if 80 km/h in a file in m/s is 288 km/h without a word, or a real limit of 300 km/h is doubted."""
    sections = INFRA["speed_sections"]
    for speed, told in ((80.0, True), (300 / 3.6, False), (40.0, False)):
        infra.write_text(json.dumps(INFRA | {"speed_sections": [sections[0] | {"speed_limit": speed}]}))
        load_line(f"{infra}:TA..TD0")
        assert ("speed 80 is 288 km/h; check its unit" in capsys.readouterr().err) == told
    load_line(f"{infra}:TA..East")
    assert "to the side" not in capsys.readouterr().err
    infra.write_text(json.dumps(INFRA | {"speed_sections": [sections[0] | {"speed_limit": 80.0}]}))
    load_line(f"{infra}:TA..East")
    assert "10.7 m/s² to the side at 28000 m, with 288 km/h on a radius of 600 m" in capsys.readouterr().err


def test_a_line_as_railml_and_back(infra: Path, railml: Path, tmp_path: Path) -> None:
    """Breaks if a number of a line changes on its way through railML, or a gap is filled without a word."""
    power = {"id": "e", "track_ranges": [part("TA", 0, 2000), part("TD0", 0, 24000), part("TE", 0, 1500)]}
    infra.write_text(json.dumps(INFRA | {"electrifications": [power]}))
    for number, source in enumerate((f"{infra}:TA..East", f"{railml}:Alder..Birch", f"{railml}:Birch..Alder")):
        convert(source, tmp_path / f"{number}.railml")
        one, two = load_line(source), load_line(str(tmp_path / f"{number}.railml"))
        assert two == one.model_copy(update={"name": two.name, "source": two.source})
    line = {
        "schema": "train_ato/line/1", "name": "l", "begin": 100.0, "end": 3000.0, "stops": [{"at": 50}, {"at": 200}],
        "speed_limits": [{"at": 500, "speed_kmh": 80}], "grades": [{"at": 0, "grade_permille": 5}],
        "category_limits": [{"category": "<a>", "needs": {"axle_load_t": 18}, "speed_limits": [{"at": 0, "speed": 9}]}],
        "curves": [{"begin": 2900, "end": 3100, "radius": 300, "side": "left"}],
    }  # fmt: skip
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(line))
    left = convert(tmp_path / "own.yaml", tmp_path / "own.railml")["left_out"]
    assert left == [
        "begin = 100 m (now 0)", "speed_limits: none to 500 m (a reader takes the lowest one there)",
        "grades: beyond the line", "curves: beyond the line", "stops: beyond the line",
    ]  # fmt: skip
    back = load_line(str(tmp_path / "own.railml"))
    (category,) = back.category_limits
    assert category.category == "<a>" and category.needs == Rating(axle_load=18e3)
    assert [(e.begin, e.end, e.side) for e in back.curves] == [(2800, 2900, "left")] and len(back.stops) == 1
    assert [(e.at, e.grade) for e in back.grades] == [(0, 0.005)] and back.end == 2900


@pytest.mark.parametrize(("selection", "message"), [
    ("", "a network of 4 tracks with branches; name the line as FILE:FROM..TO"),
    (":TA..North", "'North' is no track or station; it has West, East, TA"),
    (":TA..TB", "no path between these tracks"), (":TA", "write FROM..TO"),
])  # fmt: skip
def test_a_wrong_selection_is_refused_with_the_names(infra: Path, selection: str, message: str) -> None:
    """Breaks if a train could turn back at a switch, or a wrong name ends in a traceback."""
    with one_line(message, str(infra)):
        load_line(f"{infra}{selection}")


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


def with_profile(text: str, values: str, figures: str, *sections: str) -> str:
    """Return a file with a speed profile s1 named x, and speed sections of which the last is that of the profile."""
    own = sections[-1].replace("<linear", '<validForSpeedProfile ref="s1"/><linear', 1)
    profile = f'<speedProfile id="s1" {values}><name name="x" language="en"/>{figures}</speedProfile>'
    speeds = "".join((*sections[:-1], own))
    text = text.replace("<infra", f"<common><speedProfiles>{profile}</speedProfiles></common><infra", 1)
    return text.replace("</speeds>", f"{speeds}</speeds>")


def test_railml_limits_of_speed_profiles_are_those_of_categories(railml, capsys):
    """Breaks if a section of one profile slows all trains, or a train without a profile has no limit anywhere."""
    whole = located(
        "speedSection", 'vMax="80"', measured("n3", 600, 700), measured("n4", 700, 4300), direction="normal"
    )
    tilting = located("speedSection", 'maxSpeed="100" trainRelation="headOfTrain"', measured("n4", 1000, 2000))
    text = with_profile(RAILML, "", "", tilting)
    railml.write_text(text)
    line = load_line(f"{railml}:Alder..Birch")
    (category,) = line.category_limits
    limits = [(e.at, round(3.6 * e.speed)) for e in category.speed_limits]
    assert (category.category, limits) == ("x", [(0, 80), (1000, 100), (2000, 80)])
    assert {round(3.6 * e.speed) for e in line.speed_limits} == {80}
    told = "trainRelation = 'headOfTrain': the part of the train that the speed holds for; here it holds for its whole"
    assert told in capsys.readouterr().err
    railml.write_text(text.replace(whole, ""))
    assert {round(3.6 * e.speed) for e in load_line(f"{railml}:Alder..Birch").speed_limits} == {100}
    assert "some only for speed profiles; other trains have the lowest of them there" in capsys.readouterr().err
    railml.write_text(text.replace('ref="s1"', 'ref="s2"'))
    with pytest.raises(ValueError, match="validForSpeedProfile: ref = 's2': not in the file"):
        load_line(f"{railml}:Alder..Birch")


@pytest.mark.parametrize(("values", "profile", "kmh", "of", "told"), [
    ("", '<load axleLoad="16"/>', 100, {"light": 100, "heavy": 80, "x": 100}, ""),
    ("", '<load axleLoad="16"/><braking minimumBrakePercentage="130"/>', 100, {"light": 80, "x": 80}, ""),
    ("", '<load axleLoad="16"/><tilting/>', 100, {"light": 80, "x": 100}, ""),
    ('influence="decreasing"', '<load axleLoad="22.5"/>', 50, {"light": 50, "heavy": 50, "x": 50},
     "speedProfile s1: its lower limits hold for trains of no category too"),
])  # fmt: skip
def test_figures_of_a_speed_profile_are_those_that_a_train_needs(values, profile, kmh, of, told, tmp_path, capsys):
    """Breaks if a train without the axle load or the brakes of a profile has its speed, or a lower one spares it."""
    sections = [located("speedSection", f'maxSpeed="{speed}"', 'netElementRef="e">') for speed in (80, kmh)]
    speeds = "<functionalInfrastructure><speeds></speeds></functionalInfrastructure></infra"
    file = Path(geometry(tmp_path / "a.railml", ""))
    file.write_text(with_profile(file.read_text().replace("</infra", speeds), values, profile, *sections))
    line = load_line(str(file))
    trains = {"light": Rating(axle_load=16e3), "heavy": Rating(axle_load=20e3), "x": Rating(axle_load=9e3)}
    for name, speed in of.items():
        found = line_for(line, [name], trains[name]).speed_limits
        assert [round(3.6 * entry.speed) for entry in found] == [speed], name
    assert told in capsys.readouterr().err


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
    lost = [key.rpartition(".")[2] for key in read.left_out if not key.endswith(("@id", "@language"))]
    expected = ["signals", "resistanceFactor", "energyCatenary"]
    assert [name for name in lost if not name.startswith("@")] == expected
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


def test_a_location_against_its_net_element_turns_the_sign(railml: Path) -> None:
    """Breaks if an end before the begin is refused although keepsOrientation says it, or the sign is not turned."""
    turned = 'keepsOrientation="false" posBegin="900" posEnd="300"'
    railml.write_text(RAILML.replace('posBegin="300" posEnd="900"', turned))
    assert [(e.at, e.grade) for e in load_line(f"{railml}:Alder..Birch").grades][1:] == [(1000, -0.0125), (1600, 0)]


def test_the_track_of_a_station_with_several_is_named(infra: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if one of two stations of one name is chosen without a word."""
    data = json.loads(infra.read_text())
    data["operational_points"].append(station("East", ("TD0", 100.0)))
    infra.write_text(json.dumps(data))
    assert load_line(f"{infra}:TA..East").end == 27_000
    assert "infra.json: 'East' is on the tracks TD0, TE; the path ends on TD0" in capsys.readouterr().err


def test_a_chain_of_tracks_needs_no_selection(infra: Path) -> None:
    """Breaks if a network without branches is refused, or its tracks are not in order."""
    limits = [
        {"id": "s", "speed_limit": 30.0, "track_ranges": [part("TD0", 0, 25000), part("TE", 0, 1500)]},
        {"id": "t", "speed_limit": 9.0, "track_ranges": [part("TE", 0, 100, "START_TO_STOP")]},
    ]
    chain = {"track_sections": INFRA["track_sections"][2:], "operational_points": [], "speed_sections": limits}
    infra.write_text(json.dumps(INFRA | chain | {"switches": INFRA["switches"][1:]}))
    there, back = load_line(str(infra)), load_line(f"{infra}:reverse")
    assert there.end == 26500 and [(e.at, e.speed) for e in there.speed_limits] == [(0, 30)]
    assert back.end == 26500 and [(e.at, e.speed) for e in back.speed_limits] == [(0, 9), (100, 30)]


LOOP: dict[str, Any] = {
    "version": "3.5.0",
    "track_sections": [
        track("A", 1000, [(5, 0, 1000)]), track("C", 2000, [(10, 0, 1500)], [(400, 500, 600)]),
        track("L", 800, (), [(130, 0, 800)]),
    ],
    "switches": [
        {"id": "s1", "switch_type": "link", "ports": ends("A/END", "C/BEGIN")},
        {"id": "s2", "switch_type": "point_switch", "ports": ends("C/END", "L/BEGIN", "L/END")},
    ],
    "speed_sections": [
        {"id": "v", "speed_limit": 20, "track_ranges": [part("A", 0, 1000), part("C", 0, 2000), part("L", 0, 800)]},
        {"id": "slow", "speed_limit": 8, "track_ranges": [part("C", 0, 300)]},
        {"id": "out", "speed_limit": 5, "track_ranges": [part("C", 1000, 1100, "START_TO_STOP")]},
    ],
    "neutral_sections": [{"id": "n", "track_ranges": [part("C", 700, 750)]}],
    "operational_points": [station("West", ("A", 500)), station("Mid", ("C", 400))],
}  # fmt: skip
"""Tracks A and C to a balloon loop L; a train comes back over C, and A is its end."""


def test_a_track_that_the_path_passes_twice_is_whole_at_both_passages() -> None:
    """Breaks if a grade, curve, limit, section or station of the first passage is lost, or has the later direction."""
    lead = LOOP | {"track_sections": [*LOOP["track_sections"], track("B", 1500)]}
    switch = {"id": "s1", "switch_type": "point_switch", "ports": ends("C/BEGIN", "A/END", "B/END")}
    lead["switches"] = [switch, LOOP["switches"][1]]
    line = osrd.osrd_line(lead, "loop.json", "A..B")
    assert line.end == 7300
    grades = [(0, 0.005), (1000, 0.01), (2500, 0), (4300, -0.01), (5800, 0)]
    assert [(e.at, e.grade) for e in line.grades] == grades
    curves = [(1500, 1600, 400, "right"), (3000, 3800, 130, "left"), (5200, 5300, 400, "left")]
    assert [(e.begin, e.end, e.radius, e.side) for e in line.curves] == curves
    limits = [(0, 20), (1000, 8), (1300, 20), (2000, 5), (2100, 20), (5500, 8), (5800, 5)]
    assert [(e.at, e.speed) for e in line.speed_limits] == limits, "5 m/s: the lowest one, where B has none"
    assert [(e.begin, e.end) for e in line.neutral_sections] == [(1700, 1750), (5050, 5100)]
    assert [(e.at, e.name) for e in line.stops] == [(500, "West"), (1400, "Mid"), (5400, "Mid")]
    lead["track_sections"][1] = track("C", 2000, [(10, 0, 1500)] * 2, [(400, 500, 560), (400, 550, 600)])
    again = osrd.osrd_line(lead, "loop.json", "A..B")
    assert (again.curves, again.grades) == (line.curves, line.grades), "a curve given twice has its resistance once"


RAIL_LOOP = f"""<railML version="3.2"><infrastructure id="is"><topology><netElements>
<netElement id="a" length="1000"/><netElement id="b" length="1500"/><netElement id="c" length="2000"/>
<netElement id="l" length="800"/></netElements><netRelations>
{relation("a", 1, "c", 0)}{relation("b", 1, "c", 0)}{relation("c", 1, "l", 0)}{relation("c", 1, "l", 1)}
</netRelations></topology><geometry><gradientCurves>
{located("gradientCurve", 'gradient="10"', 'netElementRef="c" posBegin="0" posEnd="1500">')}
</gradientCurves><horizontalCurves>
{located("horizontalCurve", 'radius="400"', 'netElementRef="c" posBegin="500" posEnd="600">')}
</horizontalCurves></geometry><functionalInfrastructure><speeds>
{located("speedSection", 'maxSpeed="72"', *(f'netElementRef="{name}">' for name in "abcl"))}
{located("speedSection", 'maxSpeed="18"', 'netElementRef="c" posBegin="1000" posEnd="1100">', direction="normal")}
{located("speedSection", 'maxSpeed="9" isTemporary="true"', 'netElementRef="c" posBegin="0" posEnd="100">')}
</speeds><operationalPoints>{point("Mid", "c", 'pos="400">')}</operationalPoints>
<overCrossings>{located("overCrossing", 'constructionType="tunnel"', 'netElementRef="c" posBegin="800" posEnd="900">')}
</overCrossings><electrifications>
{located("electrificationSection", 'id="e"', *(f'netElementRef="{name}">' for name in "abcl"))}
{located("electrificationSection", 'isInsulatedSection="true"', 'netElementRef="c" posBegin="700" posEnd="750">')}
</electrifications></functionalInfrastructure></infrastructure></railML>"""


def located_2(name: str, rows: str, kind: str) -> str:
    """Return changes of railML 2: ``pos key=value ...`` per row."""
    entries = [row.split(" ", 1) for row in rows.split("; ")]
    text = "".join(f'<{kind} id="{name}{at}" pos="{at}" {keys}/>' for at, keys in entries)
    return f"<{kind}s>{text}</{kind}s>"


SPEEDS = '100 dir="up" vMax="72"; 400 dir="up" vMax="36"; 500 dir="up" vMax="end"; 1100 dir="down" vMax="54"'
WIRES = '100 type="overhead"; 800 type="overhead" isolatedSection="true"; 850 type="overhead"'
RAIL_2 = f"""<railml xmlns="https://www.railml.org/schemas/2021" version="2.5"><infrastructure id="is"><tracks>
<track id="t1" name="main"><trackTopology><trackBegin id="b1" pos="100" absPos="5100"><macroscopicNode ocpRef="w"/>
</trackBegin><trackEnd id="e1" pos="1100"><connection id="c1" ref="c3"/></trackEnd><connections>
<switch id="s1" pos="700"><connection id="cs" ref="c2" orientation="outgoing" course="left"/></switch></connections>
<crossSections><crossSection id="x" pos="300" ocpRef="m"/></crossSections></trackTopology><trackElements>
{located_2("v", SPEEDS, "speedChange")}
{located_2("g", '100 slope="5"; 600 slope="-8"; 900 slope="0"', "gradientChange")}
{located_2("r", '200 radius="0"; 300 radius="-500"; 500 radius="0"', "radiusChange")}
{located_2("e", WIRES, "electrificationChange")}
<tunnels><tunnel id="u" pos="950" length="100" crossSection="40"/></tunnels></trackElements></track>
<track id="t2"><trackTopology><trackBegin id="b2" pos="0"><connection id="c2" ref="cs"/></trackBegin>
<trackEnd id="e2" pos="400"><bufferStop id="bs"/></trackEnd></trackTopology><trackElements>
{located_2("w", '0 vMax="40" profileRef="p"', "speedChange")}{located_2("h", '0 slope="2"', "gradientChange")}
</trackElements></track>
<track id="t3"><trackTopology><trackBegin id="b3" pos="0"><connection id="c3" ref="c1"/></trackBegin>
<trackEnd id="e3" pos="500"><macroscopicNode ocpRef="o" flowDirection="both"/></trackEnd></trackTopology></track>
</tracks><operationControlPoints><ocp id="w" name="West"/><ocp id="m" name="Mid"/><ocp id="o"/>
</operationControlPoints><speedProfiles><speedProfile id="p" name="heavy" influence="increasing" maxAxleLoad="22.5">
<braking minimumBrakePercentage="60"/></speedProfile></speedProfiles></infrastructure></railml>"""
"""Network of railML 2 with made-up data: t1 with a switch to t2, and t3 behind it."""


def test_a_network_of_railml_2_by_hand(railml: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a value of railML 2 has another extent, sign or direction, or a switch leads elsewhere."""
    railml.write_text(RAIL_2)
    line = load_line(f"{railml}:West..t3")
    assert line.end == 1500 and [(e.at, e.name) for e in line.stops] == [(0, "West"), (200, "Mid"), (1500, "o")]
    assert [(e.at, e.grade) for e in line.grades] == [(0, 0.005), (500, -0.008), (800, 0)]
    assert [(e.begin, e.end, e.radius, e.side) for e in line.curves] == [(200, 400, 500, "left")]
    assert [(e.at, round(e.speed, 9)) for e in line.speed_limits][:1] == [(0, 20)]
    assert [(e.begin, e.end, e.speed) for e in line.temporary_restrictions] == [(300, 400, 10)]
    assert [(e.begin, e.end, e.cross_section) for e in line.tunnels] == [(850, 950, 40)]
    assert [(e.begin, e.end) for e in line.neutral_sections] == [(700, 750), (1000, 1500)]
    back = load_line(f"{railml}:t3..West")
    assert [round(e.speed, 9) for e in back.speed_limits][:1] == [15] and not back.temporary_restrictions
    assert [(e.at, e.grade) for e in back.grades] == [(0, 0), (700, 0.008), (1000, -0.005)]
    branch = load_line(f"{railml}:t1..t2")
    assert branch.end == 1000 and branch.category_limits[0].category == "heavy"
    assert branch.category_limits[0].needs is not None and branch.category_limits[0].needs.axle_load == 22.5e3
    assert main(["convert", f"{railml}:West..t3", str(railml.parent / "own.yaml")]) == 0
    told = capsys.readouterr()
    assert "railML 2" in told.out + told.err and "trackBegin.@absPos" in told.out + told.err
    assert load_line(str(railml.parent / "own.yaml")).grades == line.grades
    for old, new, words in (
        ('ref="c2" ori', 'ref="zz" ori', "ref = 'zz': no connection of the file"),
        ('"outgoing"', '"left"', "orientation = 'left': must be incoming or outgoing"),
        ('pos="950" length="100"', 'pos="950" length="900"', "tunnel u: it ends beyond the track t1"),
        ('slope="5"', 'slope="x"', "gradientChange g100: slope = 'x': is not a number"),
        ("600 slope".replace(" ", '" '), '600" dir="down" slope', "dir = 'down': its sign is not known"),
        ('pos="400" dir', 'pos="1400" dir', "speedChange v400: pos = 1400: must lie between 100 and 1100"),
        ('pos="700"', 'pos="100"', "switch s1: pos: outgoing at the begin of its track"),
        ('pos="600" slope', 'pos="100" slope', "gradientChange g600: pos = 100: another value there; keep one"),
        ('slope="5"', 'slope="501"', "gradientChange g100: slope = 501: must lie between -500 and 500"),
        ('vMax="36"', 'vMax="0"', "speedChange v400: vMax = 0: must lie between 0.1 and 1000"),
        ('dir="down"', 'dir="both"', "track t1: speedChange: dir = 'both': must be up or down"),
    ):
        assert RAIL_2.count(old) == 1, old
        railml.write_text(RAIL_2.replace(old, new))
        with pytest.raises(ValueError, match=words):
            load_line(f"{railml}:West..t3")


@pytest.mark.parametrize(("way", "sign"), [("up", 1), ("down", -1)])
def test_speeds_of_railml_2_at_one_place_have_an_order(railml: Path, way: str, sign: int) -> None:
    """Breaks if a restriction that ends where another one begins is permanent, or a row given twice ends none."""
    begin = 0 if sign > 0 else 1000
    rows = [(100, "40"), (100, "40"), (300, "30"), (300, "end"), (100, "80"), (0, "90"), (500, "end")]
    changes = "; ".join(f'{begin + sign * at} dir="{way}" vMax="{speed}"' for at, speed in rows)
    ends = '<trackTopology><trackBegin pos="0"/><trackEnd pos="1000"/></trackTopology>'
    text = f'<railml version="2.2"><infrastructure><track id="t">{ends}{located_2("v", changes, "speedChange")}'
    railml.write_text(f"{text}</track></infrastructure></railml>", encoding="utf-16")
    line = load_line(f"{railml}{':reverse' if sign < 0 else ''}")
    assert [(e.at, round(3.6 * e.speed)) for e in line.speed_limits] == [(0, 90), (100, 80)]
    restrictions = [(e.begin, e.end, round(3.6 * e.speed)) for e in line.temporary_restrictions]
    assert restrictions == [(100, 300, 40), (300, 500, 30)]


def test_a_turn_on_the_way_is_two_lines(railml: Path) -> None:
    """Breaks if a path that a train runs by a turn is refused without its two lines, or they do not exist."""
    railml.write_text(RAIL_2)
    with pytest.raises(ValueError, match=r"turns at 'West'.*as two lines, \S+:t2\.\.West and \S+:West\.\.t3"):
        load_line(f"{railml}:t2..West..t3")
    assert [load_line(f"{railml}:{path}").end for path in ("t2..West", "West..t3")] == [1000, 1500]


def test_crossings_and_macroscopic_nodes_of_railml_2(railml: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a train turns at a crossing of two tracks, or runs into a node against its flow."""
    ends = {
        "a": ('<macroscopicNode ocpRef="n" flowDirection="out"/>', '<connection id="ca" ref="in"/>'),
        "b": ('<connection id="cb" ref="on"/>', "<openEnd/>"),
        "m": ('<macroscopicNode ocpRef="n"/>', "<openEnd/>"),
        "k": ('<macroscopicNode ocpRef="n" flowDirection="in"/>', "<openEnd/>"),
    }
    crossing = '<connections><crossing id="x" pos="50"><connection id="in" ref="ca" orientation="incoming"/>'
    crossing += '<connection id="on" ref="cb" orientation="outgoing"/></crossing></connections>'
    text = "".join(
        f'<track id="{name}"><trackTopology><trackBegin pos="0">{first}</trackBegin><trackEnd pos="100">{last}'
        f"</trackEnd>{crossing if name == 'm' else ''}</trackTopology></track>"
        for name, (first, last) in ends.items()
    )
    head = '<railml version="2.2"><infrastructure><tracks>'
    railml.write_text(f'{head}{text}</tracks><operationControlPoints><ocp id="n"/></operationControlPoints>'
                      "</infrastructure></railml>")  # fmt: skip
    assert [load_line(f"{railml}:{path}").end for path in ("a..b", "m..a", "k..a", "k..m/2")] == [200, 150, 200, 200]
    assert "every track at this macroscopic node leads to every other" in capsys.readouterr().err
    for path in ("a..m/2", "a..k", "b..m/1"):
        with pytest.raises(ValueError, match="no path between these tracks"):
            load_line(f"{railml}:{path}")
    railml.write_text(railml.read_text().replace('id="x"', 'id="x" type="simpleSwitchCrossing"'))
    assert load_line(f"{railml}:a..m/2").end == 150


def test_a_net_element_that_the_path_passes_twice_is_whole_at_both_passages(railml: Path) -> None:
    """Breaks if railML keeps one passage only of any located datum, or a limit holds in both directions."""
    railml.write_text(RAIL_LOOP)
    for selection in ("a..b", "b..a:reverse"):
        line = load_line(f"{railml}:{selection}")
        assert [(e.at, e.grade) for e in line.grades] == [(0, 0), (1000, 0.01), (2500, 0), (4300, -0.01), (5800, 0)]
        assert [(e.begin, e.end, e.side) for e in line.curves] == [(1500, 1600, "right"), (5200, 5300, "left")]
        limits = [(0, 20), (2000, 5), (2100, 20)]
        assert [(e.at, round(e.speed, 9)) for e in line.speed_limits] == limits
        assert [(e.begin, e.end) for e in line.temporary_restrictions] == [(1000, 1100), (5700, 5800)]
        assert [(e.begin, e.end) for e in line.tunnels] == [(1800, 1900), (4900, 5000)]
        assert [(e.begin, e.end) for e in line.neutral_sections] == [(1700, 1750), (5050, 5100)]
        assert [(e.at, e.name) for e in line.stops] == [(1400, "Mid"), (5400, "Mid")]


def test_the_reversed_path_is_the_path_read_anew(infra: Path, railml: Path) -> None:
    """Breaks if ``:reverse`` of a network mirrors limits or neutral sections that hold in one direction."""
    paths = (infra, "TA", "East"), (infra, "East", "TB"), (infra, "West", "East"), (railml, "Alder", "Birch")
    for file, first, last in paths:
        one, other = load_line(f"{file}:{first}..{last}:reverse"), load_line(f"{file}:{last}..{first}")
        assert one.model_dump(exclude={"name"}) == other.model_dump(exclude={"name"})


def test_a_one_way_relation_is_run_in_its_direction_only(railml: Path) -> None:
    """Breaks if a path runs against the navigability of a net relation."""
    railml.write_text(RAILML.replace(relation("n3", 1, "n4", 0), relation("n3", 1, "n4", 0, "AB")))
    assert load_line(f"{railml}:n1..n4").end == 4300
    with pytest.raises(ValueError, match="no path between these tracks"):
        load_line(f"{railml}:n4..n1")
    with pytest.raises(ValueError, match="not navigable from n4 to n3; name another one FROM"):
        load_line(f"{railml}:n1..n4:reverse")


@pytest.mark.parametrize(
    ("unit", "length"), [("km", 4.3e6), ("metres", 4300), ("miles", 4300 * 1609.344), ("chains", 4300 * 20.1168)]
)
def test_measures_have_the_unit_of_their_system(railml: Path, unit: str, length: float) -> None:
    """Breaks if a measure in kilometres is read in metres: a line of 12.5 m in place of 12.5 km."""
    system = f'<common><positioning><linearPositioningSystem id="lps" units="{unit}"/></positioning></common>'
    text = RAILML.replace("<infrastructure", f"{system}<infrastructure", 1).replace(' length="3600.0"', "")
    text = text.replace("posBegin", "xBegin").replace("posEnd", "xEnd").replace(' pos="', ' intrinsicCoord="0')
    railml.write_text(text.replace("03500.0", "0.5"))
    line = load_line(f"{railml}:n1..n4")
    assert line.end == pytest.approx(length)
    assert line.temporary_restrictions[0].begin == pytest.approx(length * 2400 / 4300)
    railml.write_text(railml.read_text().replace(unit, "leagues"))
    with pytest.raises(ValueError, match="linearPositioningSystem lps: units = 'leagues': must be one of m, "):
        load_line(f"{railml}:n1..n4")


def curves(kind: str, *rows: tuple[str, float, float]) -> str:
    parts = [f'netElementRef="e" posBegin="{begin}" posEnd="{end}">' for _, begin, end in rows]
    return "".join(located(kind, row[0], where) for row, where in zip(rows, parts, strict=True))


def geometry(railml: Path, grades: str, bends: str = "") -> str:
    """Write one net element of 2 km with a geometry; return the name of its line."""
    railml.write_text(
        '<railML version="3.2"><infrastructure><topology><netElements><netElement id="e" length="2000"/></netElements>'
        f"</topology><geometry>{grades}{bends}</geometry></infrastructure></railML>"
    )
    return str(railml)


def test_arcs_of_gradient_and_transition_curves_are_linear_between_their_neighbours(railml: Path, capsys) -> None:
    """Breaks if an arc is level, as it was, or a chain of arcs, a direction or the height at its end is wrong."""
    arc = 'curveType="arc" deltaGradient="{}"'
    sag = curves("gradientCurve", ('gradient="-4"', 0, 500), (arc.format(10), 500, 540), (arc.format(-2), 540, 560))
    mixed, clothoid = 'curveType="mixed"', 'curveType="clothoid" radius="0"'
    bends = curves("horizontalCurve", (clothoid, 100, 140), ('radius="-500"', 140, 300), (mixed, 300, 400))
    line = load_line(name := geometry(railml, sag + curves("gradientCurve", ('gradient="4"', 560, 2000)), bends))
    expected = [(0, -4), (500, -1.5), (520, 3.5), (540, 5), (560, 4)]
    assert [(e.at, round(1e3 * e.grade, 9)) for e in line.grades] == expected
    assert "of the type mixed without a radius; straight there" in capsys.readouterr().err
    back = load_line(f"{name}:reverse")
    assert [(e.at, round(-1e3 * e.grade, 9)) for e in back.grades] == [
        (0, 4), (1440, 5), (1460, 3.5), (1480, -1.5), (1500, -4),
    ]  # fmt: skip
    found = [(e.begin, e.end, round(e.radius, 6), e.side) for e in line.curves]
    assert found == [(100, 120, 2000, "left"), (120, 140, 666.666667, "left"), (140, 300, 500, "left")]
    known = 'curveType="straight" gradient="10" deltaGradient="10"'
    assert load_line(geometry(railml, curves("gradientCurve", (known, 0, 2000)))).grades[0].grade == 0.01
    with pytest.raises(ValueError, match=r"gradientCurve: its gradient is not known: .* add gradient"):
        load_line(geometry(railml, curves("gradientCurve", (arc.format(10), 500, 540))))


def test_a_curve_without_a_radius_and_a_length_beside_its_measures_are_told(railml: Path, capsys) -> None:
    """Breaks if a curve becomes straight, or the places of a net element are scaled, without a word."""
    railml.write_text(RAILML.replace('radius="-400"', "").replace('length="3600.0"', 'length="3500.0"'))
    load_line(f"{railml}:Alder..Birch")
    railml.write_text(RAILML.replace('posBegin="300" posEnd="900"', 'posBegin="0.3" posEnd="0.9"'))
    load_line(f"{railml}:Alder..Birch")
    told = capsys.readouterr().err
    assert "gradientCurve: it is 0.6 m long; positions on a track are in m" in told
    assert "horizontalCurve: no radius, and no neighbour with one; straight there" in told
    assert "netElement n4: length 3500 m, its measures have 3600 m; places on it are scaled" in told


def sections(*rows: tuple[float, Any]) -> dict[str, Any]:
    return {"speed_sections": [{"id": "s", "speed_limit": speed, "track_ranges": [where]} for speed, where in rows]}


def other_a(slopes: Any, curves: Any = ()) -> dict[str, Any]:
    return {"track_sections": [track("A", 1000, slopes, curves), *LOOP["track_sections"][1:]]}


@pytest.mark.parametrize(("change", "message"), [
    (sections((8, part("A_", 1000, 2000))), r"speed_sections\[0\]: track_ranges\[0\]: track 'A_': no track of this"),
    (sections((8, part("A", 500, 20000))), "from 500 to 20000 m: beyond the track A of 1000 m; end it there"),
    (sections((8, part("A", -50, 200))), "from -50 to 200 m: beyond the track A"),
    (sections((8, part("A", 200, 100))), "end = 100: lies before begin 200; exchange them"),
    ({"neutral_sections": [{"track_ranges": [part("X", 0, 1)]}]}, "neutral_sections.*track 'X': no track"),
    ({"neutral_sections": [{"track_ranges": [part("C", 0, 9000)]}]}, "beyond the track C of 2000 m"),
    ({"operational_points": [station("Far", ("A", 4000))]}, "position = 4000: must lie between 0 and"),
    ({"track_sections": [track("A", 1000), track("A", 900)]}, "id = 'A': two tracks have this id"),
    (other_a([(5, 500, 2000)]), r"slopes\[0\]: from 500"),
    (other_a([(5, 0, 600), (-5, 500, 900)]),
     r"two grades from 500 to 600 m of the path, 0.005 and -0.005 .* correct one of them"),
    (other_a((), [(300, 0, 900), (-400, 50, 100)]),
     r"curves\[1\]: two radii from 50 to 100 m of the path, 300 and -400"),
    (other_a((), [(300, 0, 900), (0, 50, 100)]), r"curves\[1\]: two radii from 50 to 100 m of the path, 300 and 0"),
    (other_a((), [(-0.4, 0, 900)]), r"track_sections\[0\]: curves\[0\]: radius = -0.4: below 5 m; correct its unit"),
    ({"speed_sections": [{"speed_limit": 8}]}, r"speed_sections\[0\]: track_ranges: none, so its place is not"),
    ({"speed_sections": [{"speed_limit": 8, "track_ranges": []}]}, "track_ranges: none"),
    ({"neutral_sections": [{"track_ranges": None}]}, r"neutral_sections\[0\]: track_ranges: none"),
    ({"operational_points": [station("Far", ("A", 1001.5))]}, "position = 1001.5: must lie between 0 and 1000"),
    ({"speed_sections": {}}, "speed_sections = {}: must be a list; correct it$"),
    ({"track_sections": []}, "track_sections: empty; add the tracks"),
    ({"switches": [{"id": "x", "switch_type": "turntable", "ports": {}}]}, "type = 'turntable': must be one of link"),
    ({"switches": [{"id": "x", "switch_type": "link", "ports": ends("TX/END", "A/END")}]}, "not an end of a track"),
    ({"track_sections": [{"id": "A"}]}, "length: this key is missing"),
    ({"operational_points": [station("A", ("TX", 0))]}, "track 'TX' is not in track_sections"),
])  # fmt: skip
def test_an_entry_that_cannot_be_placed_is_refused(change: dict[str, Any], message: str) -> None:
    """Breaks if an entry vanishes, runs on over the next track, one of two values wins, or a fault has no key."""
    with one_line(f"^loop.json: .*{message}"):
        osrd.osrd_line(LOOP | change, "loop.json", "A..L")


@pytest.mark.parametrize(("before", "after", "message"), [
    ("<railML", '<!DOCTYPE railML [<!ENTITY a "b">]><railML', "document types and entities are refused"),
    ("</railML>", "", "not valid XML"),
    ('version="3.2"', 'version="1.1"', "version = '1.1': must be 2 or 3"),
    ("<railML", "<kml", "not valid XML"),
    ("infrastructure", "interlocking", "infrastructure: this element is missing"),
    ('gradient="12.5"', 'gradient="steep"', "gradient = 'steep': is not a number"),
    ('posBegin="300"', 'posBegin="9999"', "posBegin = 9999: must lie between"),
    ('measure="2400"', 'measure="24000"', "outside its linear coordinates"),
    ('netElementRef="n4" posBegin', 'netElementRef="n9" posBegin', "netElementRef = 'n9': not in the topology"),
    ('netElementRef="g1"', 'netElementRef="g9"', "operationalPoint op_Alder: netElementRef = 'g9': not in the"),
    ('ref="n3"', 'ref="n0"', "elementB: ref = 'n0': not in the topology"),
    ('navigability="None"', 'navigability="both"', "navigability = 'both': must be one of None, Both"),
    ('applicationDirection="normal"', 'applicationDirection="up"', "= 'up': must be one of both"),
    ('netElementRef="n4"><linearCoordinateBegin positioningSystemRef="lps" measure="2400"',
     'netElementRef="g1"><linearCoordinateBegin positioningSystemRef="lps" measure="2400"',
     "speedSection: netElement g1: measure 2400 to 2550 m: outside the linear coordinates of 'lps' of its parts"),
    ('id="n2"', 'id="n1"', "two net elements have this id"),
    ('posBegin="300" posEnd="900"', 'posBegin="900" posEnd="300"', "its end lies before its begin, and keeps"),
    ('netElementRef="n4" posBegin', 'keepsOrientation="no" netElementRef="n4" posBegin',
     "associatedNetElement n4: keepsOrientation = 'no': must be true or false; correct it"),
    ('isTemporary="true"', 'isTemporary="True"', "speedSection: isTemporary = 'True': must be true or false"),
    ('gradient="12.5"', 'gradient="1_2"', "gradient = '1_2': is not a number"),
    ("</infrastructure>", '</infrastructure><infrastructure id="b"/>', "infrastructure: 2 elements of this name"),
    ("<signals/>", '<electrifications><electrificationSection id="e" isInsulatedSection="yes"/></electrifications>',
     "electrificationSection e: isInsulatedSection = 'yes': must be true or false"),
    ("</gradientCurves>", curves("gradientCurve", ('gradient="3"', 500, 600)).replace('"e"', '"n4"')
     + "</gradientCurves>", "two grades from 1200 to 1300 m of the path"),
])  # fmt: skip
def test_a_railml_entry_that_cannot_be_placed_is_refused(railml: Path, before: str, after: str, message: str) -> None:
    """Breaks if an entity is expanded, a fault is a traceback, or a contradiction is left out in silence."""
    assert before in RAILML
    railml.write_text(RAILML.replace(before, after))
    with one_line(message, str(railml)):
        load_line(f"{railml}:n1..n4")


def collection(name: str, order: str, *parts: str, ordered: bool = True) -> str:
    kind, sequence = ("Ordered", f' sequence="{order}"') if ordered else ("Unordered", "")
    inner = "".join(f'<elementPart ref="{part}"/>' for part in parts)
    kind = f"elementCollection{kind}"
    return f'<netElement id="{name}"><{kind}{sequence}>{inner}</{kind}></netElement>'


def with_collection(railml: Path, where: str, direction: str = "both", element: str = "") -> str:
    """Return the line n1..n4 (500, 200 and 3600 m) with a limit of 30 km/h and a grade of 8 per mille on a location."""
    parts = (("g2", "n3", "n4"), ("g3", "n4", "g4"), ("g4", "n3"))
    added = element or "".join(collection(name, "1", *names) for name, *names in parts)
    limit = located("speedSection", 'maxSpeed="30" isTemporary="true"', where, direction=direction)
    grade = located("gradientCurve", 'gradient="8"', where)
    text = RAILML.replace("</netElements>", f"{added}</netElements>").replace("</speeds>", f"{limit}</speeds>")
    text = text.replace("</gradientCurves>", f"{grade}</gradientCurves>")
    railml.write_text(text.replace('netElementRef="n4" posBegin="300" posEnd="900"', 'netElementRef="n2"'))
    return f"{railml}:n1..n4"


@pytest.mark.parametrize(("where", "begin", "end", "sign"), [
    ('netElementRef="g2" posBegin="100" posEnd="300">', 600, 800, 1),
    ('netElementRef="g3" posBegin="3500" posEnd="3700">', 600, 800, -1),
    ('netElementRef="g2" keepsOrientation="false" intrinsicCoordBegin="0.5">', 2400, 4300, -1),
    ('netElementRef="g2">', 500, 4300, 1), (measured("g2", 650, 1000), 650, 1000, 1),
    (measured("g1", 100, 400), 100, 400, 1),
])  # fmt: skip
def test_an_entry_on_a_collection_holds_on_its_parts(railml, where, begin, end, sign):
    """Breaks if an entry on net elements of a higher level vanishes, is moved, or has the wrong direction."""
    line = load_line(with_collection(railml, where))
    slow = [(e.begin, e.end) for e in line.temporary_restrictions if e.speed == pytest.approx(30 / 3.6)]
    assert (slow[0][0], slow[-1][1]) == (begin, end) and all(a[1] == b[0] for a, b in pairwise(slow))
    slopes = [(e.at, e.grade) for e in line.grades if e.at <= end]
    assert (begin, pytest.approx(sign * 0.008)) in slopes and (end == 4300 or slopes[-1] == (end, 0))


def test_a_limit_of_one_direction_of_a_collection(railml: Path) -> None:
    """Breaks if the direction of a limit is that of the part, where the collection runs against it."""
    for direction, runs in (("normal", True), ("reverse", False)):
        name = with_collection(railml, 'netElementRef="g3" posBegin="0" posEnd="1000">', direction)
        for line, slow in ((load_line(f"{name}:reverse"), runs), (load_line(name), not runs)):
            assert any(e.speed == pytest.approx(30 / 3.6) for e in line.temporary_restrictions) == slow


@pytest.mark.parametrize(("where", "element", "message"), [
    ('netElementRef="g5" posBegin="0" posEnd="100">', collection("g5", "1", "n3", "n4", ordered=False),
     r"netElement g5: its parts have no order \(elementCollectionUnordered\).*locate the entry on n3, n4, or by"),
    ('netElementRef="g5">', collection("g5", "1", "n1", "n4"), "'n4' is not joined to the part before it"),
    ('netElementRef="g5">', collection("g5", "1", "n3", "n9"), "elementPart 'n9': not in the topology"),
    ('netElementRef="g5">', collection("g5", "1", "n3", "g5"), "elementPart 'g5' contains it; remove this part"),
    ('netElementRef="g5" posBegin="0" posEnd="3900">', collection("g5", "1", "n3", "n4"),
     "posEnd = 3900: must lie between 0 and 3800"),
    (measured("g5", 400, 700), collection("g5", "1", "n3", "n4"), "measure 400 to 700 m: outside the linear"),
    ('netElementRef="g5" posBegin="0" posEnd="9">',
     collection("g5", "1", "n3", "n4").replace('"g5"', '"g5" length="5000"'),
     "length = 5000: its parts have 3800 m; correct one of them"),
])  # fmt: skip
def test_an_entry_on_a_collection_that_cannot_be_placed_is_refused(railml, where, element, message):
    """Breaks if the reason is not the true one, or the entry is placed somewhere."""
    with one_line(f"^{railml}.*{message}"):
        load_line(with_collection(railml, where, element=element))


def test_the_length_of_a_net_element_may_be_that_of_its_track(railml: Path) -> None:
    """Breaks if a file with lengths in ``tracks`` is refused, or a track over two elements counts twice."""
    bare = '<netElement id="e"/><netElement id="f"/>'
    track = '<track id="t{0}"><linearLocation>{1}</linearLocation><length type="physical" value="{2}"/></track>'
    part = '<associatedNetElement netElementRef="{}"/>'
    text = (
        '<railML version="3.2"><infrastructure><topology><netElements>{}</netElements><netRelations>{}</netRelations>'
        "</topology><functionalInfrastructure><tracks>{}</tracks></functionalInfrastructure></infrastructure></railML>"
    )
    tracks = track.format(1, part.format("e"), 750) + track.format(2, part.format("f"), 1250.5)
    railml.write_text(text.format(bare, relation("e", 1, "f", 0), tracks))
    read = named_line(str(railml))
    assert read.line.end == 2000.5
    assert "functionalInfrastructure.tracks.track.length.@type" in read.left_out
    both = track.format(1, part.format("e") + part.format("f"), 2000)
    railml.write_text(text.format(bare, relation("e", 1, "f", 0), both))
    with pytest.raises(ValueError, match="netElement e: no length, no linear coordinates of its ends, and no track"):
        load_line(str(railml))
