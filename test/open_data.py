"""Trains and lines of railtoolkit and TTOBench in the formats of these projects; data/README.md names the sources."""

import csv
import json
from pathlib import Path
from typing import Any

import yaml

DATA = Path(__file__).parent / "data"
Rows = list[list[float]]


def rows_of(name: str, *columns: str) -> list[list[str]]:
    """Return columns of a table, without the rows in which one of them is empty."""
    with (DATA / name).open(encoding="utf-8", newline="") as file:
        rows = [[row[column] for column in columns] for row in csv.DictReader(file)]
    return [row for row in rows if all(row)]


def effort(column: str) -> Rows:
    """Return the tractive effort of a vehicle in km/h and N."""
    return [[float(speed), 1e3 * float(force)] for speed, force in rows_of("tractive_effort.csv", "speed_kmh", column)]


def vehicle(id: str, kind: str, length: float, mass: float, speed: float, base: float, air: float, **more: Any) -> Any:
    """Return a vehicle: m, t, km/h, per mille."""
    values = {"length": length, "mass": mass, "speed_limit": speed, "base_resistance": base, "air_resistance": air}
    return {"name": id, "id": id, "vehicle_type": kind, **values, **more}


def train(name: str, formation: list[str], *vehicles: Any) -> dict[str, Any]:
    schema = "https://railtoolkit.org/schema/rolling-stock.json"
    trains = [{"name": name, "id": name, "formation": formation}]
    return {"schema": schema, "schema_version": "2022.05", "trains": trains, "vehicles": list(vehicles)}


def trains() -> dict[str, dict[str, Any]]:
    """Return V 90 with ten ore wagons, a Desiro Classic, and an Intercity 2 of 5542 kW (300 kN up to 66.5 km/h)."""
    coach = {"load_limit": 20, "rotation_mass": 1.06, "rolling_resistance": 0.715}
    traxx: Rows = [[v, min(300e3, 19.95e6 / max(v, 1))] for v in range(161)]
    return {
        "freight": train(
            "freight", ["v90", *["facs"] * 10],
            vehicle("facs", "freight", 19.04, 25, 100, 1.4, 3.9, load_limit=59, rotation_mass=1.03),
            vehicle("v90", "traction unit", 14.32, 80, 80, 2.2, 10, mass_traction=80, rotation_mass=1.09,
                    tractive_effort=effort("v90_kn")),
        ),
        "local": train(
            "local", ["desiro"],
            vehicle("desiro", "multiple unit", 41.7, 68, 120, 3.0, 3.9, load_limit=20, mass_traction=45.333,
                    rotation_mass=1.08, rolling_resistance=1.4, a_braking=-0.4253, tractive_effort=effort("desiro_kn")),
        ),
        "longdistance": train(
            "longdistance", ["traxx", *["coach"] * 4, "cab"],
            vehicle("cab", "passenger", 27.27, 58, 160, 2.0, 3.64, **coach),
            vehicle("coach", "passenger", 26.8, 50, 160, 2.0, 3.64, **coach),
            vehicle("traxx", "traction unit", 18.9, 85, 160, 2.5, 6.0, mass_traction=85, rotation_mass=1.09,
                    tractive_effort=traxx),
        ),
    }  # fmt: skip


def bench(name: str, end: float, limits: Rows, grades: Rows) -> dict[str, Any]:
    """Return a line of TTOBench: speed limits in km/h, gradients in per mille."""
    return {
        "metadata": {"id": name},
        "stops": {"unit": "m", "values": [0.0, end]},
        "speed limits": {"units": {"position": "m", "velocity": "km/h"}, "values": limits},
        "gradients": {"units": {"position": "m", "slope": "permil"}, "values": grades},
    }


def lines() -> dict[str, dict[str, Any]]:
    """Return two short benchmark lines of 48.5 km, and St. Gallen - Wil."""
    table = rows_of("stgallen_wil.csv", "what", "at_m", "value")
    limits, grades = ([[float(at), float(value)] for what, at, value in table if what == kind]
                      for kind in ("limit_kmh", "grade_permil"))  # fmt: skip
    slopes: Rows = [[0, 0], [22_000, -6.67], [25_000, 6.67], [28_000, 0]]
    return {
        "slopes": bench("slopes", 48_531, [[0, 140]], slopes),
        "limit": bench("limit", 48_531, [[0, 140], [25_000, 100], [35_000, 140]], [[0, 0]]),
        "stgallen_wil": bench("stgallen_wil", 29_556.1, limits, grades),
    }


def write(folder: Path) -> None:
    """Write all trains, a level path of 10 km and all lines."""
    sections = {"name": "level", "id": "level", "characteristic_sections": [[0, 160, 0], [10_000, 160, 0]]}
    path = {"schema": "https://railtoolkit.org/schema/running-path.json", "paths": [sections]}
    for name, data in {**trains(), "level": path}.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    for name, data in lines().items():
        (folder / f"{name}.json").write_text(json.dumps(data), encoding="utf-8")
