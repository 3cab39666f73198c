"""Trips: moves of the planned places by the measured electric brake, shares and displacements of two power units."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from engine_runs import setup_of
from plant_trains import line_of

from plant_sim.consist import Consist
from plant_sim.library import load_consist, load_line
from plant_sim.line import Line
from train_ato.control.air_brake.policy import BrakeSpec, make_brake_policy
from train_ato.control.compensation.rigid import RigidForce
from train_ato.control.force_distribution import DisplacementAt, ForceDistribution, PlannedDisplacement, SharesAt
from train_ato.control.train_model import TrainModel
from train_ato.judge.metrics import summarise
from train_ato.loop.engine import run_engine
from train_ato.messages.types import Measurement
from train_ato.profile.driver import average_speed, nominal_train_model
from train_ato.profile.trip.driven_run import AVERAGE, TripRun, follow_journey, shares_for_run
from train_ato.profile.trip.journey import Journey, JourneySearch
from train_ato.profile.trip.planner import TripPlan, TripPlanner
from train_ato.profile.trip.reduced_train import coupler_tables, reduced_train
from train_ato.profile.trip.settings import TripSettings
from train_ato.scenario.scenario import raw_scenario
from train_ato.scenario.trip_scenario import write_trip

CHARGED, APPLIED = 600e3, 550e3
APPLY, RELEASE, SHIFT = 5000.0, 8000.0, 300.0
FULL = 461e3
"""Electric brake of the HXD1 between 5 and 75 km/h [N]."""


@pytest.fixture(scope="module")
def model() -> TrainModel:
    none = np.zeros(1)
    return TrainModel(load_consist("hxd1_c80_105"), load_line("daqin_section"), none, none, 0.0, 0.1)


def spec(**rules: float) -> BrakeSpec:
    application = {"apply": APPLY, "release": RELEASE, "reduction": 50e3} | {
        "electric_at_apply": 0.4,
        "electric_at_release": 0.3,
    }
    return BrakeSpec.model_validate({"policy": "trip", "applications": [application], "trip": rules})


def places(model: TrainModel, shares: list[tuple[float, float]], speed: float = 18.0, **rules: float) -> list[float]:
    """Return the places at which the pressure changes, for the used share of the electric brake from places on."""
    policy = make_brake_policy(spec(**rules), model, model.line)
    found, before, begins = [], CHARGED, [at for at, _ in shares]
    for place in np.arange(0.0, 12_000.0, 2.0):
        share = shares[int(np.searchsorted(begins, place, side="right")) - 1][1]
        pressure = policy.step(place / speed, place, speed, -share * FULL)
        if pressure != before:
            found.append(float(place))
        before = pressure
    return found


@pytest.mark.parametrize(
    ("shares", "speed", "change", "place"),
    [
        # as planned; a train with more resistance than planned waits; one without a reserve releases later
        ([(0.0, 0.4), (6000.0, 0.3)], 18.0, slice(None), [APPLY, RELEASE]),
        ([(0.0, 0.1), (6000.0, 0.3)], 18.0, 0, APPLY + SHIFT), ([(0.0, 0.1), (5100.0, 0.3)], 18.0, 0, 5100.0),
        ([(0.0, 0.4), (6000.0, 0.6)], 18.0, 1, RELEASE + SHIFT),
        ([(0.0, 0.4), (6000.0, 0.6), (8100.0, 0.3)], 18.0, 1, 8100.0),
        # a release is before the minimum speed
        ([(0.0, 0.4), (6000.0, 0.3)], 35.3 / 3.6, 1, RELEASE - SHIFT),
    ],
)  # fmt: skip
def test_a_place_moves_with_the_share_of_the_electric_brake(shares, speed, change, place, model) -> None:
    """Breaks if a place moves although the brake is used as planned, or does not where it is spared or strained."""
    assert places(model, shares, speed=speed)[change] == place


def test_a_full_electric_brake_makes_the_application_earlier(model: TrainModel) -> None:
    """Breaks if a train heavier than planned waits for the planned place, or applies more than the shift before it."""
    apply, _ = places(model, [(0.0, 0.4), (4800.0, 0.95), (5100.0, 0.3)])
    assert 4800.0 + 4.0 * 18.0 - 4.0 <= apply <= 4800.0 + 4.0 * 18.0 + 4.0
    early = places(model, [(0.0, 0.4), (1000.0, 0.95), (1400.0, 0.2), (5100.0, 0.3)], pause=1e4, call=0.9)
    assert early[0] == pytest.approx(1000.0 + 4.0 * 18.0, abs=4.0), "an unplanned application"


def test_drives_that_pull_make_the_release_earlier(model: TrainModel) -> None:
    """Breaks if drives pull against the shoes up to the planned place, or a release is below the minimum speed."""
    _, release = places(model, [(0.0, 0.4), (6000.0, -0.05)])
    assert RELEASE - SHIFT <= release <= RELEASE - SHIFT + 4.0
    assert len(places(model, [(0.0, 0.4), (6000.0, 0.3)], speed=34.9 / 3.6)) == 1


def test_a_departure_releases(model: TrainModel) -> None:
    """Breaks if a train that has stopped with applied brakes cannot depart."""
    policy = make_brake_policy(spec(), model, model.line)
    for t, speed, force in ((0.0, 5.0, -0.4 * FULL), (1.0, 0.0, 0.0)):
        assert policy.step(t, APPLY + t, speed, force) == APPLIED
    assert policy.step(2.0, APPLY + 1.0, 0.0, 1e5) == CHARGED


def test_unplanned_applications_keep_the_recharge_pause(model: TrainModel) -> None:
    """Breaks if a used up electric brake far from the plan has no effect, or the reservoirs get no time to recharge."""
    shares = [(0.0, 0.95), (500.0, 0.1), (800.0, 0.95)]
    changes = places(model, shares, pause=60.0)
    released = changes[1]
    assert changes[0] == pytest.approx(4.0 * 18.0, abs=4.0)
    assert released == pytest.approx(500.0 + 4.0 * 18.0, abs=4.0)
    assert changes[2] - released >= 60.0 * 18.0 - 1e-6


@pytest.mark.parametrize(
    ("data", "word"),
    [
        ({"policy": "trip"}, "applications"),
        ({"policy": "none", "applications": [{"apply": 1.0, "release": 2.0}]}, "applications"),
        ({"policy": "trip", "applications": [{"apply": 2.0, "release": 1.0}]}, "release"),
    ],
)
def test_contradictions_are_refused(data: dict[str, object], word: str) -> None:
    """Breaks if a policy without applications, or applications without the policy, run silently."""
    with pytest.raises(ValueError, match=word):
        BrakeSpec.model_validate(data)


MIDDLE = 21
"""Number of the second power unit."""


def two_shares(*entries: tuple[float, float]) -> ForceDistribution:
    return ForceDistribution([SharesAt(at=at, shares=(front, 1 - front)) for at, front in entries], [0.5, 0.5])


def of_two_units(wagons: int) -> dict[str, Any]:
    """Return power unit, wagons, power unit, wagons: the shipped train of 212 vehicles, shortened."""
    data = load_consist("hxd1_c80_210").model_dump(mode="json", by_alias=True, exclude_defaults=True)
    data["name"] = "short"
    for entry in data["train"]:
        entry["count"] = wagons if entry["type"] == "c80" else 1
    data["couplings"][0]["behind"] = [0, wagons, wagons + 1]
    return data


@pytest.fixture(scope="module")
def train_of_two() -> Consist:
    return Consist.model_validate(of_two_units(20))


CREST = {
    "schema": "train_ato/line/1", "name": "crest", "end_km": 9, "speed_limits": [{"at": 0, "speed_kmh": 60}],
    "grades": [{"at_km": 0, "grade": 0.0}, {"at_km": 2.5, "grade_permille": 8}, {"at_km": 3.2, "grade_permille": -14},
               {"at_km": 4.2, "grade": 0.0}],
}  # fmt: skip
"""Line with a crest of 8 per mille: the front is in the fall while the rear is on the climb."""


def crest() -> Line:
    return Line.model_validate(CREST)


@pytest.fixture(scope="module")
def settings() -> TripSettings:
    return TripSettings(end=7_000.0)


@pytest.fixture(scope="module")
def two_units(train_of_two: Consist) -> TrainModel:
    return nominal_train_model(train_of_two, crest())


def journey_of(two_units: TrainModel, settings: TripSettings, limit: float) -> Journey:
    """Return a fast journey with a limit of the quasi-static coupler force [N]."""
    train = reduced_train(two_units, settings, 0.0, 6_800.0, (50e3,))
    return JourneySearch(train, settings, limit / settings.coupler_max).journey(2.0 * 3.6e6)


@pytest.fixture(scope="module")
def journey(two_units: TrainModel, settings: TripSettings) -> Journey:
    return journey_of(two_units, settings, 2e6)


@pytest.fixture(scope="module")
def equal_run(two_units: TrainModel, settings: TripSettings, journey: Journey) -> TripRun:
    """Run with the fixed shares of the model."""
    return follow_journey(two_units, settings, journey, journey.applications)


@pytest.mark.parametrize(
    ("entries", "place", "asked", "given"),
    [
        (((100.0, 0.2), (200.0, 0.8)), 150.0, [300.0, 100.0], [200.0, 200.0]),
        (((100.0, 0.2), (200.0, 0.8)), 0.0, [-300.0, -100.0], [-80.0, -320.0]),
        (((100.0, 0.2), (200.0, 0.8)), 999.0, [350.0, 0.0], [280.0, 70.0]),
        (((0.0, 0.9),), 0.0, [300.0, 300.0], [400.0, 200.0]), (((0.0, 0.9),), 0.0, [-300.0, -300.0], [-400.0, -200.0]),
        (((0.0, 0.9),), 0.0, [400.0, 400.0], [400.0, 400.0]),
    ],
)  # fmt: skip
def test_shares_change_linearly_and_keep_the_total(entries, place, asked, given) -> None:
    """Breaks if the shares jump at a place, the total differs from the law's, or a unit at its limit loses the rest."""
    assert two_shares(*entries).forces(place, asked, [-400.0] * 2, [400.0] * 2) == pytest.approx(given)


def test_a_run_commands_the_shares_of_its_scenario() -> None:
    """Breaks if the shares of a scenario do not reach the commands of the power units."""
    shares = [{"at": -1e4, "shares": [0.5, 0.5, 0.0]}]
    changes = {"duration": 20.0, "law": "pid", "force_shares": shares}
    command = run_engine(setup_of("crh380a_gpc", changes=changes)).recording.command
    total = command.sum(axis=1)
    pulling = command[(total > 1e3) & (total < 100e3)]  # above 60 kN of a unit the third one has the rest
    assert len(pulling) and np.allclose(pulling[:, 0], pulling[:, 1]) and not pulling[:, 2].any()


def test_the_shares_of_a_run_lower_the_forces_between_the_units(two_units, settings, journey, equal_run):
    """Breaks if the shift has the wrong sign: the unit at the larger draft would pull more."""
    shares = shares_for_run(two_units, equal_run, ())
    run = follow_journey(two_units, settings, journey, journey.applications, shares)
    chosen, equal = (np.abs(found.couplers[:, :MIDDLE]).max() for found in (run, equal_run))
    assert chosen < equal


def test_quasi_static_forces_are_those_of_rest(train_of_two: Consist) -> None:
    """Breaks if a sum over the vehicles in front misses one: at rest on a grade a coupler holds all behind it."""
    line = line_of(9e3, grades=[{"at": -2e3, "grade_permille": 10}])
    tables = coupler_tables(nominal_train_model(train_of_two, line), np.array([5_000.0]))
    weights = 9.81 * 0.01 * np.array([vehicle.mass for vehicle in train_of_two.vehicles]).cumsum()
    assert tables.line_force[:, 0] == pytest.approx(weights[list(tables.numbers)], rel=1e-3)
    behind_first = tables.numbers.index(0)
    assert tables.constant[1, behind_first] == 0.5 and tables.constant[1, -1] == 1.0
    assert {MIDDLE - 1, MIDDLE} <= set(tables.numbers)


def test_the_search_keeps_a_limit_of_the_coupler_forces(two_units, settings, equal_run):
    """Breaks if the search ignores the couplers: with a small limit it must pull and brake less."""
    journey = journey_of(two_units, settings, 150e3)
    run = follow_journey(two_units, settings, journey, journey.applications)
    assert np.abs(run.couplers).max() < 0.8 * np.abs(equal_run.couplers).max()


def two_displacements(*entries: tuple[float, float, float]) -> PlannedDisplacement:
    return PlannedDisplacement([DisplacementAt(at=at, displacement=(a, b)) for at, a, b in entries], 2)


@pytest.fixture(scope="module")
def plan() -> tuple[TripPlan, dict[str, Any]]:
    """Plan of two power units with 60 wagons each over a crest, and its plant."""
    train = of_two_units(60)
    planner = TripPlanner(crest(), Consist.model_validate(train), TripSettings(end=8_000.0))
    return planner.with_unit_shares(planner.at_price(0.5)), {"consist": train, "line": CREST}


def test_the_slope_is_the_derivative_of_the_displacement() -> None:
    """Breaks if place and speed of a unit do not agree, or the displacement jumps or goes on beyond the last place."""
    planned = two_displacements((0.0, 0.0, 1.0), (100.0, 1.0, 0.0), (200.0, 4.0, 0.0))
    assert planned.at(100.0)[0] == pytest.approx([1.0, 0.0]) and planned.at(100.0)[1] == pytest.approx([0.02, -0.005])
    assert planned.at(-5.0) == ([0.0, 1.0], [0.0, 0.0])
    assert planned.at(999.0) == ([4.0, 0.0], [0.0, 0.0])
    for place in (10.0, 50.0, 99.9, 130.0, 199.0):
        before, after = planned.at(place - 1e-4)[0], planned.at(place + 1e-4)[0]
        assert planned.at(place)[1] == pytest.approx((np.array(after) - before) / 2e-4, abs=1e-7)
    for place in (100.0, 200.0 - 1e-9):
        near, there = planned.at(place - 1e-6), planned.at(place)
        assert near[0] == pytest.approx(there[0], abs=1e-6)
        assert near[1] == pytest.approx(there[1], abs=1e-6)


def test_a_train_that_moves_as_planned_has_no_error() -> None:
    """Breaks if the sign of the displacement is wrong, or its speed is missing."""
    planned = two_displacements((0.0, 0.0, 0.0), (100.0, 1.0, -2.0), (200.0, 2.0, -4.0))
    place, speed = 100.0, 10.0
    none = np.zeros(0)
    measured = Measurement(
        0, np.array([place + 1.0, place - 2.0]), speed * np.array([1.01, 0.98]), np.zeros(2), none, none, none
    )
    seen = planned.without(measured, place)
    assert seen.position == pytest.approx([place, place])
    assert seen.velocity == pytest.approx([speed, speed], rel=3e-4)  # the slope counts with the speed of vehicle 0


def test_a_run_follows_the_displaced_places() -> None:
    """Breaks if the displacements of a scenario do not reach the law."""
    ahead = [{"at": -1e4, "displacement": [2.0] * 3}]
    changes = {"duration": 120.0, "law": "pid", "laws": {"pid": {"kp": 0.5, "ki": 0.05}}}
    places = [
        run_engine(setup_of("crh380a_gpc", changes={**changes, **more})).recording.front_position[-1]
        for more in ({}, {"unit_displacements": ahead})
    ]
    assert places[1] - places[0] == pytest.approx(2.0, abs=0.2)


def test_an_observer_of_place_and_speed_follows_the_plan() -> None:
    """Breaks if displaced place and speed do not agree: mpc finds a false -.28 m/s² and pulls with 1.5 MN."""
    changes = {"duration": 95.0, "law": "mpc", "compensation": "none"}
    setup = setup_of("daqin_two_locomotives", changes=changes)
    metrics = summarise(setup, run_engine(setup).recording)
    assert metrics["speed_error_max_kmh"] <= 0.6 and metrics["saturated_s"] == 0.0


def test_the_feedforward_is_the_planned_force(plan: tuple[TripPlan, dict[str, Any]]) -> None:
    """Breaks if the motion of vehicle 0 against the train is in the profile: it then moves the whole train."""
    found, _ = plan
    run = found.run
    time = np.arange(0.0, run.time[-1] - 90.0, 0.1)
    wanted = average_speed(np.interp(time, run.time - 0.5 * run.period, run.force), 0.1, AVERAGE)
    shoes = average_speed(np.interp(time, run.time, run.shoes), 0.1, AVERAGE)
    error = RigidForce(found.model, found.profile).aheads(time, 0.0) + shoes - wanted
    assert error[100:-100].std() < 10e3  # 4 kN from the places of the vehicles on the grades; 27 kN with the motion


def test_the_written_scenario_runs_as_planned(plan: tuple[TripPlan, dict[str, Any]], tmp_path: Path) -> None:
    """Breaks if the motion of the couplings is converted to traction and braking again."""
    found, plant = plan
    path, _ = write_trip(found, tmp_path / "short.yaml", None, plant, "test")
    assert len(raw_scenario(str(path))[1]["unit_displacements"]) == len(found.displacements) > 100
    energy = []
    for changes in ({}, {"unit_displacements": None}):
        setup = setup_of(str(path), changes=changes)
        metrics = summarise(setup, run_engine(setup).recording)
        energy.append(metrics["energy_traction_kwh"])
    planned = found.summary()["energy_kwh"]
    assert energy[0] == pytest.approx(planned, rel=0.01) and energy[1] > 1.015 * planned
