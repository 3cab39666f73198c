"""Timetables: plans exist, need less energy with more time, and coast within the deceleration limit."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from case_costs import sampled
from plan_cases import random_case
from test_plan_command import options

import train_ato as ta
from plant_sim.consist import Consist
from plant_sim.line import Line
from train_ato.loop.setup import prepare
from train_ato.profile.file import read_profile, write_profile
from train_ato.profile.planner.allowance import parse_allowance
from train_ato.profile.planner.allowance_plan import supplements
from train_ato.profile.planner.plan_from_state import scheduled_points
from train_ato.profile.planner.planner import plan_profile
from train_ato.profile.planner.settings import PlanSettings
from train_ato.scenario.scenario import load_scenario

SLOW_GRADES = ((0, 20.0854), (140.006, -26.5103), (393.181, -19.196), (453.659, 18.6779), (581.36, 29.1787))
"""Place [m] and grade [per mille] of a short line with 15.87 km/h."""
ENERGY_STEP = 1e-4
"""Resolution of an energy in the summary [kWh]."""
SHORT_LINE = 800.0
"""Longest line of the many random ones [m]."""


def slow_line() -> Line:
    grades = [{"at": at, "grade_permille": grade} for at, grade in SLOW_GRADES]
    limits = [{"at": 0, "speed": 4.40799}]
    return Line.model_validate(
        {"schema": "train_ato/line/1", "name": "slow", "end": 628.874, "grades": grades, "speed_limits": limits}
    )


def slow_train() -> Consist:
    vehicle = {
        "mass": 328471, "length": 90.25, "rotating_mass_factor": 1.06074,
        "resistance": {"n_per_kn_kmh": [0.9708, 0.0216232, 0.00138097]},
        "traction": [{"to": 40.0812, "force": 122571}], "brake": [{"to": 44.0893, "force": 252851}],
    }  # fmt: skip
    data = {"schema": "train_ato/consist/1", "name": "slow", "vehicle_types": {"car": vehicle}}
    return Consist.model_validate(data | {"train": [{"type": "car"}]})


def energies(line: Line, consist: Consist, settings: PlanSettings, times: list[float]) -> list[float]:
    """Return the traction energy of increasing running times [kWh]; each time is kept."""
    found = []
    for time in times:
        result = plan_profile(line, consist, settings.model_copy(update={"time": time}))
        assert time - 1.5 <= result.running_time <= time + 0.03
        found.append(result.summary()["energy_kwh"])
    return found


def test_more_time_needs_less_energy_on_the_slow_line() -> None:
    """Breaks if a switching curve near 0 stops the train at its start: 204.3 s then needs more than 182.3 s."""
    found = energies(slow_line(), slow_train(), PlanSettings(), [170, 182.3, 204.3, 250])
    assert np.diff(found).max() <= ENERGY_STEP


@pytest.mark.parametrize("seed", [0, 3, 12])
def test_more_time_needs_less_energy_on_random_lines(seed: int) -> None:
    """Breaks if the strategies of one time are not among those of the next."""
    line, consist, settings = random_case(seed)
    least = plan_profile(line, consist, settings).running_time
    found = energies(line, consist, settings, [factor * least for factor in (1.02, 1.1, 1.25, 1.5)])
    assert np.diff(found).max() <= 1e-4 * found[0] + ENERGY_STEP


@pytest.mark.parametrize("factor", sampled([1.01, 1.05], every=2))
def test_a_longer_averaging_window_leaves_no_time_unused(factor: float) -> None:
    """Breaks if the time of a longer window is subtracted from the timetable twice: 9.3 and 4.1 s early."""
    line, consist, settings = random_case(89)
    asked = factor * plan_profile(line, consist, settings).running_time
    kept = plan_profile(line, consist, settings.model_copy(update={"time": asked}))
    assert asked - 0.2 <= kept.running_time <= asked + 0.03


@pytest.mark.campaign
def test_more_time_needs_less_energy_on_short_random_lines() -> None:
    """Breaks if a strategy without a solution, or the fastest plan, replaces the least energy of a time."""
    # Two neighbouring times on every line up to 800 m; ``studies_done/plan_refusals.py --times 230`` plans five on all.
    factors = (1.01, 1.05, 1.12, 1.25, 1.5)
    for seed in range(230):
        line, consist, settings = random_case(seed)
        if line.end > SHORT_LINE:
            continue
        try:
            least = plan_profile(line, consist, settings).running_time
        except ValueError:
            continue
        found = energies(line, consist, settings, [factor * least for factor in factors[seed % 4 :][:2]])
        assert np.diff(found).max() <= 1e-4 * found[0] + ENERGY_STEP, seed


@pytest.mark.parametrize("time", sampled([1000.0, 600.0, 900.0, 1500.0], every=4))
def test_a_fall_with_a_level_start_is_driven_in_any_time(time: float) -> None:
    """Breaks if the cut-off is 0 where the front of the train is already on the fall: 1000 s "cannot start"."""
    line = Line.model_validate(
        {"schema": "train_ato/line/1", "name": "fall", "end_km": 10, "grades": [{"at": 0, "grade_permille": -20}]}
    )
    vehicle = {
        "mass_t": 40, "length": 18, "resistance": {"n_per_kn_kmh": [1.3, 0.002, 0.00125]},
        "traction": [{"to_kmh": 117, "force_kn": 20}], "brake": [{"to_kmh": 129, "force_kn": 21}],
    }  # fmt: skip
    data = {"schema": "train_ato/consist/1", "name": "car117", "vehicle_types": {"car": vehicle}}
    consist = Consist.model_validate(data | {"train": [{"type": "car"}]})
    assert plan_profile(line, consist, PlanSettings(time=time)).running_time == pytest.approx(time, abs=0.1)


@pytest.mark.parametrize("seed", sampled([1, 3, 7, 21], every=4))
def test_coasting_uphill_keeps_the_deceleration_limit(seed: int) -> None:
    """Breaks for coasting without traction on a climb: 0.11 to 0.29 m/s² with a limit of 0.07."""
    line, consist, settings = random_case(seed)
    asked = settings.model_copy(update={"deceleration": 0.07})
    least = plan_profile(line, consist, asked).running_time
    result = plan_profile(line, consist, asked.model_copy(update={"time": 1.08 * least}))
    assert result.profile.acceleration.min() >= -0.07 * (1 + 1e-9)


def test_a_point_mass_has_no_length_to_average_over() -> None:
    """Breaks if both options are accepted: the grades of a point mass were averaged."""
    with pytest.raises(ValueError, match="grade_over_length = true with point_mass = true"):
        PlanSettings(point_mass=True, grade_over_length=True)


METRO = Path(__file__).parent.parent / "examples" / "metro"


@pytest.fixture(scope="module")
def fastest() -> ta.Plan:
    """Return the plan of least time on the metro line, with sections of 1.2, 1.2, 1.3 and 1.3 km."""
    return ta.plan(METRO / "line.yaml", METRO / "train.yaml")


def runs_of(plan: ta.Plan) -> list[float]:
    """Return the running times of the sections between two stops [s]."""
    return [after[1] - before[2] for before, after in pairwise(plan.arrivals)]


def test_every_section_has_its_own_supplement(fastest: ta.Plan) -> None:
    """Breaks if a supplement is taken from the whole run: the planner then shifts it between the stops."""
    found = ta.plan(METRO / "line.yaml", METRO / "train.yaml", end_km=2.6, allowance=[parse_allowance("5%+3s/stop")])
    wanted = [0.05 * time + 3.0 for time in runs_of(fastest)[:2]]
    assert found.allowances == pytest.approx(wanted, abs=0.11)
    assert max(a - b for a, b in zip(found.allowances, wanted, strict=True)) <= 0.03
    rows = found.summary()["stops"]
    assert [row.get("allowance_s") for row in rows[1:]] == [round(entry, 3) for entry in found.allowances]
    assert [b - a for _, a, b in found.arrivals[1:-1]] == pytest.approx([20.0])
    assert found.energy < 0.8 * fastest.energy


def test_minutes_per_100_km_and_seconds_per_stop_count_on_their_part(fastest: ta.Plan) -> None:
    """Breaks if a part reaches beyond its ends: 6 min per 100 km are 3.6 s per km; 3.2 km is no stop."""
    rules = parse_allowance("6min/100km:1.4..3.2"), parse_allowance("10s/stop:0.2..2.6")
    assert supplements(rules, fastest) == pytest.approx([10.0, 4.32 + 10.0, 2.16, 0.0])


def test_a_share_of_a_part_is_that_of_its_own_time(fastest: ta.Plan) -> None:
    """Breaks if the per cent of a part count by distance: 20 % on the first half of a section, where it starts."""
    there = float(np.interp(2000.0, fastest.front, fastest.profile.time)) - fastest.arrivals[1][2]
    found = supplements((parse_allowance("20%:1.4..2"),), fastest)
    assert found == pytest.approx([0.0, 0.2 * there, 0.0, 0.0]) and 0.2 * there == pytest.approx(8.12, abs=0.05)


@pytest.mark.parametrize("text", ["5", "5%+3%", "-5%", "3min", "5%:4", "5%:4..2", "0.2h/stop", "nan%", "5000%", ""])
def test_a_text_that_is_no_supplement_is_refused(text: str) -> None:
    """Breaks if a sign, a unit or a repeated form is dropped in silence."""
    with pytest.raises(ValueError, match=r"no supplement|no section|must lie beyond|to 10; ") as refusal:
        parse_allowance(text)
    assert str(refusal.value).startswith(f"'{text}': ")


def test_supplements_and_a_running_time_exclude_each_other() -> None:
    """Breaks if one of two running times is ignored."""
    with pytest.raises(ValueError, match="allowance with time"):
        ta.plan(METRO / "line.yaml", METRO / "train.yaml", time=480, allowance=[{"share": 0.05}])
    with pytest.raises(ValueError, match=r"km 9.000 ... 5.200 lies outside the plan"):
        ta.plan(METRO / "line.yaml", METRO / "train.yaml", allowance=[{"share": 0.05, "begin_km": 9}])


def test_the_supplements_of_the_example_reach_the_run(fastest: ta.Plan, tmp_path: Path) -> None:
    """Breaks if a run, its catching up or its profile file lose the scheduled times."""
    changes = ("replan={catch_up: true}", "profile.plan.begin=2600")
    setup = prepare(*load_scenario(str(METRO / "allowances.yaml"), changes))
    points = scheduled_points(setup.profile, setup.consist.vehicles[0].length / 2)
    assert [point.at for point in points] == pytest.approx([2600, 3900, 5200])
    runs = [(before.departure, after.arrival) for before, after in pairwise(points)]
    on_works = 0.4 * 8 * 60 / 100  # 0.4 km at 8 min per 100 km
    wanted = [1.05 * time + 4.0 + extra for time, extra in zip(runs_of(fastest)[2:], (on_works, 0.0), strict=True)]
    assert [b.latest - a.earliest for a, b in runs if a and b] == pytest.approx(wanted, abs=0.2)
    write_profile(setup.profile, tmp_path / "run.yaml", "allowances")
    assert read_profile(tmp_path / "run.yaml").end == pytest.approx(setup.profile.end)


def test_an_allowance_without_a_unit_is_refused_with_its_spelling(capsys: pytest.CaptureFixture[str]) -> None:
    """Breaks if a supplement of time is taken in an unknown unit."""
    with pytest.raises(SystemExit):
        options(str(METRO / "line.yaml"), str(METRO / "train.yaml"), "--allowance", "5")
    assert "write 5%" in capsys.readouterr().err
