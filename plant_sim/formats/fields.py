"""Checked access to the keys of a file in another format; every error is one line with file, key and value."""

import math
import re
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

from plant_sim.input_error import close_match, kind_of
from plant_sim.units import number_text

LINE_FORMATS = (
    "train_ato YAML, CSV, GPX, GeoJSON, railtoolkit YAML, TTOBench JSON, OSRD JSON, ALTRIOS YAML, railML 2 and 3"
)
TRAIN_FORMATS = "train_ato YAML, railtoolkit YAML, TTOBench JSON, OSRD JSON, ALTRIOS YAML, railML 2 and 3"

_BY_ENDING = {
    ".kml": "KML", ".osm": "OpenStreetMap XML", ".xlsx": "a table (Excel)", ".ods": "a table (OpenDocument)",
    ".txt": "plain text", ".pdf": "PDF",
}  # fmt: skip
_BY_KEYS: tuple[tuple[str, str, str], ...] = (
    ("elev_meters", "a list of heights of ALTRIOS", "line"),
    ("loco_vec", "a locomotive consist of ALTRIOS", "train"),
    ("loco_type", "a locomotive of ALTRIOS", "train"),
    ("car_type", "a rail vehicle of ALTRIOS", "train"),
    ("loco_con", "a train simulation of ALTRIOS", "train"),
    ("elements", "OpenStreetMap JSON", "line"),
)
"""Key that a format alone has, the format, and the content of the file."""
_READ = {"train": (TRAIN_FORMATS, "consist"), "line": (LINE_FORMATS, "line")}


def kind_by_ending(path: Path) -> str | None:
    """Return the format of a file without keys and values, by its ending."""
    return _BY_ENDING.get(path.suffix.lower())


def kind_by_keys(data: Any) -> tuple[str, str]:
    """Return the format of data that are not read, and ``train`` or ``line``; empty for an unknown one.

    Examples
    --------
    >>> kind_by_keys([{"idx_curr": 1, "idx_next": 2}])
    ('a network of ALTRIOS', 'line')
    """
    entries = data if isinstance(data, list) else [data]
    if isinstance(data, dict) and len(data) == 1:  # the whole below one name
        (below,) = data.values()
        entries = [data, *(below if isinstance(below, list) else [below])]
    keys = {str(key) for entry in entries[:3] if isinstance(entry, dict) for key in entry}
    return next(((kind, what) for key, kind, what in _BY_KEYS if key in keys), ("", ""))


def refuse_foreign(data: Mapping[str, Any], place: str, what: str, kinds: Mapping[str, str]) -> NoReturn:
    """Refuse data that are no ``train`` or ``line`` of a supported format.

    Parameters
    ----------
    kinds
        Format of the data, as ``train`` or ``line``.
    """
    other = "train" if what == "line" else "line"
    if other in kinds:
        raise ValueError(f"{place}: holds a {other} ({kinds[other]}), no {what}; exchange them")
    kind, held = kind_by_keys(data)
    if kind:
        formats, own = _READ[held]
        remedy = f"write its figures in one of these (own format: train_ato/{own}/1)"
        raise ValueError(f"{place}: {kind} is not read; a {held} is read from {formats}; {remedy}")
    schema = str(data.get("schema", ""))
    formats, own = _READ[what]
    raise ValueError(
        f"{place}: schema = '{schema[:60]}': no supported {what} format ({formats}); "
        f"begin a train_ato file with 'schema: train_ato/{own}/1'"
    )


MAX_FILE_SIZE = 64 * 2**20
"""Largest accepted file [bytes]."""

_GIVE = "give a file of a train or a line in a supported format (train-ato convert --help)"


def read_bytes(path: Path) -> bytes:
    """Return the content of a file of at most :data:`MAX_FILE_SIZE`."""
    try:
        if path.stat().st_size > MAX_FILE_SIZE:
            raise ValueError(f"{path}: larger than {MAX_FILE_SIZE} bytes; give a file of a train or a line")
        return path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror}); give a readable text file") from None


def decoded(raw: bytes, *, latin: bool = True) -> str:
    """Return a text in UTF-8, UTF-16 or UTF-32 with their marks, or, as a table may be, in Latin-1."""
    marks = {b"\xff\xfe\0\0": "utf-32", b"\0\0\xfe\xff": "utf-32", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}
    encoding = next((name for mark, name in marks.items() if raw.startswith(mark)), "utf-8-sig")
    try:
        return raw.decode(encoding)
    except UnicodeDecodeError:
        if not latin:
            raise
        return raw.decode("latin-1")


def read_any(path: Path) -> Any:
    """Return the data of a YAML or JSON file."""
    from plant_sim.data_text import parse_json, parse_yaml  # help of convert needs no YAML

    try:
        text = decoded(read_bytes(path), latin=False)
    except UnicodeDecodeError:
        kind = kind_by_ending(path)
        problem = f"{kind} is not read; " if kind else "not UTF-8 text; save it as UTF-8, or "
        raise ValueError(f"{path}: {problem}{_GIVE}") from None
    try:
        data = parse_json(text) if path.suffix.lower() == ".json" else parse_yaml(text)
    except ValueError as error:
        if kind_by_ending(path) or text.lstrip().startswith("<"):
            raise ValueError(f"{path}: {_kind_of(path, text)}; {_GIVE}") from None
        raise ValueError(f"{path}: not valid: {' '.join(str(error).split())[:200]}; correct it") from None
    return data


def keyed(data: Any, path: Path) -> dict[str, Any]:
    """Return data that are keys and values; other data are refused by their kind."""
    if not isinstance(data, dict):
        raise ValueError(f"{path}: {_kind_of(path, data)}; {_GIVE}")
    return data


def read_data(path: Path) -> dict[str, Any]:
    """Return the keys and values of a YAML or JSON file."""
    return keyed(read_any(path), path)


def _kind_of(path: Path, data: Any) -> str:
    """Return the kind of a file without keys and values, for messages."""
    if kind := kind_by_ending(path) or kind_by_keys(data)[0]:
        return f"{kind} is not read"
    if isinstance(data, list):
        names = ", ".join(str(key) for key in data[0])[:80] if data and isinstance(data[0], dict) else ""
        return f"holds a list{f' of entries with {names}' if names else ''} in place of keys and values"
    if str(data).lstrip().startswith("<"):
        return "XML is read as railML, in a file that ends in .railml or .xml, and as GPX in .gpx"
    if data is None:
        return "is empty"
    return f"holds {kind_of(data)} in place of keys and values"


class Fields:
    """Mapping of a file with its location, for messages."""

    def __init__(self, data: Any, place: str) -> None:
        if not isinstance(data, dict):
            raise ValueError(f"{place}: holds {_shown(data)} in place of keys and values; correct it")
        self.data: dict[Any, Any] = data
        self.place = place

    def __contains__(self, key: str) -> bool:
        return self.data.get(key) is not None

    def below(self, key: str) -> "Fields":
        """Return the mapping under a key."""
        return Fields(self.required(key), f"{self.place}: {key}")

    def required(self, key: str) -> Any:
        """Return the value of a required key."""
        if self.data.get(key) is None:
            raise ValueError(f"{self.place}: {key}: this key is missing; add it")
        return self.data[key]

    def text(self, key: str, default: str | None = None) -> str:
        """Return a value as one line of text."""
        value = self.data.get(key, default) if default is not None else self.required(key)
        if isinstance(value, (dict, list)):
            raise ValueError(f"{self.place}: {key} = {_shown(value)}: must be one text; correct it")
        return " ".join(str(value).split())

    def number(self, key: str, default: float | None = None, low: float = -math.inf, high: float = math.inf) -> float:
        """Return a number within its range."""
        if default is not None and key not in self:
            return default
        return finite_number(self.required(key), f"{self.place}: {key}", low, high)

    def whole(self, key: str, low: float, high: float) -> int:
        """Return a whole number within its range."""
        if (value := self.number(key, None, low, high)) != int(value):
            raise ValueError(f"{self.place}: {key} = {number_text(value)}: must be a whole number; correct it")
        return int(value)

    def refuse_unknown(self, *known: str) -> None:
        """Refuse a key that is none of the known ones."""
        for key in self.data:
            if key not in known:
                near = close_match(str(key), known)
                raise ValueError(f"{self.place}: unknown key '{str(key)[:40]}'{near}; correct or remove it")

    def one_of(self, *keys: str) -> str:
        """Return the one of several keys of the same quantity that is there, or the first; refuse two of them."""
        given = [key for key in keys if key in self]
        if len(given) > 1:
            raise ValueError(f"{self.place}: {' and '.join(given)} are the same quantity; keep one of them")
        return given[0] if given else keys[0]

    def entries(self, key: str, least: int = 1) -> list[Any]:
        """Return a list with a minimum number of entries."""
        value = self.required(key)
        if not isinstance(value, list) or len(value) < least:
            size = f" of at least {least}" if least else ""
            raise ValueError(f"{self.place}: {key} = {_shown(value)}: must be a list{size}; correct it")
        return value

    def each(self, key: str, least: int = 0) -> list["Fields"]:
        """Return the mappings of a list; without a minimum, the key may be missing."""
        if not least and key not in self:
            return []
        return [Fields(entry, f"{self.place}: {key}[{k}]") for k, entry in enumerate(self.entries(key, least))]

    def named(self, key: str, name: str, what: str) -> dict[str, "Fields"]:
        """Return the mappings of a list by their names; refuse one name of two."""
        found: dict[str, Fields] = {}
        for entry in self.each(key, 1):
            if (own := entry.text(name)) in found:
                raise ValueError(f"{entry.place}: {name} = '{own[:60]}': two {what} have this {name}; correct one")
            found[own] = entry
        return found

    def numbers(self, key: str, low: float, high: float, least: int = 1) -> list[float]:
        """Return a list of numbers within their range."""
        values = self.entries(key, least)
        return [finite_number(value, f"{self.place}: {key}[{k}]", low, high) for k, value in enumerate(values)]

    def table(self, key: str, *ranges: tuple[float, float], least: int = 1) -> list[list[float]]:
        """Return a list of rows of numbers, each column within its range."""
        return [
            [finite_number(value, f"{self.place}: {key}[{k}][{i}]", *ranges[i]) for i, value in enumerate(row)]
            for k, row in enumerate(self.rows(key, len(ranges), least))
        ]

    def rows(self, key: str, columns: int, least: int = 1) -> list[list[Any]]:
        """Return a list of rows, each with ``columns`` entries."""
        rows = self.entries(key, least)
        for place, row in enumerate(rows):
            if not isinstance(row, list) or len(row) != columns:
                raise ValueError(
                    f"{self.place}: {key}[{place}] = {_shown(row)}: must be a list of {columns}; correct it"
                )
        return rows


def known_text(text: str, place: str, known: Collection[str]) -> str:
    """Return a text that is one of the known ones."""
    if text not in known:
        shown = [name for name in known if name]
        names = " or ".join(shown) if len(shown) == 2 else f"one of {', '.join(shown)}"
        raise ValueError(f"{place} = '{text[:40]}': must be {names}; correct it")
    return text


def finite_number(value: Any, place: str, low: float = -math.inf, high: float = math.inf) -> float:
    """Return a finite number within its range."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e300:
        raise ValueError(f"{place} = {_shown(value)}: must be a finite number; correct it")
    if not low <= value <= high:
        bounds = f"{number_text(low)} and {number_text(high)}"
        raise ValueError(f"{place} = {number_text(value)}: must lie between {bounds}; correct it or its unit")
    return float(value)


_DIGITS = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.ASCII | re.IGNORECASE)
"""Number in a text; Python would also read 1_000 and digits of other scripts."""


def number_in(text: str, place: str, low: float = -math.inf, high: float = math.inf) -> float:
    """Return the number of a text within its range."""
    if not text.strip():
        raise ValueError(f"{place}: is missing; add it")
    if not _DIGITS.fullmatch(text.strip()):
        raise ValueError(f"{place} = '{text[:30]}': is not a number; correct it")
    return finite_number(float(text), place, low, high)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:60] + "..."


NAMED = 6
"""Number of the lost keys of a foreign file that a note names."""
IDENTIFIERS = ("id", "ref", "version", "schema", "@language", "@creator", "@schemalocation")
"""Ends of the keys without a datum of the line or the train."""
PRINTED: set[str] = set()
"""Notes that this process, or the one that started it, has printed."""


def print_assumption(text: str) -> None:
    """Print an assumed figure, or data without effect, as one line on stderr, once per process."""
    line = " ".join(f"note: {text}".split())
    if line not in PRINTED:
        PRINTED.add(line)
        sys.stderr.write(line + "\n")


def note_lost_keys(place: str, form: str, lost: Iterable[str], remedy: str = "") -> None:
    """Name the keys of a foreign file that have no effect, identifiers last; identifiers alone are no loss."""
    keys = sorted(lost, key=lambda key: key.lower().endswith(IDENTIFIERS))
    if keys and not keys[0].lower().endswith(IDENTIFIERS):
        more = f" and {len(keys) - NAMED} more{remedy}" if len(keys) > NAMED else ""
        print_assumption(f"{place}: read as {form}; without effect: {', '.join(keys[:NAMED])}{more}")


def names_in(text: str) -> tuple[str, ...]:
    """Return the names in a text with braces.

    Examples
    --------
    >>> names_in("a, {b, c}.{d, e[].f}")
    ('a', 'b.d', 'b.e[].f', 'c.d', 'c.e[].f')
    """
    found: list[str] = []
    for item in _split(text, ","):
        head, _, rest = item.strip().partition("{")
        body, *tail = _split(rest, "}")
        found += [head + name + end for name in names_in(body) for end in names_in("}".join(tail))] if rest else [head]
    return tuple(found)


def _split(text: str, mark: str) -> list[str]:
    """Return the parts of a text between the marks that are in no braces."""
    parts, depth = [""], 0
    for sign in text:
        if sign == mark and not depth:
            parts.append("")
            continue
        depth += (sign == "{") - (sign == "}")
        parts[-1] += sign
    return parts


def keys_not_carried(data: Any, carried: Iterable[str]) -> tuple[str, ...]:
    """Return the keys of a file that a reader does not carry, in the order of the file.

    Parameters
    ----------
    data
        Data of the file.
    carried
        Carried keys, as ``vehicles[].mass``. A key carries a value, and a list of values. Of the keys and values
        below it, it carries only those that have an entry of their own; ``ports.*.track`` is for any key in ``ports``.

    Examples
    --------
    >>> keys_not_carried({"a": [1], "b": [{"c": 2, "d": 3}], "p": {"x": {"y": {"z": 4}}}}, ["a", "b[].c", "p.*.y"])
    ('b[].d', 'p.x.y.z')
    """
    known: dict[str, Any] = {}
    for entry in carried:
        level = known
        for part in entry.replace("[]", "").strip(".").split("."):
            level = level.setdefault(part, {})
        level[""] = {}
    return tuple(dict.fromkeys(_not_carried(data, "", known, carried=False)))


def _not_carried(data: Any, place: str, known: dict[str, Any], *, carried: bool) -> Iterator[str]:
    """Yield the places in data of which a tree of keys has none; ``""`` in a level marks a key that is carried."""
    if isinstance(data, dict):
        for key, value in data.items():
            at = f"{place}.{key}" if place else str(key)
            level = known.get(str(key), known.get("*"))
            if level is None:
                yield from () if value is None or value == [] else (at,)
            else:
                yield from _not_carried(value, at, level, carried="" in level)
    elif isinstance(data, list):
        for value in data:
            yield from _not_carried(value, f"{place}[]", known, carried=carried)
    elif not carried and data is not None:
        yield place
