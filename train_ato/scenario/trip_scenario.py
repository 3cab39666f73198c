"""Scenario of a trip plan: profile file, planned applications, policy `trip`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import yaml

from plant_sim.consist import Consist
from plant_sim.library import consist_names, line_names
from plant_sim.line import Line
from train_ato.profile.file import write_profile
from train_ato.profile.trip.planner import TripPlan
from train_ato.scenario.scenario import SCHEMA

REST = 45.0
"""Simulated time after the planned stop [s]."""


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
    figures = plan.summary()
    data: dict[str, Any] = {
        "schema": SCHEMA,
        "name": name,
        "summary": f"trip plan: {figures['running_time_s']:.0f} s, {figures['energy_kwh']:.0f} kWh, "
        f"{len(applications)} applications of the air brake",
        "duration": float(math.ceil(plan.profile.end + REST)),
        "profile": {"file": profile, "append": []},
        "brake": brake,
        "compensation": "preview",
    }
    if base is not None:
        return {"base": base, **data}
    return {**data, "plant": plant, "law": "pid", "evaluation": {}}


def write_trip(plan: TripPlan, path: Path, base: str | None, plant: dict[str, Any], source: str) -> tuple[Path, Path]:
    """Write the scenario of a plan, and its profile beside it with the ending ``.csv``; return both paths.

    Raises
    ------
    ValueError
        If a file cannot be written.
    """
    profile = path.with_suffix(".csv")
    write_profile(plan.profile, profile, source)
    data = trip_scenario(plan, path.stem, profile.name, base, plant)
    text = f"# {source}\n" + yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=120)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ValueError(f"{path}: cannot be written ({error.strerror}); choose another place") from None
    return path, profile


def plant_data(consist_name: str, consist: Consist, line_name: str, line: Line) -> dict[str, Any]:
    """Return consist and line of a scenario: shipped names, or the data themselves."""
    found: dict[str, Any] = {"consist": consist_name, "line": line_name}
    if consist_name not in consist_names():
        found["consist"] = consist.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    if line_name not in line_names():
        found["line"] = line.model_dump(mode="json", by_alias=True, exclude_defaults=True)
    return found
