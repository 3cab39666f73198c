"""Knots of a profile: exact at the knots, smooth between them, at rest outside."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from train_ato.profile.profile import Profile


def constant_jerk(period: float = 0.1, count: int = 101, jerk: float = 0.05) -> Profile:
    time = period * np.arange(count)
    return Profile(time, 3 + 2 * time + jerk * time**3 / 6, 2 + jerk * time**2 / 2, jerk * time)


def wavy(period: float = 0.1, count: int = 401) -> Profile:
    """Two seconds of rest at both ends of a smooth run."""
    time = period * np.arange(count)
    phase = np.clip((time - 2) / (time[-1] - 4), 0, 1)
    rate = np.where((phase > 0) & (phase < 1), 2 * np.pi / (time[-1] - 4), 0)
    v = 10 * (1 - np.cos(2 * np.pi * phase))
    a = 10 * rate * np.sin(2 * np.pi * phase)
    x = np.concatenate(([0], np.cumsum(period * (v[1:] + v[:-1]) / 2 + period**2 / 12 * (a[:-1] - a[1:]))))
    return Profile(time, x, v, a)


def test_every_knot_is_returned_bit_for_bit() -> None:
    profile = wavy()
    for k, t in enumerate(profile.time):
        assert profile.at(float(t))[:3] == (profile.position[k], profile.velocity[k], profile.acceleration[k])


@given(st.floats(0.0, 10.0))
@settings(max_examples=50, deadline=None)
def test_constant_jerk_is_reproduced_between_knots(t: float) -> None:
    """Breaks for linear or quadratic interpolation: errors of 1e-5 and more."""
    x, v, a, j = constant_jerk().at(t)
    stamp = round(t * 1e9) * 1e-9
    assert x == pytest.approx(3 + 2 * stamp + 0.05 * stamp**3 / 6, abs=1e-12)
    assert v == pytest.approx(2 + 0.05 * stamp**2 / 2, abs=1e-12)
    assert a == pytest.approx(0.05 * stamp, abs=1e-11)
    assert stamp >= 10.0 or j == pytest.approx(0.05, abs=1e-10)


@given(st.floats(-5, 60), st.integers(1, 40), st.sampled_from([0.01, 0.05, 0.1, 0.2, 0.3, 0.037]))
@settings(max_examples=200, deadline=None)
def test_a_window_equals_single_readings_bit_for_bit(t: float, count: int, period: float) -> None:
    profile = wavy()
    window = profile.window(t, count, period)
    start, step = round(t * 1e9), round(period * 1e9)
    single = [profile.at_stamp(start + k * step)[:3] for k in range(count)]
    assert np.array_equal(np.array(window).T, np.array(single))


def test_an_aligned_window_is_a_view_also_past_the_end() -> None:
    profile = wavy()
    for t, count in ((3.0, 50), (39.0, 50), (39.0, 5000), (500.0, 7)):
        window = profile.window(t, count, 0.2)
        assert all(column.size == count and not column.flags.owndata for column in window)
        assert not window[0].flags.writeable
    assert window[0][-1] == profile.position[-1] and window[1][-1] == 0.0


def test_profile_is_at_rest_before_its_start_and_after_its_end() -> None:
    rolling = constant_jerk()
    assert rolling.ends_rolling
    assert rolling.at(-1.0) == (rolling.position[0], 0.0, 0.0, 0.0)
    assert rolling.at(11.0) == (rolling.position[-1], 0.0, 0.0, 0.0)


def test_a_step_of_the_speed_is_not_interpolated() -> None:
    """Breaks if a step is interpolated: hundreds of m/s² and an overshoot of the position."""
    time = 0.1 * np.arange(41)
    speed = np.where(time < 1.95, 12.0, -12.0)
    place = np.where(time < 1.95, 12 * time, 24 - 12 * (time - 2))
    profile = Profile(time, place, speed, np.zeros(41))
    assert profile.at(1.96) == (pytest.approx(23.52), 12.0, 0.0, 0.0)
    assert profile.at(2.0)[1] == -12.0


def test_resampling_keeps_knots_and_the_end() -> None:
    profile = wavy()
    fine = profile.resampled(0.05)
    assert np.array_equal(fine.position[::2], profile.position)
    assert fine.resampled(0.1) == profile
    odd = profile.resampled(0.037)
    assert odd.end >= profile.end and odd.position[-1] == profile.position[-1] and odd.velocity[-1] == 0.0


def test_equality_and_fingerprint_follow_the_bits() -> None:
    profile = wavy()
    again = Profile(profile.time, profile.position, profile.velocity, profile.acceleration)
    nudged = np.array(profile.position)
    nudged[7] = np.nextafter(nudged[7], 1e9)
    other = Profile(profile.time, nudged, profile.velocity, profile.acceleration)
    assert again == profile and hash(again) == hash(profile)
    assert other != profile and other.fingerprint() != profile.fingerprint()


def test_joined_profile_changes_at_the_start_of_the_second() -> None:
    first, late = wavy(), constant_jerk().resampled(0.1)
    shifted = Profile(late.time + 60.0, late.position, late.velocity, late.acceleration)
    both = first.followed_by(shifted)
    assert both.at(50.0) == (first.position[-1], 0.0, 0.0, 0.0)
    assert both.at(65.0) == shifted.at(65.0)
    with pytest.raises(ValueError, match="do not coincide"):
        first.followed_by(Profile(late.time + 60.03, late.position, late.velocity, late.acceleration))


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (([0, 1], [0], [0, 0], [0, 0]), "one length"),
        (([0], [0], [0], [0]), "at least two"),
        (([0, 1, 3], [0, 0, 0], [0, 0, 0], [0, 0, 0]), "evenly spaced"),
        (([0, 1], [0, np.nan], [0, 0], [0, 0]), "position of knot 1 is nan"),
        (([1, 0], [0, 0], [0, 0], [0, 0]), "evenly spaced"),
    ],
)
def test_bad_knots_are_refused_in_one_line(columns: tuple[list[float], ...], message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        Profile(*(np.array(column, dtype=float) for column in columns))
    assert "\n" not in str(caught.value)
