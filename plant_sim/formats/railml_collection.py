"""Elements of an XML file, and net elements of railML 3 that are collections of others (meso and macro level).

An ordered collection is a chain: its parts are joined end to end, and positions run on over them. An unordered one has
parts beside or behind each other: a place on it is known by a measure of a linear positioning system only.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, ParseError, fromstring
from xml.parsers.expat import ExpatError, ParserCreate

from plant_sim.elementary import plain_sum
from plant_sim.formats.fields import keys_not_carried, known_text, number_in, print_assumption, read_bytes
from plant_sim.formats.network_path import BEGIN, END, ROUNDING, Network
from plant_sim.units import number_text


@dataclass(frozen=True, slots=True)
class Entry:
    """Element of an XML file, and the name of the file for messages."""

    element: Element
    file: str

    def __contains__(self, key: str) -> bool:
        return key in self.element.attrib

    @property
    def tag(self) -> str:
        """Name without its namespace."""
        return str(self.element.tag).rpartition("}")[2]

    @property
    def place(self) -> str:
        """File, name and identifier, or that of the net element, for messages."""
        name = self.get("netElementRef") or self.get("id")
        return f"{self.file}: {' '.join(part for part in (self.tag, name) if part)}"

    def below(self, *tags: str) -> Iterator[Entry]:
        """Yield all elements with one of the names below this one, itself included."""
        return (Entry(part, self.file) for part in self.element.iter() if str(part.tag).rpartition("}")[2] in tags)

    def parts(self, *tags: str) -> list[Entry]:
        """Return the direct parts, with names only those with one of them."""
        parts = [Entry(part, self.file) for part in self.element]
        return [part for part in parts if part.tag in tags] if tags else parts

    def first(self, names: str) -> Entry | None:
        """Return the first element at a path of names below this one; None without one."""
        found: Entry | None = self
        for name in names.split("."):
            found = next(iter(found.parts(name)), None) if found else None
        return found

    def get(self, key: str, default: str = "") -> str:
        """Return the text of an attribute."""
        return self.element.get(key, default)

    def number(self, key: str, low: float = -1e9, high: float = 1e9) -> float:
        """Return a number of an attribute within its range."""
        return number_in(self.get(key), f"{self.place}: {key}", low, high)

    def flag(self, key: str, *, default: bool = False) -> bool:
        """Return a truth value of an attribute."""
        if key in self and self.get(key) not in ("true", "1", "false", "0"):
            raise ValueError(f"{self.place}: {key} = '{self.get(key)[:40]}': must be true or false; correct it")
        return self.get(key) in ("true", "1") if key in self else default

    def choice(self, key: str, known: Sequence[str]) -> str:
        """Return the text of an attribute, which is one of the known ones; the first of them without the attribute."""
        return known_text(self.get(key, known[0]), f"{self.place}: {key}", known)


def read_xml(path: Path) -> Entry:
    """Return the root of an XML file without document type and entities."""
    text = read_bytes(path)

    def refuse_document_type(*_: object) -> None:
        raise ValueError(f"{path}: DOCTYPE: document types and entities are refused; remove them")

    try:
        first = ParserCreate()  # entities need a document type, so this parser refuses them before they are expanded
        first.StartDoctypeDeclHandler = refuse_document_type
        first.Parse(text, True)
        return Entry(fromstring(text), str(path))
    except (ExpatError, ParseError, LookupError, UnicodeError) as error:
        raise ValueError(f"{path}: not valid XML: {' '.join(str(error).split())[:200]}; correct it") from None


def read_root(path: Path) -> Entry:
    """Return the root of a railML file."""
    root = read_xml(path)
    if root.tag not in ("railML", "railml"):
        raise ValueError(f"{path}: root element '{root.tag[:60]}': must be railML of version 2 or 3; give such a file")
    if version_of(root) not in ("2", "3"):
        raise ValueError(
            f"{path}: railML: version = '{str(root.get('version'))[:20]}': must be 2 or 3; export it in railML 3"
        )
    return root


def version_of(root: Entry) -> str:
    """Return the first digit of the version of railML; without one, that of its namespace."""
    return root.get("version", "2" if "/schemas/20" in str(root.element.tag) else "3")[:1]


def names_below(entry: Entry, found: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the names of all attributes (``@name``) and elements below an element; those of equal elements as one."""
    names: dict[str, Any] = {} if found is None else found
    names.update({f"@{key.rpartition('}')[2]}": True for key in entry.element.attrib})
    for part in entry.parts():
        names_below(part, names.setdefault(part.tag, {}))
    return names


def names_lost(root: Entry, carried: Iterable[str]) -> tuple[str, ...]:
    """Return the names of a file that are none of the carried ones; those of an infrastructure without its name."""
    return tuple(name.removeprefix("infrastructure.") for name in keys_not_carried(names_below(root), carried))


ORDERED, UNORDERED = "elementCollectionOrdered", "elementCollectionUnordered"
Chain = list[tuple[str, bool]]
"""Net elements of the micro level in order, True for one in the direction of the chain."""


@dataclass(frozen=True, slots=True)
class NetElement:
    """Net element.

    Attributes
    ----------
    length : float
        Length [m]; 0 for a collection without one.
    measures : dict
        Intrinsic coordinate and measure [m] of its points by rising coordinate, by linear positioning system.
    parts : tuple
        Parts of a collection, in their order; none at the micro level.
    ordered : bool
        True for an ordered collection.
    """

    name: str
    length: float
    measures: dict[str, list[tuple[float, float]]]
    parts: tuple[str, ...] = ()
    ordered: bool = False

    def position(self, system: str, measure: float) -> float | None:
        """Return the position [m] of a measure [m]; None without that system, or outside the element."""
        for (first, low), (last, high) in pairwise(self.measures.get(system, ())):
            part = (measure - low) / (high - low) if high != low else 0.0 if measure == low else math.inf
            if -1e-9 <= part <= 1.0 + 1e-9:
                return (first + part * (last - first)) * self.length
        return None

    def span(self, system: str) -> tuple[float, float] | None:
        """Return the first and the last measure [m]; None without that system."""
        rows = self.measures.get(system)
        return (rows[0][1], rows[-1][1]) if rows else None


class Stretch(NamedTuple):
    """Stretch [m] of a net element of the micro level; ``same`` is True in the direction of the collection."""

    element: str
    begin: float
    end: float
    same: bool | None
    """None for an unknown direction."""


def parts_of(element: Entry) -> tuple[tuple[str, ...], bool]:
    """Return the parts of a collection in their order, and True for an ordered one; none for a micro element."""
    ordered = element.parts(ORDERED)
    if all("sequence" in entry for entry in ordered):
        ordered.sort(key=lambda entry: entry.number("sequence"))
    collections = ordered or element.parts(UNORDERED)
    parts = tuple(part.get("ref") for entry in collections for part in entry.below("elementPart"))
    return parts, bool(ordered)


class Collections:
    """Mapping of collections, of all net elements, to those of the micro level in a network."""

    def __init__(self, elements: dict[str, NetElement], network: Network) -> None:
        self._elements, self._network = elements, network

    def members(self, name: str) -> list[str]:
        """Return the net elements of the micro level below a collection.

        A part that does not exist and a collection that contains itself are refused.
        """
        return list(dict.fromkeys(self._members(name, ())))

    def _members(self, name: str, above: tuple[str, ...]) -> Iterator[str]:
        where = f"{self._network.place}: netElement {above[-1] if above else name}"
        if name in above:
            raise ValueError(f"{where}: elementPart '{name}' contains it; remove this part")
        if name not in self._elements:
            raise ValueError(f"{where}: elementPart '{name[:60]}': not in the topology; correct it")
        if name in self._network.lengths:
            yield name
        for part in self._elements[name].parts:
            yield from self._members(part, (*above, name))

    def by_measure(self, name: str, system: str, first: float, last: float) -> list[Stretch]:
        """Return the pieces between two measures [m]; none if one of them lies outside all parts."""
        rising = self._rising(name, system)
        low, high = min(first, last), max(first, last)
        found, reached = [], set()
        for member in self.members(name):
            span = self._elements[member].span(system)
            if span is None:
                continue
            begin, end = max(low, min(span)), min(high, max(span))
            reached |= {at for at in (low, high) if self._elements[member].position(system, at) is not None}
            if begin < end or begin == end == low == high:
                near, far = sorted(self._elements[member].position(system, at) or 0.0 for at in (begin, end))
                found.append(Stretch(member, near, far, (span[1] >= span[0]) == rising))
        return found if reached == {low, high} else []

    def whole(self, name: str) -> list[Stretch]:
        """Return every part as a whole; their direction is that of the order, or of the measures, or not known."""
        element, lengths = self._elements[name], self._network.lengths
        if element.ordered:
            return [Stretch(part, 0.0, lengths[part], same) for part, same in self.chain(name)]
        members = self.members(name)
        for system in dict.fromkeys(s for member in members for s in self._elements[member].measures):
            spans = [self._elements[member].span(system) for member in members]
            if all(spans):
                rising = self._rising(name, system)
                return [
                    Stretch(member, 0.0, lengths[member], (span[1] >= span[0]) == rising)
                    for member, span in zip(members, spans, strict=True)
                    if span
                ]
        return [Stretch(member, 0.0, lengths[member], None) for member in members]

    def _rising(self, name: str, system: str) -> bool:
        """Return True if a collection runs with rising measures, as it is assumed without coordinates of its own."""
        own = self._elements[name].span(system)
        if own is None:
            print_assumption(
                f"{self._network.place}: netElement {name}: it has no coordinates of '{system}'; assumed to run with "
                "rising measures"
            )
        return own is None or own[1] >= own[0]

    def length(self, name: str) -> float:
        """Return the length of a chain [m].

        A collection without an order, or with another length than its parts, is refused.
        """
        found = plain_sum(self._network.lengths[part] for part, _ in self.chain(name))
        given = self._elements[name].length
        if given and abs(given - found) > ROUNDING:
            raise ValueError(
                f"{self._network.place}: netElement {name}: length = {number_text(given)}: its parts have "
                f"{number_text(found)} m; correct one of them"
            )
        return found

    def along(self, name: str, begin: float, end: float) -> list[Stretch]:
        """Return the pieces between two positions [m] of a chain."""
        low, high = min(begin, end), max(begin, end)
        found, at = [], 0.0
        for part, same in self.chain(name):
            length = self._network.lengths[part]
            first, last = max(low - at, 0.0), min(high - at, length)
            if first < last or (first == last and low == high):
                found.append(
                    Stretch(part, first, last, True) if same else Stretch(part, length - last, length - first, False)
                )
            at += length
        return found

    def chain(self, name: str) -> Chain:
        """Return the micro elements of an ordered collection in its direction.

        A collection without an order, or whose parts are not joined in it, is refused.
        """
        self.members(name)
        if name in self._network.lengths:
            return [(name, True)]
        element = self._elements[name]
        where = f"{self._network.place}: netElement {name}"
        if not element.ordered:
            raise ValueError(
                f"{where}: its parts have no order ({UNORDERED}), so a position on it is not known; locate the entry "
                f"on {', '.join(element.parts)[:100] or 'net elements of the micro level'}, or by measures"
            )
        found: Chain = []
        for number, part in enumerate(element.parts):
            found = self._joined(found, self.chain(part), turning=number == 1)
            if not found:
                raise ValueError(
                    f"{where}: elementPart '{part}' is not joined to the part before it; correct the order"
                )
        return found

    def _joined(self, one: Chain, other: Chain, *, turning: bool) -> Chain:
        """Return two chains as one, the second and perhaps the first one turned; empty without a joint."""
        if not one:
            return other
        turned = [[(name, not same) for name, same in reversed(chain)] for chain in (one, other)]
        for first in (one, turned[0])[: 2 if turning else 1]:
            for second in (other, turned[1]):
                (last, forward), (following, onward) = first[-1], second[0]
                end, begin = (last, END if forward else BEGIN), (following, BEGIN if onward else END)
                if begin in self._network.joined.get(end, ()) or end in self._network.joined.get(begin, ()):
                    return [*first, *second]
        return []
