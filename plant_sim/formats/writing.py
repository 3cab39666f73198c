"""Lines and trains as text of the own format, and lines as TTOBench JSON."""

from __future__ import annotations

import json
from typing import Any

import yaml

from plant_sim.consist import Consist
from plant_sim.data_text import TextDumper
from plant_sim.line import Line

NOT_IN_TTOBENCH = (
    "temporary_restrictions", "neutral_sections", "power_limits", "adhesion", "coordinates", "summary", "source",
)  # fmt: skip
"""Keys of an own line that TTOBench does not have."""
LAYOUT = "TTOBench v1.5"


def own_yaml(model: Line | Consist) -> str:
    """Return the own YAML of a line or a train; the model read from it has the same values."""
    data = model.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    return yaml.dump(
        {"schema": model.schema_, **data}, Dumper=TextDumper, sort_keys=False, allow_unicode=True, width=120
    )


def ttobench_json(line: Line) -> tuple[str, tuple[str, ...]]:
    """Return a line as TTOBench JSON from its begin on, and the keys of the line that it does not carry.

    Raises
    ------
    ValueError
        If the line has no speed limit at its begin, which this format needs.
    """
    limits = line.speed_limits
    if not limits or limits[0].at > line.begin:
        raise ValueError(
            f"line '{line.name}': speed_limits: none at its begin, which TTOBench needs; begin them at {line.begin:g} m"
        )
    stops = [stop.at for stop in line.stops if line.begin <= stop.at <= line.end]
    places = sorted({line.begin, *stops, line.end})
    data: dict[str, Any] = {
        "metadata": {"id": line.name, "library version": LAYOUT, "description": line.source},
        "stops": {"unit": "m", "values": [place - line.begin for place in places]},
        "speed limits": _steps(line, [(limit.at, limit.speed) for limit in limits], "velocity", "m/s"),
        "gradients": _steps(line, [(entry.at, 1e3 * entry.grade) for entry in line.grades], "slope", "permil"),
    }
    if not line.grades:
        del data["gradients"]
    if line.curves:
        radius = {"radius at start": "m", "radius at end": "m"}
        data["curvatures"] = {"units": {"position": "m", **radius}, "values": _curvatures(line)}
    sections = [entry for entry in line.tunnels if entry.cross_section is not None]
    if sections:
        rows = [[entry.begin - line.begin, entry.end - entry.begin, entry.cross_section] for entry in sections]
        data["tunnels"] = {"units": {"position": "m", "length": "m", "cross section": "m^2"}, "values": rows}
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n", _left_out(line, set(places) - set(stops))


def _steps(line: Line, entries: list[tuple[float, float]], quantity: str, unit: str) -> dict[str, Any]:
    """Return steps from the begin of the line on; the piece under the begin starts there."""
    rows: list[list[float]] = []
    if entries and entries[0][0] > line.begin:
        rows.append([0.0, 0.0])
    for at, value in entries:
        row = [max(at, line.begin) - line.begin, value]
        if at >= line.end:
            break
        if rows and rows[-1][0] == row[0]:
            rows[-1] = row
        else:
            rows.append(row)
    return {"units": {"position": "m", quantity: unit}, "values": rows}


def _curvatures(line: Line) -> list[list[Any]]:
    """Return position and radius of every piece, > 0 to the right; straight track between the curves."""
    rows: list[list[Any]] = []
    at = line.begin
    for curve in sorted(line.curves, key=lambda curve: curve.begin):
        if curve.begin < at:
            raise ValueError(f"line '{line.name}': curves: two overlap at {curve.begin:g} m; correct them")
        if curve.begin > at:
            rows.append([at - line.begin, "infinity", "infinity"])
        radius = -curve.radius if curve.side == "left" else curve.radius
        rows.append([curve.begin - line.begin, radius, radius])
        at = curve.end
    if at < line.end:
        rows.append([at - line.begin, "infinity", "infinity"])
    return rows


def _left_out(line: Line, added: set[float]) -> tuple[str, ...]:
    """Return the keys of a line that TTOBench does not carry."""
    found = [key for key in NOT_IN_TTOBENCH if key != "source" and getattr(line, key)]
    found += ["stops[].name"] if any(stop.name for stop in line.stops) else []
    found += ["stops[].dwell"] if any(stop.dwell for stop in line.stops) else []
    found += ["tunnels[].resistance_n_per_kn"] if any(entry.resistance_n_per_kn for entry in line.tunnels) else []
    found += ["curves[].side (none: right)"] if any(curve.side is None for curve in line.curves) else []
    found += [f"begin = {line.begin:g} m (now 0)"] if line.begin else []
    return (*found, *(f"added stop at {place - line.begin:g} m" for place in sorted(added)))
