"""Figures of a run against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from plant_sim.line import Line
from train_ato.engine import run_engine
from train_ato.history import History
from train_ato.metrics import differences, limit_over_train, overspeed, scored_part, stop_error, summarise
from train_ato.run_setup import RunSetup, prepare
from train_ato.scenario import load


def setup_of(name: str = "demo", *assignments: str) -> RunSetup:
    return prepare(*load(name, assignments))


def history(**series: object) -> History:
    """Ten ticks at 10 m/s, right on the reference, but for the series given."""
    k = 10
    time = 0.1 * np.arange(k)
    ten = np.full(k, 10.0)
    base = {
        "time": time, "position": (10 * time)[:, None], "velocity": ten[:, None], "front_position": 10 * time,
        "front_velocity": ten, "coupler_high": ten, "coupler_low": -ten, "coupler_some": np.zeros((k, 3)),
        "applied": np.zeros((k, 1)), "command": np.zeros((k, 1)), "estimate": np.zeros((k, 1)),
        "disturbance": np.zeros((k, 1)),
        "reference_position": 10 * time, "reference_velocity": ten, "reference_acceleration": np.zeros(k),
        "final_position": 10.0, "final_velocity": 10.0, "totals": {},
    }  # fmt: skip
    return History(**{**base, **series})  # type: ignore[arg-type]


def test_rms_is_the_square_root_of_the_mean_square() -> None:
    """Paper 000 prints (41) without the square: alternating +-0.1 m/s would then give 0."""
    error = 0.1 * (-1.0) ** np.arange(10)
    figures = summarise(setup_of(), history(velocity=(10.0 + error)[:, None]))
    assert figures["speed_rmse_kmh"] == pytest.approx(0.36)
    assert figures["speed_error_max_kmh"] == pytest.approx(0.36)


def test_rms_starts_at_first_motion_and_ends_with_the_scored_part() -> None:
    """Breaks if standing at the start waters the rms down, or the stop is scored with the run."""
    still = np.where(np.arange(10) < 4, 0.0, 10.0)
    standing = history(front_velocity=still, reference_velocity=still, velocity=still[:, None])
    assert scored_part(setup_of(), standing) == slice(4, 10)
    until = setup_of("demo", "score.until=6.5")
    assert scored_part(until, history()) == slice(0, 7)
    assert scored_part(setup_of("demo", "score.until_time=0.35"), history()) == slice(0, 4)


def test_variation_is_the_sum_of_changes_over_the_duration() -> None:
    """Changes of 3 kN up and down nine times in one second are 27 kN/s."""
    command = 3000.0 * (np.arange(10) % 2)
    assert summarise(setup_of(), history(command=command[:, None]))["command_variation_kn_per_s"] == pytest.approx(27)


@pytest.mark.parametrize("tick", [0.05, 0.1])
def test_jerk_is_taken_over_a_tenth_of_a_second_whatever_the_tick(tick: float) -> None:
    """V = t³/6 has jerk 1; single ticks of 0.05 s with alternating noise of 1 mm/s would show 0.8 more."""
    time = tick * np.arange(round(2 / tick))
    noise = 1e-3 * (np.arange(time.size) % 2) if tick == 0.05 else 0.0
    acceleration, jerk = differences(time**3 / 6 + noise, tick)
    np.testing.assert_allclose(acceleration, (np.arange(acceleration.size) + 0.5) ** 2 * 0.005 + 0.0004, atol=5e-4)
    spread = np.diff(acceleration) / 0.1
    np.testing.assert_allclose(jerk, spread)
    assert jerk.size == acceleration.size - 1


def test_limit_holds_until_the_rear_has_left_it() -> None:
    """Breaks if the limit is looked up at the front alone."""
    line = Line.model_validate(
        {
            "schema": "train_ato/line/1", "name": "l", "end": 5000,
            "speed_limits": [{"at": 0, "speed": 20}, {"at": 1000, "speed": 10}, {"at": 2000, "speed": 30}],
        }
    )  # fmt: skip
    front = np.array([999.0, 1000.0, 1999.0, 2300.0, 2499.0, 2501.0])
    assert limit_over_train(line, front, 500.0).tolist() == [20, 10, 10, 10, 10, 30]


def test_overspeed_is_zero_below_the_limit_and_counts_above() -> None:
    """80 km/h on the Daqin section."""
    assert overspeed(setup_of(), history()) == 0.0
    assert overspeed(setup_of(), history(front_velocity=np.full(10, 23.0))) == pytest.approx(23 - 80 / 3.6)


def test_stop_error_only_of_a_train_that_stands() -> None:
    """Breaks if a rolling train gets a stop error."""
    setup = setup_of()
    target = float(setup.profile.position[-1])
    assert stop_error(setup, history()) is None
    assert stop_error(setup, history(final_velocity=0.005, final_position=target + 0.2)) == pytest.approx(0.2)


def test_summary_has_every_key_of_the_design() -> None:
    """Breaks if a key that other tools read goes missing."""
    outcome = run_engine(setup_of("demo", "duration=5"))
    wanted = """
        scenario controller observer compensation seed ticks simulated_s wall_s real_time_factor speed_rmse_kmh
        speed_error_max_kmh position_error_max_m position_rmse_m stop_error_m overspeed_max_kmh coupler_draft_max_kn
        coupler_buff_max_kn acceleration_max jerk_max command_variation_kn_per_s energy_traction_kwh
        energy_regenerated_kwh saturated_s step_time_us_median step_time_us_p99 version
    """
    assert set(wanted.split()) <= set(outcome.summary)
    assert outcome.summary["ticks"] == 50
