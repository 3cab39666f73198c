"""Parts of the law mpc: solver, responses, observer, identification and the whole law on short runs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import train_ato as ta
from plant_sim.library import load_consist, load_line
from train_ato.control.algorithms.actuator_identification import ActuatorIdentification
from train_ato.control.algorithms.horizon_model import horizon_model, node_times, ramp_response, responses
from train_ato.control.algorithms.motion_observer import MotionObserver
from train_ato.control.algorithms.predictive_plan import decide, free_motion
from train_ato.control.algorithms.quadratic_program import inverse, multipliers
from train_ato.control.train_model import TrainModel


def _model(delay=1.0, lag=0.4):
    units = 3
    delays = np.full(units, delay)
    return TrainModel(load_consist("crh380a_three_units"), load_line("level"), delays, delays, lag, 0.1)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), rows=st.integers(1, 40))
def test_multipliers_solve_the_complementarity_problem(seed, rows):
    """A wrong exchange leaves a negative multiplier, a negative slack, or both positive."""
    random = np.random.default_rng(seed)
    factor = random.normal(size=(rows, rows))
    matrix = factor @ factor.T + 0.1 * np.eye(rows)
    slack, found = random.normal(size=rows), np.zeros(rows)
    active = random.random(rows) < 0.3
    assert multipliers(matrix, slack, active, found) >= 0
    rest = slack + matrix @ found
    scale = np.abs(slack).max()
    assert found.min() >= 0.0
    assert rest.min() >= -1e-6 * scale
    assert np.abs(found * rest).max() <= 1e-6 * scale * max(1.0, found.max())


def test_inverse_of_a_positive_definite_matrix():
    """A wrong index in factor or substitution gives another matrix."""
    factor = np.random.default_rng(1).normal(size=(20, 20))
    matrix = factor @ factor.T + np.eye(20)
    np.testing.assert_allclose(inverse(matrix) @ matrix, np.eye(20), atol=1e-9)


@pytest.mark.parametrize("lag", [0.0, 0.4])
def test_responses_equal_a_fine_simulation(lag):
    """A wrong sign or power in a closed form, or a shifted delay, differs from the integrated response."""
    nodes, delay = node_times(0.3, 20.0, 8), 1.0
    position, velocity = responses(nodes, np.array([delay]), np.ones(1), lag, delay)
    step = 1e-3
    times = np.arange(0.0, 22.0, step)
    decision = np.zeros(8)
    decision[2] = 1.0
    demand = np.interp(times - delay + 0.5 * step, nodes, decision, left=0.0)
    force = demand.copy()
    if lag:
        held = 0.0
        for k, value in enumerate(demand):
            held += (value - held) * (1.0 - math.exp(-step / lag))
            force[k] = held
    speed = np.concatenate(([0.0], np.cumsum(force) * step))
    place = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) * step))
    at = np.rint((delay + nodes) / step).astype(int)
    np.testing.assert_allclose(velocity[:, 2], speed[at], atol=2e-3)
    np.testing.assert_allclose(position[:, 2], place[at], atol=2e-2)
    assert ramp_response(-1.0, lag)[0] == 0.0


def test_plan_without_constraints_has_the_gains_of_the_regulator():
    """Wrong weights change z = -2 omega e_v - a omega² e_p; the bound is the error of the trapezoidal rule."""
    omega, share = 0.4, 0.5
    nodes = node_times(0.1, 120.0, 40)
    side = horizon_model(nodes, np.zeros(1), np.ones(1), 0.0, 0.0, omega, share)
    found = []
    for position, velocity in ((1.0, 0.0), (0.0, 1.0)):
        errors = np.array([position + velocity * nodes, velocity + 0.0 * nodes])
        z, active = np.zeros(40), np.zeros(200, dtype=np.bool_)
        gradients = (side.gradient_position, side.gradient_velocity)
        allowed = np.full(200, 1e9)
        decide(gradients, side.inverse, side.limited, side.dual, side.constraints, errors, allowed, active, z)
        found.append(-z[0])
    np.testing.assert_allclose(found, [share * omega**2, 2.0 * omega], rtol=0.05)


def test_free_motion_uses_the_delay_of_the_sign():
    """With one delay for both signs, a braking command in flight acts too late."""
    actuators = np.array([[1.0], [0.5], [1.0]])
    sent = np.zeros((10, 1))
    sent[-1] = -1000.0  # arrives after 0.4 s, since it was sent 0.1 s ago
    motion = np.zeros(4)
    free_motion(motion, np.zeros(1), sent, np.zeros(11), actuators, 0.1, 0.0, 1000.0)
    assert motion[1] == pytest.approx(-0.6)  # from 0.4 s to 1.0 s, as no later command replaces it


def test_observer_finds_a_constant_disturbance():
    """An observer without integral action keeps an offset; noise must not count as a change of the disturbance."""
    random = np.random.default_rng(3)
    observer = MotionObserver(0.1, 1.0, 0.0)
    speed = position = 0.0
    for _ in range(600):
        position += (speed + 0.5 * 0.05 * 0.1) * 0.1
        speed += 0.05 * 0.1
        observer.step(position, speed + 0.05 * random.normal(), 0.0)
    assert observer.disturbance == pytest.approx(0.05, abs=0.01)
    assert observer.speed_noise == pytest.approx(0.05, rel=0.3)


def _identified(plant_delay, plant_gain, model_delay=1.0, spoil=0.0):
    """Return the identification after 60 s of a sinusoidal command, forces of a simulated actuator."""
    model = _model(model_delay)
    identification = ActuatorIdentification(model, 0.1)
    random = np.random.default_rng(5)
    commands = [np.full(3, 3e4 * math.sin(0.03 * k)) for k in range(600)]
    force, decay = 0.0, math.exp(-0.1 / model.lag)
    late = round(plant_delay / 0.1)
    for k in range(1, 600):
        due = plant_gain * float(commands[k - 1 - late].sum()) if k > late else 0.0
        force = due + (force - due) * decay
        identification.step(commands[k - 1], force + spoil * random.normal())
    return identification


@pytest.mark.parametrize(("delay", "gain"), [(1.0, 1.0), (1.5, 1.0), (0.5, 0.8), (1.2, 1.3)])
def test_identification_finds_delay_and_gain(delay, gain):
    """A shifted history, or a gain not divided out, gives another factor; candidates are .1 apart."""
    found = _identified(delay, gain)
    assert found.factor == pytest.approx(delay, abs=0.051)
    assert found.gain == pytest.approx(gain, rel=0.02)
    assert not found.model_is_wrong


def test_identification_reports_a_wrong_model():
    """Force without relation to the commands must be reported, and the gain must stay in its bounds."""
    found = _identified(1.0, 1.0, spoil=1e5)
    assert found.model_is_wrong
    assert 0.5 <= found.gain <= 1.5


def test_delay_longer_than_the_model_is_learnt_in_a_run():
    """Without the new delay in the prediction the second half of the run is as bad as the first."""
    delays = {"links.command.delay": [1.5, 1.65, 1.8], "links.command.delay_brake": [0.9, 1.05, 1.2], "duration": 90}
    run = ta.run("crh380a_gpc:short", law="mpc", set=delays, progress=False)
    error = np.abs(run["train/measurement"]["unit_0_speed_m_s"] - run["ato/reference"]["speed_m_s"]).to_numpy()
    assert error[600:].max() < 0.25 * error[:600].max()


@pytest.mark.parametrize("compensation", ["twin", "predictor"])
def test_compensations_that_do_not_fit_are_refused(compensation):
    """A predicting compensation would count the delay twice; the feed-forward of twin is not used."""
    with pytest.raises(ValueError, match="law 'mpc' with compensation"):
        ta.run("demo", law="mpc", compensation=compensation, set={"duration": 1}, progress=False)
