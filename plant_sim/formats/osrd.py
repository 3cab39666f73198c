"""Lines in the infrastructure format of OSRD (RailJSON 3, Open Rail Association): a path through a network of tracks.

Gradients are in per mille along a track, and speeds in m/s. A radius > 0 turns to the right. Speed sections apply to
all routes. A limit by tag replaces the other limits for trains of that category. Neutral sections are directional.
"""

from collections.abc import Iterator
from typing import Any

from plant_sim.formats.fields import Fields, known_text, names_in, print_assumption
from plant_sim.formats.network_path import BEGIN, END, ROUNDING, Network, Passage, Range, TrackPath, network_line
from plant_sim.line import Line
from plant_sim.units import number_text

CARRIED_INFRA = names_in("""
    electrifications[].track_ranges[].{applicable_directions, begin, end, track},
    neutral_sections[].track_ranges[].{begin, direction, end, start, track},
    operational_points[].{extensions.identifier.name, parts[].{position, track}}, speed_sections[].{speed_limit,
    speed_limit_by_tag.*, track_ranges[].{applicable_directions, begin, end, start, track}},
    switches[].{ports.*.{endpoint, track}, switch_type}, track_nodes[].{ports.*.{endpoint, track},
    track_node_type}, track_sections[].{curves[].{begin, end, radius, start}, id, length, slopes[].{begin, end,
    gradient, start}}
""")
"""Keys of an infrastructure that the line carries, as far as they are on its path."""
DIRECTIONS = ("BOTH", "START_TO_STOP", "STOP_TO_START")
TYPES = ("link", "point_switch", "crossing", "single_slip_switch", "double_slip_switch")
"""Types of switches; ports A join ports B, at a crossing those of the same number."""


def osrd_line(data: dict[str, Any], place: str, selection: str = "", *, against: bool = False) -> Line:
    """Return the line along a path ``FROM..TO``, tracks or operational points, or ``against`` it from ``TO``."""
    top = Fields(data, place)
    if not data["track_sections"]:
        raise ValueError(f"{place}: track_sections: empty; add the tracks")
    tracks = top.named("track_sections", "id", "tracks")
    network = Network(place, {name: fields.number("length", None, 1e-3, 1e7) for name, fields in tracks.items()})
    for key, kind in (("switches", "switch_type"), ("track_nodes", "track_node_type")):
        for fields in top.each(key):
            _join_ports(network, fields, fields.text(kind))
    for fields in top.each("operational_points"):
        _name_station(network, fields)
    path = network.path(selection, against=against)
    grades, radii = _geometry(path, tracks)
    sections_of_speed = top.each("speed_sections")
    tags = dict.fromkeys(tag for fields in sections_of_speed for tag in fields.data.get("speed_limit_by_tag") or {})
    speeds = [speed for fields in sections_of_speed for speed in _speeds(path, fields)]
    by_category = {
        str(tag): [speed for fields in sections_of_speed for speed in _speeds(path, fields, tag)] for tag in tags
    }
    live = [
        Range(begin, end, 1.0)
        for fields in top.each("electrifications")
        for begin, end, _ in _ranges(path, fields, "applicable_directions")
    ]
    neutral = [passage[:2] for fields in top.each("neutral_sections") for passage in _ranges(path, fields, "direction")]
    neutral = sorted([*neutral, *path.without_power(live, "electrification")], key=lambda stretch: stretch[0])
    sections = {"neutral_sections": [{"begin": begin, "end": end} for begin, end in neutral]}
    return network_line(
        path, "OSRD infrastructure", selection, against=against, grades=grades, radii=radii, speeds=speeds,
        sections=sections, by_category=by_category,
    )  # fmt: skip


def _join_ports(network: Network, fields: Fields, kind: str) -> None:
    """Join the ends of the tracks at the ports of a switch."""
    known_text(kind, f"{fields.place}: type", TYPES)
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
    for part in fields.each("parts"):
        track = part.text("track")
        if track not in network.lengths:
            raise ValueError(f"{part.place}: track '{track[:60]}' is not in track_sections; correct it")
        length, position = network.lengths[track], part.number("position")
        if not 0 <= position <= length + ROUNDING:
            part.number("position", None, 0, length)
        spot = (track, min(position, length))
        network.named.setdefault(name, []).append(spot)


def _geometry(path: TrackPath, tracks: dict[str, Fields]) -> tuple[list[Range], list[Range]]:
    """Return the grades and the radii on the path; both change their sign with the direction."""
    grades: list[Range] = []
    radii: list[Range] = []
    for track in dict.fromkeys(track for track, _ in path.parts):
        for entry in tracks[track].each("slopes"):
            grade = entry.number("gradient", None, -500, 500) / 1e3
            grades += _signed(path.passages(track, *_extent(entry), entry.place), grade, entry.place)
        for entry in tracks[track].each("curves"):
            radius = entry.number("radius")
            radii += _signed(path.passages(track, *_extent(entry), entry.place), radius, entry.place)
    return grades, radii


def _speeds(path: TrackPath, fields: Fields, tag: str | None = None) -> list[Range]:
    """Return the speed limits of a speed section for all trains, or for those of a category."""
    passages = list(_ranges(path, fields, "applicable_directions"))
    tags = fields.below("speed_limit_by_tag") if "speed_limit_by_tag" in fields else Fields({}, fields.place)
    source, key = (tags, tag) if tag is not None and tag in tags else (fields, "speed_limit")
    if key not in source:
        if passages and tag is None:
            print_assumption(f"{fields.place}: no speed_limit; a train of no category has no limit of its own there")
        return []
    speed = source.number(key, None, 0.1, 300.0)
    return [Range(begin, end, speed, fields.place) for begin, end, _ in passages]


def _signed(passages: list[Passage], value: float, entry: str) -> list[Range]:
    return [Range(begin, end, value if forward else -value, entry) for begin, end, forward in passages]


def _extent(fields: Fields) -> tuple[float, float]:
    """Return begin and end on a track [m]; the begin of the track without one."""
    first, last = ("begin", "end") if "begin" in fields or "end" in fields else ("start", "end")
    begin, end = fields.number(first, 0.0, -1e7, 1e7), fields.number(last, None, -1e7, 1e7)
    if end < begin:
        raise ValueError(
            f"{fields.place}: {last} = {number_text(end)}: lies before {first} {number_text(begin)}; exchange them"
        )
    return begin, end


def _ranges(path: TrackPath, fields: Fields, key: str) -> Iterator[Passage]:
    """Yield the passages of the track ranges that hold in the direction of running."""
    if "track_ranges" not in fields or not fields.entries("track_ranges", 0):
        raise ValueError(f"{fields.place}: track_ranges: none, so its place is not known; add them or remove the entry")
    for part in fields.each("track_ranges"):
        track, direction = part.text("track"), known_text(part.text(key, "BOTH"), f"{part.place}: {key}", DIRECTIONS)
        for passage in path.passages(track, *_extent(part), part.place):
            if direction == "BOTH" or (direction == "START_TO_STOP") == passage.forward:
                yield passage
