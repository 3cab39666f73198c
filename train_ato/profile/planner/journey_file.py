"""Journey files: own YAML, and the journeys of TTOBench 1.5 (JSON, BSD-2).

A TTOBench journey is a list of timing points with place, lower and upper time, lower and upper speed; null is no
constraint.  First and last point are the departure and the arrival, a point with both speeds 0 is a stop.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from plant_sim.formats.fields import Fields, finite_number, read_data
from plant_sim.input_error import build_model
from plant_sim.line import Line
from train_ato.profile.planner.timing_points import JourneyFile

LENGTHS, TIMES, SPEEDS = {"m": 1.0, "km": 1e3}, {"s": 1.0}, {"km/h": 1 / 3.6, "m/s": 1.0}
COLUMNS = (
    ("position", LENGTHS),
    ("lower time constraint", TIMES),
    ("upper time constraint", TIMES),
    ("lower speed constraint", SPEEDS),
    ("upper speed constraint", SPEEDS),
)


def read_journey(name: str, line: Line) -> JourneyFile:
    """Return the journey in a file; every place must be on the line.

    Raises
    ------
    ValueError
        One line that names the file, the key, the value and the remedy.
    """
    if not Path(name).is_file():
        raise ValueError(f"{name}: no such file; give a journey (train_ato YAML, TTOBench 1.5 JSON)")
    data = read_data(Path(name))
    if "timing points" in data:
        journey = _ttobench_journey(data, name, line)
    elif str(data.get("schema", "")).startswith("train_ato/journey/"):
        journey = build_model(JourneyFile, data, name)
    else:
        raise ValueError(
            f"{name}: schema = '{str(data.get('schema', ''))[:60]}': no supported journey format (train_ato YAML, "
            "TTOBench 1.5 JSON); begin a train_ato file with 'schema: train_ato/journey/1'"
        )
    for point in journey.points:
        if not line.begin - 1e-6 <= point.at <= line.end + 1e-6:
            raise ValueError(
                f"{name}: timing point {point.label} lies beyond line '{line.name}' (km {line.begin / 1000:.3f} ... "
                f"{line.end / 1000:.3f}); give the line of the journey or move the point"
            )
    return journey


def _ttobench_journey(data: dict[str, Any], name: str, line: Line) -> JourneyFile:
    top = Fields(data, name)
    metadata = top.below("metadata") if "metadata" in top else Fields({}, f"{name}: metadata")
    track = metadata.text("associated track", line.name)
    if line.source.startswith("TTOBench") and track != line.name:
        raise ValueError(f"{name}: metadata: associated track = '{track}': the line is '{line.name}'; give that track")
    fields = top.below("timing points")
    units = fields.below("units")
    factors = [_unit(units, column, known) for column, known in COLUMNS]
    rows = fields.rows("values", len(COLUMNS), 2)
    points = []
    for k, row in enumerate(rows):
        place = f"{fields.place}: values[{k}]"
        at = finite_number(row[0], f"{place}[0]", -1e8, 1e8) * factors[0]
        values = [
            None if value is None else finite_number(value, f"{place}[{i + 1}]", 0.0, 1e8) * factor
            for i, (value, factor) in enumerate(zip(row[1:], factors[1:], strict=True))
        ]
        points.append(_point(at, values, k == 0, k == len(rows) - 1))
    source = f"TTOBench journey {metadata.text('id', Path(name).stem)}, BSD-2-Clause"
    plain = {"schema": "train_ato/journey/1", "name": Path(name).stem[:100], "source": source[:500], "points": points}
    return build_model(JourneyFile, plain, name)


def _unit(units: Fields, column: str, known: dict[str, float]) -> float:
    unit = units.text(column)
    if unit not in known:
        raise ValueError(f"{units.place}: {column} = '{unit}': must be one of {', '.join(known)}")
    return known[unit]


def _point(at: float, values: list[float | None], first: bool, last: bool) -> dict[str, Any]:
    """Return the keys of a timing point from earliest, latest, least and largest speed."""
    earliest, latest, least, most = values
    window = {"earliest": earliest, "latest": latest}
    if first or last:
        return {"at": at, "stop": True, "departure" if first else "arrival": window}
    if most == 0.0:
        return {"at": at, "stop": True, "arrival": window}
    point: dict[str, Any] = {"at": at}
    if earliest is not None or latest is not None:
        point["passing"] = window
    if least or most is not None:
        point["speed"] = {"least": least, "most": most}
    return point
