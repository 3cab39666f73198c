"""Trips over neutral sections, power limits, low adhesion and temporary restrictions: forces of the planned run."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from plant_sim.consist import Consist
from plant_sim.library import load_consist
from plant_sim.line import Line
from train_ato.messages.types import Array
from train_ato.profile.trip.plan import TripPlan
from train_ato.profile.trip.planner import TripPlanner
from train_ato.profile.trip.reduced_train import MARGIN, SectionForces, nominal_train_model, reduced_train
from train_ato.profile.trip.settings import TripSettings

SETTINGS = TripSettings(end=12_000.0)
CLIMB, FALL = {"begin_km": 1.5, "end_km": 1.7}, {"begin_km": 5.0, "end_km": 5.1}


def line_with(**sections: Any) -> Line:
    """Return a line with a fall of 4 km that needs air brake and electric brake; the departure is before km 3."""
    grades = [{"at_km": 0, "grade": 0.0}, {"at_km": 3, "grade_permille": -11}, {"at_km": 7, "grade": 0.0}]
    data = {"schema": "train_ato/line/1", "name": "fall", "end_km": 14, "grades": grades}
    return Line.model_validate({**data, "speed_limits": [{"at": 0, "speed_kmh": 60}], **sections})


@pytest.fixture(scope="module")
def consist() -> Consist:
    return load_consist("hxd1_c80_105")


@pytest.fixture(scope="module")
def open_line_plan(consist: Consist) -> TripPlan:
    return TripPlanner(line_with(), consist, SETTINGS).at_price(1.0)


def inside(plan: TripPlan, section: dict[str, float], offset: float = 0.0) -> tuple[Array, Array]:
    """Return force [N] and speed [m/s] of the planned run with a unit in a section and in most of the margin around it.

    An accelerating train reaches the begin of the margin some tenths of a second early.
    """
    run, way = plan.run, 0.8 * MARGIN * plan.run.speed
    place = run.position[:-1] - offset
    near = (place + way[:-1] >= 1e3 * section["begin_km"]) & (place - way[:-1] < 1e3 * section["end_km"])
    return run.force[1:][near], run.speed[:-1][near]


def test_a_neutral_section_has_no_force(consist: Consist, open_line_plan: TripPlan) -> None:
    """Breaks if the plan pulls or brakes in a neutral section, where the force of the plant would end at once."""
    plan = TripPlanner(line_with(neutral_sections=[CLIMB, FALL]), consist, SETTINGS).at_price(1.0)
    for section in (CLIMB, FALL):
        assert not inside(plan, section)[0].any()
        assert np.abs(inside(open_line_plan, section)[0]).max() > 50e3, "the same places of the open line"
    change = np.abs(np.diff(plan.run.force)).max()
    assert change <= SETTINGS.slew * plan.run.period + 1e-6, "a jump of the force at a section"
    assert plan.coupler_max <= SETTINGS.coupler_max


def test_a_rheostatic_brake_works_in_a_neutral_section(consist: Consist) -> None:
    """Breaks if a neutral section with electric brake is planned as one without."""
    model = nominal_train_model(consist, line_with(neutral_sections=[{**FALL, "electric_brake": True}]))
    traction, brake = SectionForces(model, 30.0).at(5_050.0, 15.0, 1e3)
    assert traction == 0.0 and brake == pytest.approx(461e3)


def test_a_power_limit_is_kept(consist: Consist, open_line_plan: TripPlan) -> None:
    """Breaks if the plan takes more power than the line has."""
    section = {"begin_km": 0.8, "end_km": 2.0}
    plan = TripPlanner(line_with(power_limits=[{**section, "power_mw": 2}]), consist, SETTINGS).at_price(1.0)
    assert np.prod(inside(plan, section), axis=0).max() <= 2.04e6, "2 %: the speed changes in a step of 0.5 s"
    assert np.prod(inside(open_line_plan, section), axis=0).max() > 4e6


def test_low_adhesion_limits_traction_and_brake(consist: Consist) -> None:
    """Breaks if the factor of a section does not limit the wheel force, or the dry rail of the plant none elsewhere."""
    model = nominal_train_model(consist, line_with(adhesion=[{**CLIMB, "factor": 0.2}]))
    forces, grip = SectionForces(model, 30.0), 184e3 * 9.81 * (0.161 + 7.5 / (36.0 + 44.0))
    assert forces.at(1_600.0, 10.0, 1e3) == pytest.approx((0.2 * grip, 0.2 * grip))
    assert forces.at(8_000.0, 10.0, 1e3) == pytest.approx((grip, grip)), "dry: traction and brake are 642 and 461 kN"


def test_every_unit_has_the_sections_at_its_own_place() -> None:
    """Breaks if the sections hold at the front of the train only: the second unit is 1 295 m behind it."""
    model = nominal_train_model(load_consist("hxd1_c80_210"), line_with(neutral_sections=[FALL]))
    forces, behind = SectionForces(model, 30.0), float(model.offsets[1])
    for place, neutral in ((5_050.0, True), (5_700.0, False), (5_050.0 + behind, True), (5_300.0 + behind, False)):
        assert (forces.at(place, 10.0, 1e9)[1] == 0.0) is neutral


def test_the_force_reaches_a_section_with_the_planned_rate(consist: Consist) -> None:
    """Breaks if the force ends at once at a section, or before it without need."""
    forces = SectionForces(nominal_train_model(consist, line_with(neutral_sections=[FALL])), 30.0)
    speed, slew = 15.0, 16e3
    begin = 5_000.0 - MARGIN * speed
    for before in (0.1, 5.0, 20.0):
        assert forces.at(begin - before * speed, speed, slew)[1] == pytest.approx(min(slew * before, 461e3))
    assert forces.at(begin - 100.0 * speed, speed, slew)[1] == pytest.approx(461e3)
    assert forces.at(5_100.0 + MARGIN * speed + 0.1, speed, slew)[1] == pytest.approx(461e3)


def test_a_section_of_a_part_of_a_cell_limits_the_cell(consist: Consist) -> None:
    """Breaks if the search sees the sections at the begin of its cells of 100 m only."""
    section = {"begin_km": 5.04, "end_km": 5.05}
    model = nominal_train_model(consist, line_with(neutral_sections=[section]))
    train = reduced_train(model, SETTINGS, 0.0, 11_800.0, ())
    neutral = [number for number in range(train.cells) if not train.drives[train.section[number]].any()]
    way = MARGIN * (60 / 3.6 - SETTINGS.speed_margin)
    assert train.place(neutral[0]) <= 5_040.0 - way and train.place(neutral[-1] + 1) >= 5_050.0 + way
    assert len(neutral) <= 2 * way / 100.0 + 3 and all(b == a + 1 for a, b in pairwise(neutral))


def test_a_temporary_restriction_is_a_speed_limit(consist: Consist) -> None:
    """Breaks if a plan exceeds a restriction with any part of the train."""
    restriction = {"begin_km": 4.5, "end_km": 5.0, "speed_kmh": 45}
    plan = TripPlanner(line_with(temporary_restrictions=[restriction]), consist, SETTINGS).at_price(1.0)
    front = plan.run.position + consist.vehicles[0].length / 2
    restricted = (front >= 4_500.0) & (front < 5_000.0 + consist.length)
    assert plan.run.speed[restricted].max() <= 45 / 3.6 < plan.run.speed[~restricted].max()


def test_a_stop_without_electric_brake_is_refused(consist: Consist) -> None:
    """Breaks if the last part of the braking is planned where the electric brake does not work."""
    section = {"begin_km": 11.95, "end_km": 12.5}
    with pytest.raises(ValueError, match=r"line 'fall': neutral_sections\[0\]: km 11.950 to km 12.500: .*; ") as raised:
        TripPlanner(line_with(neutral_sections=[section]), consist, SETTINGS)
    assert "\n" not in str(raised.value)
    TripPlanner(line_with(neutral_sections=[{**section, "electric_brake": True}]), consist, SETTINGS)
    TripPlanner(line_with(neutral_sections=[{**section, "begin_km": 12.1}]), consist, SETTINGS)
