"""Trains, lines and demands shared by the tests of the plant."""

from typing import Any

import numpy as np

from plant_sim.consist import Consist
from plant_sim.library import load_consist, load_line
from plant_sim.line import Line
from plant_sim.plant_setup import PlantSetup
from plant_sim.states import Array
from plant_sim.train import Train

STEP_NS = 5_000_000
TICK_NS = 100_000_000

LINEAR: dict[str, Any] = {"kind": "linear", "stiffness_mn_per_m": 20, "damping": 1e5}
RIGID: dict[str, Any] = {"kind": "rigid"}
CLIP = load_consist("hxd1_c80_105").draft_gears["mt2_mt2"].model_dump()
QKX = load_consist("hxd1_c80_105").draft_gears["qkx100_mt2"].model_dump()
SMOOTHED = {key: value for key, value in CLIP.items() if not key.startswith("transition")}
SMOOTHED.update(kind="smoothed", switching_speed=0.02)
TABLE = {
    "kind": "table", "deflection": [0.0, 0.004, 0.05, 0.166], "loading_kn": [0, 50, 300, 2270],
    "unloading_kn": [0, 10, 75, 570], "slack_mm": 10, "damping": 1e5,
}  # fmt: skip
SLACK = {**LINEAR, "slack_mm": 10}
GEARS: dict[str, dict[str, Any]] = {
    "linear": LINEAR, "slack": SLACK, "clip": CLIP, "printed clip": {**CLIP, "transition_damping": 0.0},
    "smoothed": SMOOTHED, "table": TABLE, "rigid": RIGID,
}  # fmt: skip


def line_of(end: float, **keys: Any) -> Line:
    """Return a line from 0 m on, with further keys."""
    return Line.model_validate({"schema": "train_ato/line/1", "name": "own", "end": end, **keys})


def train_of(types: dict[str, Any], *counts: int, **keys: Any) -> Consist:
    """Return a train of vehicle types in their order, with rigid couplers or with other keys."""
    parts = [{"type": name, "count": count} for name, count in zip(types, counts, strict=False) if count]
    data = {"schema": "train_ato/consist/1", "name": "own", "vehicle_types": types, "train": parts}
    gears = {"draft_gears": {"rigid": {"kind": "rigid"}}, "default_gear": "rigid"}
    return Consist.model_validate({**data, **gears, **keys})


def plain_line(**entries: Any) -> Line:
    """Return a level line of 200 km with additional entries."""
    return line_of(200e3, name="plain", **entries)


def slope(grade_permille: float) -> Line:
    """Return a line of one grade from before the start on."""
    return plain_line(begin_km=-10, grades=[{"at_km": -10, "grade_permille": grade_permille}])


def heavy(gear: dict[str, Any] | None = None, wagons: int = 105) -> Consist:
    """Return the HXD1 with a number of C80 wagons, by default with the draft gears of the file."""
    data = load_consist("hxd1_c80_105").model_dump(by_alias=True, exclude_none=True)
    data["train"] = [{"type": "hxd1"}, {"type": "c80", "count": wagons}] if wagons else [{"type": "hxd1"}]
    if gear is not None:
        data.update(draft_gears={"only": gear}, default_gear="only", couplings=[])
    elif not wagons:
        data.update(couplings=[])
    return Consist.model_validate(data)


def chain(count: int, gear: dict[str, Any], mass: float = 1e5, resistance: float = 0.0) -> Consist:
    """Return equal vehicles without power units."""
    car = {"mass": mass, "length": 12.0, "resistance": {"n": [resistance, 0.0, 0.0]}}
    return train_of({"car": car}, count, name="chain", draft_gears={"only": gear}, default_gear="only")


def train(
    consist: Consist, line: Line | None = None, step_ns: int = STEP_NS, tick_ns: int = TICK_NS, **setup: Any
) -> Train:
    """Return a train on a line (default: level) with a setup as in a scenario file."""
    where = load_line("level") if line is None else line
    return Train(consist, where, PlantSetup.model_validate(setup), step_ns=step_ns, tick_ns=tick_ns, seed=7)


def drive(plant: Train, seconds: float, force: float | Array = 0.0, pipe: float | None = None) -> Train:
    """Advance with a constant demand of every unit [N] and a brake-pipe demand from the first tick on."""
    demand = np.broadcast_to(np.asarray(force, dtype=np.float64), (plant.substeps, len(plant.units)))
    for _ in range(round(seconds * 1e9 / plant.tick_ns)):
        plant.advance(demand, pipe)
    return plant


def ramps(t: Array) -> Array:
    """Return a driver's demand [N] over time: traction to 400 kN, brake to -300 kN, release; 100 s."""
    braking = np.clip(400.0 - 16.0 * (t - 40.0), -300.0, 400.0)
    release = np.clip(-300.0 + 16.0 * (t - 85.0), -300.0, 0.0)
    return 1e3 * np.where(t < 40.0, np.clip(8.0 * t, 0.0, 400.0), np.where(t < 85.0, braking, release))


def run_ramps(plant: Train) -> Train:
    """Drive :func:`ramps` for 100 s, with air (if fitted) from 50 s to 70 s."""
    air = plant.consist.air_brake is not None
    pipe = {50.0: 550e3, 70.0: 600e3}
    for tick in range(round(100e9 / plant.tick_ns)):
        begin = tick * plant.tick_ns * 1e-9
        t = begin + np.arange(plant.substeps) * plant.step_ns * 1e-9
        demand = np.repeat(ramps(t)[:, None], len(plant.units), axis=1)
        plant.advance(demand, pipe.get(round(begin, 6)) if air else None)
    return plant
