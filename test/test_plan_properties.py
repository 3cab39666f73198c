"""Properties of every plan: a better train is never slower, on any line and with any jerk limit."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from plan_cases import random_case

from plant_sim.consist import Consist
from plant_sim.library import load_consist, load_line
from plant_sim.line import Line
from train_ato.profile.planner.planner import plan
from train_ato.profile.planner.settings import PlanSettings

REFUSED = (5, 13, 24, 26, 27, 52)
"""Random cases without a plan: a steep line, or a brake that fades."""
STEPS = (0.6, 1.0, 1.5, 2.0, 4.0, 10.0, 1000.0)
"""Factors on the power; with the largest the force at the border of the segments is a thousandfold."""
ROUNDING = 1.001
"""Relative running time that counts as equal: the window of the jerk limit follows the largest acceleration."""


def scaled(
    consist: Consist, traction: float = 1.0, brake: float = 1.0, mass: float = 1.0, power: float = 1.0
) -> Consist:
    """Return a train with its forces, the power of its constant-power segments, or its masses multiplied."""
    data = consist.model_dump(by_alias=True)
    for vehicle in data["vehicle_types"].values():
        vehicle["mass"] *= mass
        for key, factor in (("traction", traction), ("brake", brake)):
            for segment in vehicle[key]:
                for part in ("force", "slope_kn_per_kmh", "power"):
                    segment[part] *= factor
        for segment in vehicle["traction"]:
            segment["power"] *= power
    return Consist.model_validate(data)


def metro(power: float, *between: dict[str, float]) -> Consist:
    """Return a metro of four motor and two trailer cars with a constant power [W] per motor car from 40 km/h on."""
    resistance = {"n_per_kn": [2.0, 0.02, 0.0005]}
    traction = [{"to_kmh": 40, "force_kn": 60}, *between, {"to_kmh": 90, "power": power}]
    motor = {
        "mass": 38000, "length": 20, "rotating_mass_factor": 1.1, "resistance": resistance, "traction": traction,
        "brake": [{"to_kmh": 90, "force_kn": 60}],
    }  # fmt: skip
    return train_of({"motor": motor, "trailer": {"mass": 32000, "length": 20, "resistance": resistance}}, 4, 2)


def train_of(types: dict[str, Any], *counts: int) -> Consist:
    """Return a train of vehicle types with rigid couplers."""
    parts = [{"type": name, "count": count} for name, count in zip(types, counts, strict=True)]
    data = {"schema": "train_ato/consist/1", "name": "own", "vehicle_types": types, "train": parts}
    return Consist.model_validate({**data, "draft_gears": {"rigid": {"kind": "rigid"}}, "default_gear": "rigid"})


def line_of(**keys: Any) -> Line:
    """Return a line of 12 km with a limit of 80 km/h and two stops, changed by keys."""
    data: dict[str, Any] = {
        "schema": "train_ato/line/1",
        "name": "own",
        "end_km": 12,
        "stops": [{"at": 200}, {"at": 8000}],
    }
    return Line.model_validate({**data, "speed_limits": [{"at": 0, "speed_kmh": 80}], **keys})


def never_slower(line: Line, trains: list[Consist], settings: PlanSettings) -> list[float]:
    """Return the running times of better and better trains [s], or fail."""
    times = [plan(line, consist, settings).running_time for consist in trains]
    assert all(late <= early * ROUNDING for early, late in pairwise(times)), times
    return times


@pytest.mark.parametrize("jerk", [0.2, 0.5, 3.0])
def test_a_step_of_the_traction_envelope_makes_no_train_slower(jerk: float) -> None:
    """Breaks if the averaging takes away the force below a step: 1118 s for 665 s on a line of four sections."""
    line = line_of(grades=[{"at_km": 1, "grade_permille": 12}])
    settings = PlanSettings(jerk=jerk)
    times = never_slower(line, [metro(660e3 * factor) for factor in STEPS], settings)
    free = [plan(line, metro(660e3 * factor), PlanSettings(jerk=None)).running_time for factor in STEPS]
    late = np.array(times) / np.array(free) - 1.0
    assert late.max() < 0.03


def test_a_segment_of_one_kmh_with_twice_the_force_is_no_obstacle() -> None:
    """Breaks if a narrow step takes away the force around it."""
    narrow = metro(660e3, {"to_kmh": 41, "force_kn": 120})
    never_slower(line_of(), [metro(660e3), narrow], PlanSettings())


@pytest.mark.parametrize("factors", [(1, 1.2, 1.5, 2, 4, 8, 16)])
def test_more_force_without_service_limits_is_never_slower(factors: tuple[float, ...]) -> None:
    """Breaks if the window of the jerk limit grows with an acceleration that is of no use."""
    consist, line = load_consist("xuzhou_metro_3"), load_line("xuzhou_metro_test")
    settings = PlanSettings(acceleration=None, deceleration=None)
    never_slower(line, [scaled(consist, factor, factor) for factor in factors], settings)


@pytest.mark.parametrize(
    "seed", [0, 4, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(60) if seed not in REFUSED)]
)
def test_a_better_train_or_line_is_never_slower(seed: int) -> None:
    """Breaks if more traction, more brake, less mass, higher limits or more jerk lengthen a random run."""
    line, consist, settings = random_case(seed)
    first = plan(line, consist, settings).running_time
    faster = line.model_copy(
        update={"speed_limits": tuple(e.model_copy(update={"speed": 1.1 * e.speed}) for e in line.speed_limits)}
    )
    looser = settings.model_copy(update={"jerk": None if settings.jerk is None else 1.3 * settings.jerk})
    found = {
        "traction": plan(line, scaled(consist, traction=1.2), settings),
        "brake": plan(line, scaled(consist, brake=1.2), settings),
        "mass": plan(line, scaled(consist, mass=0.9), settings),
        "limits": plan(faster, consist, settings),
        "jerk": plan(line, consist, looser),
    }
    slower = {
        key: (result.running_time, first) for key, result in found.items() if result.running_time > first * ROUNDING
    }
    assert not slower
