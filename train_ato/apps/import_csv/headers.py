"""Column names of recorders: a quantity or its symbol, with the unit in brackets or in a row of units."""

from __future__ import annotations

import re
from collections.abc import Sequence

from train_ato.apps.import_csv.columns import QUANTITIES, plainly

__all__ = ["column_name", "is_time", "is_units_row", "with_units"]

SYMBOLS: dict[str, tuple[str, ...]] = {
    "time": ("t", "zeit"),
    "speed": ("v", "velocity", "geschwindigkeit"),
    "position": ("s", "x", "distance", "chainage", "location", "weg", "milepost", "mp", "km"),
    "force": ("f", "wheel_force", "kraft"),
    "traction_force": ("traction", "te", "tractive_effort", "tractive_force", "zugkraft"),
    "brake_force": ("braking_force", "brake_effort", "electric_brake_force", "bremskraft"),
    "reference_speed": ("v_ref", "v_target", "target_speed", "set_speed"),
    "brake_pipe_pressure": ("p", "bp", "brake_pipe", "pressure", "hll", "hauptluftleitung"),
    "timestamp": ("date", "datetime", "date_time", "date_and_time", "datum", "zeitstempel"),
}
"""Other names of a quantity in headers; all but ``timestamp`` need a unit."""
CLOCKS = ("clock", "time_of_day", "uhrzeit", "utc", "utc_time", "local_time", "gps_time")
"""Names of a column of times of day."""
_QUANTITY = {quantity.name: quantity for quantity in QUANTITIES}
_MEANT = {symbol: name for name, symbols in SYMBOLS.items() for symbol in (name, *symbols)} | {
    name: name for name in _QUANTITY
}
_UNITS = {
    "sec": "s", "seconds": "s", "kph": "kmh", "km_h": "kmh", "mps": "m_s", "hours": "h", "miles": "mi", "feet": "ft",
    "lb": "lbf",
}  # fmt: skip
"""Unit suffix of the columns of train_ato by another spelling."""
_KNOWN_UNITS = frozenset(unit for quantity in QUANTITIES for unit in quantity.units) | frozenset(_UNITS)
_BRACKETS = re.compile(r"^(.*?)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]\s*$")
_IN = re.compile(r"^(.*\S)\s+in\s+(\S+)$")


def column_name(title: str) -> str:
    """Return the column name of train_ato for a title of a recorder; another title as it is.

    Examples
    --------
    >>> column_name("V [km/h]"), column_name("Speed (m/s)"), column_name("brake pipe in bar"), column_name("Door")
    ('speed_kmh', 'speed_m_s', 'brake_pipe_pressure_bar', 'Door')
    """
    parts = _BRACKETS.match(title) or _IN.match(title)
    if parts is None:
        return "timestamp" if _MEANT.get(plainly(title)) == "timestamp" else title
    quantity = _QUANTITY.get(_MEANT.get(plainly(parts[1]), ""))
    unit = _unit(parts[2])
    return f"{quantity.name}_{unit}" if quantity is not None and unit in quantity.units else title


def is_time(title: str) -> bool:
    """Return True for a title of a column of times, with or without a date."""
    plain = plainly(title)
    return _MEANT.get(plain) in ("time", "timestamp") or plain in CLOCKS


def is_units_row(cells: Sequence[str]) -> bool:
    """Return True for a row whose cells are units, or empty, below the column names."""
    units = [cell.strip().strip("[]()") for cell in cells]
    named = [unit for unit in units if unit and unit != "-"]
    return bool(named) and all(_unit(unit) in _KNOWN_UNITS for unit in named)


def with_units(titles: Sequence[str], cells: Sequence[str]) -> list[str]:
    """Return the titles with the units of a row of units in brackets."""
    units = [cell.strip().strip("[]()").strip() for cell in cells]
    return [
        f"{title} [{unit}]" if unit and unit != "-" else title for title, unit in zip(titles, units, strict=False)
    ] + list(titles[len(units) :])


def _unit(text: str) -> str:
    """Return the unit suffix of a unit."""
    plain = plainly(text)
    return _UNITS.get(plain, plain)
