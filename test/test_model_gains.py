"""Gains from the model of the train: the loop that all laws share, and trips of random trains."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from law_trains import HAULED, LOCOMOTIVE, SINGLE, SPRING, WAGON, consist, model

from train_ato.apps.check_component.random_trains import GEAR_KINDS, random_scenario
from train_ato.apps.check_component.random_trips import FITTING_SHARE, Trip, drive_random_trip, random_trips, trips_text
from train_ato.control.algorithms.loop_gains import LoopGains
from train_ato.control.registry import LAWS

WITH_RULE = tuple(name for name in LAWS.names() if hasattr(LAWS.get(name), "model_gains"))
SEEDS = (1, 2)
"""Seeds of the random trains."""


def test_every_law_has_a_rule() -> None:
    """Breaks if a law has no gains of the model."""
    assert set(LAWS.names()) == set(WITH_RULE)


def test_gains_of_mpc_are_its_default() -> None:
    """Breaks if `gains: model` of mpc differs from its default, is not named as the source, or takes a given value."""
    train = model(HAULED, delay=0.6, lag=0.3)
    assert LAWS.gains("mpc", {}, train, 0.1).values == {}
    named = LAWS.gains("mpc", {"gains": "model", "omega": 0.2}, train, 0.1)
    assert named.values == {"gains": "model", "omega": 0.2}
    assert (named.source, named.reason) == ("model", f"computed from the model of {train.consist.name}; omega given")
    assert LAWS.make("mpc", {"gains": "model"}, train, 0.1).omega == LAWS.make("mpc", {}, train, 0.1).omega > 0.0
    with pytest.raises(ValueError, match="gains"):
        LAWS.check_parameters("mpc", {"gains": "printed"})


def test_rigid_train_follows_simc() -> None:
    """Breaks if delay, lag or period is missing in theta = 0.8 + 0.3 + 0.1 s."""
    loop = LoopGains.of(model(SINGLE, delay=0.8, lag=0.3), 0.1)
    assert loop.dead_time == pytest.approx(1.2)
    assert loop.speed == pytest.approx(1 / 2.4)
    assert loop.position == pytest.approx(1 / 2.4 / 9.6)


def test_train_without_dead_time_has_a_limited_gain() -> None:
    """Breaks if theta of one period decides: 5/s would make the noise of the speed the force."""
    assert LoopGains.of(model(SINGLE), 0.1).speed == 1.0


def test_mode_of_two_vehicles_limits_the_gain() -> None:
    """Breaks if the part of the unit in the mode, its damping or the lag is wrong in the limit of a two-mass train.

    w² = k (1/m1 + 1/m2), zeta w = c w²/(2 k), part m2/m1 of the unit; w theta is beyond half a turn.
    """
    soft = SPRING | {"stiffness": 5e6, "damping": 5e3}
    train = model(consist({"loco": LOCOMOTIVE, "wagon": WAGON}, [("loco", 1), ("wagon", 1)], soft), delay=0.6, lag=0.2)
    m1, m2 = (vehicle.mass * vehicle.rotating_mass_factor for vehicle in train.consist.vehicles)
    squared = 5e6 * (1 / m1 + 1 / m2)
    limit = 2 * 0.5 * (5e3 / 5e6 * squared / 2) * math.sqrt(1 + squared * 0.2**2) / (m2 / m1)
    assert 1.2 * math.sqrt(squared) * 0.65 > math.pi
    assert limit < 1 / 1.8
    assert LoopGains.of(train, 0.1).speed == pytest.approx(limit, rel=1e-6)


def test_softer_couplers_never_raise_the_gain() -> None:
    """Breaks if the limit of the modes has the wrong sign: a hauled train gets the gain of one mass."""
    damped = model(HAULED, delay=0.6, lag=0.3)
    rigid = consist({"loco": LOCOMOTIVE, "wagon": WAGON}, [("loco", 1), ("wagon", 4)], {"kind": "rigid"})
    assert LoopGains.of(damped, 0.1).speed < 0.5 * LoopGains.of(model(rigid, delay=0.6, lag=0.3), 0.1).speed


@pytest.mark.parametrize("name", WITH_RULE)
def test_gains_are_parameters_of_the_law(name: str) -> None:
    """Breaks if a rule names no parameter of the law, or is outside of its range, up to 10 s of delay."""
    law = LAWS.get(name)
    for train in (SINGLE, HAULED):
        for delay in (0.0, 0.5, 10.0):
            of = model(train, delay=delay, lag=0.5)
            given = law.model_gains(of, 0.1)
            LAWS.check_parameters(name, given)
            law(law.Parameters(**given), of, 0.1)


def test_random_trains_have_the_stated_range() -> None:
    """Breaks if the random trains lack long trains, several units, a draft gear, or the delays of the promise."""
    data = [random_scenario(seed, number) for seed in SEEDS for number in range(20)]
    trains = [each["plant"]["consist"]["train"] for each in data]
    delays = np.array([each["links"]["command"]["delay"] for each in data])
    lags = np.array([each["plant"]["lag"] for each in data])
    assert {each["plant"]["consist"]["draft_gears"]["gear"]["kind"] for each in data} == set(GEAR_KINDS)
    assert min(map(len, trains)) == 1
    assert 80 < max(map(len, trains)) <= 100
    assert max(sum(part["type"] == "engine" for part in train) for train in trains if len(train) > 20) > 2
    assert 0.1 <= delays.min() < 0.2
    assert 1.1 < delays.max() <= 1.2
    assert 0.2 <= lags.min() < lags.max() <= 0.6


@pytest.mark.parametrize(("name", "number"), list(zip(WITH_RULE, itertools.cycle((0, 7, 12)), strict=False)))
def test_a_random_train(name: str, number: int) -> None:
    """Breaks if a law oscillates, is taken over, or misses the stop by .5 m: metro trains and freight."""
    trip = drive_random_trip(name, SEEDS[0], number)
    assert trip.fits, f"{trip.train}: {trip.result}"


def test_slow_loop_stops_at_the_place() -> None:
    """Breaks if the plan departs before the first command acts: kp is .015/s for 82 wagons, 1.1 s and 3.7 m short."""
    trip = drive_random_trip("pid", 4, 11)
    assert trip.fits, f"{trip.train}: {trip.result}"


@pytest.mark.slow
@pytest.mark.parametrize("name", WITH_RULE)
def test_random_trains(name: str) -> None:
    """Breaks if more than one trip of 20 with the gains of the model does not fit."""
    trips = [trip for seed in SEEDS for trip in random_trips(name, 20, seed)]
    assert not any(trip.refused for trip in trips)
    assert sum(trip.fits for trip in trips) >= FITTING_SHARE * len(trips), trips_text(trips)[1]


def test_gains_that_do_not_fit_fail() -> None:
    """Breaks if the judgement passes any trip: with ten times its gain, `pid` oscillates on a long train."""
    trips = random_trips("pid", 1, values={"kp": 5.0, "ki": 1.0})
    assert not trips[0].fits
    assert trips_text(trips)[0] is False


def test_a_trip_without_a_stop_is_not_tracked() -> None:
    """Breaks if a train that rolls 30 s after its arrival counts as tracked, with a stop error of inf m.

    The couplers of 12 vehicles swing with 2 s after two accelerations 4 s apart, and the braking law takes over.
    """
    trip = drive_random_trip("pid", SEEDS[0], 6)
    assert (trip.fits, trip.stop) == (False, math.inf)
    assert trip.result.startswith("not stopped: moving, 9.63 m behind, 10 s after a planned arrival")
    assert "did not stop (limit 0.5)" in trip.result
    assert "1 takeover of the braking law" in trip.result


@pytest.mark.parametrize(("fitting", "passed"), [(19, True), (18, False)])
def test_share_of_trips(fitting: int, passed: bool) -> None:
    """Breaks if less than 95 % pass, if a refused train counts as driven, or if the worst train is not named."""
    trips = [Trip(f"train {number}", False, number < fitting, 0.1, "text") for number in range(20)]
    trips.append(Trip("train 20", True, False, math.inf, "refused"))
    found, text = trips_text(trips)
    assert found is passed
    assert text.startswith(f"{fitting} of 20 fit, 1 refused; worst: train {fitting}")
