"""Lines and trains written in the own format, lines as TTOBench JSON, and what a format does not carry."""

import json
import re
from collections.abc import Collection
from itertools import pairwise
from typing import Any

import yaml

from plant_sim.chainage import with_posts
from plant_sim.consist import Consist
from plant_sim.data_text import TextDumper
from plant_sim.line import Line, LineSection, NeutralSection

NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Sign that a text in XML must not have."""


def lost_keys(line: Line, carried: Collection[str]) -> list[str]:
    """Return the keys of a line that a format does not carry.

    Parameters
    ----------
    carried
        Carried keys, also ``stops[].name``. Without ``begin``, places are written from the begin of the line on.
    """
    own = {"schema_", "name", "source", "begin", "end"}
    found = [key for key in Line.model_fields if key not in own and key not in carried and getattr(line, key)]
    details = {
        "stops[].name": any(stop.name for stop in line.stops),
        "stops[].dwell": any(stop.dwell for stop in line.stops),
        "curves[].resistance_n_per_kn": any(curve.resistance_n_per_kn is not None for curve in line.curves),
        "curves[].side (none: right)": any(curve.side is None for curve in line.curves),
        "tunnels[].resistance_n_per_kn": any(tunnel.resistance_n_per_kn for tunnel in line.tunnels),
        "temporary_restrictions[].reason": any(entry.reason for entry in line.temporary_restrictions),
        **{
            f"neutral_sections[].{key}": any(getattr(entry, key) for entry in line.neutral_sections)
            for key in NeutralSection.model_fields
            if key not in LineSection.model_fields
        },
    }
    found += [key for key, lost in details.items() if lost and key.partition("[")[0] in carried and key not in carried]
    return found + ([] if "begin" in carried or not line.begin else [f"begin = {line.begin:g} m (now 0)"])


def refuse_overlap(line: Line, form: str) -> None:
    """Refuse overlapping curves, of which most formats have one at a place."""
    for one, other in pairwise(sorted(line.curves, key=lambda curve: curve.begin)):
        if other.begin < one.end:
            raise ValueError(
                f"line '{line.name}': curves: two overlap at {other.begin:g} m, and {form} has one at a place; write "
                "train_ato YAML, or give one curve with the radius of both"
            )


LAYOUT = "TTOBench v1.5"
IN_TTOBENCH = ("grades", "curves", "tunnels", "speed_limits", "stops")


def own_yaml(model: Line | Consist) -> str:
    """Return the own YAML of a line or a train; the model read from it has the same values."""
    data = model.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    if isinstance(model, Line) and model.chainage:
        data = with_posts(data, model.chainage, model.begin)
    return yaml.dump(
        {"schema": model.schema_, **data}, Dumper=TextDumper, sort_keys=False, allow_unicode=True, width=120
    )


def ttobench_json(line: Line) -> tuple[str, tuple[str, ...]]:
    """Return a line as TTOBench JSON from its begin on, and the keys of the line that it does not carry."""
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
        data["curvatures"] = {"units": {"position": "m", **radius}, "values": _curvatures(line, "TTOBench")}
    sections = [entry for entry in line.tunnels if entry.cross_section is not None]
    if sections:
        rows = [[entry.begin - line.begin, entry.end - entry.begin, entry.cross_section] for entry in sections]
        data["tunnels"] = {"units": {"position": "m", "length": "m", "cross section": "m^2"}, "values": rows}
    added = [f"added stop at {place - line.begin:g} m" for place in places if place not in stops]
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n", (*lost_keys(line, IN_TTOBENCH), *added)


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


def _curvatures(line: Line, form: str) -> list[list[Any]]:
    """Return position and radius of every piece, > 0 to the right; straight track between the curves."""
    refuse_overlap(line, form)
    rows: list[list[Any]] = []
    at = line.begin
    for curve in sorted(line.curves, key=lambda curve: curve.begin):
        if curve.begin > at:
            rows.append([at - line.begin, "infinity", "infinity"])
        radius = -curve.radius if curve.side == "left" else curve.radius
        rows.append([curve.begin - line.begin, radius, radius])
        at = curve.end
    if at < line.end:
        rows.append([at - line.begin, "infinity", "infinity"])
    return rows
