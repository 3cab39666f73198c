"""Lines in railML 3 (infrastructure, versions 3.1 to 3.3): a path through the net elements of the micro level.

Read are topology, gradient and horizontal curves, speed sections, temporary ones included, operational points, tunnels
and electrification sections.
Gradients are in per mille, speeds in km/h, a radius > 0 turns to the right. A location is a position in m, an
intrinsic coordinate from 0 to 1, or a measure of a linear positioning system. The element names are those of the
schema. Document types, and with them all entities, are refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from plant_sim.formats.network_path import BEGIN, END, Network, Range, line_data
from plant_sim.formats.railml_location import Location, NetElement
from plant_sim.formats.railml_sections import NOT_CARRIED_BELOW, neutral_sections, tunnels
from plant_sim.formats.railml_xml import elements_below, number_of, read_root, tag_of
from plant_sim.input_error import build_model
from plant_sim.line import Line

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

ENDINGS = (".xml", ".railml")
READ_PARTS = (
    "topology", "gradientCurves", "horizontalCurves", "speeds", "speedSections", "operationalPoints", "overCrossings",
    "electrifications",
)  # fmt: skip
"""Parts of the infrastructure that the line carries."""
POINT_ONE = "1"
"""Position of a net relation at the end of its element."""


def is_railml(path: Path) -> bool:
    """Return True for a file with an ending of railML."""
    return path.suffix.lower() in ENDINGS


def railml_line(path: Path, selection: str = "") -> tuple[Line, str, tuple[str, ...]]:
    """Return the line along a path of an infrastructure, the format, and the parts that the line does not carry.

    Parameters
    ----------
    selection
        ``FROM..TO``: net elements or operational points; empty for a network without branches.

    Raises
    ------
    ValueError
        One line with file, element, value and remedy.
    """
    place, root = str(path), read_root(path)
    infrastructure = next(elements_below(root, "infrastructure"), None)
    if infrastructure is None:
        raise ValueError(f"{place}: infrastructure: this element is missing; give a railML 3 infrastructure")
    elements = _net_elements(infrastructure, place)
    network = _network(infrastructure, elements, place)
    location = Location(elements, place)
    for point in elements_below(infrastructure, "operationalPoint"):
        spots = location.spots(point)
        if spots:
            network.named.setdefault(_name_of(point), []).extend(spots)
    found = network.path(selection)
    grades: list[Range] = []
    radii: list[Range] = []
    for kind, key, rows, scale in (
        ("gradientCurve", "gradient", grades, 1e-3),
        ("horizontalCurve", "radius", radii, 1.0),
    ):
        for curve in elements_below(infrastructure, kind):
            if curve.get(key) is None:
                continue
            value = scale * number_of(curve, key, place)
            for begin, end, forward in location.ranges(curve, found):
                rows.append((begin, end, value if forward else -value))
    speeds: list[Range] = []
    restrictions: list[dict[str, Any]] = []
    for section in elements_below(infrastructure, "speedSection"):
        key = "maxSpeed" if section.get("maxSpeed") is not None else "vMax"
        if section.get(key) in (None, "end"):
            continue
        speed = number_of(section, key, place) / 3.6
        for begin, end, _ in location.ranges(section, found, directed=True):
            if section.get("isTemporary") == "true":
                restrictions.append({"begin": begin, "end": end, "speed": speed})
            else:
                speeds.append((begin, end, speed))
    name = f"{path.stem}{f' {selection}' if selection else ''}"
    sections = {
        "temporary_restrictions": sorted(restrictions, key=lambda entry: (entry["begin"], entry["end"])),
        "tunnels": tunnels(infrastructure, location, found),
        "neutral_sections": neutral_sections(infrastructure, location, found),
    }
    data = line_data(found, name, f"railML 3 infrastructure {path.name}", grades, radii, speeds, sections)
    return build_model(Line, data, place), "railML 3", _not_read(infrastructure)


def _name_of(element: Element) -> str:
    """Return the first name of an element, else its identifier."""
    named = (entry.get("name") for entry in element if tag_of(entry) == "name")
    return next((name for name in named if name), element.get("id", ""))


def _net_elements(infrastructure: Element, place: str) -> dict[str, NetElement]:
    """Return the net elements of the micro level; those of higher levels are collections of them."""
    found: dict[str, NetElement] = {}
    for element in elements_below(infrastructure, "netElement"):
        parts = {tag_of(entry) for entry in element}
        if parts & {"elementCollectionUnordered", "elementCollectionOrdered"}:
            continue
        measures: dict[str, list[tuple[float, float]]] = {}
        for coordinate in elements_below(element, "intrinsicCoordinate"):
            for linear in elements_below(coordinate, "linearCoordinate"):
                spot = (number_of(coordinate, "intrinsicCoord", place), number_of(linear, "measure", place))
                measures.setdefault(linear.get("positioningSystemRef", ""), []).append(spot)
        name = element.get("id", "")
        lengths = [abs(rows[-1][1] - rows[0][1]) for rows in measures.values() if len(rows) > 1]
        if element.get("length") is not None:
            lengths = [number_of(element, "length", place)]
        if not lengths or lengths[0] <= 0:
            raise ValueError(f"{place}: netElement {name}: no length and no linear coordinates of its ends; add length")
        found[name] = NetElement(name, lengths[0], {key: rows for key, rows in measures.items() if len(rows) > 1})
    if not found:
        raise ValueError(f"{place}: topology: no netElement of the micro level; add the topology")
    return found


def _network(infrastructure: Element, elements: dict[str, NetElement], place: str) -> Network:
    """Return the network of the navigable net relations."""
    network = Network(place, {name: element.length for name, element in elements.items()})
    for relation in elements_below(infrastructure, "netRelation"):
        ends = []
        for letter in "AB":
            element = next(elements_below(relation, f"element{letter}"), None)
            name = "" if element is None else element.get("ref", "")
            ends.append((name, END if relation.get(f"positionOn{letter}") == POINT_ONE else BEGIN))
        if relation.get("navigability") in ("Both", "AB", "BA") and all(name in elements for name, _ in ends):
            network.join(*ends)
    return network


def _not_read(infrastructure: Element) -> tuple[str, ...]:
    """Return the parts of an infrastructure that the line does not carry, as ``functionalInfrastructure.signals``."""
    found = []
    for part in infrastructure:
        inner = [f"{tag_of(part)}.{tag_of(entry)}" for entry in part if tag_of(entry) not in READ_PARTS]
        if tag_of(part) not in READ_PARTS:
            found += inner if tag_of(part) in ("geometry", "functionalInfrastructure") else [tag_of(part)]
        for owner, name in NOT_CARRIED_BELOW:
            if any(next(elements_below(entry, name), None) is not None for entry in elements_below(part, owner)):
                found.append(f"{tag_of(part)}.{owner}.{name}")
    return tuple(dict.fromkeys(found))
