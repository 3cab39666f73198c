"""Timetables: accuracy of the running time, and energy not above that of an independent search."""

from __future__ import annotations

import numpy as np
import pytest
from plan_cases import random_case

from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.profile.planner.passes import flatten_peaks
from train_ato.profile.planner.planner import Plan, plan_profile
from train_ato.profile.planner.settings import PlanSettings


def metro() -> Consist:
    """Return six cars, four of them driven, 280 t."""
    motor = {
        "mass_t": 50, "length": 20, "rotating_mass_factor": 1.12, "resistance": {"n_per_kn_kmh": [2.0, 0.01, 0.0004]},
        "traction": [{"to_kmh": 35, "force_kn": 65}, {"to_kmh": 100, "power_kw": 632}],
        "brake": [{"to_kmh": 100, "force_kn": 70}],
    }  # fmt: skip
    trailer = {
        "mass_t": 40, "length": 20, "rotating_mass_factor": 1.05, "resistance": {"n_per_kn_kmh": [2.0, 0.01, 0.0003]},
    }  # fmt: skip
    return Consist.model_validate(
        {
            "schema": "train_ato/consist/1",
            "name": "six_cars",
            "vehicle_types": {"motor": motor, "trailer": trailer},
            "train": [{"type": "trailer"}, {"type": "motor", "count": 4}, {"type": "trailer"}],
            "draft_gears": {"rigid": {"kind": "rigid"}},
            "default_gear": "rigid",
        }
    )


def hills(limit_kmh: float | None = None) -> Line:
    """Return 8 km with a climb, a descent on which a cruising train brakes, and a smaller descent before the stop."""
    grades = ((0, 0), (1000, 12), (2500, -15), (4200, 3), (6000, -8))
    limits = [(0, 80)] if limit_kmh is None else [(0, 80), (3000, limit_kmh), (3600, 80)]
    return Line.model_validate(
        {
            "schema": "train_ato/line/1",
            "name": "hills",
            "end": 8000,
            "grades": [{"at": at, "grade_permille": grade} for at, grade in grades],
            "speed_limits": [{"at": at, "speed_kmh": speed} for at, speed in limits],
        }
    )


def braked_kwh(plan: Plan, until: float) -> float:
    """Return the brake energy before a place of the front [kWh]."""
    power = np.maximum(-plan.force, 0.0) * plan.profile.velocity
    return float(power[plan.front < until].sum() * plan.profile.period / 3.6e6)


SEARCHED = [(1.03, 48.61), (1.10, 38.91), (1.25, 28.48)]
"""Running time relative to the minimum, and kWh of an independent search over 900 energies x 400 places (2 % too high
because of its grid), point mass, no jerk limit, no margin.  Cruise with coasting before stops needs 14-21 % more."""


@pytest.mark.parametrize(("factor", "kwh"), SEARCHED)
def test_no_more_energy_than_a_search_over_all_runs(factor: float, kwh: float) -> None:
    """Breaks without coasting before the descent: the speed gained there is then braked."""
    settings = PlanSettings(jerk=None, point_mass=True, force_margin=0.0)
    least = plan_profile(hills(60), metro(), settings).running_time
    kept = plan_profile(hills(60), metro(), settings.model_copy(update={"time": factor * least}))
    assert kept.running_time == pytest.approx(factor * least, abs=0.03)
    assert kept.summary()["energy_kwh"] < kwh


def test_coasting_starts_before_a_descent() -> None:
    """With jerk, lengths and margin: 55 km/h instead of 68 at the summit, nearly no braking on the descent."""
    least = plan_profile(hills(), metro()).running_time
    kept = plan_profile(hills(), metro(), PlanSettings(time=1.1 * least))
    at_top = kept.profile.velocity[np.searchsorted(kept.front, 2500.0)]
    assert 3.6 * at_top < 60.0
    assert braked_kwh(kept, 7000.0) < 0.35 * 6.5
    assert np.abs(kept.profile.jerk()).max() <= 0.5 * (1 + 1e-5)


@pytest.mark.parametrize("seed", [11, 14, 40, 55])
@pytest.mark.parametrize("factor", [1.0, 1.0003, 1.003, 1.04])
def test_a_timetable_near_the_least_time_is_kept(seed: int, factor: float) -> None:
    """Breaks if a larger averaging window of a strategy is not part of the running time: up to 9 s late, or refused."""
    line, consist, settings = random_case(seed)
    asked = factor * plan_profile(line, consist, settings).running_time
    kept = plan_profile(line, consist, settings.model_copy(update={"time": asked}))
    assert asked - 1.0 <= kept.running_time <= asked + 0.03


def energy_of(speeds: list[float]) -> np.ndarray:
    """Return v²/2 of speeds [m²/s²]."""
    return np.array(speeds) ** 2 / 2


def test_a_peak_beside_a_dip_is_flattened_to_the_dip() -> None:
    """Breaks if flattening continues through the dip: a step of 5 m/s² in the faster part before it."""
    places = np.arange(0.0, 61.0)
    speed = np.concatenate((np.linspace(20, 17, 31), np.linspace(17, 17.2, 11)[1:], np.linspace(17.2, 14, 21)[1:]))
    energy = energy_of(speed.tolist())
    before = energy.copy()
    flatten_peaks(energy, places, 1.6, 0.8)
    assert (energy <= before).all()
    assert np.abs(np.diff(energy)).max() <= np.abs(np.diff(before)).max() + 1e-9
    assert energy[40] == pytest.approx(before[30])


def test_a_peak_with_coasting_between_traction_and_braking_is_flattened() -> None:
    """Traction, short coasting and braking within one window: the speed is constant over the window."""
    places = np.arange(0.0, 41.0)
    energy = energy_of(np.concatenate((np.linspace(8, 10, 21), [9.99, 9.98], np.linspace(9.8, 6, 18))).tolist())
    assert flatten_peaks(energy, places, 1.0, 0.5) == 1
    top = np.flatnonzero(energy > energy.max() - 1e-9)
    assert places[top[-1]] - places[top[0]] >= 1.0 * np.sqrt(2 * energy.max()) - 1.0
