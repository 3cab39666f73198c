"""Jerk limit of the planner: the reserve of forces belongs to its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from plan_cases import broken_promises, random_case

from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.profile.planner.line_tables import PlaceGrid
from train_ato.profile.planner.planner import plan_profile
from train_ato.profile.planner.section import ForceReserve
from train_ato.profile.planner.settings import PlanSettings, find_train

GRID_SHARE = 5e-4
"""Permitted increase of a running time by a higher jerk: the grid of the places changes times by this share."""


def car(top_kmh: float, force_kn: float = 47.8) -> Consist:
    """Return a car of 43.5 t with one constant traction force up to its top speed."""
    vehicle = {
        "mass_t": 43.5, "length": 18.4, "resistance": {"n_per_kn_kmh": [2.4, 0.0225, 0.00072]},
        "traction": [{"to_kmh": top_kmh, "force_kn": force_kn}], "brake": [{"to_kmh": 2 * top_kmh, "force_kn": 55}],
    }  # fmt: skip
    data = {"schema": "train_ato/consist/1", "name": "car", "vehicle_types": {"car": vehicle}}
    return Consist.model_validate(data | {"train": [{"type": "car"}]})


def climb(at_km: float, permille: float, length_km: float = 12.0, end_km: float = 12.0) -> Line:
    """Return a level line with one climb."""
    grades = [{"at": 0, "grade": 0}, {"at_km": at_km, "grade_permille": permille}]
    if length_km + at_km < end_km:
        grades.append({"at_km": at_km + length_km, "grade": 0})
    return Line.model_validate({"schema": "train_ato/line/1", "name": "climb", "end_km": end_km, "grades": grades})


@pytest.mark.parametrize("top_kmh", [42, 43, 44, 45, 52, 53, 54, 61, 62, 72])
def test_a_climb_at_the_end_of_the_traction_envelope(top_kmh: float) -> None:
    """Breaks if a speed beyond the envelope by rounding has no traction: refused, "short by 1133522425 %"."""
    fastest = plan_profile(climb(3, 20), car(top_kmh), PlanSettings(jerk=None)).running_time
    limited = plan_profile(climb(3, 20), car(top_kmh)).running_time
    assert limited <= 1.03 * fastest


def test_random_climbs_at_random_top_speeds() -> None:
    """Breaks for the same cause beside the cases of the table, and if a reserve there slows the whole run."""
    rng = np.random.default_rng(12)
    for _ in range(25):
        consist, asked = car(float(rng.uniform(40, 120))), PlanSettings(jerk=float(rng.uniform(0.5, 2)))
        line = climb(float(rng.uniform(1, 8)), float(rng.uniform(-20, 25)))
        fastest = plan_profile(line, consist, asked.model_copy(update={"jerk": None})).running_time
        limited = plan_profile(line, consist, asked)
        assert limited.running_time <= 1.03 * fastest
        assert broken_promises(line, consist, asked, limited, 0.1) == []


def test_traction_above_its_envelope_on_a_descent_before_a_climb() -> None:
    """Breaks if a step of the pass crosses the balancing speed: a train faster than its traction then climbs."""
    grades = [{"at": 0, "grade": 0}, {"at_km": 2, "grade_permille": -25}, {"at_km": 4, "grade_permille": 20}]
    line = Line.model_validate({"schema": "train_ato/line/1", "name": "dip", "end_km": 10, "grades": grades})
    asked = PlanSettings(speed_max=25)
    result = plan_profile(line, car(62), asked)
    assert broken_promises(line, car(62), asked, result, 0.1) == []
    fastest = plan_profile(line, car(62), asked.model_copy(update={"jerk": None})).running_time
    assert result.running_time <= 1.03 * fastest


@pytest.mark.parametrize("jerk", [0.1, 0.2, 0.5, 1.0, 2.0])
def test_a_reserve_at_the_start_does_not_slow_the_climb(open_data: Path, jerk: float) -> None:
    """A freight train near its limit on 18.6 per mille: 1 % of reserve everywhere takes 13 % more time (4768 s)."""
    consist, settings = find_train(str(open_data / "freight.yaml"))
    line = climb(6, 18.6, 3, 20)
    fastest = plan_profile(line, consist, settings.model_copy(update={"jerk": None})).running_time
    assert plan_profile(line, consist, settings.model_copy(update={"jerk": jerk})).running_time <= 1.03 * fastest


def times_over_jerk(line: Line, consist: Consist, settings: PlanSettings) -> list[float]:
    """Return the running times of increasing jerk limits, the last without a limit [s]."""
    limits = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, None)
    return [plan_profile(line, consist, settings.model_copy(update={"jerk": jerk})).running_time for jerk in limits]


def test_more_jerk_is_not_slower_on_the_climb(open_data: Path) -> None:
    """Breaks with one reserve for the run: 4321 s at 0.2 m/s³, 4768 s at 2."""
    consist, settings = find_train(str(open_data / "freight.yaml"))
    assert np.diff(times_over_jerk(climb(6, 18.6, 3, 20), consist, settings)).max() <= GRID_SHARE * 4200


@pytest.mark.parametrize("seed", [8, 44, 77, 92, 108, 127])
def test_more_jerk_is_not_slower_on_random_lines(seed: int) -> None:
    """Breaks with one reserve for the run: 0.5 % slower on line 92."""
    line, consist, settings = random_case(seed)
    times = times_over_jerk(line, consist, settings)
    assert np.diff(times).max() <= GRID_SHARE * max(times)


def test_a_reserve_stays_within_its_reach() -> None:
    """Breaks if an excess at one place reserves force at another one."""
    reserve = ForceReserve(PlaceGrid(0.0, 1000.0))
    grid = PlaceGrid(0.0, 1000.0)
    reserve.raise_at(np.array([100.0, 500.0]), np.array([20.0, 5.0]), np.array([[0.1, 0.0], [0.0, 0.02]]))
    traction, brake = reserve.over(grid)
    middle = 0.5 * (grid.places[1:] + grid.places[:-1])
    assert traction[np.abs(middle - 100.0) < 20.0].min() >= 0.1 and brake[np.abs(middle - 500.0) < 5.0].min() >= 0.02
    assert traction[np.abs(middle - 100.0) > 22.0].max() == 0.0 and brake[np.abs(middle - 500.0) > 7.0].max() == 0.0
