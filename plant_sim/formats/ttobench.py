"""Lines of TTOBench, an open library of train trajectory optimisation benchmarks (JSON, BSD-2).

Stops, speed limits and gradients are over the distance; gradients are positive uphill in the direction of running.
Curvatures are linear in 1/R between their entries (transition curves); they become short curves of their mean
curvature, which gives the correct work of their resistance. A tunnel has a cross section; its resistance is a figure of
the train.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from plant_sim.formats.fields import Fields, finite_number
from plant_sim.formats.notes import print_assumption
from plant_sim.input_error import build_model
from plant_sim.line import Line, order_fault
from plant_sim.number_text import number_text

LENGTHS = {"m": 1.0, "km": 1e3}
SPEEDS = {"km/h": 1 / 3.6, "m/s": 1.0}
SLOPES = {"permil": 1e-3, "percent": 1e-2, "1": 1.0}
STRAIGHT = 1e5
"""Radius beyond which a curve counts as straight [m]."""
TRANSITION, PIECES = 20.0, 10
"""Length of the parts of a transition curve [m], and their largest number."""
CARRIED_LINE = ("metadata.id", "stops", "speed limits", "gradients", "curvatures", "tunnels")
"""Keys of a line that the own file carries."""


def is_ttobench(data: dict[str, Any]) -> bool:
    """Return True if the data of a file are a line of this library."""
    return "stops" in data and isinstance(data.get("stops"), dict) and "speed limits" in data


def ttobench_line(data: dict[str, Any], place: str) -> Line:
    """Return the line in the data of a file.

    Raises
    ------
    ValueError
        One line with location, key, value and remedy.
    """
    top = Fields(data, place)
    stops = _stops(top.below("stops"))
    limits = _steps(top.below("speed limits"), "velocity", SPEEDS, 1e-3, 1e3)
    grades = _steps(top.below("gradients"), "slope", SLOPES, -1e3, 1e3) if "gradients" in top else []
    name = Path(place).stem
    if isinstance(data.get("metadata"), dict):
        name = Fields(data["metadata"], f"{place}: metadata").text("id", name)
    begin, end = min(stops[0], 0.0), stops[-1]
    if limits[0][0] > begin:
        lowest = min(speed for _, speed in limits)
        print_assumption(
            f"{place}: no speed limit from {number_text(begin)} to {number_text(limits[0][0])} m; assumed "
            f"{number_text(3.6 * lowest)} km/h there, its lowest one"
        )
        limits.insert(0, (begin, lowest))
    return build_model(
        Line,
        {
            "schema": "train_ato/line/1",
            "name": name,
            "source": f"TTOBench line {name}, BSD-2-Clause",
            "begin": begin,
            "end": end,
            "grades": [{"at": at, "grade": value} for at, value in grades],
            "curves": _curves(top, end),
            "tunnels": _tunnels(top),
            "speed_limits": [{"at": at, "speed": value} for at, value in limits],
            "stops": [{"at": at} for at in stops],
        },
        place.split(": ")[0],
    )


def _unit(fields: Fields, quantity: str, units: dict[str, float]) -> float:
    name = fields.below("units").text(quantity) if "units" in fields else fields.text("unit")
    if name not in units:
        raise ValueError(f"{fields.place}: unit of {quantity} = '{name}': must be one of {', '.join(units)}")
    return units[name]


def _stops(fields: Fields) -> list[float]:
    unit = _unit(fields, "position", LENGTHS)
    values = fields.entries("values", 2)
    stops = [finite_number(at, f"{fields.place}: values[{k}]", -1e8, 1e8) * unit for k, at in enumerate(values)]
    if fault := order_fault(stops):
        raise ValueError(f"{fields.place}: values{fault}")
    return stops


def _steps(
    fields: Fields, quantity: str, units: dict[str, float], low: float, high: float
) -> list[tuple[float, float]]:
    """Return position and value of every entry; at one position the last entry counts."""
    length, unit = _unit(fields, "position", LENGTHS), _unit(fields, quantity, units)
    steps: dict[float, float] = {}
    for k, (at, value) in enumerate(fields.rows("values", 2)):
        place = f"{fields.place}: values[{k}]"
        position = finite_number(at, f"{place}[0]", -1e8, 1e8) * length
        if steps and position < next(reversed(steps)):
            places = [finite_number(row[0], fields.place) * length for row in fields.rows("values", 2)]
            raise ValueError(f"{fields.place}: values{order_fault(places)}")
        steps[position] = finite_number(value, f"{place}[1]", low, high) * unit
    return list(steps.items())


def _curves(top: Fields, end: float) -> list[dict[str, float]]:
    if "curvatures" not in top:
        return []
    fields = top.below("curvatures")
    unit = _unit(fields, "position", LENGTHS)
    scales = [_unit(fields, f"radius at {edge}", LENGTHS) for edge in ("start", "end")]
    rows: list[tuple[float, float, float]] = []
    for k, row in enumerate(fields.rows("values", 3)):
        place = f"{fields.place}: values[{k}]"
        first, last = (_curvature(value, f"{place}[{i + 1}]") / scales[i] for i, value in enumerate(row[1:]))
        rows.append((finite_number(row[0], f"{place}[0]", -1e8, 1e8) * unit, first, last))
    if fault := order_fault([at for at, _, _ in rows]):
        raise ValueError(f"{fields.place}: values{fault}")
    ends = [at for at, _, _ in rows[1:]] + [end]
    return [
        curve
        for (at, first, last), stop in zip(rows, ends, strict=True)
        if stop > at
        for curve in _transition(at, stop, first, last)
    ]


def _tunnels(top: Fields) -> list[dict[str, float]]:
    """Return the tunnels with their cross section [m²]; one without length has no effect."""
    if "tunnels" not in top:
        return []
    fields = top.below("tunnels")
    position, length = (_unit(fields, quantity, LENGTHS) for quantity in ("position", "length"))
    _unit(fields, "cross section", {"m^2": 1.0})
    found = []
    for k, row in enumerate(fields.rows("values", 3, 0)):
        at, extent, section = (
            finite_number(value, f"{fields.place}: values[{k}][{i}]", 0, 1e8) for i, value in enumerate(row)
        )
        if extent > 0:
            begin = at * position
            found.append({"begin": begin, "end": begin + extent * length, "cross_section": section})
    return found


def _transition(begin: float, end: float, first: float, last: float) -> list[dict[str, float]]:
    """Return the curves of an entry with a linear change from the first to the last curvature [1/m]."""
    count = 1 if first == last else min(PIECES, math.ceil((end - begin) / TRANSITION))
    length = (end - begin) / count
    mean = [abs(first + (last - first) * (k + 0.5) / count) for k in range(count)]
    return [
        {"begin": begin + k * length, "end": begin + (k + 1) * length, "radius": 1 / curvature}
        for k, curvature in enumerate(mean)
        if curvature > 1 / STRAIGHT
    ]


def _curvature(value: Any, place: str) -> float:
    """Return 1/R with its sign; 0, null and 'infinity' are straight."""
    if value is None or (isinstance(value, str) and "inf" in value.lower()) or value in (float("inf"), float("-inf")):
        return 0.0
    radius = finite_number(value, place)
    return 1 / radius if radius else 0.0
