"""Paper 004: sampled model, Diophantine identity, optimum, identification, sampling period."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from law_trains import FIVE, HILLY, SINGLE, inputs, model, printed_law

from train_ato.control.algorithms.coupled_units import matrix_exponential
from train_ato.control.algorithms.predictive_law import (
    Increments,
    ResidualNetwork,
    diophantine,
    linear_law,
    response_and_past,
    sampled_actuator,
)
from train_ato.control.contract import Preview
from train_ato.control.laws.gpc import Gpc, GpcParameters


def multiply(p, q, length):
    """Return the product of two polynomials in z⁻¹ with a given length."""
    product = np.convolve(p, q)
    return np.pad(product, (0, max(0, length - product.size)))[:length]


@given(
    a=st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3),
    b=st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
    horizon=st.integers(1, 12),
)
def test_diophantine_identity(a, b, horizon):
    """(13), (14) for every j: E_j A + z^-j F_j = 1 and G_j + z^-j H_j = E_j B, coefficient by coefficient."""
    a, b = np.array([1.0, *a]), np.array(b)
    e, f = diophantine(a, horizon)
    g, h = response_and_past(e, b, horizon)
    for j in range(1, horizon + 1):
        size = j + 3
        one = multiply(e[:j], a, size) + np.concatenate((np.zeros(j), f[j - 1]))
        assert one == pytest.approx(np.eye(size)[0], abs=1e-9 * 3.0**j)
        split = np.concatenate((g[:j], h[j - 1], [0.0]))[:size]
        assert split == pytest.approx(multiply(e[:j], b, size), abs=1e-9 * 3.0**j)


@pytest.mark.parametrize(("delay", "lag", "period"), [(1.0, 0.4, 1.2), (0.6, 0.4, 0.4), (1.2, 0.4, 0.1)])
def test_sampled_model_is_the_padé_plant_under_a_held_command(delay, lag, period):
    """Simulated in 20 000 steps per sample; breaks for a bilinear transform, which has a feed-through."""
    a, b = sampled_actuator(delay, lag, period)
    assert abs(a.sum()) < 1e-9
    commands = np.random.default_rng(1).normal(size=8)
    pole, n = 2 / delay, 20_000
    h, x, y, v = period / n, 0.0, 0.0, 0.0
    speeds = [0.0]
    for u in commands:
        for _ in range(n):
            xm = x + 0.5 * h * (u - pole * x)
            ym = y + 0.5 * h * (2 * pole * x - u - y) / lag
            x, y, v = x + h * (u - pole * xm), y + h * (2 * pole * xm - u - ym) / lag, v + h * ym
        speeds.append(v)
    past_v, past_u = [0.0] * 3, [0.0] * 3
    for k, u in enumerate(commands):
        past_u = [u, *past_u[:2]]
        predicted = -a[1:] @ np.array(past_v) + b @ np.array(past_u)
        assert predicted == pytest.approx(speeds[k + 1], abs=2e-6)
        past_v = [predicted, *past_v[:2]]


def test_matrix_exponential():
    """Against a rotation and a nilpotent matrix, where it is exact."""
    turn = matrix_exponential(np.array([[0.0, -30.0], [30.0, 0.0]]))
    assert turn == pytest.approx(np.array([[np.cos(30), -np.sin(30)], [np.sin(30), np.cos(30)]]), abs=1e-10)
    assert matrix_exponential(np.array([[0.0, 2.0], [0.0, 0.0]])) == pytest.approx(np.array([[1.0, 2.0], [0.0, 1.0]]))


def best_first_command(speeds, commands, residual, target, beyond="zero"):
    """Simulate (7) for any two commands after the past, minimise (12) by least squares; return model and command."""
    a, b = sampled_actuator(1.0, 0.4, 1.2)

    def rollout(first, second):
        v, u, found = list(speeds), list(commands), []
        for j in range(target.size):
            u = [(first, second)[j] if j < 2 else (second if beyond == "hold" else 0.0), *u]
            v = [float(-a[1:] @ np.array(v[:3]) + b @ np.array(u[:3]) + residual), *v]
            found.append(v[0])
        return np.array(found)

    base = rollout(0.0, 0.0)
    effect = np.column_stack((rollout(1.0, 0.0) - base, rollout(0.0, 1.0) - base))
    rows = np.vstack((effect, np.sqrt(0.3) * np.eye(2)))
    return a, b, float(np.linalg.lstsq(rows, np.concatenate((target - base, np.zeros(2))), rcond=None)[0][0])


@pytest.mark.parametrize("beyond", ["zero", "hold"])
def test_first_command_minimises_the_cost(beyond):
    """The first command is that of (18)."""
    v, u, xi = [5.0, 4.9, 4.85], [0.1, -0.2], 0.03
    target = np.array([5.2, 5.3, 5.5, 5.6, 5.8])
    a, b, best = best_first_command(v, u, xi, target, beyond)
    law = linear_law(a, b, GpcParameters(n=5, nu=2, command_weight=0.3, beyond_horizon=beyond))
    found = law.tracking @ target - law.feedback @ np.array(v) - law.past @ np.array(u) - xi * law.residual
    assert found == pytest.approx(best, rel=1e-9) and law.scale == pytest.approx(1.0, abs=1e-9)


def test_identification_on_increments_finds_the_gain():
    """Plant with 0.8 of the gain and a constant force: the static gain goes from 1 to 0.8, the pole at 1 stays."""
    a, b = sampled_actuator(1.0, 0.4, 1.2)
    found = Increments(a, b, 0.5)
    rng = np.random.default_rng(2)
    speeds, sent = [10.0] * 4, [0.0] * 4
    first = last = 0.0
    for k in range(4000):
        speeds = [float(-a[1:] @ np.array(speeds[:3]) + 0.8 * b @ np.array(sent[:3])), *speeds[:3]]
        miss = found.miss(speeds, sent)
        first, last = (abs(miss) if k < 50 else 0.0) + first, 0.99 * last + 0.01 * abs(miss)
        found.learn(speeds, sent, miss, absolute=False)
        sent = [float(rng.uniform(-1, 1)), *sent[:3]]
    new_a, new_b = found.polynomials()
    assert abs(new_a.sum()) < 1e-12
    inner = np.cumsum(new_a)[:3].sum()
    assert new_b.sum() / inner == pytest.approx(0.8 * b.sum() / np.cumsum(a)[:3].sum(), rel=0.03)
    assert last < 0.02 * first / 50


def test_residual_network_integrates_slowly_to_a_constant():
    """A constant residual is learnt without offset, in tens of samples and not in one."""
    net = ResidualNetwork(6)
    estimates = []
    for _ in range(200):
        net.learn(0.05, 0.15)
        estimates.append(net.estimate([20.0] * 3, [0.1] * 3))
    assert 0.0 < estimates[0] < 0.03 and estimates[-1] == pytest.approx(0.05, rel=1e-3)


def drive(law, of, delay, period, steps, push=0.0):
    """Simulate one vehicle through delay and lag 0.4 s from 10 m/s to a reference of 11 m/s; return its speeds."""
    speed, acting, queue, speeds = 10.0, 0.0, [0.0] * round(delay / period), []
    keep = np.exp(-period / 0.4)
    for _ in range(steps):
        seen = inputs(
            of,
            velocity=np.array([speed]),
            reference_velocity=np.array([11.0]),
            preview=Preview(np.zeros(80), np.full(80, 11.0), np.zeros(80)),
        )
        queue.append(float(law.step(seen).force[0]))
        due = queue.pop(0)
        acting = due + (acting - due) * keep
        speed += ((acting - of.running_resistance(speed)) / of.inertia + push) * period
        speeds.append(speed)
    return np.array(speeds)


@pytest.mark.parametrize(("sampling", "good"), [(1.2, True), (0.4, False), (0.2, False)])
def test_the_sampling_period_decides(sampling, good):
    """N = 3, Nu = 2 with a delay of 1.2 s: settled at a sampling of 1.2 s, oscillating at 0.4 s and below."""
    of = model(SINGLE, delay=1.2, lag=0.4)
    law = printed_law("gpc", {"sampling": sampling, "identify": "none"}, of, 0.1)
    speeds = drive(law, of, 1.2, 0.1, 2400)
    assert bool(np.ptp(speeds[-300:]) < 0.01) is good
    if good:
        assert speeds[-1] == pytest.approx(11.0, abs=0.005)


def test_samples_horizons_and_preview_of_the_law():
    """Between samples the command is held; a ramp of the preview is interpolated at 1.2, 2.4 and 3.6 s exactly."""
    of = model(FIVE, delay=1.0, lag=0.4)
    law = printed_law("gpc", {"sampling": 0.5}, of, 0.1)
    forces = [law.step(inputs(of, velocity=np.full(5, 10.0 - 0.01 * k))).force[0] for k in range(10)]
    assert forces == [forces[0]] * 5 + [forces[5]] * 5 and forces[0] != forces[5]
    assert law.horizon == 16
    of = model(SINGLE)
    law = printed_law("gpc", {}, of, 0.1)
    times = 0.25 + 0.1 * np.arange(law.horizon)
    seen = inputs(of, delay_to_effect=0.25, preview=Preview(np.zeros(37), 10.0 + 0.3 * times, np.zeros(37)))
    assert law._ahead(seen) == pytest.approx(10.0 + 0.3 * np.array([1.2, 2.4, 3.6]), rel=1e-12)
    with pytest.raises(ValueError, match="nu 4 is longer than n 3"):
        Gpc(GpcParameters(nu=4), model(SINGLE), 0.1)


def test_one_step_by_hand():
    """(12), (18) on three units: least squares for the reference ahead, minus d_hat, split over the units."""
    # At the first step the past is steady at 10 m/s without command and without residual.
    of = model(FIVE, delay=1.0, lag=0.4)
    law = printed_law("gpc", {"sampling": 1.2, "command_weight": 0.3}, of, 0.4)
    ahead = 10.0 + 0.05 * np.arange(10)
    out = law.step(inputs(of, preview=Preview(np.zeros(10), ahead, np.zeros(10)), disturbance=np.full(5, 700.0)))
    _, _, best = best_first_command([10.0] * 3, [0.0] * 2, 0.0, ahead[[3, 6, 9]])
    assert out.force == pytest.approx(np.full(5, (best * of.inertia - 5 * 700.0) / 5), rel=1e-9)


def test_the_resistance_feedforward_is_not_part_of_the_command_history():
    """Nominal resistance, grade and air brake 20 m ahead, at the time of effect; breaks if xi or u contains it."""
    of = model(SINGLE, HILLY, delay=2.0, lag=0.4)
    plain = {"sampling": 0.4, "identify": "none"}
    bare, full = (printed_law("gpc", plain | {"resistance_feedforward": added}, of, 0.1) for added in (False, True))
    rng = np.random.default_rng(5)
    for step in range(60):
        place = np.array([990.0 + step])
        given_now = inputs(
            of, position=place, reference_position=place, velocity=np.array([10.0 + 0.01 * rng.normal()]),
            delay_to_effect=2.0, reference_acceleration=np.array([0.05]), train_shoe_force=700.0,
        )  # fmt: skip
        speed = 10.0 + 0.05 * 2.0
        held_back = 80e3 * (1.176e-2 + 7.7616e-4 * speed + 1.6e-5 * speed**2) + 700.0
        held_back += of.line_force(float(place[0]) + 20.0)
        added = full.step(given_now).force - bare.step(given_now).force
        assert added == pytest.approx([held_back], rel=1e-9)
    assert of.line_force(1060.0) > 2e3
