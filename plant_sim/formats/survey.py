"""Lines from a recorded track with heights: GPX 1.0 and 1.1, and GeoJSON (RFC 7946).

Distances are those on the WGS 84 ellipsoid. Measured heights are noisy, and a grade is their derivative: they are
averaged over :data:`WINDOW` and give a grade for every :data:`STRETCH`. A track has no speed limits, and its points
are too coarse for curves. Waypoints and points with a name beside the track are stops.
"""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from plant_sim.alignment import Alignment
from plant_sim.formats.fields import Fields, finite_number, names_in, number_in, print_assumption
from plant_sim.formats.line_table import slopes
from plant_sim.formats.railml_collection import Entry, names_lost
from plant_sim.formats.writing import NOT_XML, lost_keys
from plant_sim.input_error import build_model
from plant_sim.line import Line
from plant_sim.units import number_text

WINDOW, STRETCH = 300.0, 100.0
"""Length over which heights are averaged, and of the stretches of one grade [m]."""
BESIDE = 200.0
"""Largest distance of a station from the track [m]."""
GAP = 20e3
"""Largest distance between two points of a track [m]."""
WIDE = 1e3
"""Distance between two points of a track above which a note names them [m]."""
STRAIGHT = 5e-3
"""Difference between the length of a line and the way along its coordinates, over the way, that is named."""
MAX_COORDINATES = 2000
"""Largest number of coordinates of a line; of a longer track every n-th one."""
CARRIED = names_in("""
    coordinates, type, features[].{geometry.{coordinates, type}, properties.name, type}, geometry.{coordinates,
    type}, properties.name
""")
CARRIED_GPX = names_in("""
    @version, rte.{name, rtept.{@lat, @lon, ele}}, trk.{name, trkseg.trkpt.{@lat, @lon, ele}}, wpt.{@lat, @lon,
    ele, name}
""")
EQUATOR, ECCENTRICITY = 6_378_137.0, 6.694_379_990_14e-3
"""Radius at the equator [m] and squared eccentricity of WGS 84."""
Spot = tuple[float, float, float | None]
"""Latitude and longitude [deg], height [m] or None."""


def is_gpx(path: Path) -> bool:
    """Return True for a file with the ending of GPX."""
    return path.suffix.lower() == ".gpx"


def is_geojson(data: dict[str, Any]) -> bool:
    """Return True if the data of a file are GeoJSON."""
    return data.get("type") in ("FeatureCollection", "Feature", "LineString", "MultiLineString")


def geojson_line(data: dict[str, Any], place: str, selection: str = "") -> Line:
    """Return the line along the track of a file."""
    entries = Fields(data, place).entries("features", 0) if data["type"] == "FeatureCollection" else [data]
    tracks: list[tuple[str, list[Spot]]] = []
    stations: list[tuple[str, Spot]] = []
    for k, entry in enumerate(entries):
        feature = Fields(entry, f"{place}: features[{k}]")
        whole = feature.data.get("type") == "Feature"
        if whole and feature.data.get("geometry") is None:
            print_assumption(f"{feature.place}: no geometry; passed over")
            continue
        shape = feature.below("geometry") if whole else feature
        properties = feature.data.get("properties")
        name = str((properties if isinstance(properties, dict) else {}).get("name") or "")
        kind = shape.text("type")
        rows = shape.entries("coordinates") if kind in ("Point", "LineString", "MultiLineString") else []
        if kind == "Point" and name:
            stations.append((name, _spot(rows, shape.place)))
        elif kind == "LineString":
            tracks.append((name, [_spot(row, f"{shape.place}: coordinates[{i}]") for i, row in enumerate(rows)]))
        elif kind == "MultiLineString":
            parts = Fields(dict(enumerate(rows)), f"{shape.place}: coordinates")
            tracks.append((name, [_spot(row, f"{parts.place}: {k}") for k in parts.data for row in parts.entries(k)]))
        else:
            print_assumption(f"{feature.place}: {kind} '{name}' is neither a track nor a named point; passed over")
    line = _line(tracks, stations, place, selection, "GeoJSON")
    first = line.coordinates[0]
    print_assumption(
        f"{place}: read as [longitude, latitude]: the track begins at {abs(first.latitude):.2f}° "
        f"{'NS'[first.latitude < 0]}, {abs(first.longitude):.2f}° {'EW'[first.longitude < 0]}; else exchange them"
    )
    return line


def _spot(row: Any, place: str) -> Spot:
    if not isinstance(row, list) or len(row) not in (2, 3):
        raise ValueError(f"{place} = {str(row)[:40]}: must be [longitude, latitude, height]; correct it")
    longitude, latitude = finite_number(row[0], place, -180, 180), finite_number(row[1], place, -90, 90)
    return latitude, longitude, finite_number(row[2], place, -1e3, 1e4) if len(row) > 2 else None


def gpx_line(root: Entry, place: str, selection: str = "") -> tuple[Line, tuple[str, ...]]:
    """Return the line along a track, or route, of a GPX file, and the elements that it does not carry."""
    tracks: list[tuple[str, list[Spot]]] = []
    stations: list[tuple[str, Spot]] = []
    if root.tag != "gpx":
        raise ValueError(f"{place}: <{root.tag}> is no GPX; give a file that begins with <gpx>")
    for element in root.parts():
        kind, name, points = element.tag, _text(element, "name"), element.below("trkpt", "rtept")
        if kind in ("trk", "rte"):
            tracks.append((name, [_gpx_spot(point, f"{place}: point {k}") for k, point in enumerate(points, 1)]))
        elif kind == "wpt" and name:
            stations.append((name, _gpx_spot(element, f"{place}: wpt '{name}'")))
        elif kind == "wpt":
            print_assumption(f"{place}: a wpt without a name is no stop; passed over")
    line = _line(tracks, stations, place, selection, "GPX")
    return line, names_lost(root, CARRIED_GPX)


def _text(entry: Entry, tag: str) -> str:
    found = entry.first(tag)
    return " ".join(((found.element.text if found else None) or "").split())


def _gpx_spot(point: Entry, place: str) -> Spot:
    latitude, longitude = (
        number_in(point.get(key), f"{place}: {key}", -most, most) for key, most in (("lat", 90), ("lon", 180))
    )
    height = _text(point, "ele")
    return latitude, longitude, number_in(height, f"{place}: ele", -1e3, 1e4) if height else None


def _line(
    tracks: list[tuple[str, list[Spot]]], stations: list[tuple[str, Spot]], place: str, selection: str, form: str
) -> Line:
    """Return the line along the one, or the selected, track."""
    listed = [entry for entry in tracks if len(entry[1]) > 1 and selection in ("", entry[0])]
    if selection.isascii() and selection.isdigit() and len(listed) != 1:
        listed = tracks[int(selection) - 1 : int(selection)] if int(selection) else []
    if len(listed) != 1:
        names = ", ".join(f"{k} '{name}'" for k, (name, _) in enumerate(tracks[:8], 1))
        raise ValueError(
            f"{place}: {len(listed)} tracks{f' named {selection!r}' if selection else ''} (it has {names or 'none'}); "
            + ("select one as FILE:NAME or FILE:NUMBER" if tracks else "give a file with a track")
        )
    name, spots = listed[0]
    spots = [spot for k, spot in enumerate(spots) if not k or spot[:2] != spots[k - 1][:2]]
    at = distances(spots)
    if at[-1] < 2 * STRETCH:
        raise ValueError(f"{place}: track '{name}' is {at[-1]:.0f} m long; a line needs {2 * STRETCH:g} m")
    wide = int(np.argmax(np.diff(at)))
    gap = float(at[wide + 1] - at[wide])
    apart = f"{place}: track '{name}', points {wide + 1} and {wide + 2}: {gap / 1e3:.1f} km apart"
    if gap > GAP:
        raise ValueError(f"{apart}; give a track without gaps")
    if gap > WIDE:
        print_assumption(f"{apart}; straight between them")
    if (turn := _turning_place(at, spots)) is not None:
        print_assumption(f"{place}: track '{name}' turns back near {number_text(turn)} m; the line runs on there")
    every = math.ceil(len(spots) / MAX_COORDINATES)
    shown = sorted({*range(0, len(spots), every), len(spots) - 1})
    raw = {
        "schema": "train_ato/line/1",
        "name": name or Path(place).stem,
        "source": f"{form} track {Path(place).name}",
        "end": float(at[-1]),
        "grades": _grades(at, [spot[2] for spot in spots], place),
        "stops": _stops(at, spots, stations, place),
        "coordinates": [{"at": float(at[k]), "latitude": spots[k][0], "longitude": spots[k][1]} for k in shown],
    }
    print_assumption(f"{place}: a track has no speed limits and no curves; only the train limits the speed")
    return build_model(Line, raw, place)


def distances(spots: list[Spot]) -> Any:
    """Return the distance of every point along the track on the ellipsoid [m], shape (n,)."""
    return np.concatenate(([0.0], np.cumsum(np.hypot(*_steps(spots)))))


def _turning_place(at: Any, spots: list[Spot]) -> float | None:
    """Return the first place [m] where a track turns back, by chords of :data:`STRETCH`; None without one."""
    north, east = (np.concatenate(([0.0], np.cumsum(steps))) for steps in _steps(spots))
    knots = np.arange(0.0, float(at[-1]), STRETCH)
    x, y = (np.diff(np.interp(knots, at, values)) for values in (north, east))
    back = np.flatnonzero(x[1:] * x[:-1] + y[1:] * y[:-1] < 0.0)
    return float(knots[back[0] + 1]) if back.size else None


def _steps(spots: list[Spot]) -> tuple[Any, Any]:
    """Return the ways to the north and to the east from point to point [m], shape (n - 1,) each."""
    latitude, longitude = (np.radians(np.array([spot[:2] for spot in spots], dtype=float)[:, k]) for k in (0, 1))
    middle = (latitude[1:] + latitude[:-1]) / 2
    bulge = 1 - ECCENTRICITY * np.square([math.sin(angle) for angle in middle.tolist()])
    north = EQUATOR * (1 - ECCENTRICITY) / bulge**1.5 * np.diff(latitude)
    turn = (np.diff(longitude) + math.pi) % (2 * math.pi) - math.pi  # over the date line too
    east = EQUATOR / np.sqrt(bulge) * np.array([math.cos(angle) for angle in middle.tolist()]) * turn
    return north, east


def _grades(at: Any, heights: list[float | None], place: str) -> list[dict[str, float]]:
    """Return the grades of averaged heights, one for every stretch; none without heights."""
    known = [k for k, height in enumerate(heights) if height is not None]
    if not known:
        print_assumption(f"{place}: no heights; assumed level")
        return []
    if len(known) < len(heights):
        print_assumption(f"{place}: {len(heights) - len(known)} points without height; linear between the others")
    count = math.ceil(float(at[-1]) / STRETCH)
    knots = np.linspace(0.0, float(at[-1]), count + 1)
    fine = np.append(np.arange(0.0, float(at[-1]), 10.0), at[-1])
    height = np.array([heights[k] for k in known], dtype=float)
    level = np.interp(fine, at[known], height - height[0])
    whole = np.concatenate(([0.0], np.cumsum((level[1:] + level[:-1]) / 2 * np.diff(fine))))
    # The window is symmetric and ends at the ends of the track, where it keeps the height of the first and last point.
    half = np.minimum(WINDOW / 2, np.minimum(knots, at[-1] - knots))
    wide = np.maximum(half, 1.0)
    mean = (np.interp(knots + wide, fine, whole) - np.interp(knots - wide, fine, whole)) / (2 * wide)
    mean = np.where(half < 10.0, np.interp(knots, fine, level), mean)
    found = slopes(list(zip(knots.tolist(), mean.tolist(), strict=True)), place)
    steepest = max((abs(grade) for _, grade in found), default=0.0)
    print_assumption(
        f"{place}: heights averaged over {WINDOW:g} m, one grade for every {STRETCH:g} m; the steepest has "
        f"{number_text(1e3 * steepest, 3)} per mille"
    )
    return [{"at": begin, "grade": grade} for begin, grade in found]


def _stops(at: Any, spots: list[Spot], stations: list[tuple[str, Spot]], place: str) -> list[dict[str, Any]]:
    """Return the stations at the nearest point of the track."""
    found: dict[float, str] = {}
    for name, station in stations:
        ways = [float(distances([station, spot])[-1]) for spot in spots]
        nearest = int(np.argmin(ways))
        if ways[nearest] > BESIDE:
            print_assumption(f"{place}: '{name}' is {ways[nearest]:.0f} m beside the track; no stop")
        while ways[nearest] <= BESIDE:  # a track may pass it again
            found.setdefault(float(at[nearest]), name)
            for side in (range(nearest, -1, -1), range(nearest + 1, len(ways))):
                for k in side:
                    if ways[k] > 2 * BESIDE:
                        break
                    ways[k] = math.inf
            nearest = int(np.argmin(ways))
    return [{"at": where, "name": name} for where, name in sorted(found.items())]


def _points(line: Line) -> tuple[list[tuple[float, Spot]], tuple[str, ...]]:
    """Return the points of a line with coordinates, each with its place [m], and what a track does not carry.

    A line without coordinates is refused.
    """
    alignment = Alignment(line)
    known = [spot.at for spot in line.coordinates]
    if not known:
        raise ValueError(f"line '{line.name}': coordinates: it has none, and a track needs them; write .yaml or .csv")
    first, last = max(known[0], line.begin), min(known[-1], line.end)
    inner = [*known, *(grade.at for grade in line.rounded_grades), *(stop.at for stop in line.stops)]
    places = sorted({first, *(at for at in inner if first < at < last), last})
    where = np.array(places)
    found = alignment.coordinates(where)
    assert found is not None  # the line has coordinates
    heights = alignment.at(where).z.tolist()
    left = lost_keys(line, ("grades", "stops", "stops[].name", "coordinates"))
    if first > line.begin or last < line.end:
        left.append(f"places without coordinates: only {number_text(first)} to {number_text(last)} m")
    spots = list(zip(found[0].tolist(), found[1].tolist(), heights, strict=True))
    way = float(distances(spots)[-1])
    if abs(way - (last - first)) > STRAIGHT * way:
        left.append(f"its length of {number_text(last - first)} m: its coordinates are {number_text(way)} m apart")
    return list(zip(places, spots, strict=True)), (*left, "heights above the begin of the line, not above the sea")


def _named(line: Line, points: list[tuple[float, Spot]]) -> list[tuple[str, Spot]]:
    """Return name and coordinates of the stops within the track."""
    by_place = dict(points)
    stops = ((stop.name or f"stop at {number_text(stop.at)} m", by_place.get(stop.at)) for stop in line.stops)
    return [(name, spot) for name, spot in stops if spot is not None]


def line_geojson(line: Line) -> tuple[str, tuple[str, ...]]:
    """Return a line with coordinates as GeoJSON, and the keys that are left out."""
    points, left = _points(line)
    shapes: list[tuple[str, str, Any]] = [("LineString", line.name, [[lon, lat, z] for _, (lat, lon, z) in points])]
    shapes += [("Point", name, [lon, lat, z]) for name, (lat, lon, z) in _named(line, points)]
    features = [
        {"type": "Feature", "properties": {"name": name}, "geometry": {"type": kind, "coordinates": coordinates}}
        for kind, name, coordinates in shapes
    ]
    return json.dumps({"type": "FeatureCollection", "features": features}, ensure_ascii=False) + "\n", left


def line_gpx(line: Line) -> tuple[str, tuple[str, ...]]:
    """Return a line with coordinates as GPX 1.1, and the keys that are left out."""
    from xml.sax.saxutils import escape

    points, left = _points(line)

    def shown(text: str) -> str:
        return escape(NOT_XML.sub("", text))

    def element(tag: str, spot: Spot, name: str = "") -> str:
        inner = f"<ele>{spot[2]}</ele>" + (f"<name>{shown(name)}</name>" if name else "")
        return f'<{tag} lat="{spot[0]}" lon="{spot[1]}">{inner}</{tag}>\n'

    stations = "".join(element("wpt", spot, name) for name, spot in _named(line, points))
    rows = "".join(element("trkpt", spot) for _, spot in points)
    gpx = '<gpx version="1.1" creator="train_ato" xmlns="http://www.topografix.com/GPX/1/1">'
    head = f'<?xml version="1.0" encoding="UTF-8"?>\n{gpx}'
    return f"{head}\n{stations}<trk><name>{shown(line.name)}</name><trkseg>\n{rows}</trkseg></trk></gpx>\n", left
