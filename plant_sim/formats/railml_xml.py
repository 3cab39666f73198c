"""Elements of a railML 3 file: the root without document type and entities, elements by name, numbers of attributes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from plant_sim.formats.fields import finite_number, read_bytes

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


class _RefusedDocumentType(Exception):
    """An XML file has a document type, which may declare entities."""


def _refuse_document_type(*_: object) -> None:
    raise _RefusedDocumentType


def read_root(path: Path) -> Element:
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
    if tag_of(root) != "railML":
        raise ValueError(f"{path}: root element '{tag_of(root)[:60]}': must be railML of version 3; give such a file")
    if not root.get("version", "3").startswith("3"):
        raise ValueError(
            f"{path}: railML: version = '{str(root.get('version'))[:20]}': must be 3; export it in railML 3"
        )
    return root


def tag_of(element: Element) -> str:
    """Return the name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


def elements_below(element: Element, tag: str) -> Iterator[Element]:
    """Yield all elements of a name below an element."""
    return (entry for entry in element.iter() if tag_of(entry) == tag)


def entry_of(element: Element, place: str) -> str:
    """Return file, name and identifier of an element, for messages."""
    return f"{place}: {' '.join(part for part in (tag_of(element), element.get('id')) if part)}"


def names_below(element: Element, found: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return the names of all attributes (``@name``) and elements below an element; those of equal elements as one."""
    names: dict[str, Any] = {} if found is None else found
    names.update({f"@{key.rpartition('}')[2]}": True for key in element.keys()})  # noqa: SIM118  # not a mapping
    for entry in element:
        below = names.setdefault(tag_of(entry), {})
        names_below(entry, below)
    return names


def number_of(element: Element, key: str, place: str, low: float = -1e9, high: float = 1e9) -> float:
    """Return a number of an attribute within its range.

    Raises
    ------
    ValueError
        One line with file, element, attribute and value.
    """
    where = f"{entry_of(element, place)}: {key}"
    text = element.get(key, "")
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{where} = '{text[:40]}': must be a number") from None
    return finite_number(value, where, low, high)
