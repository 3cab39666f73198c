"""Lines in the infrastructure format of OSRD (RailJSON 3, Open Rail Association): a path through a network of tracks.

Gradients are in per mille along a track, speeds in m/s, a radius > 0 turns to the right. Speed sections hold for all
trains and routes; limits by train category are not read. Neutral sections are directional.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from plant_sim.formats.fields import Fields, finite_number
from plant_sim.formats.network_path import BEGIN, END, Network, Range, TrackPath, line_data
from plant_sim.input_error import build_model
from plant_sim.line import Line

CARRIED_INFRA = (
    "track_sections[].id", "track_sections[].length", "track_sections[].slopes", "track_sections[].curves",
    "switches[].id", "switches[].switch_type", "switches[].ports", "track_nodes[].id", "track_nodes[].track_node_type",
    "track_nodes[].ports", "speed_sections[].id", "speed_sections[].speed_limit", "speed_sections[].track_ranges",
    "neutral_sections[].id", "neutral_sections[].track_ranges", "operational_points[].id",
    "operational_points[].parts[].track", "operational_points[].parts[].position",
    "operational_points[].extensions.identifier.name",
)  # fmt: skip
"""Keys of an infrastructure that the line carries, as far as they are on its path."""
TYPES = ("link", "point_switch", "crossing", "single_slip_switch", "double_slip_switch")
"""Types of switches; ports A join ports B, at a crossing those of the same number."""


def is_osrd(data: dict[str, Any]) -> bool:
    """Return True if the data of a file are an infrastructure of OSRD."""
    return isinstance(data.get("track_sections"), list)


def osrd_line(data: dict[str, Any], place: str, selection: str = "") -> Line:
    """Return the line along a path of an infrastructure.

    Parameters
    ----------
    selection
        ``FROM..TO``: tracks or operational points; empty for a network without branches.

    Raises
    ------
    ValueError
        One line with location, key, value and remedy.
    """
    top = Fields(data, place)
    tracks = {fields.text("id"): fields for fields in _each(top, "track_sections")}
    network = Network(place, {name: fields.number("length", None, 1e-3, 1e7) for name, fields in tracks.items()})
    for key, kind in (("switches", "switch_type"), ("track_nodes", "track_node_type")):
        for fields in _each(top, key):
            _join_ports(network, fields, fields.text(kind))
    for fields in _each(top, "operational_points"):
        _name_station(network, fields)
    path = network.path(selection)
    grades, radii = _geometry(path, tracks)
    speeds = [
        (*extent, fields.number("speed_limit", None, 0.1, 300.0))
        for fields in _each(top, "speed_sections")
        if "speed_limit" in fields
        for extent in _ranges(path, fields, "applicable_directions")
    ]
    neutral = [
        {"begin": begin, "end": end}
        for fields in _each(top, "neutral_sections")
        for begin, end in _ranges(path, fields, "direction")
    ]
    name = f"{Path(place).stem}{f' {selection}' if selection else ''}"
    source = f"OSRD infrastructure {Path(place).name}"
    sections = {"neutral_sections": sorted(neutral, key=lambda entry: entry["begin"])}
    return build_model(Line, line_data(path, name, source, grades, radii, speeds, sections), place)


def _each(fields: Fields, key: str) -> Iterator[Fields]:
    """Yield the entries of a list; none without the key."""
    if key in fields:
        for number, entry in enumerate(fields.entries(key, 0)):
            yield Fields(entry, f"{fields.place}: {key}[{number}]")


def _join_ports(network: Network, fields: Fields, kind: str) -> None:
    """Join the ends of the tracks at the ports of a switch."""
    if kind not in TYPES:
        raise ValueError(f"{fields.place}: type = '{kind[:40]}': must be one of {', '.join(TYPES)}")
    ports = fields.below("ports")
    ends: dict[str, tuple[str, str]] = {}
    for port in ports.data:
        end = ports.below(port)
        track, side = end.text("track"), end.text("endpoint")
        if track not in network.lengths or side not in ("BEGIN", "END"):
            raise ValueError(
                f"{end.place}: track '{track[:60]}', endpoint '{side[:20]}': not an end of a track; correct it"
            )
        ends[str(port)] = (track, BEGIN if side == "BEGIN" else END)
    for one in (port for port in ends if port.startswith("A")):
        for other in (port for port in ends if port.startswith("B")):
            crossed = one[1:] != other[1:]
            if (kind == "crossing" and crossed) or (kind == "single_slip_switch" and (one, other) == ("A2", "B1")):
                continue
            network.join(ends[one], ends[other])


def _name_station(network: Network, fields: Fields) -> None:
    """Name the places of an operational point, by its name or its identifier."""
    name = fields.text("id")
    if "extensions" in fields and "identifier" in fields.below("extensions"):
        name = fields.below("extensions").below("identifier").text("name", name)
    for part in _each(fields, "parts"):
        track = part.text("track")
        if track not in network.lengths:
            raise ValueError(f"{part.place}: track '{track[:60]}' is not in track_sections; correct it")
        spot = (track, part.number("position", None, 0, 1e7))
        network.named.setdefault(name, []).append(spot)


def _geometry(path: TrackPath, tracks: dict[str, Fields]) -> tuple[list[Range], list[Range]]:
    """Return the grades and the radii on the path; both change their sign with the direction."""
    grades: list[Range] = []
    radii: list[Range] = []
    for track, forward in path.parts:
        sign = 1.0 if forward else -1.0
        for entry in _each(tracks[track], "slopes"):
            extent = path.extent(track, entry.number("begin"), entry.number("end"))
            grades.append((*extent, sign * entry.number("gradient", None, -500, 500) / 1e3))
        for entry in _each(tracks[track], "curves"):
            extent = path.extent(track, entry.number("begin"), entry.number("end"))
            radii.append((*extent, sign * entry.number("radius")))
    return grades, radii


def _ranges(path: TrackPath, fields: Fields, key: str) -> Iterator[tuple[float, float]]:
    """Yield begin and end on the path [m] of the track ranges that hold in its direction."""
    for part in _each(fields, "track_ranges"):
        track, direction = part.text("track"), part.text(key, "BOTH")
        if track not in path:
            continue
        if direction not in ("BOTH", "START_TO_STOP", "STOP_TO_START"):
            raise ValueError(f"{part.place}: {key} = '{direction[:30]}': must be BOTH, START_TO_STOP or STOP_TO_START")
        if direction == "BOTH" or (direction == "START_TO_STOP") == path.forward(track):
            first, last = ("begin", "end") if "begin" in part or "end" not in part.data else ("start", "end")
            low = finite_number(part.data.get(first, 0.0), f"{part.place}: {first}", 0, 1e7)
            yield path.extent(track, low, part.number(last, None, 0, 1e7))
