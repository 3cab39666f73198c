"""Paper 002: the alternating surface, one step by hand, and the fixed settling time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from law_trains import FIVE, HAULED, inputs, model, printed_law

from train_ato.control.algorithms.sliding import sig
from train_ato.control.laws.fixed_time_smc import alternating

MASS = 80e3


@given(gain=st.floats(0.01, 50.0), size=st.floats(1e-3, 100.0))
def test_the_surface_is_odd_smooth_and_rising(gain, size):
    """(19), (20): the branches meet at 1 m in value and slope; the slope is the derivative everywhere."""
    inside, outside = alternating(1.0, gain), alternating(1.0 + 1e-12, gain)
    assert inside == pytest.approx((2.0 * gain, gain * (1 + 5 / 7)))
    assert outside == pytest.approx((2.0 * gain, gain * (1 + 5 / 3)))
    value, slope = alternating(size, gain)
    assert alternating(-size, gain)[0] == -value
    h = 1e-6 * size
    if abs(size - 1.0) > 2 * h and size - h > 1e-3:
        assert slope == pytest.approx(
            (alternating(size + h, gain)[0] - alternating(size - h, gain)[0]) / (2 * h), rel=1e-4
        )


def test_one_step_by_hand():
    """(36) with coupler forces of the neighbours, resistance, x_r'' and the estimate; car 3 is 0.5 m ahead."""
    of = model(FIVE)
    law = printed_law("fixed_time_smc", {"surface": 0.3, "reaching": 0.2}, of, 0.1)
    place = 500.0 - of.offsets + np.array([0, 0, 0.5, 0, 0])
    speed = np.full(5, 10.0) + np.array([0, 0, 0.1, 0, 0])
    out = law.step(
        inputs(
            of, position=place, velocity=speed, acceleration_at_effect=0.05, disturbance=np.array([0, 0, 800.0, 0, 0])
        )
    )
    own = float(of.own_resistance(speed, place)[2])
    pull_back = 2 * (160e3 * 0.5 + 800.0 * 0.1)
    surface = 0.1 + 0.3 * (0.5 + sig(0.5, 5 / 7))
    slope = 0.3 * (1 + 5 / 7 * 0.5 ** (5 / 7 - 1))
    reaching = 0.2 * (sig(surface, 5 / 7) + sig(surface, 5 / 3))
    expected = own + pull_back - 800.0 + MASS * (0.05 - slope * 0.1 - reaching)
    assert out.force[2] == pytest.approx(expected, rel=1e-9)
    neighbour = float(of.own_resistance(speed, place)[1]) - (160e3 * 0.5 + 800.0 * 0.1) + MASS * 0.05
    assert out.force[1] == pytest.approx(neighbour, rel=1e-9)


@pytest.mark.parametrize("start", [1.0, 10.0, 108.0, 1e4])
def test_settling_time_is_bounded_whatever_the_start(start):
    """(23) + (34) with gain 2: from 1 m or 10 km the error is below 1 cm within the same time."""
    gain = 2.0
    reach = 1 / (2 * gain * (1 - 6 / 7)) + 1 / (2 * gain * (4 / 3 - 1))
    slide = 1 / (gain * (5 / 3 - 1)) * math.log(2) + 1 / (gain * (1 - 5 / 7)) * math.log(2)
    e, de, t, h = start, 0.0, 0.0, 2e-5
    while abs(e) > 0.01 or abs(de) > 0.1:
        value, slope = alternating(e, gain)
        surface = de + value
        de += h * (-slope * de - gain * (sig(surface, 5 / 7) + sig(surface, 5 / 3)))
        e += h * de
        t += h
        assert t < reach + slide
    assert t > 0.3


def test_speed_offset_is_found():
    """An offset of 0.4 m/s is estimated within 1 % after 2 s at 10 1/s, without steady error."""
    of = model(FIVE)
    law = printed_law("fixed_time_smc", {"unmatched": True, "offset_bandwidth": 10.0}, of, 0.05)
    for k in range(60):
        law.step(inputs(of, position=500.0 + 10.4 * 0.05 * k - of.offsets, velocity=np.full(5, 10.0)))
    assert law.state["unknown_rate"] == pytest.approx(0.4, rel=1e-3)


def test_needs_its_neighbours():
    """A hauled train without sensors is rejected with the name of the coupler."""
    with pytest.raises(ValueError, match=r"fixed_time_smc': .*needs the force of coupler_0"):
        printed_law("fixed_time_smc", {}, model(HAULED), 0.1)


def test_lag_smc_by_hand():
    """Surface and command of one unit and of the whole train."""
    of = model(FIVE, lag=0.4)
    p = {"c1": 1.0, "c0": 0.25, "k": 0.05, "phi": 0.1, "k_i": 1.0}
    e, de, applied = 0.2, -0.1, 5e3
    seen = inputs(
        of,
        position=500.0 + e - of.offsets,
        velocity=np.full(5, 10.0 + de),
        applied=np.full(5, applied),
        acceleration_at_effect=0.04,
        jerk_at_effect=0.02,
        disturbance=np.full(5, 400.0),
    )
    own = float(of.own_resistance(np.full(5, 9.9), np.full(5, 0.0))[0])
    off = (applied + 400.0 - own) / MASS - 0.04
    surface = off + de + 0.25 * e
    push = 0.02 - off - 0.25 * de - 0.05 * surface / (abs(surface) + 0.1) - surface
    for command in ("unit", "common"):
        out = printed_law("lag_smc", p | {"command": command}, of, 0.1).step(seen)
        assert out.force == pytest.approx(np.full(5, applied + MASS * 0.1 / (1 - math.exp(-0.25)) * push), rel=1e-9)
    spread = np.array([0.0, 0.0, 0.1, 0.0, 0.0])
    uneven = inputs(of, velocity=10.0 + spread)
    out = printed_law("lag_smc", p | {"command": "common"}, of, 0.1).step(uneven)
    assert out.force[2] - out.force[0] == pytest.approx(-MASS * 0.2 * 0.1)
