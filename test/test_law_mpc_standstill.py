"""Stops and departures of the law mpc in the holding brake: target, jump of the acceleration, roll-back."""

from __future__ import annotations

import math

import numpy as np
import pytest

import train_ato as ta
from plant_sim.library import load_consist, load_line
from train_ato.control.algorithms.standstill_force import FREE, StandstillForce
from train_ato.control.standstill import RELEASE_FORCE
from train_ato.control.train_model import TrainModel

REST = (0.0, 0.0, 0.0)
"""Reference at rest: speed and acceleration at the time of effect, and speed a node later."""


def _slope(grade):
    return {
        "schema": "train_ato/line/1", "name": "slope", "summary": "constant grade", "end_km": 10,
        "grades": [{"at": 0, "grade_permille": grade}], "speed_limits": [{"at": 0, "speed_kmh": 80}],
    }  # fmt: skip


def _run(grade, in_model, **changes):
    """Return run, speed and position of a metro train that starts on a constant grade: 0 - 36 - 0 km/h."""
    phases = [{"cruise_for": 2}, {"accelerate_to_kmh": 36}, {"cruise_for": 2}, {"brake_to": 0}]
    chosen = {
        "duration": 40, "profile.start": 200.0, "profile.phases": phases, "plant.line": _slope(grade),
        "model.line": _slope(in_model), **changes,
    }  # fmt: skip
    run = ta.run("xuzhou_metro", law="mpc", compensation="none", set=chosen, seed=12, progress=False)
    vehicles = run["train/vehicles"]
    speed, place = (vehicles.filter(like=like).to_numpy()[:, 0] for like in ("speed_m_s", "position_m"))
    return run, speed, place


@pytest.mark.parametrize("grade", [13.6, 18.9])
def test_stop_on_a_rising_grade_that_the_model_lacks(grade):
    """A force that holds the train on the grade keeps the holding brake off, and noise then moves the train on."""
    run, speed, place = _run(grade, 0.0, **{"plant.sensors.velocity_noise": 0.0226})
    assert abs(run.metrics["stop_error_m"]) < 0.1
    stands = int(np.flatnonzero(np.abs(speed) > 1e-4)[-1])
    at_rest = int(np.flatnonzero(run["ato/reference"]["speed_m_s"].to_numpy() > 0.0)[-1])
    assert stands - at_rest < 20  # 1 s
    assert np.ptp(place[stands + 1 :]) == 0.0


@pytest.mark.parametrize("grade", [-18.4, -5.0, 0.0, 15.0])
def test_brake_force_decays_before_the_holding_brake_acts(grade):
    """The holding brake alone stops the train from 0.05 m/s: mean of the last 0.25 s up to 0.45 m/s²."""
    _, speed, _ = _run(grade, grade)
    last = int(np.flatnonzero(np.abs(speed) > 1e-4)[-1]) + 1
    assert speed[last - 5] / 0.25 < 0.2


@pytest.mark.parametrize(("grade", "in_model", "largest"), [(25.0, 0.0, 0.0265), (30.0, 30.0, 0.012)])
def test_departure_on_a_rising_grade_rolls_back_less_than_with_pid(grade, in_model, largest):
    """A small force before the departure releases the holding brake: 43 mm and 28 mm; pid 27 mm and 43 mm."""
    _, _, place = _run(grade, in_model, **{"plant.sensors.velocity_noise": 0.02, "duration": 8, "profile.phases": [
        {"cruise_for": 2}, {"accelerate_to_kmh": 18}, {"brake_to": 0}]})  # fmt: skip
    assert 0.0 < place[0] - place.min() < largest
    assert place[-1] - place[0] > 5.0


def _force(name, reversing=False):
    consist = load_consist(name)
    count = len(consist.power_units)
    delays = np.full(count, 0.5)
    model = TrainModel(consist, load_line("level"), delays, delays, 0.4, 0.1, reversing=reversing)
    return StandstillForce(model, 0.1), count


def test_range_of_the_force():
    """A wrong sign lets a train at its place be driven, or keeps one away from its place."""
    force, count = _force("xuzhou_metro_3")
    mass = 1e5
    at_place, far = np.array([0.05, 0.0, 0.0, 0.0]), np.array([-0.5, 0.0, 0.0, 0.0])
    assert force.range(at_place, REST, True, mass, 0.0) == (0.0, 0.0)
    assert force.range(at_place, REST, False, mass, 0.0) == (-math.inf, 0.0)
    assert force.range(far, REST, True, mass, 0.0) == FREE
    slow = np.array([0.0, 0.04, 0.0, -0.3])
    assert force.range(slow, REST, False, mass, -3e4) == (count * RELEASE_FORCE,) * 2
    assert force.range(np.array([0.0, 0.04, 0.0, 0.0]), REST, False, mass, 0.0) == (-math.inf, 0.0)
    assert force.range(np.array([0.0, 1.0, 0.0, -0.3]), (2.0, -0.5, 1.5), False, mass, -3e4) == FREE
    rolls = np.array([0.0, 0.0, 0.0, -0.3])
    assert force.range(rolls, (0.0, 0.0, 0.1), True, mass, 0.0) == (0.0, 0.0)
    low, high = force.range(rolls, (0.01, 0.1, 0.1), True, mass, 0.0)
    assert low == pytest.approx(0.3 * mass / (1.0 - math.exp(-0.25)))
    assert high == math.inf


def test_hauled_vehicles_and_reversing_drives():
    """Hauled vehicles stop one by one, without traction; a reversing drive would move back with a negative force."""
    hauls, _ = _force("hxd1_c80_105")
    assert hauls.range(np.zeros(4), REST, False, 1e7, 0.0) == (-math.inf, 0.0)
    assert hauls.range(np.zeros(4), (0.04, -0.1, 0.0), False, 1e7, 0.0) == (-math.inf, 0.0)
    assert hauls.range(np.array([-0.01, 0.0, 0.0, 0.0]), (0.04, -0.1, 0.0), False, 1e7, 0.0) == FREE
    assert hauls.range(np.zeros(4), (0.06, -0.1, 0.0), False, 1e7, 0.0) == FREE
    assert hauls.range(np.zeros(4), REST, True, 1e7, 0.0) == (0.0, 0.0)
    assert hauls.range(np.zeros(4), (0.0, 0.0, 0.1), True, 1e7, 0.0) == (0.0, 0.0)
    assert hauls.range(np.zeros(4), (0.01, 0.1, 0.1), True, 1e7, 0.0) == FREE
    reverses, _ = _force("xuzhou_metro_3", reversing=True)
    assert reverses.range(np.zeros(4), REST, True, 1e5, 0.0) == FREE
