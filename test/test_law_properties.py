"""Properties proved in the papers, sample by sample: Lyapunov functions, contraction, fixed time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from law_trains import FIVE, SINGLE, inputs, measured, model, printed_law

from train_ato.control.algorithms.predictive_law import linear_law, sampled_actuator
from train_ato.control.algorithms.rbf import RBF_CENTERS
from train_ato.control.algorithms.sliding import sig
from train_ato.control.laws.fixed_time_smc import alternating
from train_ato.control.laws.gpc import GpcParameters
from train_ato.control.observers.contract import ObserverInput
from train_ato.control.registry import OBSERVERS

MASS = 80e3


class OnePoint:
    """One vehicle on a level line with a reference of 10 m/s, without lag: e and e' under a law and a disturbance."""

    def __init__(self, law, period, e=0.0, de=0.0):
        self.of = model(SINGLE)
        self.law = printed_law(*law, self.of, period)
        self.period, self.e, self.de = period, e, de
        self.applied = 0.0

    def step(self, own_pull=0.0, **seen):
        """Advance one period with a disturbance [m/s²] in addition to the law."""
        position, velocity = np.array([500.0 + self.e]), np.array([10.0 + self.de])
        self.applied = float(self.law.step(inputs(self.of, position=position, velocity=velocity, **seen)).force[0])
        resisting = float(self.of.own_resistance(velocity, position)[0])
        pull = (self.applied - resisting) / MASS + own_pull
        self.e += (self.de + 0.5 * pull * self.period) * self.period
        self.de += pull * self.period


@given(
    target=st.lists(st.floats(-0.05, 0.05), min_size=5, max_size=5),
    e=st.floats(-0.01, 0.01),
    de=st.floats(-0.01, 0.01),
)
def test_rbf_smc_falls_along_its_lyapunov_function(target, e, de):
    """Paper 000, (36), (37): L = S²/2 + |W* - W|²/(2 gamma) falls by S (zeta sgn S + xi |S|^alpha sgn S + ks S)."""
    # The unmodelled part is W*'h. Breaks with the wrong sign of (28), and with a missing or doubled term of (21).
    gamma, period, ks = 0.5, 1e-3, 0.5
    values = {"model_error": 0.0, "gamma": gamma, "clip": False, "ks": ks, "l2": 0.0}
    point = OnePoint(("rbf_smc", values), period, e, de)
    centres, weights = [0.01 * centre for centre in RBF_CENTERS], point.law.state["weights"][0]
    levels, proved = [], []
    for _ in range(150):
        surface = point.de + point.e
        miss = sum((wanted - now) ** 2 for wanted, now in zip(target, weights, strict=True))
        levels.append(0.5 * surface**2 + 0.5 * miss / gamma)
        zeta = 0.05 * math.tanh(abs(point.e) / 2)
        proved.append(-(zeta * abs(surface) + 0.005 * abs(surface) ** 6 + ks * surface**2))
        hidden = [math.exp(-((point.e - c) ** 2 + (point.de - c) ** 2) / (2 * 0.005**2)) for c in centres]
        point.step(sum(t * h for t, h in zip(target, hidden, strict=True)))
    assert np.diff(levels) / period == pytest.approx(np.array(proved)[:-1], abs=5e-6)


@given(surface=st.floats(0.1, 5.0), push=st.floats(-0.8, 0.8), switching=st.sampled_from(["sign", "rbf", "tanh"]))
def test_rbf_switching_smc_pulls_to_its_surface(surface, push, switching):
    """Paper 001, (8)-(12): s s' < 0 outside a layer, for any disturbance below the switching gain of 1.4 m/s²."""
    # At the surface the relay has 1.4, the learnt term 0.9 of it at |s| = phi; breaks with a wrong sign of the initial
    # weights or of the clipped input.
    phi = 0.05
    point = OnePoint(("rbf_switching_smc", {"switching": switching, "phi": phi, "eta": 0.0}), 0.02, 0.0, surface)
    sizes = [surface]
    for _ in range(600):
        point.step(push)
        sizes.append(abs(0.4 * point.e + point.de))
        if sizes[-1] < 0.05:
            break
    assert (np.diff(sizes) < 0.0).all()
    assert sizes[-1] < 0.05


def test_the_learnt_switching_term_does_not_chatter():
    """Paper 001: on the surface the force of the relay changes by 2.8 m/s² per sample, that of the network little."""
    variation = {}
    for switching in ("sign", "rbf"):
        point = OnePoint(("rbf_switching_smc", {"switching": switching}), 0.05, 0.01, 0.0)
        forces = []
        for k in range(1200):
            point.step(0.1 * math.sin(0.5 * 0.05 * k))
            forces.append(point.applied / MASS)
        variation[switching] = np.abs(np.diff(forces[200:])).mean() / 0.05
        assert abs(point.de) < 0.2
    assert variation["sign"] > 20.0
    assert variation["rbf"] < 0.2


@pytest.mark.parametrize("gain", [0.5, 2.0])
def test_fixed_time_smc_falls_along_its_lyapunov_function(gain):
    """Paper 002, (22): V = S² falls by 2 alpha2 V^((p2+1)/2) + 2 beta2 V^((g2+1)/2) on every car of a coupled train."""
    # Five sprung cars, 2 to 6 m out of place, with different speeds; breaks if a coupler, the resistance or dS_au/dE is
    # not cancelled, or an exponent is wrong.
    of, period = model(FIVE), 1e-4
    law = printed_law("fixed_time_smc", {"surface": gain, "reaching": gain}, of, period)
    wide = {"force_min": np.full(5, -1e9), "force_max": np.full(5, 1e9)}
    e, de = np.array([2.0, -5.0, 6.0, 3.0, -4.0]), np.array([0.5, -1.0, 0.0, 3.0, -2.0])
    stiffness, damping = 160e3, 800.0

    def surfaces():
        return np.array([v + alternating(x, gain)[0] for x, v in zip(e.tolist(), de.tolist(), strict=True)])

    for _ in range(3000):
        before = surfaces()
        place, speed = 500.0 + e - of.offsets, 10.0 + de
        force = law.step(inputs(of, position=place, velocity=speed, **wide)).force
        pull = stiffness * (e[:-1] - e[1:]) + damping * (de[:-1] - de[1:])
        back = np.append(pull, 0.0) - np.append(0.0, pull)
        rate = (force - back - of.own_resistance(speed, place)) / MASS
        e, de = e + (de + 0.5 * rate * period) * period, de + rate * period
        slope = (surfaces() ** 2 - before**2) / period
        proved = [-2 * gain * (abs(s) ** (12 / 7) + abs(s) ** (8 / 3)) for s in before.tolist()]
        assert slope == pytest.approx(np.array(proved), rel=0.05, abs=0.02)


@given(e=st.floats(-0.5, 0.5), de=st.floats(-0.2, 0.2), start=st.floats(-20e3, 20e3))
def test_lag_smc_contracts_to_its_surface_through_the_lag(e, de, start):
    """With s3' = -k s3/(|s3| + phi) - k_i s3 the surface shrinks at least by exp(-k_i t) in every sample."""
    # The actuator is a lag of 0.4 s with a constant demand for 0.1 s; breaks if that is not part of the law.
    of, period = model(SINGLE, lag=0.4), 0.02
    law = printed_law("lag_smc", {"k_i": 1.0}, of, period)
    keep, acting = math.exp(-period / 0.4), start
    sizes = []
    for _ in range(400):
        velocity = np.array([10.0 + de])
        resisting = float(of.own_resistance(velocity, np.zeros(1))[0])
        net = (acting - resisting) / MASS
        sizes.append(abs(net + de + 0.25 * e))
        seen = inputs(of, position=np.array([500.0 + e]), velocity=velocity, applied=np.array([acting]))
        wanted = float(law.step(seen).force[0])
        mean = wanted + (acting - wanted) * (1 - keep) * 0.4 / period
        acting = wanted + (acting - wanted) * keep
        pull = (mean - resisting) / MASS
        e, de = e + (de + 0.5 * pull * period) * period, de + pull * period
    within = np.exp(-1.0 * period * np.arange(400)) * sizes[0] + 0.003
    assert (np.array(sizes) <= within).all()


@pytest.mark.parametrize("funnel", ["dynamic", "prescribed", "fixed"])
@pytest.mark.parametrize("start", [(0.12, 0.0), (-0.2, 0.02), (0.1, -0.1)])
def test_funnel_errors_stay_inside_and_go_to_zero(funnel, start):
    """Paper 003, theorem 1, without saturation: |e1| < phi1 and |e2| < phi2 in every sample, and e1 goes to 0."""
    # Breaks with a gain or a sign of (12), (20), (23); the printed form (leak of (21) inside the mass) does not reach
    # 0.
    point = OnePoint(("funnel", {"resistance": "model", "funnel": funnel}), 0.01, *start)
    own = point.law.state[0]
    for step in range(6000):
        phi1, phi2, e, de = float(own["phi1"]), float(own["phi2"]), point.e, point.de
        point.step(applied=np.array([point.applied]))
        assert abs(e) < phi1, step
        e2 = de + 0.3 * e / (1.0 - min((e / phi1) ** 2, 0.5)) - float(own["h"])
        assert abs(e2) < phi2, step
    assert abs(point.e) < 1e-6
    assert abs(point.de) < 1e-6


def closed_loop_radius(delay: float, sampling: float, lam: float) -> float:
    """Return the largest closed-loop pole: the roots of A (1 + z⁻¹ sum P H) + z⁻¹ B sum P F, (22)."""
    a, b = sampled_actuator(delay, 0.4, sampling)
    law = linear_law(a, b, GpcParameters(command_weight=lam))
    characteristic = np.convolve(a, np.concatenate(([1.0], law.past)))
    fed_back = np.concatenate(([0.0], np.convolve(b, law.feedback)))
    size = max(characteristic.size, fed_back.size)
    total = np.pad(characteristic, (0, size - characteristic.size)) + np.pad(fed_back, (0, size - fed_back.size))
    return float(np.abs(np.roots(total)).max())


@given(lam=st.floats(1e-6, 1e4), delay=st.floats(0.6, 1.2))
def test_gpc_with_n_3_is_stable_only_at_a_sampling_of_1_2_s(lam, delay):
    """N = 3, Nu = 2: at 1.2 s all poles are inside the unit circle for any delay."""
    # At 0.4 s with 1.2 s of delay, 0.3 s with 1.1 s, and 0.2 s with any, no command weight stabilises the loop.
    assert closed_loop_radius(delay, 1.2, min(lam, 10.0)) < 0.95
    assert closed_loop_radius(1.2, 0.4, lam) > 1.0 - 1e-4
    assert closed_loop_radius(1.1, 0.3, lam) > 1.0 - 1e-4
    assert closed_loop_radius(delay, 0.2, lam) > 1.0 - 1e-4


@pytest.mark.parametrize(("sampling", "beyond"), [(1.2, "zero"), (0.8, "hold")])
def test_gpc_has_no_static_error(sampling, beyond):
    """(22): A(1) Hc(1) + B(1) Fc(1) = B(1) Rc(1), so a constant reference has no steady error."""
    a, b = sampled_actuator(1.0, 0.4, sampling)
    law = linear_law(a, b, GpcParameters(beyond_horizon=beyond))
    left = a.sum() * (1.0 + law.past.sum()) + b.sum() * law.feedback.sum()
    assert left == pytest.approx(b.sum() * law.scale * law.tracking.sum(), abs=1e-12)


@pytest.mark.parametrize("name", ["ndo", "eso"])
@given(omega=st.floats(0.5, 20.0), swing=st.floats(0.1, 0.5))
def test_the_estimate_follows_a_moving_disturbance_within_its_rate_over_omega(name, omega, swing):
    """Paper 000, (34): e' = -omega e + d', so |e| stays below max|d'|/omega (twice that with two equal poles)."""
    # A sinusoidal disturbance of 0.1 m/s², with a tolerance of one sample of the difference quotient.
    period, amplitude = 0.02, 0.1
    of = model(SINGLE, tick=period)
    values = {"omega": omega} | ({"model_error": 0.0} if name == "ndo" else {})
    observer = OBSERVERS.make(name, values, of, period)
    speed, worst = 20.0, 0.0
    rate = amplitude * swing
    for k in range(700):
        t = k * period
        resisting = float(of.own_resistance(np.array([speed]), np.zeros(1))[0])
        found = float(observer.step(ObserverInput.of(measured(of, round(t * 1e9), 0.0, speed, resisting)))[0]) / MASS
        if t > 8.0 / omega + 1.0:
            worst = max(worst, abs(found - amplitude * math.sin(swing * t)))
        speed += amplitude * math.sin(swing * (t + 0.5 * period)) * period
    poles = 2.0 if name == "eso" else 1.0
    assert worst <= poles * rate / omega + rate * period + 1e-3


def test_cascaded_by_hand_and_in_finite_time():
    """(7), (11) with implicit signs: d2 within one sample without filter, then d1; estimate m (d2 + d1')."""
    # 0.5 m/s² of unmodelled acceleration, and a position rate 0.4 m/s above the speed.
    of, period = model(SINGLE, tick=0.01), 0.01
    observer = OBSERVERS.make("cascaded", {"filter_time": 0.0}, of, period)
    place, speed, found = 500.0, 10.0, []
    for k in range(40):
        resisting = of.own_resistance(np.array([speed]), np.array([place]))
        seen = measured(of, round(k * period * 1e9), np.array([place]), speed, resisting)
        found.append(float(observer.step(ObserverInput.of(seen))[0]))
        place += (speed + 0.5 * 0.5 * period + 0.4) * period
        speed += 0.5 * period
    cascade = observer.state[0]
    assert found[0] == 0.0
    k3, k4 = 10.0, 100.0
    first_d1 = min(0.4, period * k3 * 0.4 + period * k4)
    assert found[1] == pytest.approx(MASS * (0.5 + first_d1 / period), rel=1e-3)
    assert cascade["d1"] == pytest.approx(0.4, rel=1e-3)
    assert found[-1] == pytest.approx(MASS * 0.5, rel=1e-3)


@given(error=st.floats(-50.0, 50.0))
def test_the_papers_exponents_are_those_of_the_surface(error):
    """(19): sig^(5/3) far out, sig^(5/7) near, the same on both sides."""
    value = alternating(error, 1.0)[0]
    power = 5 / 3 if abs(error) > 1.0 else 5 / 7
    assert value == pytest.approx(error + sig(error, power))
