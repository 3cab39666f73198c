"""Paper 003: series of the judges; short runs of the law with and without saturation."""

import math

import numpy as np
import pytest
from judge_results import tracked, with_command
from recordings import with_series
from reproduce_results import drive, series

from train_ato.papers.checks import late_cruise, position_error, speed_error, time_within, written
from train_ato.papers.claims import printed
from train_ato.papers.p003_funnel.cases import CASES, TRAINS
from train_ato.papers.p003_funnel.checks import boundaries, last_saturation, off_profile, recovery_by_38
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare


def test_last_saturation_bridges_gaps_and_takes_the_longest() -> None:
    """Breaks if a sample inside the limits splits an interval, or a short interval counts."""
    t = 0.05 * np.arange(2000)
    command = np.where((t > 5) & (t < 8), 200e3, 0.0) + np.where(
        (t > 30) & (t < 60) & (np.abs(t - 40) > 2), -200e3, 0.0
    )
    recording = with_command(tracked(), command).recording
    assert recording is not None
    assert last_saturation(recording, 200e3) == pytest.approx((30.05, 59.95), abs=0.06)
    with pytest.raises(ValueError, match="never at its limit"):
        last_saturation(recording, 240e3)


def test_the_limit_of_theorem_1_is_read_late_in_the_longest_cruise() -> None:
    """Breaks if the window holds a change of speed, a shorter cruise, standstill, or the begin of the cruise."""
    speed = np.repeat([0.0, 20.0, 30.0, 40.0, 20.0, 0.0], [12, 4, 2, 8, 2, 12])
    pull = np.repeat([0.0, 0.0, 0.3, 0.0, -0.3, 0.0], [12, 4, 2, 8, 2, 12])
    base = series(np.zeros(40), np.zeros(40))
    run = with_series(base, reference_velocity=speed, reference_acceleration=pull)
    assert np.flatnonzero(late_cruise(run)).tolist() == [22, 23, 24, 25]
    with pytest.raises(ValueError, match="no constant speed"):
        late_cruise(with_series(run, reference_acceleration=np.full(40, 0.1)))


def test_time_within_a_band_and_how_figures_are_written() -> None:
    """Breaks if a later excursion is missed, NaN counts as within, or a unit is wrong by a factor of 1000."""
    time = np.arange(6.0)
    values = np.array([[5.0], [0.0], [-3.0], [0.1], [0.0], [9.0]])
    assert time_within(time, values, 1.0, end=5.0) == 3.0
    assert time_within(time, values, 1.0, 1.0, 5.0) == 2.0
    assert time_within(time, values, 10.0) == 0.0
    assert np.isnan(time_within(time, values, 1.0))
    assert np.isnan(time_within(time, np.full((6, 1), np.nan), 10.0))
    figures = ((0.0024, "m"), (43.97, "m"), (7353.0, "m"), (float("nan"), "s"), (0.698, "m/s"))
    assert [written(*one) for one in figures] == ["2.4 mm", "44 m", "7.35 km", "never", "0.698 m/s"]


def test_printed_law_carries_an_offset_and_the_corrected_one_does_not() -> None:
    """During acceleration the printed law has an offset of h/k1, centimetres; with lambda in 1/s a third of it."""
    found = {}
    for key in ("printed nominal", "corrected nominal"):
        recording = drive(CASES[key].scenario, **{**CASES[key].changes, "duration": 60.0})
        found[key] = np.abs(position_error(recording)[recording.time > 30.0]).max()
    assert 0.02 < found["printed nominal"] < 0.05
    assert found["corrected nominal"] < found["printed nominal"] / 3


@pytest.mark.campaign
def test_saturation_recovers_and_its_funnels_are_wide_open() -> None:
    """An error of 44 m returns below 10 cm; the printed funnel ends far wider than the largest error."""
    case = CASES["printed saturated"]
    recording = drive(case.scenario, **case.changes)
    error = np.abs(position_error(recording)[:, 0])
    assert 43.0 < error.max() < 46.0
    assert error[-200:].max() < 0.1
    assert np.abs(speed_error(recording)).max() < 4.0
    phi1, phi2 = boundaries(case, recording)
    assert phi1[-1] > 10 * error.max()
    assert phi2[-1] > 100.0
    assert phi2[0] == pytest.approx(0.1)


@pytest.mark.campaign
def test_planned_for_200_kn_stays_within_13_m_of_the_other_profile() -> None:
    """Breaks if the shipped variant demands more than the available force, or increases the error."""
    case = CASES["pid planned"]
    recording = drive(case.scenario, **case.changes)
    off, fast = off_profile(recording, "crh380a_funnel:short")
    assert 5.0 < np.abs(off).max() < 13.0
    assert np.abs(fast).max() < 1.0
    assert np.abs(position_error(recording)).max() < 0.05


def test_trains_are_variants_of_the_short_run() -> None:
    """Breaks if a mismatch of the plant is also in the model of the law."""
    nominal = prepare(*printed(*load_scenario("crh380a_funnel:short")))
    for train in ("half_more", "later", "lagging", "light"):
        setup = prepare(*printed(*load_scenario(f"crh380a_funnel:short{TRAINS[train][1]}")))
        assert setup.model.inertia == nominal.model.inertia
        assert setup.model.lag == nominal.model.lag
        assert list(setup.model.delay) == list(nominal.model.delay)
        assert setup.plant != nominal.plant or setup.links != nominal.links


@pytest.mark.parametrize("error", [0.011, 0.1, 4.0])
def test_time_of_38_is_that_of_the_printed_funnel(error: float) -> None:
    """(8) without saturation: after the time of (38) a funnel of the width e2(t0) has 1 cm/s."""
    time = recovery_by_38(error)
    rest = 3e-7 / 0.0034
    assert (error - rest) * math.exp(-0.0034 * time) + rest == pytest.approx(0.01, rel=1e-9)
    assert math.isnan(recovery_by_38(0.005))
