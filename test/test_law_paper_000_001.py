"""Papers 000 and 001: networks, Padé form and learnt switching term against values by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from law_trains import FIVE, HILLY, LEVEL, SINGLE, asked, inputs, measured, model, printed_law, profile, stack

from train_ato.control.algorithms.rbf import RBF_CENTERS, move_weights, weighted
from train_ato.control.algorithms.sliding import sig
from train_ato.control.compensation.pade import pade_coefficients

MASS = 80e3


def activations(point, spread, width):
    """Return h_j of (25) with the centres spread (-1 -.5 0 .5 1) in all coordinates."""
    distance = np.array(point)[:, None] - spread * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    return np.exp(-(distance**2).sum(axis=0) / (2 * width**2))


def test_weights_by_hand():
    """Dw with momentum; a weight stays inside its bound; W'h."""
    weights, moved, hidden = np.zeros(2), np.zeros(2), np.array([1.0, -1.0])
    move_weights(weights, moved, hidden, 0.1, 0.5, 0.22)
    assert weights == pytest.approx([0.1, -0.1])
    move_weights(weights, moved, hidden, 0.1, 0.5, 0.22)
    assert weights == pytest.approx([0.22, -0.22])
    assert moved == pytest.approx([0.12, -0.12])
    assert weighted(weights, hidden) == pytest.approx(0.44)


def test_rbf_smc_learns_by_gamma_s_h():
    """(28), then (35): the force of the second step contains m W'h of the first learning step, with minus sign."""
    of = model(SINGLE)
    plain = printed_law("smc", {}, of, 0.1)
    net = printed_law("rbf_smc", {"gamma": 0.2, "clip": False}, of, 0.1)
    for step, (e, de) in enumerate([(0.004, 0.002), (0.006, -0.001)]):
        given_now = inputs(of, position=np.array([500.0 + e]), velocity=np.array([10.0 + de]))
        difference = net.step(given_now).force[0] - plain.step(given_now).force[0]
        if step == 0:
            assert difference == 0.0
            learnt = 0.2 * 0.1 * (de + e) * activations((e, de), 0.01, 0.005)
        else:
            seen = activations((e, de), 0.01, 0.005)
            assert difference == pytest.approx(-MASS * float(learnt @ seen), rel=1e-6)
            assert difference < -0.1


def test_the_network_holds_in_saturation():
    """At the limit for 100 s the weights are those of the first step."""
    of = model(SINGLE)
    law = printed_law("rbf_smc", {"gamma": 5.0}, of, 0.1)
    stuck = inputs(of, position=np.array([480.0]), velocity=np.array([9.99]))
    for _ in range(1000):
        law.step(stuck)
    once = printed_law("rbf_smc", {"gamma": 5.0}, of, 0.1)
    once.step(stuck)
    near = inputs(of, position=np.array([500.001]))
    assert law.step(near).force[0] == pytest.approx(once.step(near).force[0], abs=MASS * 0.1 * 60)
    assert law.state["weights"][0] == pytest.approx(once.state["weights"][0], rel=1e-6)


@given(lag=st.floats(0.05, 2.0), delay=st.floats(0.05, 2.0), omega=st.floats(0.01, 30.0))
def test_pade_form_equals_the_pade_plant(lag, delay, omega):
    """The corrected (5), a (1 - b1 s² - b2 s) = a_s (1 + b3 s), is (lam - s)/((lam + s)(tau s + 1)) to rounding.

    The printed b1 = -2/lam has a much larger error.
    """
    s = 1j * omega
    lam = 2.0 / delay
    b1, b2, b3 = pade_coefficients(lag, delay)
    plant = (lam - s) / ((lam + s) * (lag * s + 1.0))
    form = (1.0 + b3 * s) / (1.0 - b1 * s * s - b2 * s)
    assert abs(form - plant) <= 3e-16 * 8
    printed = (1.0 + b3 * s) / (1.0 + 2.0 / lam * s * s - b2 * s)
    if abs(lag - 2.0) > 0.1 and omega > 0.5:
        assert abs(printed - plant) > 1e-4


def test_pade_compensation_leads_a_ramp_exactly():
    """For a linear force the Padé lead (sigma + tau) F' is exact; without it the force is 1.2 s late."""
    of, along = model(SINGLE, LEVEL, delay=0.8, lag=0.4), profile()
    control, now = stack(of, compensation="pade", along=along), stack(of, along=along)
    k = 100
    reference, estimate = asked(of, along, k * 100_000_000)
    seen = measured(of, k * 100_000_000, reference.position, reference.velocity, 0.0)
    led = float(control.step(seen, reference, estimate)[0][0])
    needed = float(now.step(seen, reference, estimate)[0][0])
    wanted = [of.rigid_force(*along.at(0.1 * k + later)[:3]) for later in (0.0, 1.2)]
    assert needed == pytest.approx(wanted[0], rel=1e-6)
    assert abs(led - wanted[1]) < 0.12 * abs(wanted[1] - wanted[0])


def test_rbf_switching_term_by_hand():
    """(11)-(13): initial weights, clipped input, one learning step down the gradient of s²/2."""
    of = model(FIVE)
    p = {"c": 0.4, "k_w": 1.4, "phi": 1.0, "eta": 0.5, "alpha": 0.0, "width": 0.5, "identify": False}
    law = printed_law("rbf_switching_smc", p, of, 0.1)
    e, de = 0.3, 0.1
    s = 0.4 * e + de
    out = law.step(inputs(of, position=500.0 + e - of.offsets, velocity=np.full(5, 10.0 + de)))
    hidden = activations((s,), 1.0, 0.5)
    weights = -0.9 * 1.4 * np.array(RBF_CENTERS) - 0.5 * 0.1 * s * hidden
    assert out.force == pytest.approx(np.full(5, MASS * (float(weights @ hidden) - 0.4 * de)), rel=1e-9)
    far = printed_law("rbf_switching_smc", p | {"eta": 0.0}, of, 0.1)
    forces = [far.step(inputs(of, position=500.0 + x - of.offsets)).force[0] for x in (2.6, 40.0)]
    assert forces[0] == forces[1] < -MASS


@pytest.mark.parametrize(
    ("switching", "value"), [("sign", -1.4), ("tanh", -1.4 * math.tanh(0.05 / 0.2)), ("rbf", None)]
)
def test_other_switching_terms(switching, value):
    """(9) as a relay and in its smooth form; the network has the same sign."""
    of = model(SINGLE)
    law = printed_law("rbf_switching_smc", {"switching": switching, "phi": 0.2}, of, 0.1)
    out = law.step(inputs(of, velocity=np.array([10.05])))
    own = out.force[0] / MASS + 0.4 * 0.05
    assert own == pytest.approx(value) if value else -1.4 < own < -0.05


@given(surface=st.floats(-50, 50), power=st.sampled_from([5 / 7, 5 / 3, 5.0]))
def test_sig_is_odd_and_monotone(surface, power):
    """sig^p is odd, keeps the sign and grows with |z|."""
    assert sig(-surface, power) == -sig(surface, power)
    assert sig(surface, power) * surface >= 0.0
    assert abs(sig(1.1 * surface, power)) >= abs(sig(surface, power))


def drive(law, of, steps, start=(0.0, 0.0), push=0.0, period=0.05):
    """Simulate one vehicle without lag on a level line at 10 m/s against a constant force; return e and e'."""
    e, de = start
    found = []
    for _ in range(steps):
        seen = inputs(of, position=np.array([500.0 + e]), velocity=np.array([10.0 + de]))
        force = float(law.step(seen).force[0])
        own = float(of.own_resistance(np.array([10.0 + de]), np.array([500.0]))[0])
        pull = (force + push - own) / MASS
        e, de = e + (de + 0.5 * pull * period) * period, de + pull * period
        found.append((e, de))
    return np.array(found)


def test_smc_reaches_its_surface_monotonically():
    """Lyapunov: V = S²/2 falls in every sample down to the step of one sample of the switching term."""
    of = model(SINGLE, HILLY)
    law = printed_law("smc", {"model_error": 0.0, "l2": 0.0}, of, 0.05)
    path = drive(law, of, 400, start=(0.5, -0.2))
    surface = np.abs(path[:, 1] + path[:, 0])
    above = surface > 2 * 0.05 * 0.05
    assert (np.diff(surface)[above[1:] & above[:-1]] < 0).all()
    assert surface[-1] < 2e-3
    assert surface[0] > 0.2


def test_the_network_takes_over_a_constant_push():
    """Unmodelled 400 N: smc with ks alone keeps S = d/(m ks); with the network S goes to 0."""
    of = model(SINGLE)
    plain = printed_law("smc", {"model_error": 0.0, "kappa": 0.0, "l2": 0.0}, of, 0.05)
    net = printed_law("rbf_smc", {"model_error": 0.0, "kappa": 0.0, "l2": 0.0, "gamma": 0.5}, of, 0.05)
    settled = [np.abs(drive(law, of, 6000, push=400.0)[-1] @ np.ones(2)) for law in (plain, net)]
    assert settled[0] == pytest.approx(400.0 / (MASS * 0.5), rel=0.05)
    assert settled[1] < 0.05 * settled[0]
