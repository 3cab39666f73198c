"""Locations of railML 3 on net elements: positions, intrinsic coordinates, or measures of a linear reference."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from plant_sim.formats.fields import finite_number
from plant_sim.formats.network_path import TrackPath

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

BEGINS, ENDS, POSITIONS = ("posBegin", "fromPos"), ("posEnd", "toPos"), ("pos",)
"""Attributes of positions [m], of version 3.2 on and of version 3.1."""


@dataclass(frozen=True, slots=True)
class NetElement:
    """Net element of the micro level.

    Attributes
    ----------
    length : float
        Length [m].
    measures : dict
        Intrinsic coordinate and measure of its ends, by linear positioning system.
    """

    name: str
    length: float
    measures: dict[str, list[tuple[float, float]]]

    def position(self, system: str, measure: float) -> float | None:
        """Return the position [m] of a measure; None without that system, or outside the element."""
        if system not in self.measures:
            return None
        (first, low), (last, high) = self.measures[system][0], self.measures[system][-1]
        part = first + (measure - low) / (high - low) * (last - first) if high != low else first
        return part * self.length if -1e-9 <= part <= 1.0 + 1e-9 else None


class Location:
    """Reader of the locations of an infrastructure.

    Parameters
    ----------
    elements
        Net elements of the micro level.
    place
        File, for messages.
    """

    def __init__(self, elements: dict[str, NetElement], place: str) -> None:
        self._elements, self._place = elements, place

    def spots(self, owner: Element) -> list[tuple[str, float]]:
        """Return net elements and positions [m] of the spot locations of an element; all tracks of a station."""
        found = []
        for spot in _parts(owner, "spotLocation"):
            element = self._elements.get(spot.get("netElementRef", ""))
            if element is None:
                found += self._measured(spot)
            elif (position := self._at(spot, element, POSITIONS, "intrinsicCoord", "linearCoordinate")) is not None:
                found.append((element.name, position))
        return found

    def ranges(self, owner: Element, path: TrackPath, directed: bool = False) -> Iterator[tuple[float, float, bool]]:
        """Yield begin and end on a path [m] of the linear locations of an element, and True in running direction.

        A directed location that holds for the other direction of running only is left out.
        """
        for location in _parts(owner, "linearLocation"):
            applies = location.get("applicationDirection", "both")
            for part in _parts(location, "associatedNetElement"):
                element = self._elements.get(part.get("netElementRef", ""))
                if element is None or element.name not in path:
                    continue
                forward = path.forward(element.name)
                if directed and applies in ("normal", "reverse") and (applies == "normal") != forward:
                    continue
                begin = self._at(part, element, BEGINS, "intrinsicCoordBegin", "linearCoordinateBegin")
                end = self._at(part, element, ENDS, "intrinsicCoordEnd", "linearCoordinateEnd")
                low, high = path.extent(
                    element.name, 0.0 if begin is None else begin, element.length if end is None else end
                )
                along = forward == (part.get("keepsOrientation", "true") != "false")
                yield low, high, along

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
            measure = self._number(coordinate, "measure", -1e9, 1e9)
            position = element.position(coordinate.get("positioningSystemRef", ""), measure)
            if position is None:
                raise ValueError(
                    f"{self._place}: netElement {element.name}: measure = {measure:g}: outside its linear coordinates; "
                    "correct it"
                )
            return position
        return None

    def _measured(self, spot: Element) -> list[tuple[str, float]]:
        """Return all micro elements with a measure, for a location on an element of a higher level."""
        found = []
        for coordinate in _parts(spot, "linearCoordinate"):
            measure = self._number(coordinate, "measure", -1e9, 1e9)
            for element in self._elements.values():
                position = element.position(coordinate.get("positioningSystemRef", ""), measure)
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
