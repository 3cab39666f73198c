"""Lines in railML 3 (infrastructure, versions 3.1 to 3.3): a path through the net elements of the micro level.

The reader takes topology, gradient and horizontal curves, speed sections, operational points, tunnels, electrification
sections, and lengths of tracks for net elements without a length. Temporary speed sections and the sections of speed
profiles are included. Entries on collections of net elements apply to the parts of the collection. Gradients are in per
mille, and speeds in km/h. A radius > 0 turns to the right. A location is a position in m, an intrinsic coordinate from
0 to 1, or a measure of a linear positioning system in its units. The element names are those of the schema. Document
types, and with them all entities, are refused.

A tunnel is an over crossing with the construction type of a tunnel. Version 3.3 has its cross section. An
electrification section is a section with a system of electric power. A path with such sections has no traction power at
three places: outside of them, in an insulated section, and in a section without a contact line.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from plant_sim.formats.fields import known_text, names_in, print_assumption
from plant_sim.formats.network_path import BEGIN, END, Network, Range, TrackPath, network_line, steps
from plant_sim.formats.railml2 import read_railml
from plant_sim.formats.railml_collection import Entry, NetElement, parts_of, read_root
from plant_sim.formats.railml_location import Location, grades, joined, measure_of, radii
from plant_sim.line import Line
from plant_sim.units import number_text

CROSS_SECTION_RANGE = (1.0, 1000.0)
"""Plausible cross section of a tunnel [m²]."""


def tunnels(infrastructure: Entry, location: Location, path: TrackPath) -> list[dict[str, Any]]:
    """Return the tunnels on a path by rising distance; one without a cross section adds no resistance."""
    place, found = path.network.place, []
    for crossing in infrastructure.below("overCrossing"):
        if crossing.get("constructionType") != "tunnel":
            continue
        drag = next(crossing.below("tunnelResistance"), None)
        air: dict[str, float] = {"resistance_n_per_kn": 0.0}
        if drag is not None and "crossSection" in drag:
            air = {"cross_section": drag.number("crossSection", *CROSS_SECTION_RANGE)}
        extents = sorted((begin, end) for begin, end, _ in location.ranges(crossing, path))
        name = f"{place}: tunnel {crossing.get('id')}"
        if extents and "cross_section" not in air:
            print_assumption(f"{name}: it has no cross section; no additional resistance in it")
        found += [{"begin": begin, "end": end, **air} for begin, end in joined(extents)]
    return sorted(found, key=lambda entry: (entry["begin"], entry["end"]))


def neutral_sections(infrastructure: Entry, location: Location, path: TrackPath) -> list[dict[str, Any]]:
    """Return the sections of a path without traction power by rising distance; none for a path without any data."""
    listed: list[Range] = []
    for section in infrastructure.below("electrificationSection"):
        insulated = section.flag("isInsulatedSection")
        value = 0.0 if insulated or section.get("contactLineType").lower() == "none" else 1.0
        listed += [Range(begin, end, value) for begin, end, _ in location.ranges(section, path, directed=True)]
    dead = joined(path.without_power(listed, "electrificationSection"))
    return [{"begin": begin, "end": end} for begin, end in dead]


SCALED = 0.01
"""Difference of a length from that of its measures, over the length, that is noted."""
ENDINGS = (".xml", ".railml")
SPOT = "spotLocation.{@netElementRef, @pos, @intrinsicCoord, linearCoordinate.{@positioningSystemRef, @measure}}"
STRETCH = """associatedNetElement.{@netElementRef, @keepsOrientation, @posBegin, @posEnd, @fromPos, @toPos,
    @intrinsicCoordBegin, @intrinsicCoordEnd, {linearCoordinateBegin, linearCoordinateEnd}.{@positioningSystemRef,
    @measure}}"""
CARRIED = names_in(
    """
    @version, common.{positioning.linearPositioningSystems.linearPositioningSystem.{@id, @units},
    speedProfiles.speedProfile.{@id, @influence, @isBasicSpeedProfile, name.@name, load.@axleLoad,
    braking.@minimumBrakePercentage}}, infrastructure.{topology.{netElements.netElement.{@id, @length,
    associatedPositioningSystem.intrinsicCoordinate.{@intrinsicCoord, linearCoordinate.{@positioningSystemRef,
    @measure}}, elementCollectionOrdered.{@sequence, elementPart.@ref}, elementCollectionUnordered.elementPart.@ref},
    netRelations.netRelation.{@positionOnA, @positionOnB, @navigability, {elementA, elementB}.@ref}},
    geometry.{gradientCurves.gradientCurve.{@gradient, @deltaGradient, @curveType, linearLocation.STRETCH},
    horizontalCurves.horizontalCurve.{@radius, linearLocation.STRETCH}},
    functionalInfrastructure.{{speeds, speedSections}.speedSection.{@maxSpeed, @vMax, @isTemporary,
    validForSpeedProfile.@ref, linearLocation.{@applicationDirection, STRETCH}},
    operationalPoints.operationalPoint.{name.@name, SPOT}, tracks.track.{length.@value, linearLocation.STRETCH},
    overCrossings.overCrossing.{@constructionType, tunnelResistance.@crossSection, linearLocation.STRETCH},
    electrifications.electrificationSection.{@isInsulatedSection, @contactLineType,
    linearLocation.{@applicationDirection, STRETCH}}}}
""".replace("STRETCH", STRETCH).replace("SPOT", SPOT)
)
STATION = "operationalPoint"
UNITS = {
    "m": 1.0, "metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0, "km": 1e3, "kilometre": 1e3, "kilometres": 1e3,
    "kilometer": 1e3, "kilometers": 1e3, "mi": 1609.344, "mile": 1609.344, "miles": 1609.344, "yd": 0.9144,
    "yards": 0.9144, "ft": 0.3048, "foot": 0.3048, "feet": 0.3048, "chain": 20.1168, "chains": 20.1168,
}  # fmt: skip
"""Length of one unit of a linear positioning system [m]."""
NEEDS = (("load", "axleLoad", "axle_load_t"), ("braking", "minimumBrakePercentage", "brake_percentage"))
"""Element and attribute of a speed profile, and the figure of a train."""
NAVIGABILITY = ("None", "Both", "AB", "BA")
WHOLE = {"netElementRef", "keepsOrientation", "id"}
"""Attributes of a location on a net element as a whole."""


def is_railml(path: Path) -> bool:
    """Return True for a file with an ending of railML."""
    return path.suffix.lower() in ENDINGS


def holds_stock(path: Path) -> bool:
    """Return True for a file with rolling stock and without an infrastructure."""
    root = read_root(path)
    infrastructure, stock = (next(root.below(tag), None) for tag in ("infrastructure", "rollingstock"))
    return infrastructure is None and stock is not None


def railml_line(path: Path, selection: str = "", *, against: bool = False) -> tuple[Line, str, tuple[str, ...]]:
    """Return the line along a path of an infrastructure, the format, and the names that the line does not carry.

    A path is ``FROM..TO``, net elements or operational points; ``against`` runs it from ``TO`` to ``FROM``.
    """
    place = str(path)
    root, form, left = read_railml(path, CARRIED)
    found = list(root.below("infrastructure"))
    if len(found) > 1:
        raise ValueError(f"{place}: infrastructure: {len(found)} elements of this name; keep one")
    if not found:
        if holds_stock(path):
            raise ValueError(f"{place}: holds a train (railML), no line; exchange them")
        raise ValueError(f"{place}: infrastructure: this element is missing; give one with it")
    infrastructure, units = found[0], _units(root)
    elements = _net_elements(infrastructure, units)
    higher = {entry.get("id", "") for part in infrastructure.below("topology") for entry in part.element.iter()}
    network = _network(infrastructure, elements, higher)
    network.groups = {name: element.parts for name, element in elements.items() if element.ordered}
    location = Location(elements, network, higher, units)
    for point in infrastructure.below(STATION):
        spots = location.spots(point)
        if spots:
            network.named.setdefault(_name_of(point), []).extend(spots)
        else:
            print_assumption(f"{point.place}: it has no spotLocation on a netElement and is left out")
    way = network.path(selection, against=against)
    profiles = _profiles(root)
    speeds, by_category, restrictions = _speeds(infrastructure, location, way, profiles)
    line = network_line(
        way,
        f"{form} infrastructure",
        selection,
        against=against,
        grades=grades(infrastructure, location, way),
        radii=radii(infrastructure, location, way),
        speeds=speeds,
        sections={
            "temporary_restrictions": restrictions,
            "tunnels": tunnels(infrastructure, location, way),
            "neutral_sections": neutral_sections(infrastructure, location, way),
        },
        by_category=by_category,
        needs={profile.category: profile.needs for profile in profiles.values() if profile.needs},
    )
    return line, form, left


class _Profile(NamedTuple):
    """Speed profile: its category, "" for all trains; the figures that a train needs; True if it lowers the limits."""

    category: str
    needs: dict[str, float]
    lowers: bool


def _profiles(root: Entry) -> dict[str, _Profile]:
    """Return the speed profiles by their identifier; a basic one holds for all trains."""
    found: dict[str, _Profile] = {}
    for entry in root.below("speedProfile"):
        basic = entry.flag("isBasicSpeedProfile")
        needs = {
            name: part.number(key, 0.1, 500) for tag, key, name in NEEDS for part in entry.below(tag) if key in part
        }
        lowers = entry.choice("influence", ("increasing", "decreasing")) == "decreasing" and not basic
        tilts = any(True for _ in entry.below("tilting"))
        if lowers or tilts or basic:  # neither is known of a train by its figures
            if lowers:
                print_assumption(f"{entry.place}: its lower limits hold for trains of no category too")
            needs = {}
        found[entry.get("id")] = _Profile("" if basic else _name_of(entry), needs, lowers)
    return found


def _speeds(
    infrastructure: Entry, location: Location, path: TrackPath, profiles: Mapping[str, _Profile]
) -> tuple[list[Range], dict[str, list[Range]], list[dict[str, Any]]]:
    """Return the permanent speed limits [m/s] of all trains and by category, and the restrictions on a path.

    A section that is valid for speed profiles holds for their categories, in place of the limit of all trains. Where
    all sections are of a category, a train of another one has the lowest of them.
    """
    place = path.network.place
    by_category: dict[str, list[Range]] = {}
    lowered: list[Range] = []
    restrictions: list[dict[str, Any]] = []
    for section in infrastructure.below("speedSection"):
        key = "maxSpeed" if "maxSpeed" in section else "vMax"
        passages = location.ranges(section, path, directed=True, needed=True)
        entry = section.place
        if section.get(key, "end") == "end":
            if passages:
                print_assumption(f"{entry}: no maxSpeed; left out")
            continue
        speed = section.number(key, 0.1, 1000.0) / 3.6
        if passages and section.get("trainRelation", "endOfTrain") != "endOfTrain":
            print_assumption(
                f"{entry}: trainRelation = '{section.get('trainRelation', '')[:20]}': the part of the train that the "
                "speed holds for; here it holds for its whole length, which is the safe side"
            )
        refs = [part.get("ref") for part in section.below("validForSpeedProfile")]
        for ref in refs:
            if ref not in profiles:
                raise ValueError(f"{entry}: validForSpeedProfile: ref = '{ref[:60]}': not in the file; correct it")
        for begin, end, _ in passages:
            if section.flag("isTemporary"):
                restrictions.append({"begin": begin, "end": end, "speed": speed})
                continue
            categories = {profiles[ref].category: True for ref in refs} or {"": True}
            if any(profiles[ref].lowers for ref in refs):
                lowered.append(Range(begin, end, speed, entry))
            for category in categories:
                by_category.setdefault(category, []).append(Range(begin, end, speed, entry))
    general = by_category.pop("", [])
    lowest = _laid([row for rows in by_category.values() for row in rows], general, path)
    if by_category and lowest != _laid((), general, path):
        print_assumption(
            f"{place}: speedSection: some only for speed profiles; other trains have the lowest of them there"
        )
    if lowered:
        lowest = _laid((), [*lowest, *lowered], path)
    found = {category: _laid(lowest, rows, path) for category, rows in by_category.items()}
    return lowest, found, sorted(restrictions, key=lambda entry: (entry["begin"], entry["end"]))


def _laid(under: Sequence[Range], over: Sequence[Range], path: TrackPath) -> list[Range]:
    """Return the lowest values of ``over``, and where it has none those of ``under``."""

    def layer(ranges: Sequence[Range], choose: Callable[[list[float]], float]) -> list[Range]:
        return [row for row in steps(path.length, ranges, choose, 0.0) if row.value]

    return layer([*layer(under, min), *layer(over, min)], lambda values: values[-1])


def _name_of(element: Entry) -> str:
    """Return the first name of an element, else its identifier."""
    named = (entry.get("name") for entry in element.parts("name"))
    return next((name for name in named if name), element.get("id"))


def _units(root: Entry) -> dict[str, float]:
    """Return the length of one unit of the measures [m], by linear positioning system."""
    found: dict[str, float] = {}
    for system in root.below("linearPositioningSystem"):
        unit = known_text(system.get("units", "m").strip().lower(), f"{system.place}: units", UNITS)
        found[system.get("id")] = UNITS[unit]
    return found


def _net_elements(infrastructure: Entry, units: dict[str, float]) -> dict[str, NetElement]:
    """Return the net elements; those of higher levels are collections of others."""
    found: dict[str, NetElement] = {}
    tracks, place = _track_lengths(infrastructure), infrastructure.file
    for element in infrastructure.below("netElement"):
        name, measures = element.get("id"), _measures(element, units)
        parts, ordered = parts_of(element)
        if name in found:
            raise ValueError(f"{place}: netElement {name}: id: two net elements have this id; correct one")
        lengths = [
            abs(rows[-1][1] - rows[0][1]) / (rows[-1][0] - rows[0][0])
            for rows in measures.values()
            if rows[-1][0] > rows[0][0]
        ]
        by_measures = lengths
        if "length" in element:
            lengths = [element.number("length")]
        elif not parts and name in tracks:
            lengths = [tracks[name]]
        if by_measures and not parts and abs(by_measures[0] - lengths[0]) > SCALED * lengths[0]:
            print_assumption(
                f"{place}: netElement {name}: length {number_text(lengths[0])} m, its measures have "
                f"{number_text(by_measures[0])} m; places on it are scaled"
            )
        if not parts and (not lengths or lengths[0] <= 0):
            raise ValueError(
                f"{place}: netElement {name}: no length, no linear coordinates of its ends, and no track with a length "
                "that has it alone; add length"
            )
        given = lengths[0] if lengths and (not parts or "length" in element) else 0.0
        found[name] = NetElement(name, given, measures, parts, ordered)
    if all(element.parts for element in found.values()):
        raise ValueError(f"{place}: topology: no netElement of the micro level; add the topology")
    for system in sorted({key for element in found.values() for key in element.measures} - set(units)):
        print_assumption(f"{place}: linearPositioningSystem '{system}' is not in the file; its measures read as metres")
    return found


def _measures(element: Entry, units: dict[str, float]) -> dict[str, list[tuple[float, float]]]:
    """Return intrinsic coordinate and measure [m] of the points of a net element, by linear positioning system."""
    measures: dict[str, list[tuple[float, float]]] = {}
    for coordinate in element.below("intrinsicCoordinate"):
        for linear in coordinate.below("linearCoordinate"):
            system, measure = measure_of(linear, units)
            measures.setdefault(system, []).append((coordinate.number("intrinsicCoord", 0.0, 1.0), measure))
    return {system: sorted(rows) for system, rows in measures.items() if len(rows) > 1}


def _track_lengths(infrastructure: Entry) -> dict[str, float]:
    """Return the length [m] of every track with a length that lies on one net element as a whole."""
    found: dict[str, float] = {}
    for track in infrastructure.below("track"):
        parts = [part for entry in track.parts("linearLocation") for part in entry.parts()]
        lengths = [entry for entry in track.parts("length") if "value" in entry]
        if len(parts) == 1 and lengths and parts[0].element.attrib.keys() <= WHOLE and not parts[0].parts():
            found[parts[0].get("netElementRef")] = lengths[0].number("value", 1e-3, 1e7)
    return found


def _network(infrastructure: Entry, elements: dict[str, NetElement], higher: Collection[str]) -> Network:
    """Return the network of the navigable net relations."""
    lengths = {name: element.length for name, element in elements.items() if not element.parts}
    network = Network(infrastructure.file, lengths)
    for relation in infrastructure.below("netRelation"):
        ends = []
        entry = relation.place
        for letter in "AB":
            element = next(relation.below(f"element{letter}"), None)
            name = "" if element is None else element.get("ref")
            if name not in higher:
                raise ValueError(f"{entry}: element{letter}: ref = '{name[:60]}': not in the topology; correct it")
            if name in network.lengths:
                at = relation.number(f"positionOn{letter}")
                if at not in (0.0, 1.0):
                    raise ValueError(f"{entry}: positionOn{letter} = {at:g}: must be 0 or 1; correct it")
                ends.append((name, END if at else BEGIN))
        way = known_text(relation.get("navigability"), f"{entry}: navigability", NAVIGABILITY)
        if len(ends) == 2 and way != "None":
            one, other = ends if way != "BA" else ends[::-1]
            network.join(one, other, both=way == "Both")
    return network
