"""Lines in railML 3 (infrastructure, versions 3.1 to 3.3): a path through the net elements of the micro level.

Read are topology, gradient and horizontal curves, speed sections, temporary ones included, and operational points.
Gradients are in per mille, speeds in km/h, a radius > 0 turns to the right. A location is a position in m, an
intrinsic coordinate from 0 to 1, or a measure of a linear positioning system. The element names are those of the
schema. Document types, and with them all entities, are refused.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plant_sim.formats.fields import finite_number, read_bytes
from plant_sim.formats.network_path import BEGIN, END, Network, Range, line_data
from plant_sim.formats.railml_location import Location, NetElement
from plant_sim.input_error import build_model
from plant_sim.line import Line

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

ENDINGS = (".xml", ".railml")
READ_PARTS = (
    "topology", "gradientCurves", "horizontalCurves", "speeds", "speedSections", "operationalPoints",
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
    place, root = str(path), _root(path)
    infrastructure = next(_below(root, "infrastructure"), None)
    if infrastructure is None:
        raise ValueError(f"{place}: infrastructure: this element is missing; give a railML 3 infrastructure")
    elements = _net_elements(infrastructure, place)
    network = _network(infrastructure, elements, place)
    location = Location(elements, place)
    for point in _below(infrastructure, "operationalPoint"):
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
        for curve in _below(infrastructure, kind):
            if curve.get(key) is None:
                continue
            value = scale * _number(curve, key, place)
            for begin, end, forward in location.ranges(curve, found):
                rows.append((begin, end, value if forward else -value))
    speeds: list[Range] = []
    restrictions: list[dict[str, Any]] = []
    for section in _below(infrastructure, "speedSection"):
        key = "maxSpeed" if section.get("maxSpeed") is not None else "vMax"
        if section.get(key) in (None, "end"):
            continue
        speed = _number(section, key, place) / 3.6
        for begin, end, _ in location.ranges(section, found, directed=True):
            if section.get("isTemporary") == "true":
                restrictions.append({"begin": begin, "end": end, "speed": speed})
            else:
                speeds.append((begin, end, speed))
    name = f"{path.stem}{f' {selection}' if selection else ''}"
    sections = {"temporary_restrictions": sorted(restrictions, key=lambda entry: (entry["begin"], entry["end"]))}
    data = line_data(found, name, f"railML 3 infrastructure {path.name}", grades, radii, speeds, sections)
    return build_model(Line, data, place), "railML 3", _not_read(infrastructure)


class _RefusedDocumentType(Exception):
    """An XML file has a document type, which may declare entities."""


def _refuse_document_type(*_: object) -> None:
    raise _RefusedDocumentType


def _root(path: Path) -> Element:
    """Return the root of an XML file without document type and entities.

    Raises
    ------
    ValueError
        One line with file and reason.
    """
    from xml.etree.ElementTree import ParseError, fromstring
    from xml.parsers.expat import ExpatError, ParserCreate

    text = read_bytes(path)
    try:
        first = ParserCreate()  # entities need a document type, so this parser refuses them before they are expanded
        first.StartDoctypeDeclHandler = _refuse_document_type
        first.Parse(text, True)
        root = fromstring(text)
    except _RefusedDocumentType:
        raise ValueError(f"{path}: DOCTYPE: document types and entities are refused; remove them") from None
    except (ExpatError, ParseError, LookupError, UnicodeError) as error:
        raise ValueError(f"{path}: not valid XML: {' '.join(str(error).split())[:200]}; correct it") from None
    if _tag(root) != "railML":
        raise ValueError(f"{path}: root element '{_tag(root)[:60]}': must be railML of version 3; give such a file")
    if not root.get("version", "3").startswith("3"):
        raise ValueError(
            f"{path}: railML: version = '{str(root.get('version'))[:20]}': must be 3; export it in railML 3"
        )
    return root


def _tag(element: Element) -> str:
    """Return the name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


def _below(element: Element, tag: str) -> Iterator[Element]:
    """Yield all elements of a name below an element."""
    return (entry for entry in element.iter() if _tag(entry) == tag)


def _number(element: Element, key: str, place: str) -> float:
    where = f"{place}: {_tag(element)} {element.get('id', '')}: {key}"
    text = element.get(key, "")
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{where} = '{text[:40]}': must be a number") from None
    return finite_number(value, where, -1e9, 1e9)


def _name_of(element: Element) -> str:
    """Return the first name of an element, else its identifier."""
    named = (entry.get("name") for entry in element if _tag(entry) == "name")
    return next((name for name in named if name), element.get("id", ""))


def _net_elements(infrastructure: Element, place: str) -> dict[str, NetElement]:
    """Return the net elements of the micro level; those of higher levels are collections of them."""
    found: dict[str, NetElement] = {}
    for element in _below(infrastructure, "netElement"):
        parts = {_tag(entry) for entry in element}
        if parts & {"elementCollectionUnordered", "elementCollectionOrdered"}:
            continue
        measures: dict[str, list[tuple[float, float]]] = {}
        for coordinate in _below(element, "intrinsicCoordinate"):
            for linear in _below(coordinate, "linearCoordinate"):
                spot = (_number(coordinate, "intrinsicCoord", place), _number(linear, "measure", place))
                measures.setdefault(linear.get("positioningSystemRef", ""), []).append(spot)
        name = element.get("id", "")
        lengths = [abs(rows[-1][1] - rows[0][1]) for rows in measures.values() if len(rows) > 1]
        if element.get("length") is not None:
            lengths = [_number(element, "length", place)]
        if not lengths or lengths[0] <= 0:
            raise ValueError(f"{place}: netElement {name}: no length and no linear coordinates of its ends; add length")
        found[name] = NetElement(name, lengths[0], {key: rows for key, rows in measures.items() if len(rows) > 1})
    if not found:
        raise ValueError(f"{place}: topology: no netElement of the micro level; add the topology")
    return found


def _network(infrastructure: Element, elements: dict[str, NetElement], place: str) -> Network:
    """Return the network of the navigable net relations."""
    network = Network(place, {name: element.length for name, element in elements.items()})
    for relation in _below(infrastructure, "netRelation"):
        ends = []
        for letter in "AB":
            element = next(_below(relation, f"element{letter}"), None)
            name = "" if element is None else element.get("ref", "")
            ends.append((name, END if relation.get(f"positionOn{letter}") == POINT_ONE else BEGIN))
        if relation.get("navigability") in ("Both", "AB", "BA") and all(name in elements for name, _ in ends):
            network.join(*ends)
    return network


def _not_read(infrastructure: Element) -> tuple[str, ...]:
    """Return the parts of an infrastructure that the line does not carry, as ``functionalInfrastructure.signals``."""
    found = []
    for part in infrastructure:
        inner = [f"{_tag(part)}.{_tag(entry)}" for entry in part if _tag(entry) not in READ_PARTS]
        if _tag(part) not in READ_PARTS:
            found += inner if _tag(part) in ("geometry", "functionalInfrastructure") else [_tag(part)]
    return tuple(dict.fromkeys(found))
