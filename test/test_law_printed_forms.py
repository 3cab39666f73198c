"""Forms of the laws as printed in the papers, where the default differs: each against its equation."""

from __future__ import annotations

import math

import numpy as np
import pytest
from law_trains import FIVE, SINGLE, inputs, model, printed_law

from train_ato.control.algorithms.identification import Increments
from train_ato.control.algorithms.predictive_law import linear_law, sampled_actuator
from train_ato.control.algorithms.rbf import RBF_CENTERS
from train_ato.control.laws.fixed_time_smc import alternating
from train_ato.control.laws.gpc import GpcParameters
from train_ato.control.laws.rbf_switching_smc import identified_sign
from train_ato.control.observers.cascaded import Cascade, CascadedParameters

MASS = 80e3
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
        limited = min(max(MASS * expected, -400e3), 400e3)
        assert force == pytest.approx(limited, rel=1e-9)
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
    assert (abs(speeds[0] - 2.0) < 1e-6) == (gain == "stationary")
    assert abs(speeds[0] - 2.0) < 0.5


def test_identified_parameters_of_paper_004_without_a_bound():
    """(10) has no projection: a large error moves theta beyond half the norm of B only with a larger limit."""
    a, b = sampled_actuator(1.0, 0.4, 1.2)
    moved = {}
    for limit in (0.5, 1e9):
        found = Increments(a, b, limit)
        start = found.theta.copy()
        found.learn([0.0] * 4, [1.0] * 4, 50.0, absolute=False)
        moved[limit] = float(np.linalg.norm(found.theta - start)) / float(np.linalg.norm(b))
    assert moved[0.5] == pytest.approx(0.5)
    assert moved[1e9] > 5.0


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
