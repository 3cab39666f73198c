"""Properties proved in the papers, sample by sample: Lyapunov functions, contraction, fixed time.

Forms of the laws as printed in the papers, where the default differs: each against its equation.
"""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from law_trains import FIVE, SINGLE, inputs, measured, model, printed_law

from train_ato.control.algorithms.predictive_law import Increments, sampled_actuator
from train_ato.control.algorithms.sliding import RBF_CENTERS
from train_ato.control.laws.fixed_time_smc import alternating
from train_ato.control.laws.gpc import GpcParameters, linear_law
from train_ato.control.laws.rbf_switching_smc import identified_sign
from train_ato.control.observers.cascaded import Cascade, CascadedParameters
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
    target=st.lists(st.floats(-0.05, 0.05), min_size=5, max_size=5), e=st.floats(-0.01, 0.01), de=st.floats(-0.01, 0.01)
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
    assert (np.diff(sizes) < 0.0).all() and sizes[-1] < 0.05


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
    assert variation["sign"] > 20.0 and variation["rbf"] < 0.2


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
    assert abs(point.e) < 1e-6 and abs(point.de) < 1e-6


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


ERRORS = [(0.004, 0.002), (0.006, -0.001), (0.001, 0.003), (-0.002, 0.001)]


def seen(of, error, rate, **more):
    """Return the input of a law for one vehicle with these errors of position [m] and speed [m/s]."""
    return inputs(of, position=np.array([500.0 + error]), velocity=np.array([10.0 + rate]), **more)


def test_integral_of_paper_000_has_no_clamp():
    """(19): 50 m of error over 100 s are an integral of 5 000 m s; the default clamp holds it at 100 m s."""
    of = model(SINGLE)
    wide = {"force_min": np.array([-1e9]), "force_max": np.array([1e9])}
    forces = {}
    for limit in (100.0, 1e12):
        law = printed_law("smc", {"integral_limit": limit, "ks": 0.0, "xi": 0.0, "kappa": 0.0, "phi": 1.0}, of, 0.1)
        for _ in range(1001):
            law.step(seen(of, 50.0, 0.0, **wide))
        forces[limit] = law.state["integral"][0]
    assert forces == pytest.approx({100.0: 100.0, 1e12: 5000.0})


def test_network_of_paper_000_learns_at_a_limit():
    """(28) has no condition: without anti-windup the weights move at the limit."""
    of = model(SINGLE)
    found = {}
    for held in (True, False):
        law = printed_law("rbf_smc", {"gamma": 5.0, "anti_windup": held}, of, 0.1)
        for _ in range(20):
            law.step(seen(of, -0.01, 0.0, force_max=np.array([1.0]), force_min=np.array([-1.0])))
        found[held] = np.abs(law.state["weights"]).max()
    assert found[True] < 0.1 * found[False]


def test_observer_of_paper_000_with_the_network_in_its_known_part():
    """(30)-(35): delta_hat + d_hat is that of an observer that receives delta_hat, for a slow and a fast one."""
    of = model(SINGLE)
    for omega in (2.0, 1000.0):
        decay = math.exp(-omega * 0.1)
        plain = printed_law("smc", {}, of, 0.1)
        net = printed_law("rbf_smc", {"gamma": 50.0}, of, 0.1)
        printed = printed_law("rbf_smc", {"gamma": 50.0, "ndo_omega": omega}, of, 0.1)
        without = with_network = before = 0.0
        for step, (error, rate) in enumerate(ERRORS * 3):
            unexplained = 0.3 * math.sin(step)  # v' - f - u/m of the sample
            without = decay * without + (1.0 - decay) * unexplained
            with_network = decay * with_network + (1.0 - decay) * (unexplained - before)
            outside = {"disturbance": np.array([MASS * without])}
            base = plain.step(seen(of, error, rate)).force[0]
            before = (base - net.step(seen(of, error, rate)).force[0]) / MASS
            expected = base - MASS * (before + with_network)
            assert printed.step(seen(of, error, rate, **outside)).force[0] == pytest.approx(expected, abs=1e-6)
        assert abs(before) > 1e-3


def test_identification_of_paper_001_takes_the_whole_command():
    """(14): with ``command`` the network RBFI receives u(l-1), the last force over the mass, not u_n."""
    of = model(SINGLE)
    for source in ("switching", "command"):
        law = printed_law("rbf_switching_smc", {"rbfi_input": source}, of, 0.1)
        network, last, before = printed_law("rbf_switching_smc", {}, of, 0.1), (0.0, 0.0), None
        for error, rate in ERRORS:
            acceleration = 0.0 if before is None else (rate - before) / 0.1
            identified_sign(network.constants[0], network.state[0], last[source == "command"], acceleration)
            force = law.step(seen(of, error, rate, feedforward=np.array([30e3]))).force[0]
            before, last = rate, (law.state["pull"][0], force / MASS)
        assert law.state["identified"][0] == pytest.approx(network.state["identified"][0], rel=1e-12)
        assert abs(last[0] - last[1]) > 0.3


def test_networks_of_paper_001_without_clips():
    """(11), (13), (14): e'' beyond 1 m/s² reaches the networks; slope by value; learning at a force limit."""
    of = model(SINGLE)
    p = {"objective": "printed_acceleration", "clip": False, "sensitivity": "value", "rbfi_input": "command"}
    p |= {"anti_windup": False, "eta": 12.0, "eta_v": 0.6, "alpha": 0.0, "weight_limit": 1000.0}
    law = printed_law("rbf_switching_smc", p, of, 0.1)
    law.step(seen(of, 0.0, 0.0))
    command = law.units["force"][0] / MASS
    law.step(seen(of, 0.0, 0.15, force_max=np.array([1.0]), force_min=np.array([-1.0])))
    acceleration, centres = 1.5, np.array(RBF_CENTERS)
    point = (command, 0.0, 0.0)
    hidden = np.exp(-sum((value - centres) ** 2 for value in point) / 0.5)
    first = 0.5 * centres + 0.6 * (0.0 - 0.5 * centres @ hidden) * hidden
    miss = acceleration - first @ hidden
    weights = first + 0.6 * miss * hidden
    slope = float((weights * hidden) @ (centres - command)) / 0.25
    assert law.state["slope"][0] == pytest.approx(slope, rel=1e-9)
    learnt = np.exp(-((acceleration - centres) ** 2) / 0.5)
    before = -0.9 * 1.4 * centres
    expected = before - 12.0 * 0.1 * acceleration * slope * learnt
    assert law.state["weights"][0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("lag", [0.2, 0.8])
def test_equivalent_control_of_paper_001_from_measured_derivatives(lag):
    """(5), (9): y'' and y' of the measured motion and a_s' of the sent commands, with the coefficients of Padé."""
    of = model(SINGLE, lag=lag, delay=0.6)
    law = printed_law("rbf_switching_smc", {"derivatives": "measured", "switching": "sign", "c": 0.0}, of, 0.1)
    speeds, actuated, sent = [10.0, 10.02, 10.05, 10.06, 10.1], [], [0.0]
    for step, speed in enumerate(speeds):
        force = float(law.step(seen(of, 0.0, speed - 10.0, reference_acceleration=np.array([0.3]))).force[0])
        specific = of.running_resistance(speed) / of.inertia
        if step:
            actuated.append((speed - speeds[step - 1]) / 0.1 + specific)
        switching = -1.4 * ((speed > 10.0) - (speed < 10.0))
        expected = 0.3 + specific + switching
        if len(actuated) >= 3:
            y2, y1, y0 = actuated[-3:]
            expected += 0.3 * lag * (y0 - 2 * y1 + y2) / 0.01 + (lag + 0.3) * (y0 - y1) / 0.1
            expected += 0.3 * (sent[-1] - sent[-2]) / 0.1
        assert force == pytest.approx(min(max(MASS * expected, -400e3), 400e3), rel=1e-9)
        sent.append(force / MASS)


def test_excess_of_paper_003_is_that_of_a_delayed_command():
    """(8), (9): |u - sat u(t - tau)| widens the funnel without saturation, if the command of before was another."""
    of = model(SINGLE)
    widths = {}
    for kappa in ("present", "printed"):
        law = printed_law("funnel", {"resistance": "model", "kappa": kappa}, of, 0.05)
        force = law.step(seen(of, 0.0, 0.01, applied=np.array([5e3]))).force[0]
        widths[kappa] = float(law.state["phi2"][0])
    rest = 1e-4 / 0.0034
    narrowed = (0.1 - rest) * math.exp(-0.0034 * 0.05) + rest
    assert widths["present"] == pytest.approx(narrowed, rel=1e-12)
    grow = abs(force - 5e3) / MASS / 0.01
    assert widths["printed"] == pytest.approx(narrowed * math.exp(0.05 * grow), rel=1e-9)


@pytest.mark.parametrize("gain", ["horizon", "stationary"])
def test_residual_of_paper_004_has_no_stationary_effect(gain):
    """(21), (22): with a known constant xi the speed settles on the reference; with Lc of the cost it does not."""
    a, b = sampled_actuator(1.0, 0.4, 1.2)
    law = linear_law(a, b, GpcParameters(residual_gain=gain))
    speeds, sent, xi = [0.0] * 3, [0.0] * 3, 0.05
    for _ in range(400):
        command = law.scale * law.tracking.sum() * 2.0 - law.feedback @ np.array(speeds)
        command -= law.past @ np.array(sent[:2]) + xi * law.residual
        sent = [float(command), *sent[:2]]
        speeds = [float(-a[1:] @ np.array(speeds) + b @ np.array(sent) + xi), *speeds[:2]]
    assert (abs(speeds[0] - 2.0) < 1e-6) == (gain == "stationary") and abs(speeds[0] - 2.0) < 0.5


def test_identified_parameters_of_paper_004_without_a_bound():
    """(10) has no projection: a large error moves theta beyond half the norm of B only with a larger limit."""
    a, b = sampled_actuator(1.0, 0.4, 1.2)
    moved = {}
    for limit in (0.5, 1e9):
        found = Increments(a, b, limit)
        start = found.theta.copy()
        found.learn([0.0] * 4, [1.0] * 4, 50.0, absolute=False)
        moved[limit] = float(np.linalg.norm(found.theta - start)) / float(np.linalg.norm(b))
    assert moved[0.5] == pytest.approx(0.5) and moved[1e9] > 5.0


def test_law_of_paper_002_on_its_estimates():
    """(36) on x, v, d1, d1' and d2 of the cascade: force of the third vehicle by hand, speed offset 0.5 m/s."""
    of, h, gain = model(FIVE), 1e-3, 0.3
    p = {"surface": gain, "reaching": gain, "unmatched": True, "states": "estimated"}
    law = printed_law("fixed_time_smc", p, of, h)
    cascade, before = Cascade(CascadedParameters(), h), None
    for step in range(400):
        place = 500.0 - of.offsets + 10.5 * h * step
        now = inputs(
            of, position=place, velocity=np.full(5, 10.0), reference_position=500.0 - of.offsets + 10.0 * h * step
        )
        force = law.step(now).force[2]
        drive = -float(of.own_resistance(now.velocity, place)[2]) / MASS
        cascade.step(float(place[2]), 10.0, 0.5 * (drive + (drive if before is None else before)))
        before = drive
    assert cascade.d1 == pytest.approx(0.5, rel=0.01)
    error = cascade.position - now.reference_position[2]
    rate = cascade.velocity + cascade.d1 - 10.0
    value, slope = alternating(error, gain)
    surface = rate + value
    reaching = gain * (math.copysign(abs(surface) ** (5 / 7), surface) + surface * abs(surface) ** (2 / 3))
    own = float(of.own_resistance(np.full(5, cascade.velocity), place)[2])
    expected = own - MASS * (cascade.d2 + cascade.d1_rate) + MASS * (-slope * rate - reaching)
    assert force == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("name", ["offsets", "unit_mass", "unit_inertia", "share", "delay", "delay_brake"])
def test_a_law_cannot_write_into_its_model(name):
    """Breaks if `force = model.share; force *= total` changes the model of the compensation and of later runs."""
    values = getattr(model(FIVE, delay=0.4), name)
    with pytest.raises(ValueError, match="read-only"):
        values *= 2.0
