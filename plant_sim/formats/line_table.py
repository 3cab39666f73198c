"""Lines as a table (CSV): one row per place with grade or height, speed limit, radius and station.

A title is a quantity with its unit: ``position_km``, ``grade_permille``, ``Speed limit [km/h]``. A value applies from
its row to the next row with a value in its column. An empty cell changes nothing. A radius of 0 is straight track.
Heights become grades, linear between their rows.
"""

import csv
import io
import math
import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from plant_sim.chainage import parse_post
from plant_sim.formats.fields import decoded, finite_number, number_in, print_assumption, read_bytes
from plant_sim.formats.writing import lost_keys
from plant_sim.input_error import build_model, close_match
from plant_sim.line import MAX_GRADE, Line, order_fault
from plant_sim.units import number_text

FOOT, MILE = 0.3048, 1609.344
LENGTHS = {"m": 1.0, "km": 1e3, "mi": MILE, "ft": FOOT}
QUANTITIES: dict[str, dict[str, float]] = {
    "position": LENGTHS,
    "grade": {"permille": 1e-3, "percent": 1e-2, "1": 1.0, "ft_mi": FOOT / MILE},
    "elevation": LENGTHS,
    "speed_limit": {"kmh": 1 / 3.6, "m_s": 1.0, "mph": 0.44704},
    "radius": {"m": 1.0, "ft": FOOT},
    "latitude": {"deg": 1.0},
    "longitude": {"deg": 1.0},
}
"""SI value of one unit of every quantity."""
MAX_VALUES = {
    "position": 1e8, "grade": MAX_GRADE, "elevation": 1e4, "speed_limit": 300.0, "radius": 1e12, "latitude": 90.0,
    "longitude": 180.0,
}  # fmt: skip
"""Largest value of every quantity [SI]."""
SHARPEST = 5.0
"""Smallest radius of a curve [m]."""
OTHER_NAMES = {
    "place": "position", "chainage": "position", "km": "position", "mi": "position", "mile": "position",
    "miles": "position", "s": "position", "milepost": "position", "distance": "position", "gradient": "grade",
    "slope": "grade", "height": "elevation", "altitude": "elevation", "ele": "elevation", "speed": "speed_limit",
    "limit": "speed_limit", "vmax": "speed_limit", "v_max": "speed_limit", "curve_radius": "radius", "lat": "latitude",
    "lon": "longitude", "station": "stop", "name": "stop",
}  # fmt: skip
UNITS = {
    "km_h": "kmh", "kph": "kmh", "mi_h": "mph", "": "1", "degree": "deg", "mile": "mi", "miles": "mi", "foot": "ft",
    "feet": "ft", "metre": "m", "meter": "m", "metres": "m", "meters": "m", "promille": "permille",
    "per_mille": "permille", "pct": "percent",
}  # fmt: skip
_SIGNS = {"‰": " permille", "%": " percent", "°": " deg"}
TEXT = "stop"
IN_A_TABLE = ("begin", "grades", "speed_limits", "curves", "stops", "stops[].name", "coordinates")
"""Keys of a line that a table has."""
SEPARATORS = (";", "\t", ",")
_BRACKETS = re.compile(r"^(.*?)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]\s*$")
_SEPARATOR_LINE = re.compile(r'\A"?sep=.?"?\r?\n', re.IGNORECASE)
"""First line of a spreadsheet with the separator."""
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(\.\d{3})+(,\d+)?", re.ASCII)
"""Number with a point that may separate thousands."""
_SWAPPED = str.maketrans(",.", ".,")


@dataclass(frozen=True, slots=True)
class _Column:
    title: str
    quantity: str
    factor: float


def is_line_table(path: Path) -> bool:
    """Return True for a file with an ending of a table."""
    return path.suffix.lower() in (".csv", ".tsv")


def table_line(path: Path) -> Line:
    """Return the line in a table."""
    columns, rows = _read(path)
    titles = {column.quantity: column.title for column in columns}
    if ("latitude" in titles) != ("longitude" in titles):
        raise ValueError(f"{path}: line 1: latitude and longitude need each other; add or remove one")
    if "grade" in titles and "elevation" in titles:
        raise ValueError(
            f"{path}: line 1: '{titles['grade']}' and '{titles['elevation']}' are both the grade; remove one"
        )
    places = [row["position"] for _, row in rows]
    if len(rows) < 2 or (fault := order_fault(places)):
        why = fault if len(rows) > 1 else f": {len(rows)} rows; a line needs two"
        raise ValueError(f"{path}: {titles['position']}{why}")
    listed = {key: [(row["position"], row[key]) for _, row in rows if key in row] for key in (*QUANTITIES, TEXT)}
    key = "elevation" if "elevation" in titles else "grade"
    risen = slopes(listed["elevation"], f"{path}: {titles.get(key)}")
    grades = risen or listed["grade"]
    if key in titles and (not grades or grades[0][0] > places[0]):
        print_assumption(f"{path}: {titles[key]}: no grade at the begin; level there")
    if risen and (last := listed["elevation"][-1][0]) < places[-1]:
        print_assumption(f"{path}: {titles['elevation']}: no height at the end; level from {number_text(last)} m on")
        grades = [*grades, (last, 0.0)]
    limits = listed["speed_limit"]
    if not limits:
        print_assumption(f"{path}: no speed limit; only the train limits the speed")
    raw = {
        "schema": "train_ato/line/1",
        "name": path.stem,
        "source": f"table {path.name}",
        "begin": places[0],
        "end": places[-1],
        "grades": _steps(grades, places[-1], "grade"),
        "speed_limits": _steps(limits, places[-1], "speed"),
        "curves": _curves(listed["radius"], places[-1]),
        "stops": [{"at": at, "name": str(name)} for at, name in listed[TEXT]],
        "coordinates": [
            {"at": row["position"], "latitude": row["latitude"], "longitude": row["longitude"]}
            for _, row in rows
            if "latitude" in row and "longitude" in row
        ],
    }
    return build_model(Line, raw, str(path))


def slopes(heights: list[tuple[float, float]], place: str) -> list[tuple[float, float]]:
    """Return place [m] and grade of the stretches between places [m] with a height [m]; refuse an implausible one."""
    for (a, low), (b, high) in pairwise(heights):
        if abs(high - low) > MAX_GRADE * (b - a):
            change, most = number_text(high - low, 4), number_text(1e3 * MAX_GRADE)
            raise ValueError(
                f"{place}: the height changes by {change} m from {number_text(a)} to {number_text(b)} m; correct the "
                f"heights or their unit (at most {most} per mille)"
            )
    return [(a, (high - low) / (b - a)) for (a, low), (b, high) in pairwise(heights)]


def _steps(values: list[tuple[float, Any]], end: float, key: str) -> list[dict[str, float]]:
    """Return every change of a value before the end of the line."""
    found: list[dict[str, float]] = []
    for at, value in values:
        if at < end and (not found or found[-1][key] != value):
            found.append({"at": at, key: value})
    return found


def _curves(radii: list[tuple[float, Any]], end: float) -> list[dict[str, Any]]:
    """Return the curves; a radius > 0 turns to the right, 0 is straight."""
    stops = [*(at for at, _ in radii[1:]), end][: len(radii)]
    return [
        {"begin": at, "end": stop, "radius": abs(radius), "side": "right" if radius > 0 else "left"}
        for (at, radius), stop in zip(radii, stops, strict=True)
        if radius and stop > at
    ]


def _read(path: Path) -> tuple[list[_Column], list[tuple[int, dict[str, Any]]]]:
    """Return the columns, and number and values of every row."""
    text = _SEPARATOR_LINE.sub("\n", decoded(read_bytes(path)))
    head = next((line for line in text.splitlines() if line.strip() and not line.startswith("#")), "")
    mark = next((mark for mark in SEPARATORS if mark in head), ",")
    listed = csv.reader(io.StringIO(text, newline=None), delimiter=mark, strict=True)
    try:
        lines = [(listed.line_num, cells) for cells in listed if any(cells) and not cells[0].startswith("#")]
    except csv.Error as error:
        raise ValueError(f"{path}: line {listed.line_num}: {error}; correct the quotes or the cell") from None
    if not lines:
        raise ValueError(f"{path}: is empty; write a line with titles, as position_km,grade_permille,speed_limit_kmh")
    while not lines[0][1][-1].strip() and not any(cells[-1].strip() for _, cells in lines):  # marks at the ends of rows
        lines = [(number, cells[:-1]) for number, cells in lines]
    columns: list[_Column] = []
    for title in lines[0][1]:
        column = _column(title.strip(), f"{path}: line {lines[0][0]}")
        if any(column.quantity == other.quantity for other in columns):
            raise ValueError(f"{path}: line {lines[0][0]}: two columns of {column.quantity}; remove one")
        columns.append(column)
    if not any(column.quantity == "position" for column in columns):
        raise ValueError(f"{path}: line {lines[0][0]}: no place; name a column position_m or position_km")
    _refuse_thousands(columns, lines[1:], path)
    rows = []
    for number, cells in lines[1:]:
        if len(cells) != len(columns):
            raise ValueError(f"{path}: line {number}: {len(cells)} values for {len(columns)} columns; correct the line")
        place = f"{path}: line {number}"
        pairs = ((column, cell.strip()) for column, cell in zip(columns, cells, strict=True))
        row = {column.quantity: _value(column, cell, place, mark) for column, cell in pairs if cell}
        if "position" not in row:
            raise ValueError(f"{place}: no place; give one or remove the row")
        rows.append((number, row))
    return columns, rows


def _refuse_thousands(columns: list[_Column], lines: list[tuple[int, list[str]]], path: Path) -> None:
    """Refuse a number such as ``1.250``, which may be 1.25 or 1250, beside a number with the other decimal mark."""
    numbers = [
        (number, column, cell.strip())
        for number, cells in lines
        for column, cell in zip(columns, cells, strict=False)
        if column.quantity != TEXT
    ]
    for mark, other, word in (".", ",", "point"), (",", ".", "comma"):
        beside = next((cell for *_, cell in numbers if other in cell), "")
        for number, column, cell in numbers if beside else ():
            plain = cell if mark == "." else cell.translate(_SWAPPED)
            if _THOUSANDS.fullmatch(plain) and column.quantity not in ("latitude", "longitude"):
                raise ValueError(
                    f"{path}: line {number}, {column.title} = '{cell}': its {word} may separate thousands, and "
                    f"'{beside[:30]}' has the other mark; write all numbers with one decimal mark and without "
                    "thousands separators"
                )


def _column(title: str, place: str) -> _Column:
    """Return quantity and factor of a title."""
    spelt = title
    for sign, unit in _SIGNS.items():
        spelt = spelt.replace(sign, unit)
    parts = _BRACKETS.match(spelt)
    plain = re.sub(r"[^a-z0-9]+", "_", (parts[1] if parts else spelt).lower()).strip("_")
    alone = UNITS.get(plain, plain)
    named = [f"{quantity}_{alone}" for quantity, units in QUANTITIES.items() if plain and alone in units]
    if named and plain not in OTHER_NAMES:
        raise ValueError(f"{place}: column '{title}' is a unit without a quantity; name it {' or '.join(named)}")
    known = sorted({*OTHER_NAMES, *QUANTITIES, TEXT}, key=len, reverse=True)
    name = next((name for name in known if plain == name or (not parts and plain.startswith(f"{name}_"))), None)
    if name is None:
        near = close_match(plain, known) or f", none of {', '.join(QUANTITIES)}, {TEXT}"
        raise ValueError(f"{place}: unknown column '{title}'{near}; rename or remove it")
    quantity = OTHER_NAMES.get(name, name)
    if quantity == TEXT:
        return _Column(title, TEXT, 1.0)
    own = "deg" if quantity in ("latitude", "longitude") else UNITS.get(name, name)
    raw = parts[2] if parts else plain[len(name) + 1 :]
    unit = re.sub(r"[^a-z0-9]+", "_", raw.lower()).strip("_") or (own if own in QUANTITIES[quantity] else "")
    factor = QUANTITIES[quantity].get(UNITS.get(unit, unit))
    if factor is None or (not unit and quantity != "grade"):
        units = ", ".join(f"{quantity}_{unit}" for unit in QUANTITIES[quantity])
        raise ValueError(f"{place}: column '{title}' has no known unit; name it {units}")
    if not unit:
        print_assumption(f"{place}: column '{title}' has no unit; read as a fraction, 0.01 for 10 per mille")
    return _Column(title, quantity, factor)


def _value(column: _Column, text: str, place: str, mark: str) -> Any:
    """Return a cell in SI."""
    if column.quantity == TEXT:
        return " ".join(text.replace("\0", "").split())
    where = f"{place}, {column.title}"
    kilometre = parse_post(text.replace(",", "."))
    if column.quantity == "position" and column.factor in (1.0, 1e3) and kilometre is not None:
        return kilometre
    if "," in text and mark == ",":
        raise ValueError(f"{where} = '{text[:30]}': separate the columns by semicolons, or write a decimal point")
    number, most = number_in(text.replace(",", "."), where), MAX_VALUES[column.quantity] / column.factor
    if column.quantity == "grade" and column.factor == 1.0 and abs(number) > most:
        raise ValueError(f"{where} = {number_text(number)}: name the column grade_permille or grade_percent")
    finite_number(number, where, -most, most)
    value = number * column.factor
    if column.quantity == "speed_limit" and value <= 0:
        raise ValueError(f"{where} = {number_text(number)}: must be above 0; correct it")
    if column.quantity == "radius" and 0 < abs(value) < SHARPEST:
        raise ValueError(f"{where} = {number_text(number)}: below {SHARPEST:g} m; correct it, 0 is straight")
    return value


def line_csv(line: Line) -> tuple[str, tuple[str, ...]]:
    """Return a line as table, and its keys that a table does not carry."""
    cells: dict[float, dict[str, str]] = {line.begin: {}, line.end: {}}

    def put(at: float, key: str, value: float | str) -> None:
        cells.setdefault(at, {})[key] = value if isinstance(value, str) else repr(value)

    left = lost_keys(line, IN_A_TABLE)
    for grade in line.grades:
        put(grade.at, "grade_1", grade.grade)
    for limit in line.speed_limits:
        put(limit.at, "speed_limit_m_s", limit.speed)
    bends = sorted(line.curves, key=lambda curve: curve.begin)
    left += ["curves: overlapping ones"] if any(b.begin < a.end for a, b in pairwise(bends)) else []
    for bend in bends:
        put(bend.begin, "radius_m", -bend.radius if bend.side == "left" else bend.radius)
        if not math.isclose(bend.end, line.end) and not any(other.begin == bend.end for other in bends):
            put(bend.end, "radius_m", 0.0)
    for stop in line.stops:
        put(stop.at, TEXT, stop.name or f"stop at {number_text(stop.at)} m")
    for spot in line.coordinates:
        put(spot.at, "latitude_deg", spot.latitude)
        put(spot.at, "longitude_deg", spot.longitude)
    beyond = [at for at in cells if not line.begin <= at <= line.end]
    left += [f"entries beyond the line at {number_text(at)} m" for at in beyond]
    named = ("grade_1", "speed_limit_m_s", "radius_m", TEXT, "latitude_deg", "longitude_deg")
    keys = [key for key in named if any(key in row for row in cells.values())]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["position_m", *keys])
    for at in sorted(set(cells) - set(beyond)):
        writer.writerow([repr(at), *(cells[at].get(key, "") for key in keys)])
    return out.getvalue(), tuple(left)
