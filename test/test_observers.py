"""Observers and compensations: exact between samples, held over gaps, errors in closed form, a simulated train."""

import math

import law_trains as lt
import numpy as np
import pytest
from engine_runs import setup_of
from hypothesis import given, settings
from hypothesis import strategies as st

from plant_sim.plant_setup import PlantSetup
from plant_sim.train import Train
from train_ato.control.air_brake.policy import BrakeSpec, make_brake_policy
from train_ato.control.compensation.ahead_train import AheadTrain, TwinParameters
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.compensation.predictor import DelayEstimate
from train_ato.control.compensation.rigid import RigidForce
from train_ato.control.observers.cascaded import Cascade, CascadedParameters
from train_ato.control.observers.contract import ObserverInput, ObserverStack
from train_ato.control.observers.force_balance import lag_weight
from train_ato.control.registry import COMPENSATIONS, OBSERVERS
from train_ato.messages.types import Measurement, Reference


def observe(observer, of, speeds, applied, period, **more):
    """Run an observer over speeds and forces; return the estimates."""
    found = []
    for k, (speed, force) in enumerate(zip(speeds, applied, strict=True)):
        seen = lt.measured(of, round(k * period * 1e9), 0.0, speed, force)
        found.append(float(observer.step(ObserverInput.of(seen, **more))[0]))
    return np.array(found)


@given(omega=st.floats(0.01, 1e5), period=st.floats(0.001, 1.0), push=st.floats(-0.5, 0.5))
def test_exact_for_any_bandwidth(omega, period, push):
    """A constant force gives 1 - exp(-omega t), for omega Tc from 1e-5 to 1e5; explicit Euler diverges above 2."""
    of = lt.model(lt.SINGLE, tick=period)
    observer = OBSERVERS.make("ndo", {"omega": omega, "model_error": 0.0}, of, period)
    count = 12
    speeds, force = [20.0], []
    for _ in range(count):
        force.append(float(of.own_resistance(np.array([speeds[-1]]), np.zeros(1))[0]))
        speeds.append(speeds[-1] + push * period)
    found = observe(observer, of, speeds[:-1], [0.0, *force[:-1]], period)
    expected = 80e3 * push * -np.expm1(-omega * period * np.arange(count))
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-6 * 80e3 + 1e-9 * 80e3 / period)


@pytest.mark.parametrize(
    ("train", "name", "parameters", "steps", "forces", "rel"),
    [
        (lt.FIVE, "ndo", {"scope": "train", "omega": 50.0}, 20, [8e3] * 5, 1e-3),
        (lt.PUSHED, "eso", {"omega": 20.0}, 40, [33.4e3] * 2, 0.01),
    ],
)
def test_the_balance_of_a_train_is_shared_over_the_units(train, name, parameters, steps, forces, rel):
    """400 t, and two locomotives with wagons between of 668 t, at 0.1 m/s²: the total is shared."""
    of = lt.model(train)
    observer = OBSERVERS.make(name, parameters, of, 0.1)
    for k in range(steps):
        speed = 10.0 + 0.01 * k
        force = of.running_resistance(speed) / of.n_units
        out = observer.step(ObserverInput.of(lt.measured(of, k * 100_000_000, 0.0, speed, force)))
    assert out == pytest.approx(np.array(forces), rel=rel)


def test_vehicle_scope_uses_the_coupler():
    """With the coupler force a hauled locomotive in balance has no disturbance; without it 200 kN."""
    of = lt.model(lt.HAULED, sensors=(0,))
    observer = OBSERVERS.make("ndo", {"model_error": 0.0}, of, 0.1)
    own = float(of.own_resistance(np.array([10.0]), np.array([500.0]))[0])
    for k in range(10):
        seen = lt.measured(of, k * 100_000_000, 500.0, 10.0, 200e3 + own)
        forces = seen.applied, np.array([200e3]), np.zeros(1)
        out = observer.step(ObserverInput(seen.stamp * 1e-9, seen.position, seen.velocity, *forces))
    assert abs(out[0]) < 1e-6


def test_gaps_and_invalid_samples_are_not_used():
    """A NaN changes neither the estimate nor the difference quotient of the next sample."""
    of = lt.model(lt.SINGLE)
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
    of = lt.model(lt.FIVE)
    observer = ObserverStack(of, OBSERVERS.make("none", {}, of, 0.1), make_brake_policy(BrakeSpec(), of, of.line))
    estimate = observer.step(lt.measured(of, 700_000_000, 0.0, 10.0, 0.0))
    assert estimate.stamp == 700_000_000
    assert (estimate.force == np.zeros(5)).all()


def follow(cascade, period, duration, amplitude=1.0):
    """Simulate x' = v + d1, v' = d2 with d11 and d12 of the paper; return the relative rms errors after 1 s."""
    t = np.arange(0.0, duration, period)
    d1, rate = 3 * np.sin(t + np.pi / 6), 3 * np.cos(t + np.pi / 6)
    d2 = amplitude * 6 * np.sin(3 * t) * np.cos(t)
    speed = amplitude * 1.5 * (1 - np.cos(2 * t)) + amplitude * 0.75 * (1 - np.cos(4 * t))
    integral = amplitude * (1.5 * (t - np.sin(2 * t) / 2) + 0.75 * (t - np.sin(4 * t) / 4))
    place = integral + 3 * (np.cos(np.pi / 6) - np.cos(t + np.pi / 6))
    found = np.empty((t.size, 3))
    for k in range(t.size):
        cascade.step(float(place[k]), float(speed[k]), 0.0)
        found[k] = cascade.d1, cascade.d1_rate, cascade.d2
    settled = t > 1.0
    return [
        float(np.sqrt(np.mean((found[settled, i] - truth[settled]) ** 2) / np.mean(truth[settled] ** 2)))
        for i, truth in enumerate((d1, rate, d2))
    ]


@pytest.mark.parametrize(
    ("period", "levant", "implicit"),
    [(1e-3, (0.001, 0.05, 0.005), (0.05, 0.10, 0.12)), (1e-2, (0.01, 0.45, 0.02), (0.05, 0.10, 0.12))],
)
def test_accuracy_over_the_period(period, levant, implicit):
    """Relative rms of d1, d1', d2: Levant's is best, but its d1' degrades from 4 to 36 % between 1 and 10 ms."""
    assert (np.array(follow(Cascade(CascadedParameters(method="levant"), period), period, 6.0)) <= levant).all()
    assert (np.array(follow(Cascade(CascadedParameters(), period), period, 6.0)) <= implicit).all()


def test_implicit_signs_do_not_chatter():
    """For a constant disturbance the estimate is constant to rounding; explicit signs would ripple by k Tc."""
    cascade = Cascade(CascadedParameters(), 0.01)
    found = []
    for k in range(400):
        cascade.step(0.5 * 0.01 * k + 0.5 * 2.0 * (0.01 * k) ** 2, 2.0 * 0.01 * k, 0.0)
        found.append((cascade.d1, cascade.d2))
    rest = np.array(found[-50:])
    assert np.ptp(rest, axis=0).max() < 1e-9
    assert rest[-1] == pytest.approx((0.5, 2.0), rel=1e-6)


@given(omega=st.floats(0.05, 1e4), period=st.floats(0.002, 0.5), push=st.floats(-1.0, 1.0))
def test_eso_error_is_the_closed_form(omega, period, push):
    """The error is d (1 + k (1-b)) b^k, b = exp(-omega Tc): double pole, no offset, stable for any omega Tc."""
    of = lt.model(lt.SINGLE, tick=period)
    eso = OBSERVERS.make("eso", {"omega": omega}, of, period)
    count = 15
    speeds, force = [20.0], [0.0]
    for _ in range(count - 1):
        speeds.append(speeds[-1] + push * period)
        own = [of.own_resistance(np.array([speed]), np.zeros(1))[0] for speed in speeds[-2:]]
        force.append(0.5 * float(own[0] + own[1]))
    seen = [lt.measured(of, round(k * period * 1e9), 0.0, speeds[k], force[k]) for k in range(count)]
    found = [eso.step(ObserverInput.of(sample))[0] / 80e3 for sample in seen]
    b, k = math.exp(-omega * period), np.arange(count)
    expected = push * (1 - (1 + k * (1 - b)) * b**k)
    assert np.array(found) == pytest.approx(expected, abs=1e-9 + 1e-9 / period)


@pytest.mark.parametrize("name", ["ndo", "eso", "cascaded"])
@given(values=st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=3, max_size=12))
def test_every_estimate_is_finite(name, values):
    """For any measurement the estimate is finite; after reset() the same inputs give the same bits."""
    of = lt.model(lt.FIVE)
    observer = OBSERVERS.make(name, {}, of, 0.1)

    seen = [lt.measured(of, k * 100_000_000, value, 10.0 if k % 2 else value, value) for k, value in enumerate(values)]

    def run():
        return np.array([observer.step(ObserverInput.of(sample)) for sample in seen])

    first = run()
    assert np.isfinite(first).all()
    observer.reset()
    assert run().tobytes() == first.tobytes()


@pytest.mark.parametrize("name", ["ndo", "eso", "cascaded"])
def test_coupler_forces_between_units_are_no_disturbance(name):
    """A stretched coupler between two driven vehicles gives no estimate: 160 kN/m by 0.2 m would be 32 kN."""
    of = lt.model(lt.FIVE)
    observer = OBSERVERS.make(name, {} if name != "ndo" else {"model_error": 0.0}, of, 0.1)
    place = 500.0 - of.offsets + np.array([0.2, 0, 0, 0, 0])
    own = of.own_resistance(np.full(5, 10.0), place)
    applied = own + np.array([32e3, -32e3, 0, 0, 0])
    for k in range(30):
        seen = lt.measured(of, k * 100_000_000, place + k * 1.0, 10.0, applied)
        out = observer.step(ObserverInput.of(seen))
    assert np.abs(out).max() < 1.0


@given(period=st.floats(0.005, 1.0), lag=st.floats(0.01, 5.0), start=st.floats(-1, 1), aim=st.floats(-1, 1))
def test_mean_force_of_a_lag_is_exact(period, lag, start, aim):
    """From the forces at both ends of a tick only; without lag it is the force of the end."""
    keep = math.exp(-period / lag)
    end = aim + (start - aim) * keep
    mean = aim + (start - aim) * (1 - keep) * lag / period
    weight = lag_weight(period, lag)
    assert weight * start + (1 - weight) * end == pytest.approx(mean, abs=1e-9)
    assert lag_weight(period, 0.0) == 0.0


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
    of = lt.model(lt.FIVE, lt.HILLY)
    place = np.concatenate((np.linspace(lt.HILLY.begin - 400.0, lt.HILLY.end + 400.0, 701), np.arange(900.0, 1100.0)))
    speed = np.tile(np.linspace(-1.0, 1.0, 17), 53)
    single = [of.resisting_force(x, v) for x, v in zip(place.tolist(), speed.tolist(), strict=True)]
    assert of.resisting_forces(place, speed).tolist() == single


@pytest.mark.parametrize(("train", "how"), [(lt.SINGLE, "rigid"), (lt.FIVE, "chain"), (lt.FIVE, "rigid")])
def test_prediction_equals_the_simulated_train(train, how):
    """0.8 s of changing commands through lag 0.4 s: within 2 mm, 2 mm/s and 1 % of the force."""
    of, along = lt.model(train, lt.LEVEL, delay=0.8, lag=0.4), lt.profile()
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
    of, along = lt.model(lt.SINGLE, lt.LEVEL, delay=0.25), lt.profile()
    state = (np.array([500.0]), np.array([10.0]), np.array([9e3]))
    view = step(of, "predictor", {}, along, state, np.array([[10e3], [20e3], [30e3]]), np.array([-4e3]))
    given_off = (0.05 * 10e3 + 0.1 * 20e3 + 0.1 * 30e3) / 80e3 - 0.25 * (4e3 + of.running_resistance(10.0)) / 80e3
    assert view.velocity[0] == pytest.approx(10.0 + given_off, abs=8e-3)
    of, along = lt.model(lt.SINGLE, lt.LEVEL, delay=1.0, delay_brake=0.5), lt.profile()
    sent = np.array([[40e3]] * 7 + [[-60e3]] + [[-60e3]] * 2)
    view = step(of, "predictor", {}, along, (np.array([500.0]), np.array([10.0]), np.array([40e3])), sent)
    expected = 10.0 + (0.2 * 40e3 - 0.3 * 60e3 - 0.5 * of.running_resistance(10.0)) / 80e3
    assert view.velocity[0] == pytest.approx(expected, abs=5e-3) and view.applied[0] == -60e3


@pytest.mark.parametrize("every", [1, 3, 5])
@settings(max_examples=20)
@given(ticks=st.integers(0, 15), seed=st.integers(0, 5))
def test_the_delay_is_found(every, ticks, seed):
    """From any initial delay, also by a slow law with two gaps of a second; breaks if a call counts as one tick."""
    estimate = DelayEstimate(lt.model(lt.SINGLE, lt.LEVEL, delay=0.5, lag=0.4), 2.0)
    rng = np.random.default_rng(seed)
    keep, acting, command, last = math.exp(-0.1 / 0.4), 0.0, 0.0, 0
    sent, queue = [0.0] * 20, [0.0] * ticks
    for k in range(600):
        if k % every == 0 and not (200 <= k < 210 or 300 <= k < 310):
            in_flight = estimate.step(np.array(sent[-20:])[:, None], acting, max(1, k - last))
            last, command = k, command + float(rng.normal()) * 2e3
        sent.append(command)
        queue.append(command)
        due = queue.pop(0)
        acting = due + (acting - due) * keep
    assert estimate.delay == pytest.approx(0.1 * ticks)
    assert in_flight.shape[0] == max(1, ticks)


def test_a_predictor_needs_a_delay_and_driven_vehicles():
    """Breaks if an estimate without an initial delay, or a chain with hauled vehicles, is accepted."""
    with pytest.raises(ValueError, match="compensation 'predictor': delay: estimated needs an initial delay"):
        COMPENSATIONS.make("predictor", {"delay": "estimated"}, lt.model(lt.SINGLE), 0.1)
    with pytest.raises(
        ValueError,
        match=r"train: chain needs every vehicle driven, here 1 of 5; set compensations\.predictor\.train: rigid",
    ):
        COMPENSATIONS.make("predictor", {"train": "chain"}, lt.model(lt.HAULED, delay=0.5), 0.1)


def test_the_twin_of_units_has_their_rigid_force():
    """Newton's law within 2 % of the largest force; five units on a crest get different forces with its sum."""
    of, along = lt.model(lt.SINGLE, lt.HILLY), lt.profile()
    ahead = AheadTrain(of, along, TwinParameters(), None, 0.0)
    ahead.run(150.0, keep_from=0.0)
    times = np.arange(5.0, 140.0, 2.5)
    found = np.array([ahead.force(0, t) for t in times])
    needed = np.array([of.rigid_force(*along.at(t + 0.025)[:3]) for t in times])
    assert np.abs(found - needed).max() < 0.02 * np.abs(needed).max()
    of, along = lt.model(lt.FIVE, lt.HILLY), lt.profile()
    ahead = AheadTrain(of, along, TwinParameters(), None, 0.0)
    ahead.run(105.0, keep_from=0.0)
    forces = [ahead.force(unit, 100.0) for unit in range(5)]
    assert 1000.0 < along.at(100.0)[0] < 1400.0
    assert sum(forces) == pytest.approx(of.rigid_force(*along.at(100.025)[:3]), rel=0.03)
    assert max(forces) - min(forces) > 2e3


def test_the_twin_of_a_long_train_keeps_it_on_the_profile():
    """Its force through delay and lag, open loop, keeps a sprung train within 3 cm/s; a rigid feed-forward not."""
    types = {"loco": lt.LOCOMOTIVE, "wagon": lt.WAGON}
    soft = lt.consist(types, [("loco", 1), ("wagon", 20)], lt.SPRING | {"stiffness": 2e6, "damping": 5e3})
    of, along = lt.model(soft, lt.LEVEL, delay=0.8, lag=0.4), lt.profile(pull=0.18)
    worst = {}
    for name in ("preview", "twin"):
        control = lt.stack(of, "pid", {"kp": 0.0, "ki": 0.0}, name, along=along)
        real = plant(of, 0.0, 0.0, 0.4, 5_000_000)
        queue, errors = [np.zeros(1)] * 8, []
        for k in range(1200):
            reference, estimate = lt.asked(of, along, k * TICK_NS)
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
    of, along = lt.model(lt.HAULED, lt.HILLY, delay=0.5, sensors=(0,)), lt.profile(pull=0.3)
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
    of, along = lt.model(lt.FIVE, lt.LEVEL, delay=0.5, lag=0.4), lt.profile()
    seen = lt.measured(of, 0, 500.0, 10.0, 1e3)
    for name in ("preview", "twin", "pade", "none"):
        view = step(of, name, {}, along, (seen.position, seen.velocity, seen.applied), np.zeros((5, 5)))
        assert (view.position == seen.position).all()
        assert view.reference_velocity[0] == along.at(20.0)[1]
        assert view.delay_to_effect == pytest.approx(0.5 if name in ("preview", "twin") else 0.0)


@pytest.mark.parametrize("every", [1, 5])
def test_a_law_slower_than_the_loop_estimates_the_same_delay(every: int) -> None:
    """Breaks if the ticks between two calls are not counted: a true delay of 0.5 s counts as one of 0.1 s."""
    of = lt.model(lt.SINGLE, delay=0.2)
    layer = COMPENSATIONS.make("predictor", {"delay": "estimated"}, of, every * of.tick)
    layer.set_profile(RigidForce(of, lt.profile()))
    random = np.random.default_rng(3)
    sent = np.repeat(random.uniform(-100e3, 100e3, 300 // every), every)[:, None]
    for tick in range(10 * every, 300 - every, every):
        state = (np.array([100.0]), np.array([10.0]), sent[tick - 6])
        layer.step(step_input(of, lt.profile(), tick * of.tick, state, sent[tick - 2 * every : tick]))
    assert layer.actuators["forward"].tolist() == pytest.approx([0.5])
