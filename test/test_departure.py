"""Whole runs with a departure on a grade: release of the holding brake."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from train_ato.loop.engine import run_engine
from train_ato.loop.setup import prepare
from train_ato.scenario.scenario import check_scenario

HERE = Path("departure.yaml")
LIGHT = {"mass_t": 60, "length": 15, "resistance": {"n_per_kn_kmh": [1.0, 0.005, 0.0001]}}
DRIVEN = {
    **LIGHT,
    "traction": [{"to_kmh": 60, "force_kn": 120}],
    "brake": [{"to_kmh": 60, "force_kn": 120}],
}


def scenario(grade_permille: float, **changes: Any) -> dict[str, Any]:
    """Return a run of 20 m on a grade: a locomotive and three wagons, 240 t, start after 5 s, 0.02 m/s²."""
    plant = {
        "consist": {
            "schema": "train_ato/consist/1",
            "name": "short",
            "vehicle_types": {"engine": DRIVEN, "wagon": LIGHT},
            "train": [{"type": "engine"}, {"type": "wagon", "count": 3}],
            "draft_gears": {"spring": {"kind": "linear", "stiffness_mn_per_m": 10, "damping_kns_per_m": 100}},
            "default_gear": "spring",
        },
        "line": {
            "schema": "train_ato/line/1",
            "name": "slope",
            "begin": -500,
            "end": 1000,
            "grades": [{"at": -500, "grade_permille": grade_permille}],
        },
        **changes.pop("plant", {}),
    }
    limits = {"acceleration": 0.02, "deceleration": 0.02, "jerk": 0.02}
    phases = [{"cruise_for": 5}, {"accelerate_to_kmh": 1.5}, {"cruise_for": 25}, {"brake_to": 0}]
    return {
        "schema": "train_ato/scenario/1",
        "name": "departure",
        "duration": 90,
        "step": 0.002,
        "plant": plant,
        "links": {"command": {"delay": 0.4}},
        "profile": {"start": 0, "limits": limits, "phases": phases},
        "laws": {"pid": {"kp": 0.5, "ki": 0.05}},
        "compensation": "preview",
        **changes,
    }


def driven(data: dict[str, Any]) -> tuple[np.ndarray, dict[str, Any]]:
    """Return the speed of vehicle 0 at every tick [m/s] and the summary."""
    outcome = run_engine(prepare(check_scenario(data, HERE), HERE))
    assert outcome.recording is not None
    return outcome.recording.velocity[:, 0], outcome.summary


@pytest.mark.parametrize("grade", [-15.0, -8.0, -4.0, 0.0, 8.0])
def test_a_train_departs_on_any_grade(grade: float) -> None:
    """Breaks if the train stays held on -15 per mille, where the profile needs brake from the start."""
    speed, summary = driven(scenario(grade))
    assert (speed[:50] == 0.0).all()
    assert summary["speed_error_max_kmh"] < 0.4 and abs(summary["stop_error_m"]) < 0.3
    assert (speed[-30:] == 0.0).all(), "it must stand in the end, also on the fall"


def test_the_model_averages_grades_as_the_plant_does() -> None:
    """With `grade_over_length` the plant enters a grade gradually; another feed-forward would cause a jerk."""
    grades = [{"at": -500, "grade_permille": 0}, {"at": 12, "grade_permille": 30}]
    errors = []
    for over_length in (True, False):
        data = scenario(0.0, plant={"grade_over_length": over_length})
        whole = {**DRIVEN, "mass_t": 240, "length": 60}
        data["plant"]["consist"].update(vehicle_types={"engine": whole}, train=[{"type": "engine"}])
        data["plant"]["line"]["grades"] = grades
        setup = prepare(check_scenario(data, HERE), HERE)
        gravity = setup.consist.gravity * 240e3
        assert setup.model.line_force(12.0) == pytest.approx(gravity * (0.015 if over_length else 0.030), rel=0.04)
        errors.append(run_engine(setup).summary["speed_error_max_kmh"])
    assert errors[0] < 0.5 * errors[1]
