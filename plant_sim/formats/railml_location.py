"""Locations of railML 3 on net elements: positions, intrinsic coordinates, or measures of a linear reference.

Grades and curve radii of railML 3 on a path.

A gradient curve of the type arc has a change of gradient instead of a gradient, and a horizontal curve that is a
transition has no radius. Their gradient and curvature are linear between the values of the neighbours at both ends.
"""

import math
from collections.abc import Collection, Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

from plant_sim.formats.fields import known_text, print_assumption
from plant_sim.formats.network_path import ROUNDING, STRAIGHT, Network, Passage, Range, TrackPath
from plant_sim.formats.railml_collection import Collections, Entry, NetElement, Stretch
from plant_sim.units import number_text

APPLIES = ("both", "normal", "reverse")
BEGINS, ENDS, POSITIONS = ("posBegin", "fromPos"), ("posEnd", "toPos"), ("pos",)
"""Attributes of positions [m], of version 3.2 on and of version 3.1."""
AT_BEGIN = BEGINS, "intrinsicCoordBegin", "linearCoordinateBegin"
AT_END = ENDS, "intrinsicCoordEnd", "linearCoordinateEnd"
AT_SPOT = POSITIONS, "intrinsicCoord", "linearCoordinate"
"""Position, intrinsic coordinate and linear coordinate of the begin and the end of a stretch, and of a spot."""


def measure_of(coordinate: Entry, units: dict[str, float]) -> tuple[str, float]:
    """Return linear positioning system and measure [m] of a coordinate."""
    system = coordinate.get("positioningSystemRef")
    return system, coordinate.number("measure") * units.get(system, 1.0)


class Location:
    """Reader of the locations of an infrastructure.

    Parameters
    ----------
    elements
        Net elements by identifier, collections included.
    network
        Network of those of the micro level.
    higher
        Identifiers of all parts of the topology.
    units
        Length of one unit of the measures [m], by linear positioning system.
    place
        File, for messages.
    """

    def __init__(
        self, elements: dict[str, NetElement], network: Network, higher: Collection[str], units: dict[str, float]
    ) -> None:
        self._elements, self._higher, self._units, self.place = elements, higher, units, network.place
        self._collections = Collections(elements, network)

    def spots(self, owner: Entry) -> list[tuple[str, float]]:
        """Return net elements and positions [m] of the spot locations of an element; all tracks of a station."""
        found = []
        for spot in owner.parts("spotLocation"):
            element = self._element(owner, spot)
            if element is None:
                found += self._measured(spot)
            elif element.parts:
                pieces = self._on_collection(owner, spot, element, AT_SPOT)
                found += [(piece.element, piece.begin) for piece in pieces]
            elif (position := self._at(spot, element, *AT_SPOT)) is not None:
                found.append((element.name, position))
        return found

    def ranges(
        self, owner: Entry, path: TrackPath, *, directed: bool = False, needed: bool = False, signed: bool = False
    ) -> list[Passage]:
        """Return begin and end on a path [m] of the linear locations of an element, and True in running direction.

        Parameters
        ----------
        directed
            Leave out a location that holds for the other direction of running only.
        needed
            Refuse an element without a location on a net element, which is else named.
        signed
            Refuse a location without a known direction.
        """
        found: list[Passage] = []
        known = 0
        entry = owner.place
        for location in owner.parts("linearLocation"):
            applies = known_text(
                location.get("applicationDirection", "both"), f"{entry}: applicationDirection", APPLIES
            )
            for part in location.parts("associatedNetElement"):
                element = self._element(owner, part)
                if element is None:
                    continue
                known += 1
                keeps = part.flag("keepsOrientation", default=True)
                for piece in self._pieces(owner, part, element, rising=signed and keeps):
                    if piece.same is None and (signed or applies != "both"):
                        raise ValueError(
                            f"{entry}: netElement {element.name}: its direction over its parts is not known; add its "
                            f"linear coordinates, or locate the entry on {', '.join(element.parts)[:100]}"
                        )
                    turned = piece.same is False
                    found += [
                        passage._replace(forward=(passage.forward != turned) == keeps)
                        for passage in path.passages(piece.element, piece.begin, piece.end, entry)
                        if not directed or applies == "both" or (applies == "normal") == (passage.forward != turned)
                    ]
        if not known:
            problem = "it has no linearLocation on a netElement"
            if needed:
                raise ValueError(f"{entry}: {problem}; add one, or remove the element")
            print_assumption(f"{entry}: {problem} and is left out")
        return found

    def _pieces(self, owner: Entry, part: Entry, element: NetElement, *, rising: bool) -> list[Stretch]:
        """Return the stretches of the micro level of a location on a net element; ``rising`` refuses a turned one."""
        if element.parts:
            return self._on_collection(owner, part, element, AT_BEGIN, AT_END)
        begin, end = (self._at(part, element, *keys) for keys in (AT_BEGIN, AT_END))
        first, last = 0.0 if begin is None else begin, element.length if end is None else end
        if rising and last < first:
            raise ValueError(
                f"{owner.place}: netElement {element.name}: its end lies before its begin, and "
                "keepsOrientation is true; exchange them, or set keepsOrientation to false"
            )
        return [Stretch(element.name, first, last, True)]

    def _on_collection(
        self, owner: Entry, part: Entry, element: NetElement, *ends: tuple[tuple[str, ...], str, str]
    ) -> list[Stretch]:
        """Return the stretches of the micro level between the ends of a location on a collection; one end is a spot."""
        name, entry = element.name, owner.place
        measures = [
            measure_of(coordinate, self._units) for _, _, linear in ends for coordinate in part.parts(linear)[:1]
        ]
        try:
            if len(measures) == len(ends):
                found = self._collections.by_measure(name, measures[0][0], measures[0][1], measures[-1][1])
                if not found:
                    span = " to ".join(number_text(measure) for _, measure in measures)
                    raise ValueError(
                        f"netElement {name}: measure {span} m: outside the linear coordinates of '{measures[0][0]}' of "
                        "its parts; correct it"
                    )
                return found
            if all(key not in part for keys, intrinsic, _ in ends for key in (*keys, intrinsic)):
                return self._collections.whole(name)
            whole = NetElement(name, self._collections.length(name), element.measures)
        except ValueError as error:
            raise ValueError(f"{entry}: {str(error).removeprefix(f'{self.place}: ')}") from None
        places = [self._at(part, whole, *end) for end in ends]
        first, last = places[0], places[-1]
        return self._collections.along(name, first or 0.0, whole.length if last is None else last)

    def _element(self, owner: Entry, part: Entry) -> NetElement | None:
        """Return the net element of a location; None for another part of the topology."""
        name = part.get("netElementRef")
        if name not in self._elements and name not in self._higher:
            raise ValueError(f"{owner.place}: netElementRef = '{name[:60]}': not in the topology; correct it")
        return self._elements.get(name)

    def _at(
        self, part: Entry, element: NetElement, positions: tuple[str, ...], intrinsic: str, linear: str
    ) -> float | None:
        """Return the position on a net element [m]; None for an end that the location does not have."""
        for key in positions:
            if key in part:
                return part.number(key, 0.0, element.length * (1 + 1e-9))
        if intrinsic in part:
            return element.length * part.number(intrinsic, 0.0, 1.0)
        for coordinate in part.parts(linear):
            system, measure = measure_of(coordinate, self._units)
            position = element.position(system, measure)
            if position is None:
                raise ValueError(
                    f"{self.place}: netElement {element.name}: measure = {coordinate.get('measure')}: outside its "
                    f"linear coordinates of '{system}'; correct it"
                )
            return position
        return None

    def _measured(self, spot: Entry) -> list[tuple[str, float]]:
        """Return all micro elements with a measure, for a location on another part of the topology."""
        found = []
        for coordinate in spot.parts("linearCoordinate"):
            measure = measure_of(coordinate, self._units)
            for element in self._elements.values():
                position = None if element.parts else element.position(*measure)
                if position is not None:
                    found.append((element.name, position))
        return found


KINDS = ("straight", "arc", "mixed")
"""Types of gradient curves."""
PIECE, PIECES = 20.0, 10
"""Length of the pieces of a transition [m], and their largest number."""
DELTA_ROUNDING = 5e-4
"""Difference between deltaGradient and the gradients of the neighbours that counts as rounding."""


class _Transition(NamedTuple):
    """Stretch [m] with a linear change of a value; the change is None if the file does not have it."""

    begin: float
    end: float
    change: float | None
    entry: str


def grades(infrastructure: Entry, location: Location, path: TrackPath) -> list[Range]:
    """Return the grades on a path in running direction; an arc as pieces of constant grade."""
    rows: list[Range] = []
    arcs: list[_Transition] = []
    for curve in infrastructure.below("gradientCurve"):
        entry = curve.place
        passages = location.ranges(curve, path, signed=True)
        delta = 1e-3 * curve.number("deltaGradient") if "deltaGradient" in curve else None
        kind = curve.choice("curveType", KINDS)
        if "gradient" in curve and (not delta or curve.get("curveType") == "straight"):
            value = 1e-3 * curve.number("gradient", -500, 500)
            rows += [Range(begin, end, value if forward else -value, entry) for begin, end, forward in passages]
        elif kind == "mixed" and delta is None:
            print_assumption(f"{entry}: of the type mixed without a gradient; left out")
        else:
            arcs += [_Transition(begin, end, delta, entry) for begin, end in joined(passages)]
    found = _between(rows, arcs, None)
    for arc in arcs:
        known = found.get(arc)
        if known is None:
            raise ValueError(
                f"{arc.entry}: its gradient is not known: it has none, and no neighbour with one; add gradient"
            )
        first, last = known
        if arc.change is not None and abs(last - first - arc.change) > DELTA_ROUNDING:
            print_assumption(
                f"{arc.entry}: deltaGradient = {number_text(1e3 * arc.change)}: its neighbours differ by "
                f"{number_text(1e3 * (last - first))} per mille; read linear between them"
            )
    return rows + [piece for arc, (first, last) in found.items() for piece in _pieces(arc, first, last)]


def radii(infrastructure: Entry, location: Location, path: TrackPath) -> list[Range]:
    """Return the curve radii on a path [m], > 0 to the right in running direction."""
    rows: list[Range] = []
    transitions: list[_Transition] = []
    for curve in infrastructure.below("horizontalCurve"):
        entry = curve.place
        passages = location.ranges(curve, path, signed=True)
        kind, radius = curve.get("curveType"), curve.number("radius") if "radius" in curve else None
        if radius or (radius is not None and kind in ("", *KINDS)):  # 0 of a transition is no radius
            bend = 1.0 / radius if radius else 0.0
            rows += [Range(begin, end, bend if forward else -bend, entry) for begin, end, forward in passages]
        elif kind == "mixed":
            print_assumption(f"{entry}: of the type mixed without a radius; straight there")
        elif kind != "straight":
            transitions += [_Transition(begin, end, None, entry) for begin, end in joined(passages)]
    found = _between(rows, transitions, 0.0)
    for transition, values in found.items():
        if not any(values):
            print_assumption(f"{transition.entry}: no radius, and no neighbour with one; straight there")
    rows += [piece for entry, (first, last) in found.items() for piece in _pieces(entry, first, last)]
    return [Range(row.begin, row.end, 1.0 / row.value, row.entry) for row in rows if abs(row.value) > 1.0 / STRAIGHT]


def joined(passages: Iterable[tuple[float, float] | Passage]) -> list[tuple[float, float]]:
    """Return the stretches of one element [m] by rising distance, over several net elements as one."""
    found: list[tuple[float, float]] = []
    for begin, end, *_ in sorted(passages):
        if found and begin <= found[-1][1] + ROUNDING:
            found[-1] = (found[-1][0], max(end, found[-1][1]))
        elif end > begin:
            found.append((begin, end))
    return found


def _between(
    rows: Sequence[Range], transitions: Sequence[_Transition], beside: float | None
) -> dict[_Transition, tuple[float, float]]:
    """Return the values at begin and end of the transitions, from the rows and transitions that they touch.

    ``beside`` is the value where nothing touches; with None, the change of the file gives the other end.
    """
    firsts: dict[_Transition, float] = {}
    lasts: dict[_Transition, float] = {}
    for entry in transitions:
        for row in rows:
            if abs(row.end - entry.begin) <= ROUNDING:
                firsts[entry] = row.value
            if abs(row.begin - entry.end) <= ROUNDING:
                lasts[entry] = row.value
    order = sorted(transitions)
    for sequence in (order, order[::-1]) * 2:  # a chain of arcs takes its values from both sides
        for entry in sequence:
            if entry.change is not None and entry in firsts:
                lasts.setdefault(entry, firsts[entry] + entry.change)
            if entry.change is not None and entry in lasts:
                firsts.setdefault(entry, lasts[entry] - entry.change)
        for before, after in pairwise(order):
            if abs(before.end - after.begin) <= ROUNDING:
                if before in lasts:
                    firsts.setdefault(after, lasts[before])
                if after in firsts:
                    lasts.setdefault(before, firsts[after])
    if beside is not None:
        return {entry: (firsts.get(entry, beside), lasts.get(entry, beside)) for entry in order}
    return {entry: (firsts[entry], lasts[entry]) for entry in order if entry in firsts and entry in lasts}


def _pieces(entry: _Transition, first: float, last: float) -> list[Range]:
    """Return pieces with the mean value of each."""
    count = max(1, min(PIECES, math.ceil((entry.end - entry.begin) / PIECE)))
    length = (entry.end - entry.begin) / count
    return [
        Range(
            entry.begin + k * length,
            entry.begin + (k + 1) * length,
            first + (last - first) * (k + 0.5) / count,
            entry.entry,
        )
        for k in range(count)
    ]
