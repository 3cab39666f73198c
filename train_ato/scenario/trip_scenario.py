"""Scenario of a trip plan: profile file, planned applications, policy `trip`, gains of the final stop.

The law `pid` has a position error of d/ki under a constant error d of the modelled acceleration. 15 % of
the running resistance of loaded wagons at low speed are 0.0014 m/s²: with the default ki = 0.001 1/s² the train stops
1.4 m off. Before the stop the gains are therefore higher. Over the whole trip they would convert the motion of the
couplers to traction and braking.
"""

import math
from pathlib import Path
from typing import Any

import yaml

from plant_sim.consist import Consist
from plant_sim.data_text import TextDumper
from plant_sim.library import consist_names, line_names
from plant_sim.line import Line
from train_ato.profile.file import write_profile
from train_ato.profile.trip.plan import TripPlan
from train_ato.program.errors import refused_unwritten
from train_ato.scenario.profile_spec import SOURCES
from train_ato.scenario.scenario import raw_scenario
from train_ato.scenario.scenario_files import SCHEMA

REST = 45.0
"""Simulated time after the planned stop [s]."""
FINAL_GAINS = 250.0
"""Time before the planned stop from which the gains are those of :func:`final_gains` [s]."""
WAVE_IMPEDANCE = 0.85e6
"""Largest gain of a power unit on its speed error [N s/m]: wave impedance of the couplers of wagons, with a reserve."""
MAX_KP = 0.08
"""Largest gain on the speed error per mass [1/s]."""


class _Row(dict[str, Any]):
    """Entry of a table by place, written in one line."""


class _RowDumper(TextDumper):
    """Writer of scenarios with such rows."""


_RowDumper.add_representer(
    _Row, lambda dumper, row: dumper.represent_mapping("tag:yaml.org,2002:map", row, flow_style=True)
)


def final_gains(inertia: float, units: int) -> dict[str, float]:
    """Return the gains kp [1/s] and ki [1/s²] of `pid` for the final stop; the damping ratio is 0.5.

    Parameters
    ----------
    inertia
        Mass of the train with rotating parts [kg].
    units
        Number of power units.
    """
    kp = round(min(MAX_KP, WAVE_IMPEDANCE * units / inertia), 4)
    return {"kp": kp, "ki": round(kp**2, 6)}


def trip_scenario(plan: TripPlan, name: str, profile: str, base: str | None, plant: dict[str, Any]) -> dict[str, Any]:
    """Return the scenario of a plan as plain data.

    Parameters
    ----------
    plan
        The plan.
    name
        Name of the scenario.
    profile
        Profile file, relative to the scenario.
    base
        Scenario with plant, delays and criteria; None: the plant of ``plant`` without lag and delay.
    plant
        Consist and line.
    """
    applications = [entry.model_dump(mode="json") for entry in plan.applications]
    brake: dict[str, Any] = {"policy": "trip" if applications else "none", "events": [], "applications": applications}
    figures, gains = plan.summary(), final_gains(plan.model.inertia, plan.model.n_units)
    data: dict[str, Any] = {
        "schema": SCHEMA,
        "name": name,
        "summary": f"trip plan: {figures['running_time_s']:.0f} s, {figures['energy_kwh']:.0f} kWh, "
        f"{len(applications)} applications of the air brake",
        "duration": float(math.ceil(plan.profile.end + REST)),
        "profile": {"file": profile, "append": []},
        "brake": brake,
        "compensation": "preview",
        "law_changes": [{"at": round(max(plan.profile.end - FINAL_GAINS, 0.0), 1), "laws": {"pid": gains}}],
    }
    if plan.shares:
        data["force_shares"] = [_Row(entry.model_dump(mode="json")) for entry in plan.shares]
    if plan.displacements:
        data["unit_displacements"] = [_Row(entry.model_dump(mode="json")) for entry in plan.displacements]
    if base is not None:
        former = raw_scenario(base)[1]
        replaced = (*SOURCES, "start", "since", "until")  # also as start_km or since_min
        removed = {key: None for key in former.get("profile") or {} if key.partition("_")[0] in replaced}
        data["profile"] = {**removed, **data["profile"]}
        different = {key: value for key, value in plant.items() if former.get("plant", {}).get(key) != value}
        return {"base": base, **data, **({"plant": different} if different else {})}
    return {**data, "plant": plant, "law": "pid", "evaluation": {}}


def write_trip(plan: TripPlan, path: Path, base: str | None, plant: dict[str, Any], source: str) -> tuple[Path, Path]:
    """Write the scenario of a plan, and its profile beside it with the ending ``.csv``; return both paths."""
    profile = path.with_suffix(".csv")
    write_profile(plan.profile, profile, source)
    data = trip_scenario(plan, path.stem, profile.name, base, plant)
    text = f"# {source}\n" + yaml.dump(data, Dumper=_RowDumper, sort_keys=False, allow_unicode=True, width=120)
    with refused_unwritten(path):
        path.write_text(text, encoding="utf-8", errors="backslashreplace")
    return path, profile


def plant_data(consist_name: str, consist: Consist, line_name: str, line: Line) -> dict[str, Any]:
    """Return consist and line of a scenario: shipped names, or the data themselves."""
    found: dict[str, Any] = {"consist": consist_name, "line": line_name}
    if consist_name not in consist_names():
        found["consist"] = consist.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    if line_name not in line_names():
        found["line"] = line.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    return found
