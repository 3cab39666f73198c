"""Locations of railML 3 on net elements: positions, intrinsic coordinates, or measures of a linear reference."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

from plant_sim.formats.fields import finite_number
from plant_sim.formats.network_path import Network, Passage, TrackPath
from plant_sim.formats.notes import print_assumption
from plant_sim.formats.railml_collection import Collections, NetElement, Stretch
from plant_sim.formats.railml_xml import entry_of
from plant_sim.number_text import number_text

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

BEGINS, ENDS, POSITIONS = ("posBegin", "fromPos"), ("posEnd", "toPos"), ("pos",)
"""Attributes of positions [m], of version 3.2 on and of version 3.1."""


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
        self,
        elements: dict[str, NetElement],
        network: Network,
        higher: Collection[str],
        units: dict[str, float],
    ) -> None:
        self._elements, self._higher, self._units, self._place = elements, higher, units, network.place
        self._collections = Collections(elements, network)

    def spots(self, owner: Element) -> list[tuple[str, float]]:
        """Return net elements and positions [m] of the spot locations of an element; all tracks of a station."""
        found = []
        for spot in _parts(owner, "spotLocation"):
            element = self._element(owner, spot)
            if element is None:
                found += self._measured(spot)
            elif element.parts:
                pieces = self._on_collection(owner, spot, element, (POSITIONS, "intrinsicCoord", "linearCoordinate"))
                found += [(piece.element, piece.begin) for piece in pieces]
            elif (position := self._at(spot, element, POSITIONS, "intrinsicCoord", "linearCoordinate")) is not None:
                found.append((element.name, position))
        return found

    def ranges(
        self, owner: Element, path: TrackPath, directed: bool = False, needed: bool = False, signed: bool = False
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

        Raises
        ------
        ValueError
            One line with file, element, value and remedy.
        """
        found: list[Passage] = []
        known = 0
        entry = entry_of(owner, self._place)
        for location in _parts(owner, "linearLocation"):
            applies = location.get("applicationDirection", "both")
            if applies not in ("both", "normal", "reverse"):
                raise ValueError(
                    f"{entry}: applicationDirection = '{applies[:30]}': must be both, normal or reverse; correct it"
                )
            for part in _parts(location, "associatedNetElement"):
                element = self._element(owner, part)
                if element is None:
                    continue
                known += 1
                keeps = part.get("keepsOrientation", "true") not in ("false", "0")
                for piece in self._pieces(owner, part, element):
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

    def _pieces(self, owner: Element, part: Element, element: NetElement) -> list[Stretch]:
        """Return the stretches of the micro level of a location on a net element."""
        if element.parts:
            ends = (
                (BEGINS, "intrinsicCoordBegin", "linearCoordinateBegin"),
                (ENDS, "intrinsicCoordEnd", "linearCoordinateEnd"),
            )
            return self._on_collection(owner, part, element, *ends)
        begin = self._at(part, element, BEGINS, "intrinsicCoordBegin", "linearCoordinateBegin")
        end = self._at(part, element, ENDS, "intrinsicCoordEnd", "linearCoordinateEnd")
        return [Stretch(element.name, 0.0 if begin is None else begin, element.length if end is None else end, True)]

    def _on_collection(
        self, owner: Element, part: Element, element: NetElement, *ends: tuple[tuple[str, ...], str, str]
    ) -> list[Stretch]:
        """Return the stretches of the micro level between the ends of a location on a collection; one end is a spot."""
        name, entry = element.name, entry_of(owner, self._place)
        measures = [self._measure(coordinate) for _, _, linear in ends for coordinate in _parts(part, linear)[:1]]
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
            if all(part.get(key) is None for keys, intrinsic, _ in ends for key in (*keys, intrinsic)):
                return self._collections.whole(name)
            whole = NetElement(name, self._collections.length(name), element.measures)
        except ValueError as error:
            raise ValueError(f"{entry}: {str(error).removeprefix(f'{self._place}: ')}") from None
        places = [self._at(part, whole, *end) for end in ends]
        first, last = places[0], places[-1]
        return self._collections.along(name, first or 0.0, whole.length if last is None else last)

    def _element(self, owner: Element, part: Element) -> NetElement | None:
        """Return the net element of a location; None for another part of the topology."""
        name = part.get("netElementRef", "")
        if name not in self._elements and name not in self._higher:
            raise ValueError(
                f"{entry_of(owner, self._place)}: netElementRef = '{name[:60]}': not in the topology; correct it"
            )
        return self._elements.get(name)

    def _measure(self, coordinate: Element) -> tuple[str, float]:
        """Return linear positioning system and measure [m]."""
        system = coordinate.get("positioningSystemRef", "")
        return system, self._number(coordinate, "measure", -1e9, 1e9) * self._units.get(system, 1.0)

    def _at(
        self, part: Element, element: NetElement, positions: tuple[str, ...], intrinsic: str, linear: str
    ) -> float | None:
        """Return the position on a net element [m]; None for an end that the location does not have."""
        for key in positions:
            if part.get(key) is not None:
                return self._number(part, key, 0.0, element.length * (1 + 1e-9))
        if part.get(intrinsic) is not None:
            return element.length * self._number(part, intrinsic, 0.0, 1.0)
        for coordinate in _parts(part, linear):
            system, measure = self._measure(coordinate)
            position = element.position(system, measure)
            if position is None:
                raise ValueError(
                    f"{self._place}: netElement {element.name}: measure = {coordinate.get('measure')}: outside its "
                    f"linear coordinates of '{system}'; correct it"
                )
            return position
        return None

    def _measured(self, spot: Element) -> list[tuple[str, float]]:
        """Return all micro elements with a measure, for a location on another part of the topology."""
        found = []
        for coordinate in _parts(spot, "linearCoordinate"):
            measure = self._measure(coordinate)
            for element in self._elements.values():
                position = None if element.parts else element.position(*measure)
                if position is not None:
                    found.append((element.name, position))
        return found

    def _number(self, element: Element, key: str, low: float, high: float) -> float:
        tag, text = str(element.tag).rpartition("}")[2], element.get(key, "")
        where = f"{self._place}: {tag} {element.get('netElementRef', '')}: {key}"
        try:
            value = float(text)
        except ValueError:
            raise ValueError(f"{where} = '{text[:40]}': must be a number") from None
        return finite_number(value, where, low, high)


def _parts(element: Element, tag: str) -> list[Element]:
    """Return the direct parts of an element with a name."""
    return [entry for entry in element if str(entry.tag).rpartition("}")[2] == tag]
