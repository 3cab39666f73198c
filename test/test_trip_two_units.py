"""Trips of a train with two power units: shares by place, coupler forces in the search."""

from __future__ import annotations

import numpy as np
import pytest

from plant_sim.consist import Consist
from plant_sim.library import load_consist
from plant_sim.line import Line
from train_ato.control.force_distribution import ForceDistribution, SharesAt
from train_ato.control.train_model import TrainModel
from train_ato.loop.engine import run_engine
from train_ato.loop.setup import prepare
from train_ato.profile.trip.driven_run import TripRun, follow_journey, shares_for_run
from train_ato.profile.trip.journey import Journey, JourneySearch
from train_ato.profile.trip.reduced_train import coupler_tables, nominal_train_model, reduced_train
from train_ato.profile.trip.settings import TripSettings
from train_ato.scenario.scenario import load_scenario

MIDDLE = 21
"""Number of the second power unit."""


def two_shares(*entries: tuple[float, float]) -> ForceDistribution:
    return ForceDistribution([SharesAt(at=at, shares=(front, 1 - front)) for at, front in entries], [0.5, 0.5])


@pytest.fixture(scope="module")
def consist() -> Consist:
    """Power unit, 20 wagons, power unit, 20 wagons: the shipped train of 212 vehicles, shortened."""
    data = load_consist("hxd1_c80_210").model_dump(mode="json", by_alias=True, exclude_defaults=True)
    data["name"] = "short"
    for entry in data["train"]:
        entry["count"] = 20 if entry["type"] == "c80" else 1
    data["couplings"][0]["behind"] = [0, MIDDLE - 1, MIDDLE]
    return Consist.model_validate(data)


def crest() -> Line:
    """Return a line with a crest of 8 per mille: the front is in the fall while the rear is on the climb."""
    grades = [
        {"at_km": 0, "grade": 0.0},
        {"at_km": 2.5, "grade_permille": 8},
        {"at_km": 3.2, "grade_permille": -14},
        {"at_km": 4.2, "grade": 0.0},
    ]
    limits = [{"at": 0, "speed_kmh": 60}]
    return Line.model_validate(
        {
            "schema": "train_ato/line/1",
            "name": "crest",
            "end_km": 9,
            "grades": grades,
            "speed_limits": limits,
        }
    )


@pytest.fixture(scope="module")
def settings() -> TripSettings:
    return TripSettings(end=7_000.0)


@pytest.fixture(scope="module")
def model(consist: Consist) -> TrainModel:
    return nominal_train_model(consist, crest())


def journey_of(model: TrainModel, settings: TripSettings, limit: float) -> Journey:
    """Return a fast journey with a limit of the quasi-static coupler force [N]."""
    train = reduced_train(model, settings, 0.0, 6_800.0, (50e3,))
    return JourneySearch(train, settings, limit / settings.coupler_max).journey(2.0 * 3.6e6)


@pytest.fixture(scope="module")
def journey(model: TrainModel, settings: TripSettings) -> Journey:
    return journey_of(model, settings, 2e6)


@pytest.fixture(scope="module")
def equal_run(model: TrainModel, settings: TripSettings, journey: Journey) -> TripRun:
    """Run with the fixed shares of the model."""
    return follow_journey(model, settings, journey, journey.applications)


def test_shares_change_linearly_and_keep_the_total() -> None:
    """Breaks if the shares jump at a place, or the total differs from that of the law."""
    distribution = two_shares((100.0, 0.2), (200.0, 0.8))
    limits = [-900.0, -900.0], [900.0, 900.0]
    assert distribution.forces(150.0, [300.0, 100.0], *limits) == pytest.approx([200.0, 200.0])
    assert distribution.forces(0.0, [-300.0, -100.0], *limits) == pytest.approx([-80.0, -320.0])
    assert distribution.forces(999.0, [500.0, 0.0], *limits) == pytest.approx([400.0, 100.0])


def test_a_unit_at_its_limit_leaves_the_rest_to_the_other() -> None:
    """Breaks if force is lost at the limit of a unit, or a limit is exceeded."""
    distribution = two_shares((0.0, 0.9))
    assert distribution.forces(0.0, [300.0, 300.0], [-400.0] * 2, [400.0] * 2) == pytest.approx([400.0, 200.0])
    assert distribution.forces(0.0, [-300.0, -300.0], [-400.0] * 2, [400.0] * 2) == pytest.approx([-400.0, -200.0])
    assert distribution.forces(0.0, [400.0, 400.0], [-400.0] * 2, [400.0] * 2) == pytest.approx([400.0, 400.0])


def test_a_run_commands_the_shares_of_its_scenario() -> None:
    """Breaks if the shares of a scenario do not reach the commands of the power units."""
    shares = [{"at": -1e4, "shares": [0.5, 0.5, 0.0]}]
    changes = {"duration": 20.0, "law": "pid", "force_shares": shares}
    command = run_engine(prepare(*load_scenario("crh380a_gpc", changes=changes))).recording.command
    total = command.sum(axis=1)
    pulling = command[(total > 1e3) & (total < 100e3)]  # above 60 kN of a unit the third one has the rest
    assert len(pulling) and np.allclose(pulling[:, 0], pulling[:, 1]) and not pulling[:, 2].any()


def test_the_shares_of_a_run_lower_the_forces_between_the_units(model, settings, journey, equal_run):
    """Breaks if the shift has the wrong sign: the unit at the larger draft would pull more."""
    shares = shares_for_run(model, equal_run, ())
    run = follow_journey(model, settings, journey, journey.applications, shares)
    chosen, equal = (np.abs(found.couplers[:, :MIDDLE]).max() for found in (run, equal_run))
    assert chosen < equal


def test_quasi_static_forces_are_those_of_rest(consist: Consist) -> None:
    """Breaks if a sum over the vehicles in front misses one: at rest on a grade a coupler holds all behind it."""
    line = Line.model_validate(
        {"schema": "train_ato/line/1", "name": "climb", "end_km": 9, "grades": [{"at": -2e3, "grade_permille": 10}]}
    )
    tables = coupler_tables(nominal_train_model(consist, line), np.array([5_000.0]))
    weights = 9.81 * 0.01 * np.array([vehicle.mass for vehicle in consist.vehicles]).cumsum()
    assert tables.line_force[:, 0] == pytest.approx(weights[list(tables.numbers)], rel=1e-3)
    behind_first = tables.numbers.index(0)
    assert tables.constant[1, behind_first] == 0.5 and tables.constant[1, -1] == 1.0
    assert {MIDDLE - 1, MIDDLE} <= set(tables.numbers)


def test_the_search_keeps_a_limit_of_the_coupler_forces(model, settings, equal_run):
    """Breaks if the search ignores the couplers: with a small limit it must pull and brake less."""
    journey = journey_of(model, settings, 150e3)
    run = follow_journey(model, settings, journey, journey.applications)
    assert np.abs(run.couplers).max() < 0.8 * np.abs(equal_run.couplers).max()
