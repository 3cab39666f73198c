"""Law pid by hand, step by step."""

import math

import numpy as np
import pytest
from law_trains import FIVE, SINGLE, inputs, model, printed_law


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
            of, velocity=np.full(5, 10.2), position=502.0 - of.offsets, feedforward=np.full(5, 7e3),
            disturbance=np.full(5, 2e3),
        )
    )  # fmt: skip
    assert out.force == pytest.approx(np.full(5, 7e3 - 2e3 - 80e3 * (0.1 * 0.2 + 0.01 * 2.0)), rel=1e-9)


@pytest.mark.parametrize("name", ["pid", "smc", "rbf_smc", "rbf_switching_smc", "fixed_time_smc", "funnel"])
def test_an_estimated_disturbance_is_subtracted_from_the_force(name):
    """Breaks if a law adds the estimate of the observer, or leaves it out."""
    of, force = model(FIVE, lag=0.4), {}
    for disturbance in (0.0, 2e3, -3e3):
        law = printed_law(name, {}, of, 0.1)
        law.step(inputs(of, velocity=np.full(5, 10.1)))
        moved = {"t": 50.1, "velocity": np.full(5, 10.1), "position": 501.0 - of.offsets}
        force[disturbance] = law.step(inputs(of, **moved, disturbance=np.full(5, disturbance))).force
    for disturbance, found in force.items():
        assert found - force[0.0] == pytest.approx(np.full(5, -disturbance), abs=1e-6)


def test_pid_integral_holds_in_saturation_and_is_clamped():
    """Breaks without anti-windup: after 100 s at the limit the integral would be 500 m; the clamp is 20 m."""
    of = model(SINGLE)
    law = printed_law("pid", {"integral": "speed", "feedforward": False, "kp": 1.0, "ki": 0.1}, of, 0.1)
    for _ in range(1000):
        stuck = law.step(inputs(of, velocity=np.array([4.0])))
    assert stuck.force[0] == 400e3 and 0 <= law.step(inputs(of)).force[0] < 80e3 * 0.1 * 0.7
    law = printed_law("pid", {"integral": "speed", "feedforward": False, "kp": 0.0, "ki": 0.01}, of, 0.1)
    for _ in range(1000):
        slow = law.step(inputs(of, velocity=np.array([9.0])))
    assert slow.force[0] == pytest.approx(80e3 * 0.01 * 20.0)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["traction", "brake"])
def test_pid_integral_at_a_limit_is_held_against_it_only(side):
    """Breaks if the anti-windup has the wrong sign: 80 t, 400 kN, kp 1/s, ki 0.1/s², sum of the speed error, 0.1 s."""
    # Errors of 6, 6 and -1 m/s: the first one gives 80 t (6 + 0.06) > 400 kN, the second is held, the third counts.
    of = model(SINGLE)
    law = printed_law("pid", {"integral": "speed", "feedforward": False, "kp": 1.0, "ki": 0.1}, of, 0.1)
    forces = [law.step(inputs(of, velocity=np.array([10.0 - side * slow]))).force[0] for slow in (6.0, 6.0, -1.0)]
    assert forces[:2] == [side * 400e3, side * 400e3]
    assert forces[2] == pytest.approx(-side * 80e3 * (1.0 - 0.1 * (0.6 - 0.1)))


def test_pid_does_not_bridge_a_gap_and_starts_again_cleared():
    """Breaks if the difference quotient spans a missed sample (80 kN), or a start keeps filters or integral."""
    of = model(SINGLE)
    gains = {"kp": 1.0, "ki": 0.0, "kd": 2.5, "derivative_time": 0.0, "feedforward": False}
    law = printed_law("pid", gains, of, 0.1)
    speeds = (10.01, math.nan, 10.05, 10.06)
    forces = [law.step(inputs(of, velocity=np.array([speed]))).force[0] for speed in speeds]
    assert forces == pytest.approx([-800.0, -800.0, -4000.0, -4800.0 - 80e3 * 2.5 * 0.1])
    of = model(SINGLE)
    gains = {"kp": 1.0, "ki": 0.1, "kd": 1.0, "integral": "speed", "feedforward": False}
    law = printed_law("pid", {**gains, "filter_time": 1.0, "derivative_time": 1.0}, of, 0.1)
    for speed in (11.0, 11.5, 12.0):
        law.step(inputs(of, velocity=np.array([speed])))
    law.clear_state()
    assert law.step(inputs(of, velocity=np.array([10.5]))).force[0] == pytest.approx(-80e3 * (0.5 + 0.1 * 0.05))
