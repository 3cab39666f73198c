"""Downsampling and delay identification on arrays: peaks, gaps, delays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant_sim.library import load_line
from train_ato.apps.report.delays import found_delay
from train_ato.apps.report.downsample import NO_CODE, heat_map, kept
from train_ato.apps.report.track_shape import track_shape
from train_ato.loop.series import aligned


@given(st.integers(1, 5), st.integers(1, 4000), st.integers(20, 300), st.integers(0, 2**32 - 1))
def test_no_peak_of_any_column_is_lost(columns: int, count: int, rows: int, seed: int) -> None:
    """Breaks if downsampling loses an extreme, the ends or the order, or keeps too many rows."""
    random = np.random.default_rng(seed)
    table = [random.standard_normal(count) for _ in range(columns)]
    chosen = kept(table, rows)
    assert chosen.size <= max(rows, 2 * columns + 2)
    assert (np.diff(chosen) > 0).all()
    assert (chosen[0], chosen[-1]) == (0, count - 1)
    for column in table:
        assert column[chosen].max() == column.max()
        assert column[chosen].min() == column.min()


@given(st.integers(0, 99_999))
def test_a_spike_of_one_tick_in_an_hour_stays_at_its_time(place: int) -> None:
    """Breaks if peaks are averaged or shifted in time."""
    values = np.sin(np.arange(100_000) / 5000.0)
    values[place] = -7.0
    assert place in kept([values, np.zeros(100_000)], 2000)


def test_gaps_stay_gaps() -> None:
    """Breaks if a line is drawn across a gap, or its ends move."""
    values = np.sin(np.arange(50_000) / 300.0)
    values[20_000:30_000] = np.nan
    chosen = kept([values], 1000)
    assert np.isnan(values[chosen]).any()
    good = chosen[~np.isnan(values[chosen])]
    assert (good[good < 25_000].max(), good[good > 25_000].min()) == (19_999, 30_000)


@given(st.integers(1, 3000), st.integers(1, 40), st.integers(10, 500), st.integers(0, 2**32 - 1))
def test_a_heat_map_keeps_every_vehicles_extreme(count: int, vehicles: int, columns: int, seed: int) -> None:
    """Breaks if a cell shows the mean, loses the sign, or a regular log has gaps."""
    values = np.random.default_rng(seed).standard_normal((count, vehicles)) * 1e3
    picture = heat_map(0.1 * np.arange(count), values, columns)
    assert picture.codes.shape == (vehicles, min(count, columns))
    assert NO_CODE not in picture.codes
    vehicle = int(np.abs(values).max(axis=0).argmax())
    extreme = values[np.abs(values[:, vehicle]).argmax(), vehicle]
    shown = picture.codes[vehicle] * picture.unit
    assert shown[np.abs(shown).argmax()] == pytest.approx(extreme, rel=1 / 127)
    for number in range(vehicles):
        assert np.abs(picture.codes[number]).max() * picture.unit == pytest.approx(
            np.abs(values[:, number]).max(), abs=picture.unit
        )


def test_a_heat_map_of_a_log_with_a_gap_is_grey_there() -> None:
    """Breaks if missing messages are shown as zero force."""
    time = np.concatenate((np.arange(0, 100, 0.1), np.arange(150, 200, 0.1)))
    picture = heat_map(time, np.ones((time.size, 3)), 200)
    middles = picture.begin + (np.arange(200) + 0.5) * (picture.end - picture.begin) / 200
    grey = (picture.codes == NO_CODE).all(axis=0)
    assert grey[(middles > 105) & (middles < 149)].all()
    assert not grey[(middles < 99) | (middles > 151)].any()


def test_another_scale_changes_codes_not_values() -> None:
    """Breaks if a common scale changes the forces."""
    values = np.linspace(-400, 400, 500)[:, None]
    picture = heat_map(0.1 * np.arange(500), values, 500)
    wide = picture.scaled(800.0)
    assert wide.largest == pytest.approx(800.0)
    assert wide.codes * wide.unit == pytest.approx(picture.codes * picture.unit, abs=wide.unit)


def test_values_at_other_times_are_exact_linear_or_missing() -> None:
    """Breaks if a slow topic is held too long, or a gap has values."""
    time = np.arange(10.0)
    assert aligned(time, time, time**2).tolist() == (time**2).tolist()
    assert aligned(np.array([0.5, 2.25]), time, 2 * time) == pytest.approx([1.0, 4.5])
    gap = np.array([0.0, 1.0, 2.0, 7.0, 8.0])
    found = aligned(np.array([1.5, 4.5, 7.5]), gap, gap)
    assert found[[0, 2]] == pytest.approx([1.5, 7.5])
    assert np.isnan(found[1])
    assert np.isnan(aligned(time, np.empty(0), np.empty(0))).all()


@pytest.mark.parametrize(
    ("delay", "lag", "tick"), [(0.8, 0.4, 0.1), (0.0, 0.0, 0.1), (1.25, 0.0, 0.05), (0.3, 0.6, 0.02)]
)
def test_a_delay_is_found_to_a_part_of_a_tick(delay: float, lag: float, tick: float) -> None:
    """Breaks if the identified delay is wrong, or the lag is missing in it."""
    fine = 20
    time = np.arange(0.0, 400.0, tick)
    demand = 1e5 * (np.sin(time / 7) + 0.5 * np.sin(time / 2.3 + 1))
    moments = np.arange(0.0, 400.0, tick / fine)
    held = np.maximum(np.floor((moments - delay) / tick + 1e-9).astype(int), 0)
    force = demand[held]
    if lag:
        gain, state, smooth = 1 - np.exp(-tick / fine / lag), force[0], []
        for value in force:
            smooth.append(state)
            state += gain * (value - state)
        force = np.array(smooth)
    middle, found = found_delay(time, demand, force[::fine], 4.0, lag)
    assert middle.size > 5
    assert np.isfinite(found).all()
    assert np.median(found) == pytest.approx(delay + lag, abs=0.5 * tick)


def test_no_delay_is_found_where_nothing_moves() -> None:
    """Breaks if a delay is identified from the noise of a constant force."""
    time = np.arange(0.0, 200.0, 0.1)
    demand = np.where(time < 100, 1e5 * np.sin(time), 2e5)
    _, found = found_delay(time, demand, np.roll(demand, 5), 3.0)
    assert np.isfinite(found[: found.size // 2 - 2]).all()
    assert np.isnan(found[found.size // 2 + 2 :]).all()
    assert found_delay(time[:3], demand[:3], demand[:3], 3.0)[0].size == 0


def test_a_track_has_its_grades_heights_and_curves() -> None:
    """Breaks if grades are shifted, equal ones are split at curves, or heights are wrong."""
    line = load_line("daqin_section")
    shape = track_shape(line, 0.0, 45_000.0)
    assert shape.grade[-1] == shape.grade[-2]
    assert (np.diff(shape.grade[:-1]) != 0).all()
    rise = (np.diff(shape.place) * shape.grade[:-1]).sum()
    assert shape.height[-1] == pytest.approx(rise)
    assert len(shape.curves) == sum(curve.begin < 45_000 for curve in line.curves)
    for begin, end, radius in shape.curves:
        assert 0 <= begin < end <= 45
        assert radius > 100
    assert track_shape(load_line("level"), 0.0, 1000.0).is_plain
