"""Lower bound of the traction work: never above a feasible run, and close to the least one."""

from __future__ import annotations

import numpy as np
import pytest
from plan_cases import random_case
from test_plan_energy import SEARCHED, hills, metro

from plant_sim.library import load_consist, load_line
from plant_sim.line import Line
from train_ato.profile.planner import energy_bound, value_bound
from train_ato.profile.planner.dynamic_programming import Resolution
from train_ato.profile.planner.planner import Plan, net_energy_bound, plan_profile
from train_ato.profile.planner.settings import PlanSettings

BARE = PlanSettings(jerk=None, point_mass=True, force_margin=0.0)


def timetabled(line: Line, settings: PlanSettings, factor: float) -> Plan:
    """Return the plan of a running time relative to the minimum."""
    least = plan_profile(line, metro(), settings).running_time
    return plan_profile(line, metro(), settings.model_copy(update={"time": factor * least}))


@pytest.mark.parametrize(("factor", "kwh"), SEARCHED)
def test_the_bound_is_below_an_exhaustive_search_and_close(factor: float, kwh: float) -> None:
    """Breaks for a wrong sign of any term: the search over 900 energies x 400 places has a run with this energy."""
    bound = net_energy_bound(timetabled(hills(60), BARE, factor)) / 3.6e6
    assert bound <= kwh
    assert bound >= 0.9 * kwh  # a bound without use: 0 is always valid


def test_the_bound_of_a_level_line_without_slack_in_it() -> None:
    """Breaks if a part of the bracket is missing: a level run needs at least the resistance at its mean speed."""
    line = Line.model_validate({"schema": "train_ato/line/1", "name": "level", "end": 6000})
    result = timetabled(line, BARE, 1.3)
    bound = net_energy_bound(result)
    resistance = result.train.resistance_at(np.array([6000 / result.running_time]))
    assert float(resistance[0]) * 6000 <= bound <= 3.6e6 * result.summary()["energy_kwh"]


def short_section(seed: int, factor: float) -> Plan:
    line, consist, settings = random_case(seed)
    settings = settings.model_copy(update={"jerk": None, "calling": False})
    time = factor * plan_profile(line, consist, settings).running_time
    return plan_profile(line, consist, settings.model_copy(update={"time": time}))


@pytest.mark.parametrize(("seed", "factor", "least"), [(2, 1.15, 0.95), (25, 1.05, 0.94)])
def test_the_bound_of_a_short_section_is_close(seed: int, factor: float, least: float) -> None:
    """Breaks if the value of a price of time loses a term: the linear program is 12 and 15 % below these plans."""
    result = short_section(seed, factor)
    assert least * result.energy <= net_energy_bound(result) <= result.energy


def on_falls_to_a_limit(factor: float) -> Plan:
    line, consist = load_line("xuzhou_metro_test"), load_consist("xuzhou_metro_3")
    fastest = plan_profile(line, consist, PlanSettings(jerk=None)).running_time
    return plan_profile(line, consist, PlanSettings(jerk=None, time=factor * fastest))


@pytest.mark.campaign
def test_the_bound_on_falls_to_a_limit_is_below_an_independent_optimum() -> None:
    """Breaks if every slab of a price of time has free changes of force: the bound is 8 % below the optimum.

    The optimum in kWh is that of ``studies_done/plan_optimum.py``.
    """
    assert 0.95 * 17.625 <= net_energy_bound(on_falls_to_a_limit(1.1)) / 3.6e6 <= 17.625


def test_the_linear_program_alone_is_below_an_independent_optimum(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if E may exceed the limit by the range of the line force; optimum of ``studies_done/plan_optimum.py``."""
    monkeypatch.setattr(value_bound, "value_lower_bound", lambda *_: 0.0)
    assert 0.97 * 11.291 <= net_energy_bound(on_falls_to_a_limit(1.3)) / 3.6e6 <= 11.291


def test_the_value_of_a_price_alone_is_a_bound_on_a_coarse_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if the value of a price of time loses a term: the linear program is 12 % below this plan."""
    monkeypatch.setattr(energy_bound, "energy_lower_bound", lambda *_: 0.0)
    monkeypatch.setattr(value_bound, "FIRST", Resolution(100, 150))
    monkeypatch.setattr(value_bound, "LAST", Resolution(200, 300))
    result = short_section(2, 1.15)
    assert 0.89 * result.energy <= net_energy_bound(result) <= result.energy


@pytest.mark.parametrize("seed", [1, 4, 23])
def test_no_random_plan_needs_less(seed: int) -> None:
    """Breaks for grades, lengths, margins or jerk that the bound counts as a cost but a run does not have."""
    line, consist, settings = random_case(seed)
    least = plan_profile(line, consist, settings.model_copy(update={"calling": False}))
    asked = least.settings.model_copy(update={"time": 1.15 * least.running_time})
    result = plan_profile(line, consist, asked)
    assert net_energy_bound(result) <= 3.6e6 * result.summary()["energy_kwh"] * (1 + 1e-6)
