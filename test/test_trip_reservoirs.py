"""Trips of a train whose applications use up its reservoirs: planned shoe forces against those of the plant."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from plant_sim.consist import Consist
from plant_sim.library import load_consist
from plant_sim.line import Line
from train_ato.profile.trip.driven_run import TripRun, follow_journey
from train_ato.profile.trip.journey import Journey, JourneySearch
from train_ato.profile.trip.reduced_train import nominal_train_model, reduced_train
from train_ato.profile.trip.settings import TripSettings

LIMIT = 70 / 3.6
FORCE_TOLERANCE = 0.02
"""Largest relative difference of a planned force from that of the plant; 0.01 of it: settled part of the table."""


def train(reservoir_use: float) -> Consist:
    """Return the shipped train with shoes of twice the force: a long fall then needs several applications."""
    data = load_consist("hxd1_c80_105").model_dump(by_alias=True, exclude_none=True)
    data["air_brake"].update(reservoir_use=reservoir_use, recharge_time=90.0, braking_factor=(0, 0.34))
    return Consist.model_validate(data)


@pytest.fixture(scope="module")
def line() -> Line:
    """Fall of 11 km of 10 per mille; the electric brake alone holds 6.3 per mille."""
    grades = [{"at_km": 0, "grade": 0.0}, {"at_km": 3, "grade_permille": -10}, {"at_km": 14, "grade": 0.0}]
    limits = [{"at": 0, "speed": LIMIT}]
    return Line.model_validate(
        {"schema": "train_ato/line/1", "name": "long fall", "end_km": 19, "grades": grades, "speed_limits": limits}
    )


def journey_and_run(line: Line, planned: Consist) -> tuple[Journey, TripRun]:
    """Return the journey planned with one train, and the run of the train with exhaustible reservoirs along it."""
    settings = TripSettings()
    reduced = reduced_train(nominal_train_model(planned, line), settings, 0.0, 17_500.0, (50e3,))
    journey = JourneySearch(reduced, settings).journey(3.6e6)
    return journey, follow_journey(nominal_train_model(train(0.25), line), settings, journey, journey.applications)


def force_ratios(journey: Journey, run: TripRun) -> list[float]:
    """Return the shoe force of the plant over the planned one at the end of every application."""
    found = []
    for entry in journey.applications:
        index = int(np.searchsorted(run.position, entry.release)) - 1
        speed = 3.6 * run.speed[index]
        planned = journey.shoes[int(np.searchsorted(journey.place, entry.release - 1e-6)) - 1]
        found.append(float(run.shoes[index] * (3 * speed + 150) / (2 * speed + 150) / planned))
    return found


def test_planned_applications_have_the_force_of_the_plant(line: Line) -> None:
    """Breaks if the search counts the reservoirs as full: the fifth application then has 0.75 of the planned force."""
    journey, run = journey_and_run(line, train(0.25))
    supplies = [entry.supply for entry in journey.applications]
    assert len(supplies) >= 4 and supplies[0] == 1.0 and min(supplies) < 0.85
    assert force_ratios(journey, run) == pytest.approx([1.0] * len(supplies), abs=FORCE_TOLERANCE)
    assert run.speed.max() <= LIMIT


def test_full_reservoirs_in_the_search_are_not_those_of_the_plant(line: Line) -> None:
    """Breaks if the line of the test before needs no repeated applications, so that this test shows nothing."""
    journey, run = journey_and_run(line, train(0.0))
    assert {entry.supply for entry in journey.applications} == {1.0}
    assert min(force_ratios(journey, run)) < 0.8
    assert run.speed.max() > LIMIT


def test_a_longer_pause_gives_more_supply(line: Line) -> None:
    """Breaks if the supply does not recharge in the pause, or is used up without an application."""
    settings = TripSettings.model_validate({"air_brake": {"pause": 180.0}})
    model = nominal_train_model(train(0.25), line)
    journey = JourneySearch(reduced_train(model, settings, 0.0, 17_500.0, (50e3,)), settings).journey(3.6e6)
    times = [np.interp((entry.apply, entry.release), journey.place, journey.time) for entry in journey.applications]
    recharged = [1.0 - 0.25 * np.exp(-(b[0] - a[1]) / 90.0) for a, b in pairwise(times)]
    for entry, least in zip(journey.applications[1:], recharged, strict=True):
        # the release wave is up to 29 s slower than that of the application: exp(29/90) = 1.38
        assert 1.0 - 1.4 * (1.0 - least) <= entry.supply <= least
