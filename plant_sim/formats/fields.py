"""Checked access to the keys of a file in another format; every error is one line with file, key and value."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from plant_sim.data_text import parse_json, parse_yaml
from plant_sim.formats.not_read import kind_by_ending, kind_by_keys
from plant_sim.input_error import kind_of
from plant_sim.number_text import number_text

MAX_FILE_SIZE = 64 * 2**20
"""Largest accepted file [bytes]."""

_GIVE = "give a file of a train or a line in a supported format (train-ato convert --help)"


def read_bytes(path: Path) -> bytes:
    """Return the content of a file of at most :data:`MAX_FILE_SIZE`.

    Raises
    ------
    ValueError
        One line with file and reason.
    """
    try:
        if path.stat().st_size > MAX_FILE_SIZE:
            raise ValueError(f"{path}: larger than {MAX_FILE_SIZE} bytes; give a file of a train or a line")
        return path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror}); give a readable text file") from None


def read_data(path: Path) -> dict[str, Any]:
    """Return the keys and values of a YAML or JSON file.

    Raises
    ------
    ValueError
        One line with file and reason.
    """
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{path}: {_kind_of(path, 'not UTF-8 text')}; {_GIVE}") from None
    try:
        data = parse_json(text) if path.suffix.lower() == ".json" else parse_yaml(text)
    except ValueError as error:
        if kind_by_ending(path) or text.lstrip().startswith("<"):
            raise ValueError(f"{path}: {_kind_of(path, text)}; {_GIVE}") from None
        raise ValueError(f"{path}: not valid: {' '.join(str(error).split())[:200]}; correct it") from None
    if not isinstance(data, dict):
        raise ValueError(f"{path}: {_kind_of(path, data)}; {_GIVE}")
    return data


def _kind_of(path: Path, data: Any) -> str:
    """Return the kind of a file without keys and values, for messages."""
    if kind := kind_by_ending(path) or kind_by_keys(data)[0]:
        return f"{kind} is not read"
    if isinstance(data, list):
        names = ", ".join(str(key) for key in data[0])[:80] if data and isinstance(data[0], dict) else ""
        return f"holds a list{f' of entries with {names}' if names else ''} in place of keys and values"
    if str(data).lstrip().startswith("<"):
        return "XML is read as railML only, in a file that ends in .railml or .xml"
    if data is None:
        return "is empty"
    return "not UTF-8 text" if data == "not UTF-8 text" else f"holds {kind_of(data)} in place of keys and values"


class Fields:
    """Mapping of a file with its location, for messages."""

    def __init__(self, data: Any, place: str) -> None:
        if not isinstance(data, dict):
            raise ValueError(f"{place}: holds {_shown(data)} in place of keys and values; correct it")
        self.data: dict[Any, Any] = data
        self.place = place

    def __contains__(self, key: str) -> bool:
        return self.data.get(key) is not None

    def below(self, key: str) -> Fields:
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
        return " ".join(str(value).split())

    def number(self, key: str, default: float | None = None, low: float = -math.inf, high: float = math.inf) -> float:
        """Return a number within its range."""
        if default is not None and key not in self:
            return default
        return finite_number(self.required(key), f"{self.place}: {key}", low, high)

    def entries(self, key: str, least: int = 1) -> list[Any]:
        """Return a list with a minimum number of entries."""
        value = self.required(key)
        if not isinstance(value, list) or len(value) < least:
            raise ValueError(f"{self.place}: {key} = {_shown(value)}: must be a list of at least {least}")
        return value

    def rows(self, key: str, columns: int, least: int = 1) -> list[list[Any]]:
        """Return a list of rows, each with ``columns`` entries."""
        rows = self.entries(key, least)
        for place, row in enumerate(rows):
            if not isinstance(row, list) or len(row) != columns:
                raise ValueError(f"{self.place}: {key}[{place}] = {_shown(row)}: must be a list of {columns}")
        return rows


def finite_number(value: Any, place: str, low: float = -math.inf, high: float = math.inf) -> float:
    """Return a finite number within its range.

    Raises
    ------
    ValueError
        One line with location and value.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e300:
        raise ValueError(f"{place} = {_shown(value)}: must be a finite number")
    if not low <= value <= high:
        raise ValueError(f"{place} = {number_text(value)}: must lie between {number_text(low)} and {number_text(high)}")
    return float(value)


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:60] + "..."
