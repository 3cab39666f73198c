"""Disturbance observer of paper 000: exact between samples, held over gaps, correct units."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from law_trains import FIVE, HAULED, SINGLE, measured, model

from train_ato.control.air_brake.policy import BrakeSpec, make_brake_policy
from train_ato.control.observers.contract import ObserverInput
from train_ato.control.observers.stack import ObserverStack
from train_ato.control.registry import OBSERVERS


def observe(observer, of, speeds, applied, period, **more):
    """Run an observer over speeds and forces; return the estimates."""
    found = []
    for k, (speed, force) in enumerate(zip(speeds, applied, strict=True)):
        seen = measured(of, round(k * period * 1e9), 0.0, speed, force)
        found.append(float(observer.step(ObserverInput.of(seen, **more))[0]))
    return np.array(found)


@given(omega=st.floats(0.01, 1e5), period=st.floats(0.001, 1.0), push=st.floats(-0.5, 0.5))
def test_exact_for_any_bandwidth(omega, period, push):
    """A constant force gives 1 - exp(-omega t), for omega Tc from 1e-5 to 1e5; explicit Euler diverges above 2."""
    of = model(SINGLE, tick=period)
    observer = OBSERVERS.make("ndo", {"omega": omega, "model_error": 0.0}, of, period)
    count = 12
    speeds, force = [20.0], []
    for _ in range(count):
        force.append(float(of.own_resistance(np.array([speeds[-1]]), np.zeros(1))[0]))
        speeds.append(speeds[-1] + push * period)
    found = observe(observer, of, speeds[:-1], [0.0, *force[:-1]], period)
    expected = 80e3 * push * -np.expm1(-omega * period * np.arange(count))
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-6 * 80e3 + 1e-9 * 80e3 / period)


def test_train_scope_is_shared_over_the_units():
    """400 t at 0.1 m/s²: 40 kN in total, 8 kN per unit; breaks if every unit gets the total."""
    of = model(FIVE)
    observer = OBSERVERS.make("ndo", {"scope": "train", "omega": 50.0}, of, 0.1)
    for k in range(20):
        speed = 10.0 + 0.01 * k
        total = of.running_resistance(speed)
        out = observer.step(ObserverInput.of(measured(of, k * 100_000_000, 0.0, speed, total / 5)))
    assert out == pytest.approx(np.full(5, 8e3), rel=1e-3)


def test_vehicle_scope_uses_the_coupler():
    """With the coupler force a hauled locomotive in balance has no disturbance; without it 200 kN."""
    of = model(HAULED, sensors=(0,))
    observer = OBSERVERS.make("ndo", {"model_error": 0.0}, of, 0.1)
    own = float(of.own_resistance(np.array([10.0]), np.array([500.0]))[0])
    for k in range(10):
        seen = measured(of, k * 100_000_000, 500.0, 10.0, 200e3 + own)
        known = ObserverInput(
            seen.stamp * 1e-9, seen.position, seen.velocity, seen.applied, np.array([200e3]), np.zeros(1)
        )
        out = observer.step(known)
    assert abs(out[0]) < 1e-6


def test_gaps_and_invalid_samples_are_not_used():
    """A NaN changes neither the estimate nor the difference quotient of the next sample."""
    of = model(SINGLE)
    observer = OBSERVERS.make("ndo", {"omega": 1e3, "model_error": 0.0}, of, 0.1)
    force = float(of.own_resistance(np.array([10.0]), np.zeros(1))[0])
    found = observe(observer, of, [10.0, 10.0, math.nan, 1e300, 13.0, 13.0], [force] * 6, 0.1)
    assert np.isfinite(found).all()
    assert np.abs(found[:5]).max() < 1.0
    observer.reset()
    again = observe(observer, of, [10.0, 10.0], [force] * 2, 0.1)
    assert (again == found[:2]).all()


def test_observer_stack_passes_stamps_and_none_is_zero():
    """The stack keeps the stamp; without an observer the estimate is 0 N for every unit."""
    of = model(FIVE)
    observer = ObserverStack(of, OBSERVERS.make("none", {}, of, 0.1), make_brake_policy(BrakeSpec(), of, of.line))
    estimate = observer.step(measured(of, 700_000_000, 0.0, 10.0, 0.0))
    assert estimate.stamp == 700_000_000
    assert (estimate.force == np.zeros(5)).all()
