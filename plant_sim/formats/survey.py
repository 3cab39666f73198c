"""Lines from a recorded track with heights: GPX 1.0 and 1.1, and GeoJSON (RFC 7946).

Distances are those on the WGS 84 ellipsoid. Measured heights are noisy, and a grade is their derivative: they are
averaged over :data:`WINDOW` and give a grade for every :data:`STRETCH`. A track has no speed limits, and its points
are too coarse for curves. Waypoints and points with a name beside the track are stops.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from plant_sim.formats.fields import Fields, finite_number, print_assumption
from plant_sim.formats.line_table import slopes
from plant_sim.input_error import build_model
from plant_sim.line import Line
from plant_sim.units import number_text

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

WINDOW, STRETCH = 300.0, 100.0
"""Length over which heights are averaged, and of the stretches of one grade [m]."""
BESIDE = 200.0
"""Largest distance of a station from the track [m]."""
GAP = 20e3
"""Largest distance between two points of a track [m]."""
MAX_COORDINATES = 2000
"""Largest number of coordinates of a line; of a longer track every n-th one."""
CARRIED = ("type", "features[].type", "features[].geometry", "features[].properties.name", "geometry", "coordinates")
"""Keys of GeoJSON that the line carries."""
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
    """Return the line along the track of a file.

    Parameters
    ----------
    selection
        Name of one of several tracks.

    Raises
    ------
    ValueError
        One line with location, key, value and remedy.
    """
    entries = data["features"] if isinstance(data.get("features"), list) else [data]
    tracks: list[tuple[str, list[Spot]]] = []
    stations: list[tuple[str, Spot]] = []
    for k, entry in enumerate(entries):
        feature = Fields(entry, f"{place}: features[{k}]")
        shape = feature.below("geometry") if feature.data.get("type") == "Feature" else feature
        properties = feature.data.get("properties")
        name = str((properties if isinstance(properties, dict) else {}).get("name") or "")
        kind, rows = shape.text("type"), shape.entries("coordinates")
        if kind == "Point" and name:
            stations.append((name, _spot(rows, shape.place)))
        elif kind == "LineString":
            tracks.append((name, [_spot(row, f"{shape.place}: coordinates[{i}]") for i, row in enumerate(rows)]))
        elif kind == "MultiLineString":
            tracks.append((name, [_spot(row, shape.place) for part in rows for row in part]))
        else:
            print_assumption(f"{feature.place}: {kind} '{name}' is neither a track nor a named point; passed over")
    return _line(tracks, stations, place, selection, "GeoJSON")


def _spot(row: Any, place: str) -> Spot:
    if not isinstance(row, list) or len(row) not in (2, 3):
        raise ValueError(f"{place} = {str(row)[:40]}: must be [longitude, latitude, height]; correct it")
    longitude, latitude = finite_number(row[0], place, -180, 180), finite_number(row[1], place, -90, 90)
    return latitude, longitude, finite_number(row[2], place, -1e3, 1e4) if len(row) > 2 else None


def gpx_line(root: Element, place: str, selection: str = "") -> tuple[Line, tuple[str, ...]]:
    """Return the line along a track, or route, of a GPX file, and the elements that it does not carry.

    Parameters
    ----------
    selection
        Name of one of several tracks.

    Raises
    ------
    ValueError
        One line with location, value and remedy.
    """
    tracks: list[tuple[str, list[Spot]]] = []
    stations: list[tuple[str, Spot]] = []
    for element in root:
        kind = element.tag.rpartition("}")[2]
        name = _text(element, "name")
        points = [entry for entry in element.iter() if entry.tag.rpartition("}")[2] in ("trkpt", "rtept")]
        if kind in ("trk", "rte"):
            tracks.append((name, [_gpx_spot(point, place) for point in points]))
        elif kind == "wpt" and name:
            stations.append((name, _gpx_spot(element, place)))
    known = {"gpx", "trk", "rte", "trkseg", "trkpt", "rtept", "wpt", "name", "ele"}
    left = dict.fromkeys(entry.tag.rpartition("}")[2] for entry in root.iter())
    line = _line(tracks, stations, place, selection, "GPX")
    return line, tuple(f"<{tag}>" for tag in left if tag not in known)


def _text(element: Element, tag: str) -> str:
    found = next((entry.text for entry in element if entry.tag.rpartition("}")[2] == tag), None)
    return " ".join((found or "").split())


def _gpx_spot(point: Element, place: str) -> Spot:
    values: dict[str, float | None] = {}
    for key, text in (("lat", point.get("lat")), ("lon", point.get("lon")), ("ele", _text(point, "ele") or None)):
        try:
            values[key] = None if text is None else float(text)
        except ValueError:
            raise ValueError(f"{place}: {key} = '{str(text)[:30]}': is not a number; correct it") from None
    latitude = finite_number(values["lat"], f"{place}: lat", -90, 90)
    longitude = finite_number(values["lon"], f"{place}: lon", -180, 180)
    height = values["ele"]
    return latitude, longitude, None if height is None else finite_number(height, f"{place}: ele", -1e3, 1e4)


def _line(
    tracks: list[tuple[str, list[Spot]]], stations: list[tuple[str, Spot]], place: str, selection: str, form: str
) -> Line:
    """Return the line along the one, or the selected, track."""
    listed = [entry for entry in tracks if len(entry[1]) > 1 and selection in ("", entry[0])]
    if len(listed) != 1:
        names = ", ".join(f"'{name}'" for name, _ in tracks[:8])
        raise ValueError(
            f"{place}: {len(listed)} tracks{f' named {selection!r}' if selection else ''} (it has {names or 'none'}); "
            "select one as FILE:NAME"
        )
    name, spots = listed[0]
    spots = [spot for k, spot in enumerate(spots) if not k or spot[:2] != spots[k - 1][:2]]
    at = distances(spots)
    wide = int(np.argmax(np.diff(at)))
    if at[wide + 1] - at[wide] > GAP:
        raise ValueError(
            f"{place}: track '{name}', points {wide} and {wide + 1}: {(at[wide + 1] - at[wide]) / 1e3:.1f} km apart; "
            "give a track without gaps"
        )
    if at[-1] < 2 * STRETCH:
        raise ValueError(f"{place}: track '{name}' is {at[-1]:.0f} m long; a line needs {2 * STRETCH:g} m")
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
    latitude, longitude = (np.radians(np.array([spot[:2] for spot in spots], dtype=float)[:, k]) for k in (0, 1))
    middle = (latitude[1:] + latitude[:-1]) / 2
    bulge = 1 - ECCENTRICITY * np.square([math.sin(angle) for angle in middle.tolist()])
    north = EQUATOR * (1 - ECCENTRICITY) / bulge**1.5 * np.diff(latitude)
    turn = (np.diff(longitude) + math.pi) % (2 * math.pi) - math.pi  # over the date line too
    east = EQUATOR / np.sqrt(bulge) * np.array([math.cos(angle) for angle in middle.tolist()]) * turn
    return np.concatenate(([0.0], np.cumsum(np.hypot(north, east))))


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
    fine = np.arange(0.0, float(at[-1]) + 5.0, 10.0)
    level = np.interp(fine, at[known], np.array([heights[k] for k in known], dtype=float))
    whole = np.concatenate(([0.0], np.cumsum((level[1:] + level[:-1]) / 2 * 10.0)))
    # The window is symmetric and ends at the ends of the track, where it keeps the height of the first and last point.
    half = np.minimum(WINDOW / 2, np.minimum(knots, at[-1] - knots))
    wide = np.maximum(half, 1.0)
    mean = (np.interp(knots + wide, fine, whole) - np.interp(knots - wide, fine, whole)) / (2 * wide)
    mean = np.where(half < 10.0, np.interp(knots, fine, level), mean)
    found = slopes(list(zip(knots.tolist(), mean.tolist(), strict=True)))
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
        else:
            found.setdefault(float(at[nearest]), name)
    return [{"at": where, "name": name} for where, name in sorted(found.items())]
