"""Reading of a recorder's CSV: columns of numbers with their line numbers."""

import csv
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from plant_sim.chainage import parse_post
from plant_sim.formats.fields import decoded
from plant_sim.input_error import InputFaults
from train_ato.api.import_csv.columns import NOTCH, QUANTITIES, TIMESTAMP, Column, column_of, plain_notch, plainly
from train_ato.api.import_csv.layout import NO_LAYOUT, RecorderLayout
from train_ato.messages.types import Array

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
    """Return the titles with the units of a row of units in brackets; a title may have the same unit already."""
    units = [cell.strip().strip("[]()").strip() for cell in cells]
    names = list(titles)
    for place, (title, unit) in enumerate(zip(titles, units, strict=False)):
        own = column_name(title)
        if not unit or unit == "-" or own.endswith(f"_{_unit(unit)}"):
            continue
        if _is_known(own) and own != "timestamp":
            raise ValueError(f"{title}: the row of units below has '{unit}'; correct one of them")
        names[place] = f"{title} [{unit}]"
    return names


def _unit(text: str) -> str:
    """Return the unit suffix of a unit."""
    plain = plainly(text)
    return _UNITS.get(plain, plain)


_FRACTION = re.compile(r"[.,](\d+)$|[.,](\d+)(?=[Z+-])")
_DAY_FIRST = re.compile(r"^(\d{1,2})\.(\d{1,2})\.(\d{4})(?:[ T]+|,\s*)(\d{1,2})(:\d{2}(?::\d{2}(?:[.,]\d+)?)?)$")
_SLASHES = re.compile(r"^(\d{1,2})[/-](\d{1,2})[/-](\d{4})(?:[ T]+|,\s*)(\d{1,2})(:\d{2}(?::\d{2}(?:[.,]\d+)?)?)$")
_HALF = re.compile(r"^(.*?)(\d{1,2})(:\d{2}(?::\d{2}(?:[.,]\d+)?)?)\s*([AaPp])\.?[Mm]\.?$")
_YEAR_FIRST = re.compile(r"^(\d{4})/(\d{1,2})/(\d{1,2})(?=[ T,])")
_UNIX = re.compile(r"^\d{10}(?:\d{3}){0,3}(?:[.,]\d+)?$")
TIME_OF_DAY = re.compile(r"^\d{1,2}:\d{2}(?::\d{2}(?:[.,]\d+)?)?(?:\s*[AaPp]\.?[Mm]\.?)?$")
"""Time of day without a date."""
DATE = re.compile(r"^(?:\d{4}([-/])\d{1,2}\1\d{1,2}|\d{1,2}([-./])\d{1,2}\2\d{4})$")
"""Date without a time of day."""
DAY = 86_400_000_000
_ZERO, _UNIT = datetime(2000, 1, 1, tzinfo=timezone.utc), timedelta(microseconds=1)
UNIX_DIGITS = {10: 1e6, 13: 1e3, 16: 1.0, 19: 1e-3}
"""Microseconds of one unit of a Unix time, by its digits before the decimal mark."""


def moments(texts: Sequence[str]) -> list[float | None]:
    """Return the seconds of the moments of a column from the first one on; None for a text that is no date and time.

    Times of day alone pass midnight where they fall by more than 12 h. The order of day and month in ``03/01/2026`` is
    the order that fits all rows. Where both orders fit, the order with the shorter run is used.
    """
    orders = [[_microseconds(text, first) for text in texts] for first in ("month", "day")]
    best = min(orders, key=lambda found: (found.count(None), _length(found)))
    clocks = all(TIME_OF_DAY.match(text) for text in texts)
    found: list[float | None] = []
    days, last = 0, None
    zero = next((value for value in best if value is not None), 0)
    for value in best:
        if value is not None and clocks:
            days += DAY if last is not None and value + days < last - DAY // 2 else 0
            value += days  # the day of the value
            last = value
        found.append(None if value is None else (value - zero) / 1e6)
    return found


def _length(values: Sequence[int | None]) -> int:
    known = [value for value in values if value is not None]
    return max(known) - min(known) if known else 0


def _microseconds(text: str, first: str) -> int | None:
    """Return a moment in microseconds, in UTC without a zone; ``first`` of month and day in a date with slashes."""
    if _UNIX.match(text):
        whole, _, part = text.replace(",", ".").partition(".")
        unit = UNIX_DIGITS[len(whole)]
        return round(int(whole) * unit if unit >= 1 else int(whole) // 1000) + round(float(f"0.{part or 0}") * unit)
    if (half := _HALF.match(text)) is not None:
        before, hour, rest, letter = half.groups()
        if not 1 <= int(hour) <= 12:
            return None
        text = f"{before}{int(hour) % 12 + (12 if letter in 'Pp' else 0)}{rest}"
    if TIME_OF_DAY.match(text):
        text = f"2000-01-01T{text.zfill(len(text) + 1) if text[1] == ':' else text}"
    text = _YEAR_FIRST.sub(lambda parts: f"{parts[1]}-{int(parts[2]):02d}-{int(parts[3]):02d}", text)
    for pattern in (_DAY_FIRST, _SLASHES):
        if (parts := pattern.match(text)) is not None:
            day, month, year, hour, rest = parts.groups()
            if pattern is _SLASHES and first == "month":
                day, month = month, day
            text = f"{year}-{int(month):02d}-{int(day):02d}T{int(hour):02d}{rest}"
    plain = _FRACTION.sub(lambda match: "." + (match[1] or match[2])[:6].ljust(6, "0"), text).replace("Z", "+00:00")
    plain = re.sub(r"([ T])(\d):", r"\g<1>0\2:", plain)
    try:
        moment = datetime.fromisoformat(plain)
    except ValueError:
        return None
    return ((moment if moment.tzinfo is not None else moment.replace(tzinfo=timezone.utc)) - _ZERO) // _UNIT


_Result = TypeVar("_Result")


class FileFaults:
    """Faults of one file, in the order of their discovery."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._texts: dict[tuple[str, str], str] = {}
        self._counts: Counter[tuple[str, str]] = Counter()

    def add(self, text: str) -> None:
        """Add a fault: place and problem, without the file."""
        self._texts.setdefault(("", text), text)

    def add_of_kind(self, place: str, kind: str, text: str) -> None:
        """Add a fault of a column or the rows; further ones of its kind there are only counted."""
        self._texts.setdefault((place, kind), text)
        self._counts[place, kind] += 1

    def add_of_cell(self, table: "CsvTable", row: int, column: Column, kind: str, problem: str) -> None:
        """Add a fault of a cell; further ones of its kind in the column are only counted."""
        self.add_of_kind(column.title, kind, table.at(row, column, problem))

    def attempt(self, check: Callable[..., _Result], *data: Any) -> _Result | None:
        """Return the result of a check; None if it raises ValueError, whose text is added."""
        try:
            return check(*data)
        except ValueError as error:
            self.add(str(error).removeprefix(f"{self.path}: "))
            return None

    def refuse(self) -> None:
        """Raise InputFaults if the file has faults."""
        lines = []
        for key, text in self._texts.items():
            more = f" (and {self._counts[key] - 1} more of this kind)" if self._counts[key] > 1 else ""
            lines.append(f"{self.path}: {text}{more}")
        if lines:
            raise InputFaults.of(lines, self.path)


MAX_FILE = 512 * 2**20
"""Maximum size of a file [bytes]."""
SEPARATORS = (";", "\t", ",")
_NUMBER = re.compile(r"^[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?$")
_THOUSANDS = re.compile(r"^[-+]?[1-9]\d{0,2},\d{3}$")
_SEPARATOR_LINE = re.compile(r'^"?sep=(.)"?$', re.IGNORECASE)
"""First line of a spreadsheet with the separator."""
PLACES = ("position", "front_position")
_NOTHING = frozenset(("", "nan", "null", "none", "na", "n/a", "-"))
"""Texts of a cell without number."""


@dataclass
class CsvTable:
    """Columns of a file, in SI.

    Attributes
    ----------
    columns : dict
        Quantity and unit of every column by title, in the order of the file.
    values : dict of Array, each of shape (n,)
        SI numbers by title; NaN: empty cell.
    lines : ndarray of int, shape (n,)
        Line number of every row in the file, from 1.
    decimals : dict of int
        Maximum number of decimals in a column; -1 for numbers with an exponent.
    """

    path: Path
    columns: dict[str, Column] = field(default_factory=dict)
    values: dict[str, Array] = field(default_factory=dict)
    lines: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    decimals: dict[str, int] = field(default_factory=dict)

    def find(self, quantity: str, unit: int | None = None) -> Column | None:
        """Return the column of a quantity, or None."""
        found = (column for column in self.columns.values() if (column.quantity, column.unit) == (quantity, unit))
        return next(found, None)

    def at(self, row: int, column: Column, text: str) -> str:
        """Return a fault with its line and column."""
        return f"line {self.lines[row]}, {column.title}: {text}"

    def wrong(self, row: int, column: Column, text: str) -> ValueError:
        """Return an error that names the file, the line and the column."""
        return ValueError(f"{self.path}: {self.at(row, column, text)}")

    def resolution(self, column: Column) -> float:
        """Return the resolution of a column from its decimals [SI]; 0 if unknown."""
        decimals = self.decimals[column.title]
        return 0.0 if decimals < 0 or decimals > 9 else float(10.0**-decimals * column.factor)


AIR = 101_325.0
"""Pressure of the air [Pa], for gauge pressures."""


def read_table(
    path: Path, rename: dict[str, str], ignore: frozenset[str], layout: RecorderLayout = NO_LAYOUT
) -> CsvTable:
    """Read a recorder's file.

    The column names are in the first line that is not empty and does not begin with ``#``. Semicolons, tabs or commas
    separate them. The next line may have their units. A first line ``sep=;`` gives the separator. Decimal commas are
    read; between commas they need quotes. Cells may be empty. Date and time of day may be in two columns.

    Parameters
    ----------
    path
        CSV file, in UTF-8, UTF-16 or Latin-1.
    rename
        Names of columns by their titles in the file.
    ignore
        Titles of ignored columns.
    layout
        Layout of the file; it names the columns that the other parameters do not.

    Raises
    ------
    InputFaults
        All faults, one line each with the file, the line and the column.
    """
    lines = _lines(path)
    number, titles, separator = _head(path, lines, layout)
    table, faults = CsvTable(path), FileFaults(path)
    rows = list(lines)
    if len(titles) == 1 and rows:
        mark, widest = max(
            ((mark, line.count(mark)) for mark in SEPARATORS for _, line in rows), key=lambda row: row[1]
        )
        if widest:
            raise ValueError(
                f"{path}: line {number}: one column, '{titles[0][:40]}', above rows of {widest + 1}; remove the lines "
                f"above the column names or begin them with #, and separate the names with '{mark}'"
            )
    names = titles
    if rows and is_units_row(cells := _cells(rows[0][1], separator)[: len(titles)]):
        try:
            names = with_units(titles, cells)
        except ValueError as error:
            raise ValueError(f"{path}: line {number}, {error}") from None
        del rows[0]
    first = _cells(rows[0][1], separator) if rows else []
    given = {title: name for title, name in layout.renames().items() if title in titles and title not in ignore}
    ignore, rename = ignore | ({*titles} & {*layout.ignore} - {*rename}), given | rename
    names, dates = _with_times(titles, names, [cell.strip() for cell in first], {*rename, *ignore})
    dates = titles.index(layout.date) if layout.date and layout.date in titles else dates
    ignored = ignore | ({titles[dates]} if dates is not None else set())
    if layout.ignore_others:
        ignored |= {
            title for title, name in zip(titles, names, strict=True) if not _is_known(rename.get(title) or name)
        }
    kept = _columns(table, titles, names, rename, ignored, lambda text: faults.add(f"line {number}, {text}"))
    _read_rows(table, kept, rows, separator, len(titles), faults, dates, layout.shares)
    faults.refuse()
    pressure = table.find("brake_pipe_pressure")
    if layout.gauge and pressure is not None:
        table.values[pressure.title] += AIR
    return table


def _head(path: Path, lines: Iterator[tuple[int, str]], layout: RecorderLayout) -> tuple[int, list[str], str]:
    """Return the number of the line with the titles, the titles, and the mark between the columns."""
    number, head = next((entry for entry in lines if entry[0] > layout.skip_lines), (0, ""))
    if not number:
        raise ValueError(f"{path}: no column names; give them in the first line, for example time_s,speed_kmh,force_kn")
    declared = _SEPARATOR_LINE.match(head.strip())
    if declared is not None:
        number, head = next(lines, (0, ""))
    found = layout.separator or next((mark for mark in SEPARATORS if mark in head), ",")
    separator = declared[1] if declared else found
    titles = [title.strip() for title in _cells(head, separator)]
    while titles and not titles[-1]:
        titles.pop()
    return number, titles, separator


def titles_of(path: Path) -> list[str]:
    """Return the titles of the columns of a file without a layout."""
    return _head(path, _lines(path), NO_LAYOUT)[1]


def _is_known(name: str) -> bool:
    try:
        column_of(name, column_name(name))
    except ValueError:
        return False
    return True


def _with_times(titles: list[str], names: list[str], cells: list[str], given: set[str]) -> tuple[list[str], int | None]:
    """Return the names with a column of times of day as ``timestamp``, and the column of their dates, or None."""
    free = [place for place, title in enumerate(titles) if title not in given and place < len(cells)]
    clocks = [place for place in free if TIME_OF_DAY.match(cells[place]) and is_time(titles[place])]
    dates = [place for place in free if DATE.match(cells[place])]
    if not clocks:
        return names, None
    names = [TIMESTAMP if place == clocks[0] else name for place, name in enumerate(names)]
    return names, dates[0] if dates else None


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines with content and their numbers."""
    try:
        if path.stat().st_size > MAX_FILE:
            raise ValueError(f"{path}: larger than {MAX_FILE // 2**20} MB; split it into single runs")
        raw = path.read_bytes()
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror}); give the CSV file of a recorder") from None
    if raw.lstrip(b"\xef\xbb\xbf \r\n")[:1] in (b"<", b"{"):
        raise ValueError(f"{path}: XML or JSON, not a table; give the CSV file of a recorder")
    if b"\0" in raw and raw[:2] not in (b"\xff\xfe", b"\xfe\xff", b"\0\0"):
        raise ValueError(f"{path}: not a text file; give the CSV file of a recorder")
    for number, line in enumerate(decoded(raw).splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            yield number, line


def _cells(line: str, separator: str) -> list[str]:
    return next(csv.reader([line], delimiter=separator)) if '"' in line else line.split(separator)


def _columns(
    table: CsvTable,
    titles: list[str],
    names: list[str],
    rename: dict[str, str],
    ignore: frozenset[str],
    complain: Callable[[str], None],
) -> list[int]:
    """Add the columns to the table; return the indices of the columns to read; faults go to ``complain``."""
    for option, given in (("--rename", rename), ("--ignore", ignore)):
        for title in given:
            if title not in titles:
                complain(f"{option} {title}: no such column; the file has {', '.join(titles)}")
    kept = []
    for place, (title, name) in enumerate(zip(titles, names, strict=True)):
        if title not in ignore:
            try:
                table.columns[title] = _column(table, place, title, rename.get(title) or column_name(name))
                kept.append(place)
            except ValueError as error:
                complain(str(error))
    return kept


def _column(table: CsvTable, place: int, title: str, name: str) -> Column:
    """Return a column that the table does not have yet."""
    if not title:
        raise ValueError(f"column {place + 1} has no name; name or remove it")
    if title in table.columns:
        raise ValueError(f"column '{title}' appears twice; rename or remove one")
    column = column_of(title, name)
    other = table.find(column.quantity, column.unit)
    if other is not None and column.quantity != NOTCH:
        raise ValueError(
            f"columns '{other.title}' and '{title}' are the same quantity; remove one with --ignore '{title}'"
        )
    return column


def _read_rows(
    table: CsvTable,
    kept: list[int],
    rows: list[tuple[int, str]],
    separator: str,
    width: int,
    faults: FileFaults,
    dates: int | None,
    shares: Mapping[str, Mapping[str, float]],
) -> None:
    columns = list(table.columns.values())
    texts: list[list[str]] = [[] for _ in columns]
    numbers: list[int] = []
    for number, line in rows:
        cells = _cells(line, separator)
        if len(cells) != width and not (len(cells) > width and not "".join(cells[width:]).strip()):
            problem = f"line {number}: {len(cells)} values for {width} columns; correct the line"
            faults.add_of_kind("rows", "width", problem)
            continue
        numbers.append(number)
        for column, entries, place in zip(columns, texts, kept, strict=True):
            text = cells[place].strip()
            dated = dates is not None and column.quantity == TIMESTAMP
            entries.append(f"{cells[dates or 0].strip()} {text}" if dated else text)
    table.lines = np.array(numbers, dtype=np.int64)
    marks: dict[str, str] = {}
    for column, entries in zip(columns, texts, strict=True):
        if column.quantity == TIMESTAMP:
            table.values[column.title] = _moments(table, column, entries, faults)
        elif column.quantity == NOTCH:
            table.values[column.title] = _notches(table, column, entries, shares.get(column.title, {}), faults)
        else:
            table.values[column.title] = _numbers(table, column, entries, separator, marks, faults)


def _numbers(
    table: CsvTable, column: Column, entries: list[str], separator: str, marks: dict[str, str], faults: FileFaults
) -> Array:
    """Convert the cells of a column to SI; ``marks`` has the first number of the file with each decimal mark."""
    values = np.full(len(entries), np.nan)
    decimals = 0
    commas = [text for text in entries if "," in text]
    thousands = separator == "," and bool(commas) and all(_THOUSANDS.match(text) for text in commas)
    for row, text in enumerate(entries):
        if text.lower() in _NOTHING:
            continue
        kilometre = parse_post(text.replace(",", ".")) if "+" in text and column.quantity in PLACES else None
        if kilometre is not None and column.factor in (1.0, 1e3):
            values[row] = kilometre / column.factor
            decimals = max(decimals, 3 if column.factor > 1 else 0)
            continue
        if not _NUMBER.match(text):
            faults.add_of_cell(table, row, column, "number", f"'{text[:30]}' is not a number; correct it")
            continue
        if thousands and "," in text:
            problem = (
                f"'{text[:30]}' may be {text.replace(',', '.')} or {text.replace(',', '')}; write it without a comma"
            )
            faults.add_of_cell(table, row, column, "number", problem)
            continue
        mark = "," if "," in text else "." if "." in text else ""
        if mark and mark not in marks:
            marks[mark] = text
            if len(marks) > 1:
                faults.add_of_kind("rows", "mark", table.at(row, column, _two_marks(marks)))
        plain = text.replace(",", ".")
        value = float(plain)
        if not math.isfinite(value):
            faults.add_of_cell(table, row, column, "large", f"'{text[:30]}' is too large; correct it")
            continue
        values[row] = value
        if decimals >= 0:
            exponent = "e" in plain or "E" in plain
            decimals = -1 if exponent else max(decimals, len(plain.partition(".")[2].rstrip("0")))
    table.decimals[column.title] = decimals
    return np.asarray(values * column.factor)


def _notches(
    table: CsvTable, column: Column, entries: list[str], shares: Mapping[str, float], faults: FileFaults
) -> Array:
    """Return the share of the largest force of every row; an empty cell keeps the notch before."""
    values, last = np.zeros(len(entries)), 0.0
    for row, text in enumerate(entries):
        if text and plain_notch(text) not in shares:
            known = ", ".join(shares) or "none; write notches in a layout"
            problem = f"'{text[:30]}' is no notch of the layout ({known}); add it there"
            faults.add_of_cell(table, row, column, "notch", problem)
        last = shares.get(plain_notch(text), last)
        values[row] = last
    table.decimals[column.title] = -1
    return values


def _two_marks(marks: dict[str, str]) -> str:
    """Return the fault of a file with two decimal marks: ``1,250`` may be 1.25 or 1250."""
    return (
        f"'{marks[','][:30]}' has a comma and '{marks['.'][:30]}' a point; write all numbers with one decimal mark and "
        "without thousands separators"
    )


def _moments(table: CsvTable, column: Column, entries: list[str], faults: FileFaults) -> Array:
    """Convert date and time of day to seconds since the first row."""
    values = np.full(len(entries), np.nan)
    rows = [row for row, text in enumerate(entries) if text.lower() not in _NOTHING]
    for row, moment in zip(rows, moments([entries[row] for row in rows]), strict=True):
        if moment is None:
            example = "write for example 2026-03-01T08:15:30.5 or 01.03.2026 08:15:30"
            faults.add_of_cell(table, row, column, "date", f"'{entries[row][:30]}' is not a date and time; {example}")
            continue
        values[row] = moment
    table.decimals[column.title] = -1
    return values
