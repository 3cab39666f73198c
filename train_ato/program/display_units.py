"""Units of display: what a command prints, exports or draws with ``--units us`` or ``--units metric``.

Files that a command reads again (a run, a scenario, a line) stay as they are. Times, accelerations, powers and energies
have one unit everywhere. Factors and suffixes are those of :mod:`plant_sim.units`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import fields, is_dataclass, replace
from functools import cache
from typing import Any

from plant_sim.units import number_text, unit_suffixes, unit_symbols

DISPLAY: dict[str, dict[str, str]] = {
    "us": {
        "m": "ft", "km": "mi", "m/s": "mph", "km/h": "mph", "kg": "lb", "t": "ton", "N": "lbf", "kN": "lbf",
        "MN": "lbf", "N/s": "lbf/s", "kN/s": "lbf/s", "Pa": "psi", "kPa": "psi", "bar": "psi",
    },
    "metric": {"m/s": "km/h", "kg": "t", "N": "kN", "N/s": "kN/s", "Pa": "bar", "kPa": "bar"},
}  # fmt: skip
"""Unit of display by the unit of the program, for every system of ``--units``."""
_chosen: list[str] = []
"""System of the command that runs; empty without the option."""


@contextmanager
def displayed_in(system: str | None) -> Iterator[None]:
    """Show the numbers of the block in a system of units of :data:`DISPLAY`; None does not convert them."""
    if system is None:
        yield
        return
    _chosen.append(system)
    try:
        with redirect_stdout(_Shown(sys.stdout)):
            yield
    finally:
        _chosen.pop()


class _Shown:
    """Stream that shows the quantities of its texts in the chosen units."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text."""
        return int(self._stream.write(shown_text(text)))


def display_unit(symbol: str) -> tuple[str, float]:
    """Return the unit of display and its factor; the unit itself and 1 if it is not shown in another one."""
    target = DISPLAY[_chosen[-1]].get(symbol) if _chosen else None
    if target is None:
        return symbol, 1.0
    return target, unit_symbols()[target][1] / unit_symbols()[symbol][1]


def shown_value(value: float, text: str, symbol: str) -> str:
    """Return the text of a number, in another unit of display the converted number with as many digits."""
    factor = display_unit(symbol)[1]
    return _times(text, factor, value) if float(text) else text


@contextmanager
def stored_units() -> Iterator[None]:
    """Show the numbers of the block in the units of the program, for the texts of a file that is read again."""
    chosen = _chosen[:]
    _chosen.clear()
    try:
        yield
    finally:
        _chosen[:] = chosen


def symbol_in(name: str) -> str:
    """Return the unit at the end of a key or a heading, "" without one.

    Examples
    --------
    >>> symbol_in("speed_max_kmh"), symbol_in("stop, km"), symbol_in("buff"), symbol_in("resistance_n_per_kn")
    ('km/h', 'km', '', '')
    """
    if " " in name or (len(name) > 1 and name in unit_symbols()):
        head, _, last = name.rpartition(" ")
        return last if last in unit_symbols() and not head[-1:].isdigit() else ""  # a quantity is no heading
    found = [suffix for suffix in unit_suffixes() if name.endswith(suffix)]
    suffix = max(found, key=len, default="")
    return "" if not suffix or name.removesuffix(suffix).endswith("_per") else unit_suffixes()[suffix]


def shown_name(name: str) -> str:
    """Return a key or a heading with its unit of display."""
    symbol = symbol_in(name)
    target, _ = display_unit(symbol)
    if target == symbol:
        return name
    if name.endswith(symbol):
        return name.removesuffix(symbol) + target
    old = next(key for key, unit in unit_suffixes().items() if unit == symbol and name.endswith(key))
    return name.removesuffix(old) + next(key for key, unit in unit_suffixes().items() if unit == target)


def shown_data(value: Any, symbol: str = "") -> Any:
    """Return JSON data with keys and numbers in the units of display."""
    if isinstance(value, dict):
        own = str(value.get("unit") or "") or symbol_in(str(value.get("metric", "")))
        found = {}
        for key, entry in value.items():
            unit = own if key in ("value", "limit") else symbol_in(str(key)) or symbol
            named = display_unit(own)[0] if key == "unit" else shown_name(entry) if key == "metric" else entry
            found[shown_name(str(key))] = shown_data(named, unit)
        return found
    if isinstance(value, (list, tuple)):
        return [shown_data(entry, symbol) for entry in value]
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    target, factor = display_unit(symbol)
    return value * factor if number and target != symbol else value


def shown_table(
    columns: Iterable[str], rows: Iterable[Iterable[Any]], keys: Iterable[str] = ()
) -> tuple[list[str], list[list[Any]]]:
    """Return headings and rows of a table in the units of display.

    A cell has the unit of its column, else that of the first cell of its row. One of a text and the number behind it
    is converted from the number, with the digits of the text.

    Parameters
    ----------
    keys
        Keys of the columns with their units, for headings without.
    """
    heads = list(columns)
    units = [symbol_in(key) for key in (list(keys) or heads)]
    found = []
    for row in rows:
        first, *cells = row
        own = symbol_in(first) if isinstance(first, str) else ""
        named = shown_name(first) if isinstance(first, str) and not units[0] else _shown_cell(first, units[0])
        found.append([named, *(_shown_cell(cell, unit or own) for cell, unit in zip(cells, units[1:], strict=True))])
    return [shown_name(head) for head in heads], found


def _shown_cell(cell: Any, symbol: str) -> Any:
    if isinstance(cell, tuple):
        text, value = cell
        return shown_value(value, text, symbol)
    if not isinstance(cell, str):
        return shown_data(cell, symbol)
    return (
        _NUMBER.sub(lambda number: _times(number[0], display_unit(symbol)[1]), cell)
        if _CELL.fullmatch(cell)
        else shown_text(cell)
    )


_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_CELL = re.compile(r"[-+−]?\d+(?:\.\d+)?\*?")
"""Cell with one number, perhaps marked as the best."""


def _times(text: str, factor: float, value: float | None = None) -> str:
    """Return a number of a text, or the value behind it, times a factor with the digits of the text, at least three."""
    if factor == 1.0:
        return text
    digits = max(3, len(text.replace(".", "").lstrip("-0")))
    return number_text(float(f"{(float(text) if value is None else value) * factor:.{digits}g}"), digits)


@cache
def _quantities(system: str) -> re.Pattern[str]:
    """Return the pattern of a quantity in a text, of a place as ``km 1.5``, and of a limit without its unit."""
    units = "|".join(sorted(map(re.escape, DISPLAY[system]), key=len, reverse=True))
    number = r"\d+(?:\.\d+)?"
    several = rf"{number}(?:(?:,| \.\.\.| …| to| and| /) [-+−]?{number}|[-–]{number})*"
    place = rf"|(?<!\w)km (?P<place>{number})(?![\d+])" if "km" in DISPLAY[system] else ""
    return re.compile(
        rf"(?<![\w.])(?<!\d )(?<!\d\+)(?P<numbers>{several}) (?P<unit>{units})(?![\w/²³‰%+]){place}"
        rf"|\(limit (?P<limit>{number})\)|;"
    )


def shown_texts(value: Any) -> Any:
    """Return data of texts, also in dataclasses, with their quantities in the units of display."""
    if not _chosen:
        return value
    if isinstance(value, str):
        return shown_text(value)
    if isinstance(value, (list, tuple)):
        return type(value)(map(shown_texts, value))
    if isinstance(value, dict):
        return {key: shown_texts(entry) for key, entry in value.items()}
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{field.name: shown_texts(getattr(value, field.name)) for field in fields(value)})
    return value


def shown_text(text: str) -> str:
    """Return a text with its quantities in the units of display; a limit has the unit of the value before it."""
    if not _chosen:
        return text
    factor = 1.0

    def shown(found: re.Match[str]) -> str:
        nonlocal factor
        if found["unit"]:
            target, factor = display_unit(found["unit"])
            return f"{_NUMBER.sub(lambda number: _times(number[0], factor), found['numbers'])} {target}"
        if found["limit"]:
            return f"(limit {_times(found['limit'], factor)})"
        if found.groupdict().get("place"):
            target, scale = display_unit("km")
            return f"{target} {_times(found['place'], scale)}"
        factor = 1.0
        return found[0]

    return _quantities(_chosen[-1]).sub(shown, text)
