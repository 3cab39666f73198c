"""Paper 002: observers and surface against exact values."""

import math

import numpy as np
import pytest
from reproduce_results import drive

from train_ato.papers.checks import mean_speed_error, position_error, rms
from train_ato.papers.p002_freight.cases import LAWS
from train_ato.papers.p002_freight.observer_trials import fixed_time_bound, nominal_settling, observer_accuracy, truth

OFFSETS = 80.0 * np.arange(5)


def test_truth_is_the_printed_set() -> None:
    """Breaks if a disturbance, its derivative or the couplers' part of d2 is wrong; values at t = 0 by hand."""
    d1, d2, rate = (values[0] for values in truth(np.zeros(1)))
    assert d1 == pytest.approx([1.5, 0, 0, 0, 0], abs=1e-12)
    assert rate == pytest.approx([3 * math.cos(math.pi / 6), 18, 1, 1, 0], abs=1e-4)
    theta = 0.01
    plain = [0, 0, 0, 3, 6 * math.sin(1)]
    assert d2 == pytest.approx(np.array(plain) + theta * np.array([-1.5, 1.5, 0, 0, 0]), abs=1e-12)


@pytest.mark.parametrize(("gain", "error"), [(1.9, 1.0), (50.0, 1.0), (2.0, 0.5)])
def test_on_the_surface_the_time_is_the_integral_of_it(gain: float, error: float) -> None:
    """From S = 0 the time from E to the band is 7/(2 g) ln((1 + E^(2/7))/(1 + band^(2/7))), by y = E^(2/7)."""
    rate = -gain * (error + error ** (5 / 7))
    found, _ = nominal_settling(gain, error, rate, band=0.01)
    exact = 3.5 / gain * math.log((1 + error ** (2 / 7)) / (1 + 0.01 ** (2 / 7)))
    assert found["settling"] == pytest.approx(exact, rel=0.01)


def test_bound_by_hand_and_never_exceeded() -> None:
    """(23) is 3.5/g + 1.5/g, (34) is ln 2 (1.5 + 3.5)/g; 100 times the start: little more time, 10⁶ of force."""
    assert fixed_time_bound(2.0) == pytest.approx((2.5, 2.5 * math.log(2)))
    near, far = (nominal_settling(2.0, error, 0.0)[0] for error in (10.0, 1000.0))
    assert near["settling"] < far["settling"] < 1.15 * near["settling"] < near["bound"]
    assert far["acceleration"] > 1e5 * near["acceleration"]


def test_observers_at_1_ms() -> None:
    """Bare signs chatter at 1 ms; implicit ones find d1 and d2 within 10 % in 0.1 s, Levant within 1 % in 0.25 s."""
    found, series = observer_accuracy(1e-3, 0.7, 0.3)
    assert found["implicit settling"] < 0.1
    assert max(found["implicit d1"], found["implicit d2"]) < 0.12
    assert found["levant settling"] < 0.25
    assert max(found["levant d1"], found["levant d2"]) < 0.01
    assert found["printed d1"] > 0.3 or math.isnan(found["printed settling"])
    assert series["levant"].shape == series["truth"].shape == (3, series["time"].size, 5)


def test_observers_at_the_finest_sampling_time() -> None:
    """Breaks if the profile of a short run at 0.01 ms is planned beyond its end, with too many knots."""
    found, _ = observer_accuracy(1e-5, 0.002, 0.001)
    assert np.isfinite(found["printed d1"])


def test_ideal_train_is_in_its_place_after_two_seconds() -> None:
    """All five start 108 m ahead and are within 0.1 m from 1.7 s on, but never without the speed offset d1."""
    recording = drive("freight_consensus", duration=2.5)
    error = position_error(recording, OFFSETS)
    assert error[0] == pytest.approx(np.full(5, 108.0))
    assert np.abs(error[recording.time > 1.7]).max() < 0.1
    blind = drive("freight_consensus", duration=2.5, laws={"fixed_time_smc": {"unmatched": False}})
    assert np.abs(position_error(blind, OFFSETS)[blind.time > 1.7]).max() > 0.3


def test_realistic_train_at_a_delay_of_1_s() -> None:
    """The common command meets the goals; the law of the paper at gain 2 diverges within half a minute."""
    recording = drive("freight_consensus:realistic+delay_1_0", duration=60.0, **dict(LAWS["common damped"][1]))
    scored = recording.time > 5
    assert rms(position_error(recording, OFFSETS)[scored]) < 0.2
    assert rms(mean_speed_error(recording)[scored]) < 0.08
    assert max(recording.coupler_draft_max.max(), -recording.coupler_buff_max.min()) / 160e3 < 0.45
    lost = drive("freight_consensus:realistic+delay_1_0", duration=60.0, **dict(LAWS["print"][1]))
    assert rms(position_error(lost, OFFSETS)[scored]) > 5.0
