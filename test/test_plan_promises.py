"""Property tests of the planner over random lines and trains."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plan_cases import broken_promises, limit_by_hand, random_case, resistance_by_hand

from train_ato.profile.planner.plan_from_state import TrainState, replan
from train_ato.profile.planner.planner import Plan, plan_profile
from train_ato.profile.planner.train_tables import AvailableForce

PERIOD = 0.1
SEEDS = st.integers(0, 10**6)


def planned(seed: int) -> Plan | None:
    line, consist, asked = random_case(seed)
    try:
        return plan_profile(line, consist, asked, PERIOD)
    except ValueError as error:
        assert "\n" not in str(error) and " km " in str(error)
        return None


@given(SEEDS)
@settings(max_examples=25, deadline=None)
def test_a_plan_keeps_forces_limits_comfort_and_stops(seed: int) -> None:
    """Breaks within a few cases without the reserves for grades and for steps of the envelope."""
    line, consist, asked = random_case(seed)
    result = planned(seed)
    if result is not None:
        assert broken_promises(line, consist, asked, result, PERIOD) == []


def test_full_traction_on_a_climb_keeps_its_margin() -> None:
    """Breaks if only knots that accelerate are limited: 3e-5 of the largest traction too much, without a jerk limit."""
    line, consist, asked = random_case(1054)
    result = planned(1054)
    assert asked.jerk is None and result is not None
    assert broken_promises(line, consist, asked, result, PERIOD) == []


@given(SEEDS)
@settings(max_examples=8, deadline=None)
def test_force_and_limit_agree_with_a_sum_by_hand(seed: int) -> None:
    """Force and limit of the plan against a calculation from the data files, vehicle by vehicle."""
    line, consist, _ = random_case(seed)
    result = planned(seed)
    if result is None:
        return
    rng = np.random.default_rng(seed)
    inertia = sum(vehicle.mass * vehicle.rotating_mass_factor for vehicle in consist.vehicles)
    for knot in rng.integers(0, len(result.profile), 20):
        x, v, a = (float(c[knot]) for c in (result.front, result.profile.velocity, result.profile.acceleration))
        if v == 0:
            continue
        force = inertia * a + resistance_by_hand(line, consist, x, v)
        assert result.force[knot] == pytest.approx(force, abs=1e-6 * inertia)
        assert v <= limit_by_hand(line, x, consist.length, result.train.speed_max) + 1e-4


@given(SEEDS, st.floats(0, 1), st.floats(0, 1))
@settings(max_examples=15, deadline=None)
def test_a_replan_starts_here_needs_what_is_left_and_meets_the_stops(seed: int, when: float, left: float) -> None:
    line, consist, asked = random_case(seed)
    first = planned(seed)
    if first is None or asked.jerk is None:
        return
    old = first.profile
    knot = int(when * (len(old) - 2))
    speed = float(old.velocity[knot]) * (0.97 + 0.03 * left)
    behind = 2.0 * (1 - left) if speed > 1 else 0.0
    now = TrainState(float(old.time[knot]), float(old.position[knot]) - behind, speed, float(old.acceleration[knot]))
    force = AvailableForce(traction=0.8 + 0.2 * left, brake=0.85 + 0.15 * left)
    try:
        again = replan(now, old, line, consist, asked, available=force)
    except ValueError as error:
        assert "\n" not in str(error)
        return
    new = again.profile
    assert new.start == pytest.approx(now.time, abs=1e-9)
    if speed > 0:
        x, v, _, _ = new.at(now.time)
        assert (x, v) == (pytest.approx(now.position, abs=1e-6), pytest.approx(now.velocity, abs=1e-9))
    assert new.position[-1] == pytest.approx(old.position[-1], abs=1e-6) and new.velocity[-1] == 0
    assert len(old.followed_by(new)) >= len(new)
    rate = abs(now.acceleration) + (asked.acceleration or 0) + (asked.deceleration or 0)
    settled = (new.time > now.time + 2 * rate / asked.jerk) & (new.velocity > 0.05)
    traction, electric, air = again.train.forces_at(new.velocity)
    keep = 1 - again.settings.force_margin
    assert np.all((again.force - keep * traction)[settled] <= 1e-4 * traction.max())
    assert np.all((-again.force - keep * (electric + air))[settled] <= 1e-4 * (electric + air).max())


@given(SEEDS, st.floats(1.01, 1.4))
@settings(max_examples=15, deadline=None)
def test_a_timetable_is_kept_with_no_more_energy(seed: int, slack: float) -> None:
    """Breaks for a coasting rule that ignores the energy on lines with hills."""
    line, consist, asked = random_case(seed)
    fastest = planned(seed)
    if fastest is None or len(line.grades) > 8:
        return
    time = slack * fastest.running_time
    try:
        slower = plan_profile(line, consist, asked.model_copy(update={"time": time}), PERIOD)
    except ValueError as error:
        assert "too slack" in str(error)
        return
    assert slower.running_time == pytest.approx(time, abs=1.5)
    assert broken_promises(line, consist, asked, slower, PERIOD) == []
    assert slower.summary()["energy_kwh"] <= fastest.summary()["energy_kwh"] * 1.001 + 0.01
