"""Lines and trains that people bring: tables, GPX and GeoJSON with heights, ALTRIOS, paths over via points."""

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from refusals import one_line
from test_readers import changed

from plant_sim.alignment import Alignment
from plant_sim.consist import SupplyCurve
from plant_sim.formats.altrios import curve_resistance
from plant_sim.formats.network_path import BEGIN, END, Network
from plant_sim.formats.reading import read_line, read_train
from plant_sim.formats.writing import own_yaml
from plant_sim.input_error import build_model
from plant_sim.library import load_line
from plant_sim.line import Line, Rating, line_for, reversed_line
from plant_sim.track import Track
from plant_sim.traction import Envelope
from train_ato.api.converting import convert
from train_ato.api.planning import plan
from train_ato.cli.main import main
from train_ato.profile.planner.allowance import Allowance

TABLE = """\
# our survey of 2026
Chainage [km];Gradient [permille];Speed limit [km/h];Radius [m];Station
12+000;5,0;80;;West
12+400;-2,5;;-600;
13+000;;60;0;Mid
14+500;;;;East
"""


def written(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_a_table_by_hand_and_back(tmp_path: Path) -> None:
    """Breaks if a unit, a place 12+345, an empty cell or a side is read wrongly, or the table back has other values."""
    line = load_line(written(tmp_path / "line.csv", TABLE))
    assert (line.begin, line.end) == (12e3, 14.5e3)
    assert [(e.at, e.grade) for e in line.grades] == [(12e3, 0.005), (12.4e3, -0.0025)]
    assert [(e.at, round(3.6 * e.speed, 9)) for e in line.speed_limits] == [(12e3, 80), (13e3, 60)]
    assert [(e.begin, e.end, e.radius, e.side) for e in line.curves] == [(12.4e3, 13e3, 600, "left")]
    assert [(e.at, e.name) for e in line.stops] == [(12e3, "West"), (13e3, "Mid"), (14.5e3, "East")]
    own, back = tmp_path / "own.yaml", tmp_path / "back.csv"
    assert main(["convert", str(tmp_path / "line.csv"), str(own)]) == 0 and main(["convert", str(own), str(back)]) == 0
    again = load_line(str(back))
    for key in ("begin", "end", "grades", "speed_limits", "curves", "stops"):
        assert getattr(again, key) == getattr(line, key), key
    assert load_line(f"{tmp_path / 'line.csv'}:reverse").grades[0].grade == 0.0025


@pytest.mark.parametrize(
    ("head", "row", "key", "value"),
    [
        ("position_m,elevation_m", "0,10\n1000,15\n3000,5", "grades", [0.005, -0.005]),
        ("position_mi,elevation_ft", "0,0\n1,52.8\n2,0", "grades", [0.01, -0.01]),
        ("position_m,elevation_m", "0,10\n1000,15\n3000,", "grades", [0.005, 0.0]),
        ("position_ft,grade_percent", "0,1.5\n5280,1.5", "grades", [0.015]),
        ("km,speed_limit_mph", "0,25\n2,25", "speed_limits", [25 * 0.44704]),
        ("position_m\tv_max_m_s", "0\t25\n2000\t25", "speed_limits", [25.0]),
        ("position_m,grade_percent", "0,1.5\r1000,1.5", "grades", [0.015]),
        ("position_m,gradient %", "0,0.1\n1000,0.1", "grades", [0.001]),
        ("mi,elevation [feet]", "0,0\n1,52.8", "grades", [0.01]),
        ("position_meters,speed [mi/h]", "0,25\n2,25", "speed_limits", [25 * 0.44704]),
    ],
)
def test_units_of_a_table(tmp_path: Path, head: str, row: str, key: str, value: list[float]) -> None:
    """Breaks if the unit of a title is not that of its numbers."""
    line = load_line(written(tmp_path / "a.csv", f"{head}\n{row}\n"))
    found = [entry.grade if key == "grades" else entry.speed for entry in getattr(line, key)]
    assert found == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty; write a line with titles"),
        ("grade_permille\n1\n2\n", "no place; name a column position_m"),
        ("position,grade_permille\n0,1\n", "'position' has no known unit; name it position_m"),
        ("position_m,km/h\n0,1\n", "'km/h' is a unit without a quantity; name it speed_limit_kmh"),
        ("m,speed_kmh\n0,1\n", "a quantity; name it position_m or elevation_m or radius_m"),
        ("position_m,cant_mm\n0,1\n", "'cant_mm', none of position, grade, elevation, speed_limit, radius"),
        ("position_m,slop\n0,1\n", "unknown column 'slop'; did you mean 'slope'"),
        ("position_m,grade_permille\n0,x\n5,1\n", "line 2, grade_permille = 'x': is not a number"),
        ("position_m,grade_permille\n0,1\n", "1 rows; a line needs two"),
        ("position_m,grade_permille\n9,1\n0,1\n", "places fall"),
        ("position_m,grade_permille\n0,1,5\n9,1\n", "line 2: 3 values for 2 columns"),
        ("position_m,grade_permille,elevation_m\n0,1,5\n9,1,5\n", "are both the grade; remove one"),
        ("position_m,grade_permille\n0,nan\n9,1\n", "grade_permille = 'nan': is not a number"),
        ("position_m,grade_permille\n0,1_0\n9,1\n", "'1_0': is not a number"),
        ("position_m,grade_permille\n0,900\n9,1\n", "line 2, grade_permille = 900: must lie between -500 and 500; "),
        ("km,Gradient\n0,-5\n9,1\n", "line 2, Gradient = -5: name the column grade_permille or grade_percent"),
        ("position_m,radius_m\n0,1\n9,0\n", "line 2, radius_m = 1: below 5 m"),
        ("position_m,latitude\n0,1\n9,0\n", "latitude and longitude need each other"),
        ('position_m,stop\n0,"A\n9,B\n', "unexpected end of data; correct the quotes"),
        (f"position_m,stop\n0,{'A' * 140_000}\n9,B\n", "line 2: field larger than field limit"),
        ("position_m,speed_limit_kmh\n0,0\n9,1\n", "speed_limit_kmh = 0: must be above 0"),
        ("position_m;elevation_m\n0,5;998,5\n900;1.002\n", "line 3, elevation_m = '1.002': its point may separate"),
        ("position_m;grade_permille\n0;1\n1.000,5;2\n", "line 3, position_m = '1.000,5': its point may separate"),
        ("position_m;grade_permille\n0;3.5\n1,250;2\n", "position_m = '1,250': its comma may separate thousands, and "),
        ("position_m,elevation_m\n0,5\n10,15\n", "elevation_m: the height changes by 10 m from 0 to 10 m; correct"),
        ("position_m,v_max_kmh,limit_kmh\n0,0,1\n9,1,1\n", "two columns of speed_limit"),
    ],
)
def test_a_faulty_table_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    """Breaks if a fault is a traceback, or names neither file nor line."""
    with one_line(message, str(tmp_path / "a.csv")):
        load_line(written(tmp_path / "a.csv", text))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("position_m;speed_limit_kmh\n0;80\n2.000;60\n", "the line is 2 m long; check the unit of its places"),
        ("km,gradient\n0,0.3\n1,0.2\n", "line 1: column 'gradient' has no unit; read as a fraction, 0.01 for 10 per"),
        ("km,elevation_m\n0,3\n1,13\n9,\n", "elevation_m: no height at the end; level from 1000 m on"),
        ("km,elevation_m\n0,\n1,5\n2,9\n", "elevation_m: no grade at the begin; level there"),
        ("km,elevation_m\n0,3\n1,\n2,\n", "elevation_m: no grade at the begin; level there"),
    ],
)
def test_a_doubtful_table_is_told(tmp_path: Path, text: str, told: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a thousands separator, or heights without a begin, are read without a word."""
    load_line(written(tmp_path / "a.csv", text))
    assert told in capsys.readouterr().err


def test_a_table_with_marks_at_the_ends_of_its_rows(tmp_path: Path) -> None:
    """Breaks if an empty last column, `sep=`, UTF-16 or a line break in a cell is refused, or a value is dropped."""
    text = "km;speed_limit_kmh;;\r\n0;80;;\r\n1,5;60;;\r\n"
    line = load_line(written(tmp_path / "a.csv", text))
    assert line.end == 1500 and len(line.speed_limits) == 1
    with pytest.raises(ValueError, match="unknown column ''"):
        load_line(written(tmp_path / "a.csv", text.replace("1,5;60;", "1,5;60;7")))
    text = 'sep=;\nkm;speed_limit_kmh;stop\n1;80;"A\nB"\n3;60;C\n'
    (tmp_path / "a.csv").write_bytes(text.encode("utf-16"))
    line = load_line(str(tmp_path / "a.csv"))
    assert (line.end, [stop.name for stop in line.stops]) == (3000, ["A B", "C"])
    (tmp_path / "a.yaml").write_text(own_yaml(line), encoding="utf-16")
    assert read_line(tmp_path / "a.yaml").line == line, "YAML and JSON too"


def test_a_file_in_another_encoding_is_refused_with_its_remedy(tmp_path: Path) -> None:
    """Breaks if the refusal of JSON in Latin-1 has no word on its encoding."""
    (tmp_path / "a.json").write_text('{"id": "Gr\u00fcn"}', encoding="latin-1")
    with pytest.raises(ValueError, match="not UTF-8 text; save it as UTF-8, or give"):
        load_line(str(tmp_path / "a.json"))


EAST = 1 / (6_378_137.0 / math.sqrt(1 - 6.694379990141e-3 * math.sin(math.radians(48)) ** 2))
"""Longitude of 1 m on the parallel of 48° over its cosine [rad]."""


def track(rise: float = 0.01, noise: float = 0.0, length: float = 4000.0, step: float = 20.0) -> list[list[float]]:
    """Return longitude, latitude and height of points to the east with a constant grade in the middle half."""
    places = np.arange(0.0, length + 1, step)
    heights = 100 + rise * np.clip(places - length / 4, 0, length / 2)
    heights += noise * np.where(np.arange(places.size) % 2, 1, -1)
    degrees = np.degrees(places * EAST / math.cos(math.radians(48)))
    return [[11 + lon, 48.0, height] for lon, height in zip(degrees.tolist(), heights.tolist(), strict=True)]


def geojson(points: list[list[float]], stations: dict[str, list[float]]) -> dict[str, Any]:
    shapes = [
        {"type": "Feature", "properties": {"name": "Ours"}, "geometry": {"type": "LineString", "coordinates": points}}
    ]
    shapes += [
        {"type": "Feature", "properties": {"name": name}, "geometry": {"type": "Point", "coordinates": spot}}
        for name, spot in stations.items()
    ]
    return {"type": "FeatureCollection", "features": shapes}


def gpx(points: list[list[float]], stations: dict[str, list[float]]) -> str:
    marks = "".join(f'<wpt lat="{s[1]}" lon="{s[0]}"><name>{name}</name></wpt>' for name, s in stations.items())
    rows = "".join(f'<trkpt lat="{p[1]}" lon="{p[0]}"><ele>{p[2]}</ele></trkpt>' for p in points)
    return (
        '<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1">'
        f"{marks}<trk><name>Ours</name><trkseg>{rows}</trkseg></trk></gpx>"
    )


@pytest.mark.parametrize("length", [1490.3, 1494.9, 1495.1, 1499.7])
@pytest.mark.parametrize("grade", [0.0, 0.012])
def test_a_steady_grade_high_above_the_sea_is_steady_up_to_the_end(tmp_path: Path, length: float, grade: float) -> None:
    """Breaks if the average of the last heights lacks some metres: 63 per mille on a level track at 500 m."""
    way = np.linspace(0.0, length, 21)
    points = [
        [11.0 + math.degrees(x * EAST / math.cos(math.radians(48))), 48.0, 500.0 + grade * x] for x in way.tolist()
    ]
    line = load_line(written(tmp_path / "high.gpx", gpx(points, {})))
    assert line.end == pytest.approx(length, abs=1e-3)
    assert [entry.grade for entry in line.grades] == pytest.approx([grade] * 15, abs=2e-5)


@pytest.mark.parametrize("form", ["gpx", "geojson"])
@pytest.mark.parametrize("noise", [0.0, 1.5])
def test_a_track_with_heights_by_hand(tmp_path: Path, form: str, noise: float, capsys) -> None:
    """Breaks if distances, heights or stations are wrong, or noise of 1.5 m becomes grades of 150 per mille."""
    points = track(noise=noise)
    spots = {"Start": points[0][:2], "End": [points[-1][0], 48.0005], "Far": [11.0, 49.0]}
    text = gpx(points, spots) if form == "gpx" else json.dumps(geojson(points, spots))
    line = load_line(written(tmp_path / f"way.{'gpx' if form == 'gpx' else 'json'}", text))
    told = capsys.readouterr().err
    assert line.name == "Ours" and line.end == pytest.approx(4000, abs=0.05)
    grades = [(entry.at + 50, entry.grade) for entry in line.grades]
    for middle, grade in grades:
        expected = 0.01 if 1200 < middle < 2800 else 0.0 if not 800 < middle < 3200 else None
        tolerance = (2e-3 if 200 < middle < 3800 else 2e-2) if noise else 1e-9
        assert expected is None or grade == pytest.approx(expected, abs=tolerance), middle
    rise = sum(grade * 100 for _, grade in grades)
    assert rise == pytest.approx(20, abs=2 * noise + 1e-6)
    assert [(round(stop.at), stop.name) for stop in line.stops] == [(0, "Start"), (4000, "End")]
    assert "heights averaged over 300 m" in told and "'Far' is 1" in told and "no speed limits and no curves" in told
    assert len(line.coordinates) == len(points)


def test_a_track_that_passes_a_station_twice_stops_twice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the second passage has no stop, or a track that turns back has no word."""
    points = track()
    halt = {"Halt": [points[100][0], 48.0005]}
    line = load_line(written(tmp_path / "one.gpx", gpx(points, halt)))
    assert [round(stop.at) for stop in line.stops] == [2000]
    assert "turns back" not in capsys.readouterr().err
    line = load_line(written(tmp_path / "two.gpx", gpx(points + points[-2::-1], halt)))
    assert [round(stop.at) for stop in line.stops] == [2000, 6000]
    assert "track 'Ours' turns back near 4000 m" in capsys.readouterr().err


def test_a_height_that_a_receiver_lost_is_refused_in_one_line(tmp_path: Path) -> None:
    """Breaks if heights of 0 among others are refused as grades that the file does not have."""
    points = [[lon, lat, 500 * (k not in (40, 41))] for k, (lon, lat, _) in enumerate(track())]
    with one_line("lost.gpx: the height changes by -66.67 m from 600 to 700 m", "correct the heights or their unit"):
        load_line(written(tmp_path / "lost.gpx", gpx(points, {})))


@pytest.mark.parametrize("ending", ["csv", "json", "gpx", "geojson", "yaml", "railml"])
def test_every_key_of_a_line_is_written_or_named(ending: str, tmp_path: Path) -> None:
    """Breaks if a key, or the length of a line with coordinates for a shorter one, is lost without a word."""
    text = """schema: train_ato/line/1
name: full
summary: all keys
end: 8000
chainage: [{begin: 12+000, end: 16+000}, {begin: 16+500, end: 20+500}]
grades: [{at: 0, grade_permille: 3}, {at: 2000, grade_permille: -6}]
vertical_curves: [{at: 2000, radius_km: 10}]
curves: [{begin: 500, end: 900, radius: 500, side: left, resistance_n_per_kn: 2}, {begin: 1500, end: 1900, radius: 80}]
tunnels: [{begin: 1000, end: 1500, cross_section: 45}, {begin: 5000, end: 5500, resistance_n_per_kn: 1.5}]
speed_limits: [{at: 0, speed_kmh: 80}, {at: 3000, speed_kmh: 60}]
category_limits: [{category: freight, speed_limits: [{at: 0, speed_kmh: 50}]}]
temporary_restrictions: [{begin: 1100, end: 1300, speed_kmh: 30, reason: works}]
neutral_sections: [{begin: 2500, end: 2600, electric_brake: true}]
power_limits: [{begin: 6000, end: 7000, power_kw: 2500}]
adhesion: [{begin: 3000, end: 3200, factor: 0.6}]
stops: [{at: 200, name: A, dwell: 30}, {at: 7900, name: C}]
coordinates: [{at: 0, latitude: 48.0, longitude: 11.0}, {at: 8000, latitude: 48.0, longitude: 11.1}]
"""
    line = load_line(written(tmp_path / "full.yaml", text))
    told = " ".join(convert(tmp_path / "full.yaml", tmp_path / f"out.{ending}")["left_out"])
    back = load_line(str(tmp_path / f"out.{ending}"))
    averaged = {"grades", "stops", "coordinates", "end"} if ending in ("gpx", "geojson") else set()
    keys = {*Line.model_fields} - {"schema_", "name", "source"} - averaged
    assert not [key for key in keys if getattr(line, key) != getattr(back, key) and key not in told]
    assert (back.end == pytest.approx(8000, rel=5e-3)) != ("its length of 8000 m" in told)


def test_a_faulty_track_is_refused(tmp_path: Path) -> None:
    """Breaks if a document type is read, or a faulty number or an ambiguous track is a traceback."""
    points = track()
    one = gpx(points, {})
    two = one.replace("</gpx>", f"<trk><name>B</name><trkseg>{one.partition('<trkseg>')[2]}")
    good = geojson(points, {})
    parts = {"type": "MultiLineString", "coordinates": [points, 5]}
    doctype = '<!DOCTYPE gpx [<!ENTITY a "b">]>' + gpx(points, {})
    for name, text, message in (
        ("a.gpx", doctype, "DOCTYPE: document types and entities are refused"),
        ("a.gpx", two, r"2 tracks \(it has 1 'Ours', 2 'B'\); select one as FILE:NAME or FILE:NUMBER"),
        ("a.gpx", gpx(points, {}).replace("gpx ", "kml ", 1).replace("/gpx", "/kml"), "<kml> is no GPX"),
        ("a.gpx", one.replace('lat="48.0"', "", 1), "point 1: lat: is missing; add it"),
        ("a.json", json.dumps(good | {"features": None}), "features: this key is missing"),
        ("a.json", json.dumps(parts), "coordinates: 1 = 5: must be a list"),
        ("a.json", json.dumps({"type": "LineString", "coordinates": points[:1] * 9}), "track '' is 0 m long"),
        ("a.gpx", gpx(points, {}).replace("<ele>100.0", "<ele>high", 1), "ele = 'high': is not a number"),
        ("a.gpx", gpx(points[:5], {}), "80 m long; a line needs 200 m"),
        ("a.json", json.dumps(geojson([[1, 2, 3], [math.inf, 2]], {})), "(finite number|not valid)"),
        ("a.json", json.dumps(geojson([[1, 2, 3, 4], [1, 2]], {})), "longitude, latitude, height"),
        ("a.json", json.dumps({"type": "FeatureCollection", "features": []}), "0 tracks"),
    ):
        with one_line(message):
            load_line(written(tmp_path / name, text))
    assert load_line(f"{written(tmp_path / 'a.gpx', two)}:B").name == "B"
    assert load_line(f"{written(tmp_path / 'a.gpx', two)}:2").name == "B"
    good["features"].append({"type": "Feature", "properties": None, "geometry": None})
    assert load_line(written(tmp_path / "a.json", json.dumps(good))).name == "Ours"


@pytest.mark.parametrize("ending", ["gpx", "geojson"])
def test_a_line_with_coordinates_as_a_track_and_back(tmp_path: Path, ending: str, capsys) -> None:
    """Breaks if a place, a height or a name is lost, a name is no XML, or a key that a track has not has no line."""
    spots = {"Start & <West>": track()[0][:2], "E\vnd": track()[-1][:2]}
    data = yaml.safe_load(own_yaml(load_line(written(tmp_path / "way.json", json.dumps(geojson(track(), spots))))))
    data |= {"speed_limits": [{"at": 0, "speed": 20}], "begin": 100.0}
    source, target = written(tmp_path / "own.yaml", yaml.safe_dump(data)), tmp_path / f"back.{ending}"
    assert main(["convert", source, str(target)]) == 0
    told = capsys.readouterr().err
    assert "not carried" in told and "speed_limits" in told and "begin = 100 m (now 0)" in told
    line, back = load_line(source), load_line(str(target))
    assert back.name == line.name and back.end == pytest.approx(line.end - 100, abs=0.05)
    assert [(round(stop.at), stop.name.replace("\v", "")) for stop in back.stops] == [(3900, "End")]
    places = np.arange(300.0, 3700.0, 100.0)
    heights = [Alignment(found).at(places + found.begin).z for found in (line, back)]
    np.testing.assert_allclose(heights[1], heights[0], atol=0.3)  # averaged again over 300 m
    bare = written(tmp_path / "bare.csv", TABLE)
    assert main(["convert", bare, str(tmp_path / f"no.{ending}")]) == 2
    assert "coordinates: it has none, and a track needs them" in capsys.readouterr().err


def test_a_gap_of_a_track_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a part in the wrong order, or exchanged coordinates, are read without a word."""
    points = track()
    load_line(written(tmp_path / "b.json", json.dumps(geojson([[y, x, z] for x, y, z in points], {}))))
    assert "[longitude, latitude]: the track begins at 11.00° N, 48.00° E" in capsys.readouterr().err
    load_line(written(tmp_path / "a.json", json.dumps(geojson(points[100:] + points[:100], {}))))
    assert "points 101 and 102: 4.0 km apart; straight between them" in capsys.readouterr().err


def link(
    number: int, flip: int, after: int, before: int, other: int = 0, length: float = 1000.0, **more: Any
) -> dict[str, Any]:
    """Return a link that rises 5 m per km; the heading passes north within it."""
    return {
        "idx_curr": number, "idx_flip": flip, "idx_next": after, "idx_next_alt": other, "idx_prev": before,
        "idx_prev_alt": 0, "length_meters": length, "osm_id": "7",
        "elevs": [
            {"offset_meters": 0.0, "elev_meters": 10.0}, {"offset_meters": length, "elev_meters": 10 + length / 200},
        ],
        "headings": [
            {"offset_meters": 0.0, "heading_radians": 6.1}, {"offset_meters": 600.0, "heading_radians": 0.1},
            {"offset_meters": length, "heading_radians": 0.1},
        ],
        "speed_sets": {
            name: {"speed_limits": [
                {"offset_start_meters": 0.0, "offset_end_meters": 1000.0, "speed_meters_per_second": speed},
            ], "speed_params": [], "is_head_end": False}
            for name, speed in (("Freight", 15.0), ("Passenger", 25.0))
        },
        "cat_power_limits": [], "link_idxs_lockout": [],
    } | more  # fmt: skip


def limited(first: float, second: float) -> dict[str, Any]:
    """Return speed sets with a limit [m/s] up to 400 m and another one beyond."""
    rows = [
        {"offset_start_meters": begin, "offset_end_meters": end, "speed_meters_per_second": speed}
        for begin, end, speed in ((0.0, 400.0, first), (400.0, 1000.0, second))
    ]
    return {"Freight": {"speed_limits": rows, "speed_params": [], "is_head_end": False}, "Local": {"speed_limits": []}}


LINKS = [
    link(1, 5, 2, 0, 3), link(2, 6, 4, 1), link(3, 7, 4, 1, length=1500.0), link(4, 8, 0, 2),
    link(8, 4, 6, 0, 7), link(6, 2, 5, 8), link(7, 3, 5, 8, length=1500.0), link(5, 1, 0, 6),
]  # fmt: skip
"""Two ways from link 1 to link 4, and their flips."""


def test_an_altrios_network_by_hand(tmp_path: Path) -> None:
    """Breaks if a heading over north is a curve of 344°, or a via point, speed set, flip or resistance is lost."""
    name = written(tmp_path / "net.yaml", yaml.safe_dump([{"max_grade": 0.06}, LINKS]))
    found = read_line(Path(name), "1..4")
    line = found.line
    assert line.end == 3000 and [round(e.grade, 9) for e in line.grades] == [0.005]
    turn = 0.1 - 6.1 + 2 * math.pi
    curve = line.curves[0]
    assert len(line.curves) == 3 and (curve.begin, curve.end, curve.side) == (0, 600, "right")
    assert curve.radius == pytest.approx(600 / turn)
    assert curve.resistance_n_per_kn == pytest.approx(1e3 * 0.056 * turn / 600)  # below 1° per 100 ft
    assert Track(line).dry.max() == pytest.approx(0.056 * turn / 600)
    assert [e.speed for e in line.speed_limits] == [15.0] and set(found.left_out) == {"[].osm_id"}
    assert read_line(Path(name), "1..4,Passenger").line.speed_limits[0].speed == 25.0
    assert line_for(line, ["Passenger"]).speed_limits[0].speed == 25.0
    assert read_line(Path(name), "1..3..4").line.end == 3500
    back = read_line(Path(name), "1..3..4", against=True).line
    assert back.end == 3500 and back.grades[0].grade == 0.005  # a flip has heights of its own
    for wrong, message in (
        ("4..1", "no path between"),
        ("1..9", "'9' is no track"),
        ("1..4,Fast", "'Fast' is none of"),
    ):
        with pytest.raises(ValueError, match=message):
            read_line(Path(name), wrong)
    assert curve_resistance(0.01) == pytest.approx(3.20666e-5 + 4.136338e-3 + 9.1140e-7, rel=1e-5)


def test_assumptions_and_flips_of_an_altrios_network(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the limits of another kind of train are taken without a word, or a wrong flip makes another path."""
    name = Path(written(tmp_path / "n.yaml", yaml.safe_dump(changed(LINKS, (0, "speed_sets", "Freight"), KeyError))))
    read_line(name, "1..4, Passenger")
    assert "no 'Freight'" not in capsys.readouterr().err
    read_line(name, "1 .. 4")
    assert "link 1: speed_sets: no 'Freight'; limits of 'Passenger'" in capsys.readouterr().err
    read_line(Path(written(tmp_path / "h.yaml", yaml.safe_dump(changed(LINKS, (0, "elevs"), [])))), "1..4")
    assert "link 1: elevs: fewer than two; assumed level" in capsys.readouterr().err
    wrong = written(tmp_path / "f.yaml", yaml.safe_dump(changed(LINKS, (1, "idx_flip"), 8)))
    with pytest.raises(ValueError, match="the path is not navigable from 8 to 8"):
        read_line(Path(wrong), "1..2..4", against=True)


CAR = {
    "car_type": "Loaded", "freight_type": "Ore", "length_meters": 12.0, "axle_count": 4, "brake_count": 1,
    "mass_static_base_kilograms": 28e3, "mass_freight_kilograms": 92e3, "speed_max_meters_per_second": 20.0,
    "braking_ratio": 0.11, "mass_rot_per_axle_kilograms": 750.0, "bearing_res_per_axle_newtons": 40.0,
    "rolling_ratio": 0.0015, "davis_b_seconds_per_meter": 1e-5, "cd_area_square_meters": 4.0, "curve_coeff_0": 0.056,
    "curve_coeff_1": 0.4387579, "curve_coeff_2": 0.01025485,
}  # fmt: skip
LOCOMOTIVE = {"mass_kilograms": 195e3, "force_max_newtons": 667.2e3, "pwr_out_max_watts": 3.3e6, "pwr_aux_offset": 8e3}
ORE: dict[str, Any] = {
    "train_id": "ore", "train_config": {"rail_vehicles": [CAR], "n_cars_by_type": {"Loaded": 40}},
    "loco_con": {"loco_vec": [LOCOMOTIVE, LOCOMOTIVE]},
}  # fmt: skip
"""Train of ALTRIOS with made-up figures."""


def test_an_altrios_train_by_hand(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if the drag gets a half, an axle counts once, or a rolling resistance or a car of equal name is lost."""
    found = read_train(Path(written(tmp_path / "ore.yaml", yaml.safe_dump(ORE))))
    loco, car = found.consist.vehicles[0], found.consist.vehicles[2]
    assert found.consist.mass == pytest.approx(2 * 195e3 + 40 * 120e3) and len(found.consist.vehicles) == 42
    assert car.resistance.n == pytest.approx((160 + 0.0015 * 120e3 * 9.81, 1e-5 * 120e3 * 9.81, 1.225 * 4.0))
    assert car.inertia == pytest.approx(123e3) and loco.resistance.n == pytest.approx((0.0015 * 195e3 * 9.81, 0, 0))
    forces = [segment.at(v) for segment, v in zip(loco.traction, (1.0, 15.0), strict=True)]
    assert forces == pytest.approx([667.2e3, 3.3e6 / 15]) and loco.independent_power
    limits = found.consist.plan_limits
    assert limits.speed == 20
    inertia = 40 * 123e3 + 2 * 195e3
    assert limits.deceleration == pytest.approx(0.11 * 40 * 120e3 * 9.81 / inertia)
    assert "train_config.rail_vehicles[].freight_type" in found.left_out
    assert "loco_con.loco_vec[].pwr_aux_offset" in found.left_out
    told = capsys.readouterr().err
    assert "rigid couplers" in told and "locomotives of 22 m" in told
    for change, message in (({"loco_con": None}, "loco_con: no locomotives"), ({"train_config": {
        "rail_vehicles": [CAR], "n_cars_by_type": {}}}, "n_cars_by_type: Loaded: this key is missing")):  # fmt: skip
        with pytest.raises(ValueError, match=message):
            read_train(Path(written(tmp_path / "bad.yaml", yaml.safe_dump(ORE | change))))
    ore = {"train_id": "x", "loco_con": ORE["loco_con"], "train_config": {
        "rail_vehicles": [CAR | {"car_type": "locomotive 0"}], "n_cars_by_type": {"locomotive 0": 40}}}  # fmt: skip
    found = read_train(Path(written(tmp_path / "t.yaml", yaml.safe_dump(ore))))
    assert found.consist.mass == pytest.approx(2 * 195e3 + 40 * 120e3)


LIMIT = ("speed_sets", "Freight", "speed_limits", 0)


@pytest.mark.parametrize(
    ("keys", "value", "message"),
    [
        ((1, "idx_curr"), 1, "link 1: idx_curr = 1: two links have this number"),
        ((1, "idx_curr"), KeyError, "idx_curr: this key is missing"),
        ((1, "length_meters"), 0, "link 2: length_meters = 0: must lie between"),
        ((1,), "x", r"\[1\]: holds 'x' in place of keys and values"),
        ((0, "elevs", 1, "offset_meters"), 500.0, "link 1: elevs: from 0 to 500 m of a link of 1000 m"),
        ((0, "elevs", 0, "offset_meters"), 500.0, "link 1: elevs: from 500 to 1000 m"),
        ((0, "elevs", 1, "elev_meters"), 5000.0, r"link 1: elevs\[1\]: elev_meters = 5000: 4990 m on 1000 m"),
        ((0, "headings", 1, "heading_radians"), 350.0, "heading_radians = 350: must lie between -6.3 and 6.3"),
        ((0, *LIMIT, "offset_end_meters"), 1800.0, "offset_end_meters = 1800: must lie between 0 and 1001"),
        ((0, *LIMIT, "offset_start_meters"), 1001.0, "offset_end_meters = 1000: must lie between 1001 and 1001"),
        ((0, "speed_set"), {"speed_limits": []}, "speed_sets and speed_set are the same quantity"),
        (("train_config", "rail_vehicles", 0, "axle_count"), 4.5, "axle_count = 4.5: must be a whole number"),
        (("train_config", "n_cars_by_type", "Loaded"), 40.7, "Loaded = 40.7: must be a whole number"),
        (("train_config", "n_cars_by_type", "Empty"), 20, "n_cars_by_type: unknown key 'Empty'"),
        (("train_config", "rail_vehicles"), [CAR, CAR], r"rail_vehicles\[1\]: car_type = 'Loaded': two entries"),
        (("train_config", "rail_vehicles", 0, "rolling_ratio"), 1.5, "rolling_ratio = 1.5: must lie between"),
        (("loco_con", "loco_vec", 0, "mass"), 1e5, r"loco_con: loco_vec\[0\]: mass_kilograms and mass are the same"),
        (("loco_con", "loco_vec", 0, "pwr_out_max_watts"), 3300.0, "pwr_out_max_watts = 3300: must lie between 20000"),
        (("train_id",), ["a"], r"train_id = \['a'\]: must be one text"),
    ],
)
def test_a_faulty_altrios_file_is_refused(tmp_path: Path, keys: Any, value: Any, message: str) -> None:
    """Breaks if a fault gives another line or train without a word, or the message has another cause."""
    network = isinstance(keys[0], int)
    path = Path(written(tmp_path / "a.yaml", yaml.safe_dump(changed(LINKS if network else ORE, keys, value))))
    with one_line(message):
        read_line(path, "1..4") if network else read_train(path)


CATEGORIES: dict[str, Any] = {
    "schema": "train_ato/line/1", "name": "x", "end": 5000, "speed_limits": [{"at": 0, "speed_kmh": 80}],
    "category_limits": [{"category": "freight", "speed_limits": [{"at": 0, "speed_kmh": 60}]}],
}  # fmt: skip


def test_limits_by_category_are_checked_as_those_of_all_trains(tmp_path: Path, capsys) -> None:
    """Breaks if a category counts twice, or its missing or doubtful limit has no note."""
    place = ("category_limits", 0, "speed_limits", 0)
    for keys, value, told in (
        (("category_limits",), CATEGORIES["category_limits"] * 2, "category_limits: 'freight' has two entries"),
        (
            (*place, "speed_kmh"),
            -60,
            "category_limits.0.speed_limits.0.speed_kmh = -60: input should be greater than 0",
        ),
        (("category_limits", 0, "category"), "", "category_limits.0.category = ''"),
        ((*place, "speed_kmh"), 600, "category_limits 'freight': speed 166.667 is 600 km/h"),
        ((*place, "at"), 1500, "category_limits 'freight': none from 0 to 1500 m"),
    ):
        file = Path(written(tmp_path / "l.yaml", yaml.safe_dump(changed(CATEGORIES, keys, value))))
        try:
            read_line(file)
        except ValueError as error:
            assert told in str(error)
        else:
            assert told in capsys.readouterr().err
    with pytest.raises(ValueError, match="speed_limits of 'freight': none before 1500 m"):
        read_line(file, against=True)


@pytest.mark.parametrize(
    ("rating", "categories", "speed"),
    [
        ({"axle_load_t": 16, "cant_deficiency_mm": 275, "brake_percentage": 150}, [], 50.0),  # the first it meets
        ({"axle_load_t": 16, "cant_deficiency_mm": 275}, [], 30.0),  # no brake percentage
        ({"axle_load_t": 22.5, "brake_percentage": 150, "cant_deficiency_mm": 275}, [], 15.0),  # too heavy
        ({"axle_load_t": 25}, [], 20.0),
        ({"axle_load_t": 16}, ["mail"], 40.0),  # its category is before its figures
        ({"axle_load_t": 16}, ["tilting"], 30.0),  # of this category, but not with its figures
        (None, ["light"], 20.0),
    ],
)
def test_limits_by_the_figures_of_a_train(rating: Any, categories: list[str], speed: float) -> None:
    """Breaks if a bound has the wrong sense, a missing figure counts as met, or the other direction forgets it."""
    rows = (
        ("tilting", {"axle_load_t": 17, "cant_deficiency_mm": 275, "brake_percentage": 140}, 50.0),
        ("mail", None, 40.0),
        ("light", {"axle_load_t": 18}, 30.0),
        ("heavy", {"axle_load_t": 22.5}, 15.0),
    )
    limits = [
        {"category": name, "speed_limits": [{"at": 0, "speed": limit}]} | ({"needs": needs} if needs else {})
        for name, needs, limit in rows
    ]
    data = CATEGORIES | {"speed_limits": [{"at": 0, "speed": 20.0}], "category_limits": limits}
    line = build_model(Line, data, "line")
    train = None if rating is None else build_model(Rating, rating, "train")
    for way in (line, reversed_line(line), reversed_line(reversed_line(line))):
        assert line_for(way, categories, train).speed_limits[0].speed == speed
    bare = line.model_copy(update={"speed_limits": ()})
    with pytest.raises(
        ValueError, match="none for this train; add one of tilting, mail, light, heavy to the categories"
    ):
        line_for(bare, ["tram"])


@pytest.mark.parametrize(
    ("model", "data", "message"),
    [
        (Allowance, {"share_percent": 2000}, "share_percent = 2000: input should be less than or equal to 1000"),
        (Allowance, {"per_100km_min": -1}, "per_100km_min = -1: input should be greater than or equal to 0"),
        (Line, CATEGORIES | {"grades": [{"at": 0, "grade_permille": [5]}]}, r"grades.0.grade_permille = \[5\]: input"),
        (SupplyCurve, {"mode": "a", "speed_kmh": [0, None], "force": [1, 1]}, "speed_kmh.1 = None: input should"),
    ],
)
def test_a_refusal_has_the_key_the_value_and_the_bound_of_the_file(model: Any, data: Any, message: str) -> None:
    """Breaks if a value with the suffix of a unit is refused under its SI key, or with the bound of the SI unit."""
    with pytest.raises(ValueError, match=message):
        build_model(model, data, "file")


LINES = "".join(
    f'<valueLine xValue="{v}"><value yValue="{f}"/></valueLine>' for v, f in ((0, 270), (40, 270), (120, 90))
)
RAIL_STOCK = f"""<railML xmlns="https://www.railml.org/schemas/3.3" version="3.3"><rollingstock><vehicles>
<vehicle id="loco" speed="120" bruttoWeight="120" length="20" rotatingMassFactor="1.15" maximumAxleLoad="20">
<engine><powerMode mode="diesel" isPrimaryMode="true"><tractionData><details><tractiveEffort><valueTable
xValueUnit="km/h" yValueUnit="kN">{LINES}</valueTable></tractiveEffort></details></tractionData></powerMode></engine>
<drivingResistance><info airDragCoefficient="0.8" crossSectionArea="10" rollingResistance="1.5"/></drivingResistance>
</vehicle>
<vehicle id="coach" speed="160" tareWeight="30" bruttoWeight="40" length="25" rotatingMassFactor="1.05">
<drivingResistance><info airDragCoefficient="0.3" crossSectionArea="10" rollingResistance="1.2"/></drivingResistance>
</vehicle></vehicles><formations><formation id="push" speed="110">
<trainOrder orderNumber="2" vehicleRef="loco"/><trainOrder orderNumber="1" vehicleRef="coach"/>
<trainOrder orderNumber="3" vehicleRef="coach"/><trainEngine maxAcceleration="0.4"/>
<trainBrakes meanDeceleration="0.9" regularBrakePercentage="130"/><trainResistance><daviesFormulaFactors
constantFactorA="4000" speedDependentFactorB="40" squareSpeedDependentFactorC="2.5" massDependent="false"/>
</trainResistance></formation></formations></rollingstock></railML>
"""
"""Rolling stock of railML 3 with made-up figures."""


DRAGS = RAIL_STOCK[: RAIL_STOCK.index("<trainResistance")] + RAIL_STOCK[RAIL_STOCK.index("</formation>") :]
"""The same with the resistances of the vehicles."""


def test_a_railml_train_by_hand(tmp_path: Path) -> None:
    """Breaks if the order, a unit, the share of the resistance or the brake of a formation is read wrongly."""
    consist = read_train(Path(written(tmp_path / "stock.railml", RAIL_STOCK))).consist
    assert [vehicle.length for vehicle in consist.vehicles] == [25, 20, 25] and consist.mass == 200e3
    loco = consist.vehicles[1]
    traction = Envelope(loco.traction)
    assert [traction.force(v / 3.6) for v in (0, 40, 80, 120)] == pytest.approx([270e3, 270e3, 180e3, 90e3])
    assert loco.independent_power and loco.inertia == pytest.approx(138e3)
    assert loco.resistance.n == pytest.approx((0.6 * 4000, 0.6 * 40 * 3.6, 0.6 * 2.5 * 12.96))
    limits, rating = consist.plan_limits, consist.rating
    assert (limits.speed, limits.deceleration, limits.acceleration) == (110 / 3.6, 0.9, 0.4)
    assert (rating.axle_load, rating.brake_percentage) == (20e3, 130)
    brake = 0.9 * (138e3 + 2 * 42e3) + 0.05 * 9.81 * 200e3
    assert Envelope(loco.brake).force(10.0) == pytest.approx(brake)
    first = read_train(Path(written(tmp_path / "own.railml", DRAGS))).consist.vehicles[0]
    assert first.resistance.n == pytest.approx((1.2 * 40 * 9.81, 0, 0.5 * 1.225 * 3.0))
    info = '<info maxTractiveEffort="270000" tractivePower="3000000"/>'
    plain = RAIL_STOCK[: RAIL_STOCK.index("<details>")] + info + RAIL_STOCK[RAIL_STOCK.index("</details>") + 10 :]
    curve = Envelope(read_train(Path(written(tmp_path / "info.railml", plain))).consist.vehicles[1].traction)
    assert (curve.force(1.0), curve.force(20.0)) == pytest.approx((270e3, 150e3))


RAIL_STOCK_2 = f"""<railml xmlns="http://www.railml.org/schemas/2016" version="2.3"><rollingstock><vehicles>
<vehicle id="loco" speed="120" bruttoWeight="120" length="20" axleLoad="20" resistanceFactor="1.5"><engine>
<propulsion id="d" powerType="diesel" power="3000000" rotationMassFactor="1.15"><tractiveEffort><valueTable
xValueUnit="km/h" yValueUnit="kN">{LINES.replace("<value ", "<values ")}</valueTable></tractiveEffort></propulsion>
</engine></vehicle>
<vehicle id="coach" speed="160" tareWeight="30" bruttoWeight="40" length="25" resistanceFactor="1.2"/></vehicles>
<formations><formation id="push" speed="110"><trainOrder><vehicleRef orderNumber="2" vehicleRef="loco"/>
<vehicleRef orderNumber="1" vehicleRef="coach" vehicleCount="2"/></trainOrder>
<trainEngine trainMaxAcceleration="0.4"/><trainBrakes meanDeceleration="0.9" regularBrakePercentage="130"/>
<trainResistance daviesFactorA="4000" daviesFactorB="40" daviesFactorC="2.5" daviesMassDependent="false"/>
</formation></formations></rollingstock></railml>"""
"""The same rolling stock in railML 2, both coaches in front; a coach has no factor of rotating masses there."""


def test_a_train_of_railml_2_is_that_of_railml_3(tmp_path: Path) -> None:
    """Breaks if an attribute of railML 2 has another meaning than its counterpart, or a count is not used."""
    moved = RAIL_STOCK.replace('orderNumber="2" vehicleRef="loco"', 'orderNumber="9" vehicleRef="loco"')
    moved = moved.replace(' length="25" rotatingMassFactor="1.05"', ' length="25"')
    third, second = (
        read_train(Path(written(tmp_path / f"stock{number}.xml", text)))
        for number, text in ((3, moved), (2, RAIL_STOCK_2))
    )
    assert second.format == "railML 2" and second.consist.source == "railML 2 rolling stock stock2.xml"
    assert second.consist.model_copy(update={"source": third.consist.source}) == third.consist
    refused = RAIL_STOCK_2.replace('vehicleCount="2"', 'vehicleCount="1.5"')
    with pytest.raises(ValueError, match=r"vehicleCount = 1\.5: must be a whole number"):
        read_train(Path(written(tmp_path / "half.xml", refused)))


def test_a_railml_train_from_file_to_plan_and_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a train that convert reads has no plan, or is lost on the way to OSRD."""
    name, line = written(tmp_path / "stock.xml", RAIL_STOCK), written(tmp_path / "line.csv", TABLE)
    assert main(["plan", line, f"{name}:push"]) == 0
    assert main(["convert", name, str(tmp_path / "back.json")]) == 0
    assert "rating" in capsys.readouterr().err
    back = read_train(tmp_path / "back.json").consist
    assert back.mass == 200e3 and Envelope(back.vehicles[0].traction).force(80 / 3.6) == pytest.approx(180e3)
    for source, target in ((name, "train.railml"), (line, "line.railml")):
        convert(source, tmp_path / target)
    times = [plan(where, train).running_time for where, train in (
        (line, name), (tmp_path / "line.railml", tmp_path / "train.railml"),
    )]  # fmt: skip
    assert times[1] == pytest.approx(times[0], rel=1e-9)


@pytest.mark.parametrize("text", [RAIL_STOCK, RAIL_STOCK_2, DRAGS, ORE])
def test_a_train_as_railml_and_back(tmp_path: Path, text: Any) -> None:
    """Breaks if a figure of a train changes on the way, or one that a formation does not have is lost in silence."""
    name = written(tmp_path / "a.xml", text) if text != ORE else written(tmp_path / "a.yaml", yaml.safe_dump(ORE))
    left = convert(name, tmp_path / "b.xml")["left_out"]
    one, two = (read_train(Path(file)).consist for file in (name, str(tmp_path / "b.xml")))
    assert len(one.vehicles) == len(two.vehicles) and two.name == one.name
    for old, new in zip(one.vehicles, two.vehicles, strict=True):
        mass, drag = old.mass, [kind.resistance.polynomial(kind.mass, 9.81) for kind in (old, new)]
        assert (new.mass, new.length) == pytest.approx((mass, old.length)) and new.inertia == pytest.approx(old.inertia)
        assert drag[1] == pytest.approx(drag[0], rel=1e-9) or "vehicle_types: resistance (now shared by mass)" in left
        curves = [[Envelope(kind.traction).force(v) for v in np.arange(0.5, 33.0)] for kind in (old, new)]
        assert curves[1] == pytest.approx(curves[0], rel=2e-3) and new.independent_power == old.independent_power
    assert (two.plan_limits, two.rating) == (one.plan_limits, one.rating)
    if text != ORE:
        assert not [key for key in left if not key.endswith("@id")]
        assert Envelope(two.vehicles[1].brake).force(9) == pytest.approx(Envelope(one.vehicles[1].brake).force(9))


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('vehicleRef="loco"', 'vehicleRef="locos"', "formation push: vehicleRef = 'locos': no vehicle; it has loco"),
        ('bruttoWeight="120"', 'bruttoWeight="12o"', "vehicle loco: bruttoWeight = '12o': is not a number"),
        ('length="25"', "", "vehicle coach: length: is missing; add it"),
        ('yValueUnit="kN"', 'yValueUnit="lbf"', "vehicle loco: yValueUnit = 'lbf': must be N or kN"),
        ('massDependent="false"', 'massDependent="true"', "massDependent = true: is not read"),
        ('isPrimaryMode="true"', 'isPrimaryMode="false"', "powerMode: 0 primary modes"),
        ('id="coach"', 'id="loco"', "vehicle loco: two vehicles have this id"),
        ("<trainBrakes", "<brakes", "formation push: trainBrakes: missing"),
        ('id="push"', "", "formation: it has no id"),
        ('xValue="40"', 'xValue="0"', "speeds must rise"),
        ('orderNumber="2"', 'orderNumber="1"', "orderNumber = 1: two have it"),
        ('mode="diesel"', 'mode="Diesel"', "vehicle loco: mode = 'Diesel': must be one of electric, diesel, battery"),
        ('<value yValue="270"/>', "", "vehicle loco: valueTable: give two valueLine or more, each with one value"),
    ],
)
def test_a_faulty_railml_train_is_refused(tmp_path: Path, before: str, after: str, message: str) -> None:
    """Breaks if a fault is a traceback, or names neither file nor element."""
    with one_line(message, "s.railml"):
        read_train(Path(written(tmp_path / "s.railml", RAIL_STOCK.replace(before, after, 1))))


def test_a_path_over_via_points_is_the_shortest_one_that_passes_them() -> None:
    """Breaks if a via point is left out, the order of two is exchanged, or the train turns at one."""
    network = Network("net", {"a": 100.0, "b": 100.0, "c": 300.0, "d": 100.0, "e": 50.0})
    for one, other in (("a", "b"), ("a", "c"), ("b", "d"), ("c", "d"), ("d", "e")):
        network.join((one, END), (other, BEGIN))
    assert [name for name, _ in network.path("a..e").parts] == ["a", "b", "d", "e"]
    assert [name for name, _ in network.path("a..c..e").parts] == ["a", "c", "d", "e"]
    assert [name for name, _ in network.path("a..b..d..e").parts] == ["a", "b", "d", "e"]
    for wrong in ("a..e..d", "a..b..c", "a..", "a....e"):
        with pytest.raises(ValueError, match="selection"):
            network.path(wrong)


def test_curves_of_their_own_resistance_are_named_where_they_are_lost(tmp_path: Path) -> None:
    """Breaks if a format without this key loses it in silence, or the mirrored line has another resistance."""
    name = written(tmp_path / "net.yaml", yaml.safe_dump([{}, LINKS])) + ":1..4"
    own = tmp_path / "own.yaml"
    assert main(["convert", name, str(own)]) == 0
    kept: Line = load_line(str(own))
    assert kept.curves[0].resistance_n_per_kn == load_line(name).curves[0].resistance_n_per_kn
    for a, b in pairwise(("own.yaml", "own.yaml:reverse")):
        dry = [sorted(set(np.round(Track(load_line(str(tmp_path / end))).dry, 12))) for end in (a, b)]
        assert dry[0] == dry[1]
