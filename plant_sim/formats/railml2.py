"""Infrastructure and rolling stock of railML 2 (2.0 to 2.5), written anew as that of railML 3 and read by its readers.

A track of railML 2 has its data at the positions where they change, and its switches between its ends. A value holds
from its position to the next change of the track or to its end, a speed with ``dir="down"`` in the other direction. A
speed before ``vMax="end"`` is a temporary restriction. A track with switches becomes a chain of parts ``ID/1``,
``ID/2``. Tracks at one macroscopic node are all joined there. The element names are those of the schema.
"""

import math
from collections.abc import Iterable
from itertools import combinations, pairwise, product
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

from plant_sim.formats.fields import known_text, names_in, print_assumption
from plant_sim.formats.railml_collection import ORDERED, Entry, names_lost, read_root, version_of
from plant_sim.units import number_text

CARRIED = names_in("""
    @version, infrastructure.{operationControlPoints.ocp.{@id, @name}, speedProfiles.speedProfile.{@id,
    @influence, @maxAxleLoad, @name, braking.@minimumBrakePercentage}, tracks.track.{@id,
    trackElements.{electrificationChanges.electrificationChange.{@isolatedSection, @pos, @type},
    gradientChanges.gradientChange.{@pos, @slope}, radiusChanges.radiusChange.{@pos, @radius},
    speedChanges.speedChange.{@dir, @pos, @profileRef, @vMax}, tunnels.tunnel.{@crossSection, @length, @pos}},
    trackTopology.{connections.{crossing.{@pos, @type, connection.{@id, @orientation, @passable, @ref}},
    switch.{@pos, connection.{@id, @orientation, @passable, @ref}}}, crossSections.crossSection.{@ocpRef, @pos},
    {trackBegin, trackEnd}.{@pos, connection.{@id, @ref}, macroscopicNode.{@flowDirection, @ocpRef}}}}},
    rollingstock.{formations.formation.{@id, @speed, trainBrakes.{@meanDeceleration, @regularBrakePercentage},
    trainEngine.@trainMaxAcceleration, trainOrder.vehicleRef.{@orderNumber, @vehicleCount, @vehicleRef},
    trainResistance.{@daviesFactorA, @daviesFactorB, @daviesFactorC, @daviesMassDependent}},
    vehicles.vehicle.{@axleLoad, @bruttoWeight, @id, @length, @resistanceFactor, @speed, @tareWeight,
    engine.propulsion.{@maxTractEffort, @power, @powerType, @rotationMassFactor,
    tractiveEffort.valueTable.{@xValueUnit, @yValueUnit, valueLine.{@xValue, values.@yValue}}}}}
""")
DAVIS = ("constantFactorA", "speedDependentFactorB", "squareSpeedDependentFactorC")
"""Factors of the running resistance in railML 3."""
_End = tuple[str, str]
"""Part of a track, and its position 0 or 1."""
CHANGES = {
    "gradientChange": "gradientCurve",
    "radiusChange": "horizontalCurve",
    "electrificationChange": "electrificationSection",
}
"""Elements of railML 3 by the changes of their values."""
WAYS = {"": None, "up": "normal", "down": "reverse"}
"""Direction of running in railML 3 by that of a speed change."""
NAVIGABLE = {(True, True): "Both", (True, False): "AB", (False, True): "BA", (False, False): "None"}
"""Navigability of a relation by the ways from A to B and from B to A."""
VALUES = ("slope", "radius", "vMax", "type", "isolatedSection")
ENDS = ("end", "999.9")
"""Speed of the end of a temporary restriction, and that before railML 2.3."""


def read_railml(path: Path, carried: Iterable[str]) -> tuple[Entry, str, tuple[str, ...]]:
    """Return the root of a file in railML 3, its format, and the names of it that are not carried.

    Parameters
    ----------
    carried
        Names of railML 3 that the reader carries.
    """
    root = read_root(path)
    if version_of(root) == "3":
        return root, "railML 3", names_lost(root, carried)
    new = Element("railML", version="3")
    for infrastructure in root.below("infrastructure"):
        _infrastructure(infrastructure, new)
    for stock in root.below("rollingstock"):
        _stock(stock, SubElement(new, "rollingstock"))
    return Entry(new, root.file), "railML 2", names_lost(root, CARRIED)


def _add(parent: Element, tag: str, **keys: str | None) -> Element:
    """Return a new element below another one; keys with None are left out."""
    return SubElement(parent, tag, {key: value for key, value in keys.items() if value is not None})


def _first(element: Entry, tag: str) -> Entry:
    """Return the first element of a name below an element."""
    if (found := next(element.below(tag), None)) is None:
        raise ValueError(f"{element.place}: {tag}: missing; add it")
    return found


def _infrastructure(old: Entry, root: Element) -> None:
    """Write tracks, stations and speed profiles of an infrastructure."""
    common, tracks = SubElement(root, "common"), _Tracks(SubElement(root, "infrastructure"), old.file)
    for profile in old.below("speedProfile"):
        entry = _add(common, "speedProfile", id=profile.element.get("id"), influence=profile.element.get("influence"))
        _add(entry, "name", name=profile.element.get("name"))
        if profile.get("maxAxleLoad"):
            _add(entry, "load", axleLoad=profile.get("maxAxleLoad"))
        entry.extend(part.element for part in profile.parts("tilting", "braking"))
    for track in old.below("track"):
        tracks.add(track)
    tracks.join({ocp.get("id"): ocp.element.get("name") for ocp in old.below("ocp")})


class _Tracks:
    """Tracks of railML 2 as net elements, net relations and located data of railML 3."""

    def __init__(self, infrastructure: Element, place: str) -> None:
        self._new, self._place = infrastructure, place
        topology = SubElement(infrastructure, "topology")
        self._elements, self._relations = SubElement(topology, "netElements"), SubElement(topology, "netRelations")
        self._ends: dict[str, _End | None] = {}
        self._joints: list[tuple[_End | str, str, str]] = []
        self._nodes: dict[str, list[tuple[_End, str]]] = {}
        self._stations: dict[str, list[tuple[str, float]]] = {}

    def add(self, track: Entry) -> None:
        """Write one track with its data."""
        name, place = track.get("id"), self._place
        if not name:
            raise ValueError(f"{place}: track: id: missing; add it")
        first, last = (_first(track, tag) for tag in ("trackBegin", "trackEnd"))
        begin = first.number("pos")
        length = last.number("pos", begin + 1e-3) - begin
        nodes = [(node.number("pos", begin, begin + length) - begin, node)
                 for node in track.below("switch", "crossing")]  # fmt: skip
        cuts = sorted({0.0, length, *(at for at, node in nodes if node.parts("connection"))})
        parts = [name] if len(cuts) == 2 else [f"{name}/{number}" for number in range(1, len(cuts))]
        if len(parts) > 1:
            chain = _add(_add(self._elements, "netElement", id=name), ORDERED)
        for number, part in enumerate(parts):
            _add(self._elements, "netElement", id=part, length=repr(cuts[number + 1] - cuts[number]))
            if len(parts) > 1:
                _add(chain, "elementPart", ref=part)
            if number:
                self._relate((parts[number - 1], "1"), (part, "0"))
        for node, end, position in ((first, (parts[0], "0"), 0.0), (last, (parts[-1], "1"), length)):
            for connection in node.below("connection"):
                self._connect(connection, end)
            for macro in node.below("macroscopicNode"):
                flow = macro.choice("flowDirection", ("both", "in", "out"))
                self._nodes.setdefault(macro.get("ocpRef"), []).append((end, flow))
                self._stations.setdefault(macro.get("ocpRef"), []).append((name, position))
        for at, node in nodes:
            self._branch(node, at, cuts, parts)
        for section in track.below("crossSection"):
            at = section.number("pos", begin, begin + length) - begin
            self._stations.setdefault(section.get("ocpRef"), []).append((name, at))
        self._locate(track, name, begin, length)

    def _connect(self, connection: Entry, end: _End | None) -> None:
        """Register a connection at an end of a part, None for one without a way from there."""
        passable = connection.flag("passable", default=True)
        self._ends[connection.get("id")] = end if passable else None
        if end is not None and passable:
            self._joints.append((end, connection.get("ref"), connection.place))

    def _branch(self, node: Entry, at: float, cuts: list[float], parts: list[str]) -> None:
        """Register the connections of a switch or crossing at a position of a track [m]."""
        number = cuts.index(at) if at in cuts else 0
        plain = node.tag == "crossing" and "Switch" not in node.get("type")
        sides: dict[str, list[str]] = {"incoming": [], "outgoing": []}
        for connection in node.parts("connection"):
            way = known_text(connection.get("orientation"), f"{connection.place}: orientation", sides)
            sides[way].append(connection.get("ref"))
            out = way == "outgoing"
            if not plain and not (number if out else number < len(parts)):
                where = f"{node.place}: pos: {way} at the {'begin' if out else 'end'} of its track"
                raise ValueError(f"{where} leads over no part of it; place it on the track beside it")
            end = None if plain else (parts[number - 1], "1") if out else (parts[number], "0")
            self._connect(connection, end)
        if node.tag == "crossing":
            self._joints += [(one, two, node.place) for one, two in product(*sides.values())]

    def join(self, names: dict[str, str | None]) -> None:
        """Write the relations of all connections and nodes, and the stations with their names."""
        for end, ref, entry in self._joints:
            for key in (end, ref) if isinstance(end, str) else (ref,):
                if key not in self._ends:
                    raise ValueError(f"{entry}: ref = '{key[:60]}': no connection of the file; correct it")
            near = self._ends[end] if isinstance(end, str) else end
            far = self._ends[ref]
            if near is not None and far is not None:
                self._relate(near, far)
        for ocp, ends in self._nodes.items():
            if len(ends) > 2:
                print_assumption(f"{self._place}: ocp {ocp}: every track at this macroscopic node leads to every other")
            for (one, flow), (other, onward) in combinations(ends, 2):
                ways = (flow != "out" and onward != "in", onward != "out" and flow != "in")
                self._relate(one, other, NAVIGABLE[ways])
        for ocp, name in names.items():
            station = _add(self._new, "operationalPoint", id=ocp)
            _add(station, "name", name=name)
            for track, at in self._stations.get(ocp, ()):
                _add(station, "spotLocation", netElementRef=track, pos=repr(at))

    def _relate(self, one: _End, other: _End, way: str = "Both") -> None:
        relation = _add(self._relations, "netRelation", positionOnA=one[1], positionOnB=other[1], navigability=way)
        _add(relation, "elementA", ref=one[0])
        _add(relation, "elementB", ref=other[0])

    def _locate(self, track: Entry, name: str, begin: float, length: float) -> None:
        """Write the data along a track: values between their changes, and tunnels."""
        edge = begin + length, track

        def listed(tag: str, way: str | None = None, profile: str | None = None) -> list[tuple[float, Entry]]:
            found = [(e.number("pos", begin, begin + length), e) for e in track.below(tag)
                     if way is None or (e.get("dir"), e.get("profileRef")) == (way, profile)]  # fmt: skip
            return found if tag == "tunnel" else _each_once(found, -1.0 if way == "down" else 1.0)

        def written(old: Entry, tag: str, first: float, last: float, way: str | None = None, **keys: str) -> Element:
            low, high = sorted((first - begin, last - begin))
            if high > length * (1 + 1e-9):
                raise ValueError(f"{old.place}: it ends beyond the track {name}; correct it")
            entry = _add(self._new, tag, id=old.element.get("id"), **keys)
            location = _add(entry, "linearLocation", applicationDirection=way)
            _add(location, "associatedNetElement", netElementRef=name, posBegin=repr(low), posEnd=repr(high))
            return entry

        for tag, new in CHANGES.items():
            changes = listed(tag)
            for (at, change), (end, _) in zip(changes, [*changes[1:], edge], strict=False):
                if change.get("dir") == "down":
                    raise ValueError(f"{change.place}: dir = 'down': its sign is not known; write dir up")
                off = str(change.flag("isolatedSection")).lower()
                keys = {"isInsulatedSection": off, "contactLineType": change.get("type")}
                if tag != "electrificationChange":
                    slope = tag == "gradientChange"
                    value = change.number("slope", -500, 500) if slope else change.number("radius")
                    keys = {"gradient" if slope else "radius": repr(value)}
                written(change, new, at, end, **keys)
        for at, tunnel in listed("tunnel"):
            end = at + tunnel.number("length", 0)
            entry = written(tunnel, "overCrossing", at, end, constructionType="tunnel")
            _add(entry, "tunnelResistance", crossSection=tunnel.element.get("crossSection"))
        speeds = track.below("speedChange")
        for way, profile in sorted({(e.get("dir"), e.get("profileRef")) for e in speeds}):
            known_text(way, f"{self._place}: track {name}: speedChange: dir", WAYS)
            last = (begin, track) if way == "down" else edge
            changes = listed("speedChange", way, profile)
            followed = [*zip(changes, [*changes[1:], last], strict=False)]
            brief = [pair for pair in followed if _ends(pair[1]) and not _ends(pair[0])]
            lasting = [one for one, after in followed if not _ends(one) and not _ends(after)]
            for (at, change), (end, after) in [*zip(lasting, [*lasting[1:], last], strict=False), *brief]:
                temporary = str(_ends((end, after))).lower()
                keys = {"maxSpeed": repr(change.number("vMax", 0.1, 1000.0)), "isTemporary": temporary}
                entry = written(change, "speedSection", at, end, WAYS[way], **keys)
                if profile:
                    _add(entry, "validForSpeedProfile", ref=profile)


def _each_once(changes: list[tuple[float, Entry]], sign: float) -> list[tuple[float, Entry]]:
    """Return changes in running order, -1 for falling places; two values at one place are refused.

    At one place a restriction ends first, and the lower one of two speeds is a restriction if it ends before the next
    change.
    """

    def order(change: tuple[float, Entry]) -> tuple[float, float]:
        speed = math.inf if _ends(change) else change[1].number("vMax") if change[1].get("vMax") else 0.0
        return sign * change[0], -speed

    found: dict[tuple[float | str, ...], tuple[float, Entry]] = {}
    for change in sorted(changes, key=order):
        found.setdefault((change[0], *(change[1].get(key, "") for key in VALUES)), change)
    kept = [*found.values()]
    for (one, other), after in zip(pairwise(kept), [*kept[2:], None], strict=False):
        if one[0] == other[0] and not _ends(one) and (after is None or not _ends(after)):
            raise ValueError(f"{other[1].place}: pos = {number_text(one[0])}: another value there; keep one")
    return kept


def _ends(entry: tuple[float, Entry]) -> bool:
    """Return True for the change at the end of a temporary restriction."""
    return entry[1].get("vMax") in ENDS


def _stock(old: Entry, new: Element) -> None:
    """Write vehicles and formations of rolling stock."""
    for vehicle in old.below("vehicle"):
        keys = {key: vehicle.element.get(key) for key in ("id", "length", "speed", "bruttoWeight", "tareWeight")}
        entry = _add(new, "vehicle", **keys, maximumAxleLoad=vehicle.element.get("axleLoad"))
        if vehicle.get("resistanceFactor"):
            info = _add(SubElement(entry, "drivingResistance"), "info", airDragCoefficient="0", crossSectionArea="0")
            info.set("rollingResistance", vehicle.get("resistanceFactor"))
        drives = [*vehicle.below("propulsion")]
        for drive in drives[:1]:
            if drive.get("rotationMassFactor"):
                entry.set("rotatingMassFactor", drive.get("rotationMassFactor"))
            kind = drive.get("powerType").lower()
            mode = _add(SubElement(entry, "engine"), "powerMode", mode=kind, isPrimaryMode="true")
            traction = SubElement(mode, "tractionData")
            force, power = map(drive.element.get, ("maxTractEffort", "power"))
            _add(traction, "info", maxTractiveEffort=force, tractivePower=power)
            if (table := next((t for e in drive.parts("tractiveEffort") for t in e.parts()), None)) is not None:
                print_assumption(f"{drive.place}: power and maxTractEffort: no effect beside its table")
                effort = SubElement(SubElement(traction, "details"), "tractiveEffort")
                copy = SubElement(effort, "valueTable", table.element.attrib)
                for line in table.parts("valueLine"):
                    row = _add(copy, "valueLine", xValue=line.element.get("xValue"))
                    for value in line.parts("values"):
                        _add(row, "value", yValue=value.element.get("yValue"))
        if len(drives) > 1:
            print_assumption(f"{vehicle.place}: propulsion: {len(drives)}; the first one is read")
    for formation in old.below("formation"):
        entry = _add(new, "formation", id=formation.element.get("id"), speed=formation.element.get("speed"))
        order = list(formation.below("vehicleRef"))
        order.sort(key=lambda ref: ref.number("orderNumber", 0, 1e5))
        refs = [ref.element.get("vehicleRef") for ref in order for _ in range(_count(ref))]
        for number, name in enumerate(refs):
            _add(entry, "trainOrder", orderNumber=str(number), vehicleRef=name)
        for engine in formation.parts("trainEngine"):
            _add(entry, "trainEngine", maxAcceleration=engine.element.get("trainMaxAcceleration"))
        entry.extend(part.element for part in formation.parts("trainBrakes"))
        for drag in formation.parts("trainResistance"):
            keys = dict(zip(DAVIS, (drag.element.get(f"daviesFactor{letter}") for letter in "ABC"), strict=True))
            mass = drag.element.get("daviesMassDependent")
            _add(SubElement(entry, "trainResistance"), "daviesFormulaFactors", massDependent=mass, **keys)


def _count(ref: Entry) -> int:
    """Return the number of equal vehicles of a train order."""
    count = ref.number("vehicleCount", 1, 1000) if ref.get("vehicleCount") else 1.0
    if count != int(count):
        raise ValueError(f"{ref.place}: vehicleCount = {count:g}: must be a whole number; correct it")
    return int(count)
