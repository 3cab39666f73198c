"""Predictor, delay estimate and twin against a simulated train."""

import math

import numpy as np
import pytest
from engine_runs import setup_of
from hypothesis import given
from hypothesis import strategies as st
from law_trains import (
    FIVE,
    HAULED,
    HILLY,
    LEVEL,
    LOCOMOTIVE,
    SINGLE,
    SPRING,
    WAGON,
    asked,
    consist,
    measured,
    model,
    profile,
    stack,
)

from plant_sim.plant_setup import PlantSetup
from plant_sim.train import Train
from train_ato.control.compensation.ahead_train import AheadTrain, TwinParameters
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.compensation.predictor import DelayEstimate
from train_ato.control.compensation.rigid import RigidForce
from train_ato.control.registry import COMPENSATIONS
from train_ato.messages.types import Measurement, Reference

TICK_NS = 100_000_000


def step_input(of, along, t, state, commands_in_flight, disturbance=None):
    """Return the input of a compensation for a state (position, speed, force of every unit) on a profile."""
    stamp, n = round(t * 1e9), of.n_units
    none = np.zeros(len(of.sensors))
    low, high = of.force_limits(state[1])
    return CompensationInput(
        Measurement(stamp, *state, none, none, none), Reference(stamp, *along.at(t)[:3]),
        np.zeros(n) if disturbance is None else disturbance, commands_in_flight, None, low, high,
    )  # fmt: skip


def step(of, name, parameters, along, state, commands_in_flight, disturbance=None):
    """Return the input of a law that a compensation gives at 20 s."""
    layer = COMPENSATIONS.make(name, parameters, of, of.tick)
    layer.set_profile(RigidForce(of, along))
    return layer.step(step_input(of, along, 20.0, state, commands_in_flight, disturbance))


def plant(of, position, speed, lag, step_ns=1_000_000):
    """Return the simulated train of a model, without disturbances."""
    setup = PlantSetup.model_validate({"start": {"position": position, "speed": speed}, "lag": lag})
    return Train(of.consist, of.line, setup, step_ns=step_ns, tick_ns=TICK_NS)


def test_resistance_of_many_points_equals_that_of_one():
    """Same bits along and beyond the line, on and between the points of the table, forwards, at rest and backwards."""
    of = model(FIVE, HILLY)
    place = np.concatenate((np.linspace(HILLY.begin - 400.0, HILLY.end + 400.0, 701), np.arange(900.0, 1100.0)))
    speed = np.tile(np.linspace(-1.0, 1.0, 17), 53)
    single = [of.resisting_force(x, v) for x, v in zip(place.tolist(), speed.tolist(), strict=True)]
    assert of.resisting_forces(place, speed).tolist() == single


@pytest.mark.parametrize(("train", "how"), [(SINGLE, "rigid"), (FIVE, "chain"), (FIVE, "rigid")])
def test_prediction_equals_the_simulated_train(train, how):
    """0.8 s of changing commands through lag 0.4 s: within 2 mm, 2 mm/s and 1 % of the force."""
    of, along = model(train, LEVEL, delay=0.8, lag=0.4), profile()
    real = plant(of, 500.0, 10.0, 0.4)
    n = of.n_units
    commands = np.array([[20e3 + 4e3 * k] * n for k in range(16)])
    if how == "chain":
        commands = commands + 3e3 * np.arange(n)
    for command in commands[:8]:
        real.advance(np.tile(command, (real.substeps, 1)))
    seen = real.observe().measurement
    state = (seen.position, seen.velocity, seen.applied)
    view = step(of, "predictor", {"train": how}, along, state, commands[8:])
    for command in commands[8:]:
        real.advance(np.tile(command, (real.substeps, 1)))
    then = real.observe().measurement
    assert view.position == pytest.approx(then.position, abs=2e-3)
    assert view.velocity == pytest.approx(then.velocity, abs=2e-3)
    assert view.applied == pytest.approx(then.applied, rel=0.01)
    assert np.abs(then.velocity - seen.velocity).min() > 0.2
    assert view.reference_velocity[0] == along.at(20.8)[1]


def test_prediction_with_parts_of_ticks_and_overtaking_commands():
    """0.25 s on ticks of 0.1 s with a head wind of 4 kN; a brake command acts before older traction commands."""
    of, along = model(SINGLE, LEVEL, delay=0.25), profile()
    state = (np.array([500.0]), np.array([10.0]), np.array([9e3]))
    view = step(of, "predictor", {}, along, state, np.array([[10e3], [20e3], [30e3]]), np.array([-4e3]))
    given_off = (0.05 * 10e3 + 0.1 * 20e3 + 0.1 * 30e3) / 80e3 - 0.25 * (4e3 + of.running_resistance(10.0)) / 80e3
    assert view.velocity[0] == pytest.approx(10.0 + given_off, abs=8e-3)
    of, along = model(SINGLE, LEVEL, delay=1.0, delay_brake=0.5), profile()
    sent = np.array([[40e3]] * 7 + [[-60e3]] + [[-60e3]] * 2)
    view = step(of, "predictor", {}, along, (np.array([500.0]), np.array([10.0]), np.array([40e3])), sent)
    expected = 10.0 + (0.2 * 40e3 - 0.3 * 60e3 - 0.5 * of.running_resistance(10.0)) / 80e3
    assert view.velocity[0] == pytest.approx(expected, abs=5e-3) and view.applied[0] == -60e3


@given(ticks=st.integers(1, 15), seed=st.integers(0, 5))
def test_the_delay_is_found(ticks, seed):
    """From any initial delay, within 40 s of an ordinary command."""
    estimate = DelayEstimate(model(SINGLE, LEVEL, delay=0.5, lag=0.4), 2.0)
    rng = np.random.default_rng(seed)
    keep, acting, command = math.exp(-0.1 / 0.4), 0.0, 0.0
    queue = [0.0] * ticks
    for _ in range(400):
        commands_in_flight = estimate.step(np.array([[command]]), acting)
        command += float(rng.normal()) * 2e3
        queue.append(command)
        due = queue.pop(0)
        acting = due + (acting - due) * keep
    assert estimate.delay == pytest.approx(0.1 * ticks)
    assert commands_in_flight.shape[0] == max(1, ticks)


@pytest.mark.parametrize("every", [3, 5])
def test_the_delay_is_found_at_a_longer_control_period(every):
    """A law at 0.3 or 0.5 s on ticks of 0.1 s, and two gaps of a second; breaks if a call counts as one tick."""
    estimate = DelayEstimate(model(SINGLE, LEVEL, delay=0.5, lag=0.4), 2.0)
    rng = np.random.default_rng(3)
    keep, acting, command, last = math.exp(-0.1 / 0.4), 0.0, 0.0, 0
    sent, queue = [0.0] * 20, [0.0] * 9
    for k in range(600):
        if k % every == 0 and not (200 <= k < 210 or 300 <= k < 310):
            estimate.step(np.array(sent[-20:])[:, None], acting, max(1, k - last))
            last, command = k, command + float(rng.normal()) * 2e3
        sent.append(command)
        queue.append(command)
        due = queue.pop(0)
        acting = due + (acting - due) * keep
    assert estimate.delay == pytest.approx(0.9)


def test_a_predictor_needs_a_delay_and_driven_vehicles():
    """Breaks if an estimate without an initial delay, or a chain with hauled vehicles, is accepted."""
    with pytest.raises(ValueError, match="compensation 'predictor': delay: estimated needs an initial delay"):
        COMPENSATIONS.make("predictor", {"delay": "estimated"}, model(SINGLE), 0.1)
    with pytest.raises(
        ValueError,
        match=r"train: chain needs every vehicle driven, here 1 of 5; set compensations\.predictor\.train: rigid",
    ):
        COMPENSATIONS.make("predictor", {"train": "chain"}, model(HAULED, delay=0.5), 0.1)


def test_the_twin_of_units_has_their_rigid_force():
    """Newton's law within 2 % of the largest force; five units on a crest get different forces with its sum."""
    of, along = model(SINGLE, HILLY), profile()
    ahead = AheadTrain(of, along, TwinParameters(), None, 0.0)
    ahead.run(150.0, keep_from=0.0)
    times = np.arange(5.0, 140.0, 2.5)
    found = np.array([ahead.force(0, t) for t in times])
    needed = np.array([of.rigid_force(*along.at(t + 0.025)[:3]) for t in times])
    assert np.abs(found - needed).max() < 0.02 * np.abs(needed).max()
    of, along = model(FIVE, HILLY), profile()
    ahead = AheadTrain(of, along, TwinParameters(), None, 0.0)
    ahead.run(105.0, keep_from=0.0)
    forces = [ahead.force(unit, 100.0) for unit in range(5)]
    assert 1000.0 < along.at(100.0)[0] < 1400.0
    assert sum(forces) == pytest.approx(of.rigid_force(*along.at(100.025)[:3]), rel=0.03)
    assert max(forces) - min(forces) > 2e3


def test_the_twin_of_a_long_train_keeps_it_on_the_profile():
    """Its force through delay and lag, open loop, keeps a sprung train within 3 cm/s; a rigid feed-forward not."""
    types = {"loco": LOCOMOTIVE, "wagon": WAGON}
    soft = consist(types, [("loco", 1), ("wagon", 20)], SPRING | {"stiffness": 2e6, "damping": 5e3})
    of, along = model(soft, LEVEL, delay=0.8, lag=0.4), profile(pull=0.18)
    worst = {}
    for name in ("preview", "twin"):
        control = stack(of, "pid", {"kp": 0.0, "ki": 0.0}, name, along=along)
        real = plant(of, 0.0, 0.0, 0.4, 5_000_000)
        queue, errors = [np.zeros(1)] * 8, []
        for k in range(1200):
            reference, estimate = asked(of, along, k * TICK_NS)
            seen = real.observe().measurement
            queue.append(control.step(seen, reference, estimate)[0])
            errors.append(float(seen.velocity[0]) - reference.velocity)
            real.advance(np.tile(queue.pop(0), (real.substeps, 1)))
        worst[name] = np.abs(errors[30:]).max()
    assert worst["twin"] < 0.03 and worst["preview"] > 2.0 * worst["twin"]


def test_the_twin_damps_the_waves_in_its_couplers():
    """Breaks if its units are fixed ends: the wave of the departure of 105 wagons keeps its swing of 350 kN."""
    setup = setup_of("demo", changes={"plant": {"line": "level"}})
    ahead = AheadTrain(setup.model, setup.profile, TwinParameters(), None, 0.0)
    ahead.run(230.0, keep_from=0.0)
    early, late = (np.ptp([ahead.force(0, t) for t in np.arange(begin, begin + 40.0)]) for begin in (60.0, 180.0))
    assert early > 150e3 and late < 0.4 * early


@pytest.mark.parametrize("gap", [(), (20, 21, 22)])
def test_the_simulated_copy_predicts_the_train(gap):
    """Without lag and mismatch, predicted state and coupler force are those 0.5 s later, with or without gaps."""
    of, along = model(HAULED, HILLY, delay=0.5, sensors=(0,)), profile(pull=0.3)
    layer = COMPENSATIONS.make("train_predictor", {"step": 0.001}, of, of.tick)
    layer.set_profile(RigidForce(of, along))
    real, queue, views, truth = plant(of, 0.0, 0.0, 0.0), [np.zeros(1)] * 5, {}, []
    for k in range(60):
        seen = real.observe().measurement
        truth.append((float(seen.position[0]), float(seen.velocity[0]), float(real.coupler_force[0])))
        command = np.array([30e3 + 10e3 * math.sin(0.5 * k)]) if k not in gap else queue[-1]
        if k not in gap:
            state = (seen.position, seen.velocity, seen.applied)
            views[k] = layer.step(step_input(of, along, 0.1 * k, state, np.array(queue)))
            layer.on_command_sent(command)
        queue.append(command)
        real.advance(np.tile(queue.pop(0), (real.substeps, 1)))
    for k, view in views.items():
        if 0 < k < 55:
            found = (view.position[0], view.velocity[0], view.coupler_force[0])
            assert found == pytest.approx(truth[k + 5], rel=1e-6, abs=1e-3)
    assert truth[-1][1] > 0.2


def test_measured_state_passes_through_twin_and_preview():
    """They change the feed-forward only: state and reference are those of the present."""
    of, along = model(FIVE, LEVEL, delay=0.5, lag=0.4), profile()
    seen = measured(of, 0, 500.0, 10.0, 1e3)
    for name in ("preview", "twin", "pade", "none"):
        view = step(of, name, {}, along, (seen.position, seen.velocity, seen.applied), np.zeros((5, 5)))
        assert (view.position == seen.position).all()
        assert view.reference_velocity[0] == along.at(20.0)[1]
        assert view.delay_to_effect == pytest.approx(0.5 if name in ("preview", "twin") else 0.0)


@pytest.mark.parametrize("every", [1, 5])
def test_a_law_slower_than_the_loop_estimates_the_same_delay(every: int) -> None:
    """Breaks if the ticks between two calls are not counted: a true delay of 0.5 s counts as one of 0.1 s."""
    of = model(SINGLE, delay=0.2)
    layer = COMPENSATIONS.make("predictor", {"delay": "estimated"}, of, every * of.tick)
    layer.set_profile(RigidForce(of, profile()))
    random = np.random.default_rng(3)
    sent = np.repeat(random.uniform(-100e3, 100e3, 300 // every), every)[:, None]
    for tick in range(10 * every, 300 - every, every):
        state = (np.array([100.0]), np.array([10.0]), sent[tick - 6])
        layer.step(step_input(of, profile(), tick * of.tick, state, sent[tick - 2 * every : tick]))
    assert layer.actuators["forward"].tolist() == pytest.approx([0.5])
