"""One step of every law of paper 000 and its baseline, by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from law_trains import FIVE, HAULED, HILLY, SINGLE, inputs, model, printed_law


def test_pid_forces_of_paper_000():
    """1e7 N/(m/s), 1 N/m, 1 N s²/m; breaks if a gain is scaled by the mass or a sign is wrong."""
    of = model(SINGLE)
    law = printed_law(
        "pid",
        {"per_mass": False, "kp": 1e7, "ki": 1.0, "kd": 1.0, "feedforward": False, "derivative_time": 0.0},
        of,
        0.05,
    )
    first = law.step(inputs(of, velocity=np.array([10.01]), position=np.array([503.0])))
    assert first.force[0] == pytest.approx(-(1e7 * 0.01 + 1.0 * 3.0), rel=1e-9)
    second = law.step(inputs(of, velocity=np.array([10.02]), position=np.array([503.0])))
    assert second.force[0] == pytest.approx(-(1e7 * 0.02 + 3.0 + 1.0 * 0.01 / 0.05), rel=1e-9)


def test_pid_per_mass_with_feedforward_and_disturbance():
    """Law: u = u_ff - d - M (kp e' + ki e); breaks if the estimate is added instead of subtracted."""
    of = model(FIVE)
    law = printed_law("pid", {"kp": 0.1, "ki": 0.01}, of, 0.1)
    out = law.step(
        inputs(
            of,
            velocity=np.full(5, 10.2),
            position=502.0 - of.offsets,
            feedforward=np.full(5, 7e3),
            disturbance=np.full(5, 2e3),
        )
    )
    assert out.force == pytest.approx(np.full(5, 7e3 - 2e3 - 80e3 * (0.1 * 0.2 + 0.01 * 2.0)), rel=1e-9)


def test_pid_integral_holds_in_saturation_and_is_clamped():
    """Breaks without anti-windup: after 100 s at the limit the integral would be 500 m; the clamp is 20 m."""
    of = model(SINGLE)
    law = printed_law("pid", {"integral": "speed", "feedforward": False, "kp": 1.0, "ki": 0.1}, of, 0.1)
    for _ in range(1000):
        stuck = law.step(inputs(of, velocity=np.array([4.0])))
    assert stuck.force[0] == 400e3
    free = law.step(inputs(of))
    assert 0 <= free.force[0] < 80e3 * 0.1 * 0.7
    law = printed_law("pid", {"integral": "speed", "feedforward": False, "kp": 0.0, "ki": 0.01}, of, 0.1)
    for _ in range(1000):
        slow = law.step(inputs(of, velocity=np.array([9.0])))
    assert slow.force[0] == pytest.approx(80e3 * 0.01 * 20.0)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["traction", "brake"])
def test_pid_integral_at_a_limit_is_held_against_it_only(side):
    """Breaks if the anti-windup has the wrong sign: 80 t, 400 kN, kp 1/s, ki 0.1/s², sum of the speed error, 0.1 s.

    Errors of 6, 6 and -1 m/s: the first one gives 80 t (6 + 0.06) > 400 kN, the second is held, the third counts.
    """
    of = model(SINGLE)
    law = printed_law("pid", {"integral": "speed", "feedforward": False, "kp": 1.0, "ki": 0.1}, of, 0.1)
    forces = [law.step(inputs(of, velocity=np.array([10.0 - side * slow]))).force[0] for slow in (6.0, 6.0, -1.0)]
    assert forces[:2] == [side * 400e3, side * 400e3]
    assert forces[2] == pytest.approx(-side * 80e3 * (1.0 - 0.1 * (0.6 - 0.1)))


def test_pid_derivative_does_not_bridge_a_missed_sample():
    """Breaks if the difference quotient spans the missed sample: 0.04 m/s in 0.1 s would be 80 kN at kd = 2.5."""
    of = model(SINGLE)
    gains = {"kp": 1.0, "ki": 0.0, "kd": 2.5, "derivative_time": 0.0, "feedforward": False}
    law = printed_law("pid", gains, of, 0.1)
    speeds = (10.01, math.nan, 10.05, 10.06)
    forces = [law.step(inputs(of, velocity=np.array([speed]))).force[0] for speed in speeds]
    assert forces == pytest.approx([-800.0, -800.0, -4000.0, -4800.0 - 80e3 * 2.5 * 0.1])


def test_pid_starts_again_with_cleared_filters():
    """Breaks if ``clear_state`` keeps the filtered error, the filtered rate or the integral."""
    of = model(SINGLE)
    gains = {"kp": 1.0, "ki": 0.1, "kd": 1.0, "integral": "speed", "feedforward": False}
    law = printed_law("pid", {**gains, "filter_time": 1.0, "derivative_time": 1.0}, of, 0.1)
    for speed in (11.0, 11.5, 12.0):
        law.step(inputs(of, velocity=np.array([speed])))
    law.clear_state()
    assert law.step(inputs(of, velocity=np.array([10.5]))).force[0] == pytest.approx(-80e3 * (0.5 + 0.1 * 0.05))


def test_smc_of_paper_000_by_hand():
    """(19), (21), (22) on the locomotive with the force of its first coupler; breaks on any wrong term."""
    of = model(HAULED, HILLY, sensors=(0,))
    law = printed_law("smc", {"ks": 0.0}, of, 0.1)
    e, de = 0.2, -0.05
    out = law.step(
        inputs(
            of,
            t=1.0,
            position=np.array([2000.0 + e]),
            velocity=np.array([10.0 + de]),
            reference_position=np.array([2000.0]),
            acceleration_at_effect=0.03,
            coupler_force=np.array([250e3]),
            shoe_force=np.array([1e3]),
            disturbance=np.array([500.0]),
            force_max=np.array([760e3]),
        )
    )
    kmh = 3.6 * (10.0 + de)
    specific = 1.20 + 0.0065 * kmh + 0.000279 * kmh**2 + 4.0
    f = 250e3 + 184e3 * 9.81e-3 * specific + 1e3
    surface = de + e
    reaching = 0.005 * abs(surface) ** 5 + 0.05 * math.tanh(e / 2)
    expected = f / 1.01 + 184e3 * 0.03 - 500.0 - 184e3 * (de + 0.1 * e + reaching)
    assert out.force[0] == pytest.approx(expected, rel=2e-6)


def test_smc_integral_and_linear_reaching():
    """The integral is the trapezoid of e from the second step on; ks S is added."""
    of = model(SINGLE)
    law = printed_law("smc", {"ks": 0.5, "kappa": 0.0, "xi": 0.0, "l2": 0.2}, of, 0.1)
    law.step(inputs(of, position=np.array([500.1])))
    out = law.step(inputs(of, position=np.array([500.3])))
    own = 80e3 * (1.176e-2 + 7.7616e-4 * 10 + 1.6e-5 * 100) / 1.01
    surface = 0.3 + 0.2 * 0.5 * (0.1 + 0.3) * 0.1
    assert out.force[0] == pytest.approx(own - 80e3 * (0.2 * 0.3 + 0.5 * surface), rel=1e-9)


def test_smc_with_feedforward_weighs_the_train():
    """With lag and delay the equivalent control is the feed-forward, and the mass that of the train."""
    of = model(HAULED)
    law = printed_law(
        "smc",
        {"equivalent": "feedforward", "l1": 0.07, "l2": 0.002, "ks": 0.05, "phi": 0.1, "xi": 0.0},
        of,
        0.1,
    )
    out = law.step(inputs(of, velocity=np.array([10.1]), feedforward=np.array([90e3]), force_max=np.array([760e3])))
    assert out.force[0] == pytest.approx(90e3 - 584e3 * (0.07 * 0.1 + 0.05 * 0.1), rel=1e-9)
