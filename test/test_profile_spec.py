"""Profiles from phases, points, steps and files: limits, places, knots and one-line refusals."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plant_trains import line_of, train_of
from pydantic import ValidationError
from refusals import one_line

from train_ato.profile.file import read_profile, write_profile
from train_ato.profile.profile import Profile
from train_ato.scenario.profile_spec import ProfileSpec

CONSIST = train_of({"unit": {
    "mass_t": 200, "length": 120, "rotating_mass_factor": 1.05, "resistance": {"n_per_kn_kmh": [1.2, 0.01, 0.0005]},
    "traction": [{"to_kmh": 40, "force_kn": 210}, {"to_kmh": 120, "power_kw": 2333.333}],
    "brake": [{"to_kmh": 120, "force_kn": 250}],
}}, 1)  # fmt: skip
LINE = line_of(10e3, name="flat")


def build(period: float = 0.05, **block: Any) -> Profile:
    return ProfileSpec.model_validate(block).build(CONSIST, LINE, period)


METRO = {
    "start": 0,
    "limits": {"jerk": 0.6, "acceleration": 0.8, "deceleration": 0.8},
    "phases": [
        {"cruise_until": 2}, {"accelerate_to_kmh": 80}, {"cruise_until": 130}, {"brake_to_kmh": 60},
        {"cruise_until": 235}, {"accelerate_to_kmh": 80}, {"cruise_until": 410}, {"brake_to": 0},
    ],
}  # fmt: skip


def test_phases_agree_with_a_hand_calculation() -> None:
    """A change of speed dv takes dv/a + a/j at the mean speed, because S-curves are symmetric."""
    profile = build(**METRO)
    top, low, extra = 80 / 3.6, 60 / 3.6, 0.8 / 0.6
    full, part = top / 0.8 + extra, (top - low) / 0.8 + extra
    way = top / 2 * full + top * (130 - 2 - full) + (top + low) / 2 * part * 2
    way += low * (235 - 130 - part) + top * (410 - 235 - part) + top / 2 * full
    assert profile.position[-1] == pytest.approx(way, abs=1e-6)
    assert profile.end == pytest.approx(410 + full, abs=0.05)
    assert np.abs(profile.jerk()).max() <= 0.6 + 1e-9
    assert 0.8 - 1e-6 <= -profile.acceleration.min() <= 0.8 + 1e-9


@given(
    st.lists(st.floats(1, 30), min_size=1, max_size=5), st.floats(0.1, 2.0), st.floats(0.2, 1.2), st.floats(0.2, 1.2)
)
@settings(max_examples=60, deadline=None)
def test_phases_keep_every_limit(speeds: list[float], jerk: float, up: float, down: float) -> None:
    phases: list[dict[str, float]] = []
    now = 0.0
    for speed in [*speeds, 0.0]:
        phases += [{"accelerate_to" if speed >= now else "brake_to": speed}, {"cruise_for": 3.0}]
        now = speed
    limits = {"jerk": jerk, "acceleration": up, "deceleration": down, "traction_fraction": 0.9}
    if sum(speeds) >= 80:
        return
    profile = build(limits=limits, phases=phases)
    v = np.maximum(profile.velocity, 1e-9)
    force = np.where(v <= 40 / 3.6, 210e3, 2333.333e3 / v) * 0.9
    weight = 200e3 * 9.81e-3
    resistance = weight * (1.2 + 0.01 * 3.6 * v + 0.0005 * (3.6 * v) ** 2)
    assert np.all(profile.acceleration <= np.minimum(up, (force - resistance) / 210e3) + 2e-3)
    assert profile.acceleration.min() >= -down - 1e-9
    assert np.abs(profile.jerk()).max() <= jerk * (1 + 1e-6)
    assert profile.velocity[-1] == 0.0 and profile.velocity.min() > -1e-9


@pytest.mark.parametrize(
    ("phases", "place"),
    [
        ([{"accelerate_to_kmh": 80}, {"stop_at_km": 4.321}], 4321.0),
        ([{"accelerate_to_kmh": 80}, {"brake_to_kmh": 30, "at_km": 2}, {"stop_at": 2500}], 2500.0),
        ([{"accelerate_to_kmh": 50}, {"cruise_to": 1000}, {"brake_to": 0, "at": 1500}], 1500.0),
    ],
)
def test_the_front_stops_exactly_at_the_place(phases: list[dict[str, float]], place: float) -> None:
    profile = build(0.01, phases=phases)
    assert profile.position[-1] + 60 == pytest.approx(place, abs=1e-9)
    if place == 2500.0:  # a speed is reached at its place too
        knot = int(np.searchsorted(profile.position, 2000 - 60))
        assert profile.velocity[knot] == pytest.approx(30 / 3.6, abs=1e-3)
        assert profile.velocity[knot - 100] > 30 / 3.6 + 0.05


def test_running_backwards_passes_through_rest() -> None:
    profile = build(start=2000, phases=[{"accelerate_to": 12}, {"accelerate_to": -12}, {"brake_to": 0}])
    assert (profile.velocity.min(), profile.velocity.max()) == pytest.approx((-12, 12), abs=0.01)


def test_points_keep_distance_and_jerk() -> None:
    points = [{"time": t, "speed": v} for t, v in ((0, 0), (20, 15), (100, 15), (110, 10), (150, 10), (170, 0))]
    profile = build(limits={"jerk": 0.4}, points=points)
    assert profile.position[-1] == pytest.approx(150 + 1200 + 125 + 400 + 100, abs=1e-6)
    assert np.abs(profile.jerk()).max() <= 0.4 + 1e-9
    assert profile.end == pytest.approx(170 + 1.25 / 0.4, abs=0.05)
    assert profile.velocity.max() == pytest.approx(15, abs=1e-9)


def test_points_over_places_stop_there() -> None:
    points = [{"place": s, "speed": v} for s, v in ((60, 0), (400, 20), (2000, 20), (2300, 0))]
    assert build(points=points).position[[0, -1]] == pytest.approx([0.0, 2300 - 60], abs=1e-6)


def test_steps_are_the_reference_of_paper_002() -> None:
    steps = [{"at": 0, "speed": 12}, {"at": 10, "speed": 0}, {"at": 20, "speed": -12}]
    profile = build(0.01, start=320, steps=steps, until=30, allow_rolling_end=True)
    for t, x, v in ((0, 320, 12), (9.99, 439.88, 12), (10, 440, 0), (19.99, 440, 0), (25, 380, -12), (30, 320, -12)):
        assert profile.at(t)[:2] == (pytest.approx(x, abs=1e-9), v)


def test_a_file_is_restored_bit_for_bit_and_inlined(tmp_path: Path) -> None:
    profile = build(**METRO)
    for name in ("run.csv", "run.yaml"):
        write_profile(profile, tmp_path / name, "a source\nof two lines, r\udcff")
        assert read_profile(tmp_path / name) == profile
    block = ProfileSpec.model_validate({"file": "run.csv"})
    inlined = ProfileSpec.model_validate(block.inlined(tmp_path))
    assert inlined.file is None
    assert inlined.build(CONSIST, LINE, 0.05) == block.build(CONSIST, LINE, 0.05, folder=tmp_path) == profile


def test_units_missing_columns_and_uneven_times(tmp_path: Path) -> None:
    """A run of constant acceleration written in km and km/h at uneven times must come out on even knots."""
    time = np.array([0.0, 0.3, 1.1, 2.0, 2.7, 4.0, 5.5, 6.0])
    rows = "\n".join(f"{t},{3.6 * 0.5 * t}" for t in time)
    (tmp_path / "a.csv").write_text(f"# by hand\ntime_s,speed_kmh\n{rows}\n")
    profile = read_profile(tmp_path / "a.csv", 0.1)
    assert profile.position[-1] == pytest.approx(0.25 * 36, abs=1e-9)
    assert profile.velocity[10] == pytest.approx(0.5, abs=1e-12)
    with pytest.raises(ValueError, match="not evenly spaced"):
        read_profile(tmp_path / "a.csv")


def test_phases_continue_a_file_that_ends_rolling(tmp_path: Path) -> None:
    time = 0.1 * np.arange(101)
    rolling = Profile(time, 10 * time, np.full(101, 10.0), np.zeros(101))
    write_profile(rolling, tmp_path / "rolling.csv")
    block = {"file": "rolling.csv", "limits": {"deceleration": 0.5, "jerk": 0.5}, "append": [{"brake_to": 0}]}
    profile = ProfileSpec.model_validate(block).build(CONSIST, LINE, 0.1, folder=tmp_path)
    assert profile.position[-1] == pytest.approx(100 + 5 * (20 + 1), abs=1e-6)
    with pytest.raises(ValueError, match=r"ends rolling at 36\.0 km/h .* or set profile\.allow_rolling_end: true"):
        ProfileSpec.model_validate({"file": "rolling.csv"}).build(CONSIST, LINE, 0.1, folder=tmp_path)


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ({}, "exactly one of"),
        ({"file": "a", "phases": [{"cruise_for": 1}]}, "exactly one of"),
        ({"steps": [{"at": 0, "speed": 1}]}, "until"),
        ({"phases": [{"cruise_for": 1, "brake_to": 0}]}, "exactly one of"),
        ({"phases": [{"cruise_for": 1, "at": 0}]}, "'at' has no effect with"),
        ({"phases": [{"accelerate_to": math.inf}]}, "finite"),
        ({"phases": [{"accelerate_to": 5}], "limits": {"jerk": -1}}, "greater than 0"),
        ({"points": [{"time": 0, "place": 0, "speed": 1}, {"time": 1, "speed": 0}]}, "either a time or a place"),
    ],
)
def test_a_wrong_block_is_refused_by_its_model(block: dict[str, Any], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        ProfileSpec.model_validate(block)


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ({"phases": [{"accelerate_to_kmh": 80}, {"stop_at_km": 12}]}, r"km 12\.000 .* beyond the end of line 'flat'"),
        ({"phases": [{"accelerate_to_kmh": 80}, {"stop_at": 200}]}, r"phase 1: stop_at = km 0\.200 .* earliest place"),
        ({"phases": [{"accelerate_to_kmh": 80}]}, "ends rolling"),
        ({"phases": [{"accelerate_to_kmh": 50}, {"accelerate_to_kmh": 20}]}, "phase 1: accelerate_to is below"),
        ({"phases": [{"cruise_for": 9}, {"cruise_until": 5}]}, r"phase 1: cruise_until = 5 s is before .* at 9\.00"),
        ({"phases": [{"accelerate_to_kmh": 150}, {"brake_to": 0}], "limits": {"traction_fraction": 0.8}}, "150.0 km/h"),
        ({"start": 100, "phases": [{"accelerate_to": -9}, {"cruise_for": 60}, {"brake_to": 0}]}, "before the begin"),
        ({"points": [{"time": 0, "speed": 1}, {"time": 0, "speed": 0}]}, "number 1"),
        ({"points": [{"place": 0, "speed": 0}, {"place": 9, "speed": 0}]}, "at rest"),
        ({"file": "missing.csv"}, "missing.csv: cannot be read"),
        ({"knots": "time,speed\n0,0\n1,x\n"}, "line 3, speed"),
        ({"knots": "time,speed\n0,0\n1\n"}, "line 3: 1 values for the 2 columns"),
        ({"knots": "time,pace\n0,0\n1,1\n"}, "column 'pace' is unknown"),
        ({"knots": "time,speed\n0,0\n1,nan\n2,0\n"}, "give a finite number"),
        ({"knots": "time,speed\n1,0\n0,0\n"}, "is not after that of the previous row"),
        ({"knots": "time,speed\n0,0\n1e12,0\n"}, "at most"),
        ({"knots": "time,speed\n0,0\n5e7,0\n"}, "a profile of 500000001 knots"),
        ({"knots": "# nothing\n"}, "no row of column names"),
    ],
)
def test_an_impossible_profile_is_refused_in_one_line(block: dict[str, Any], message: str) -> None:
    with one_line(message):
        ProfileSpec.model_validate(block).build(CONSIST, LINE, 0.1, folder=Path())


@given(st.binary(max_size=200))
@settings(max_examples=100, deadline=None)
def test_random_bytes_are_a_profile_or_one_line(tmp_path_factory: pytest.TempPathFactory, noise: bytes) -> None:
    for suffix in ("csv", "yaml"):
        path = tmp_path_factory.getbasetemp() / f"noise_{hash(noise)}.{suffix}"
        path.write_bytes(noise)
        try:
            read_profile(path, 0.1)
        except ValueError as error:
            assert "\n" not in str(error) and path.name in str(error)
        path.unlink()


def test_a_grid_of_a_file_is_of_finite_seconds(tmp_path: Path) -> None:
    for grid in (".nan", "1.0e+300", "true", "1.0e-12", "1, start: .inf"):
        (tmp_path / "p.yaml").write_text(f"{{schema: train_ato/profile/1, speed: [0, 1, 0], period: {grid}}}")
        with pytest.raises(ValueError, match=r"p\.yaml: period, start: .* give seconds"):
            read_profile(tmp_path / "p.yaml")


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
    single = [profile.at((start + k * step) * 1e-9)[:3] for k in range(count)]
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
    with one_line(message):
        Profile(*(np.array(column, dtype=float) for column in columns))
