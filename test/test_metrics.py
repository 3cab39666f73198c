"""Figures of a run against hand calculations."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from recordings import recording_of, with_final

from plant_sim.line import Line
from train_ato.loop.engine import run_engine
from train_ato.loop.metrics import (
    differences,
    evaluated_ticks,
    limit_over_train,
    mean_jerk_1s,
    overspeed,
    stop_error,
    summarise,
)
from train_ato.loop.recording import Recording
from train_ato.loop.setup import RunSetup, prepare
from train_ato.messages.types import Diagnostic
from train_ato.scenario.scenario import load_scenario


def setup_of(name: str = "demo", *assignments: str) -> RunSetup:
    return prepare(*load_scenario(name, assignments))


def recording(**series: object) -> Recording:
    """Ten ticks at 10 m/s on the reference, except for the given series."""
    k = 10
    time = 0.1 * np.arange(k)
    ten = np.full(k, 10.0)
    base = {
        "position": (10 * time)[:, None], "velocity": ten[:, None], "front_position": 10 * time,
        "front_velocity": ten, "coupler_draft_max": ten, "coupler_buff_max": -ten,
        "applied": np.zeros((k, 1)), "command": np.zeros((k, 1)), "estimate": np.zeros((k, 1)),
        "disturbance": np.zeros((k, 1)),
        "reference_position": 10 * time, "reference_velocity": ten, "reference_acceleration": np.zeros(k),
    }  # fmt: skip
    return recording_of(time, **{**base, **series})


def by_hand() -> Recording:
    """Return six ticks of 0.1 s with figures by hand calculation; the train moves from the third on."""
    speed, reference = np.array([0.0, 0.0, 1.0, 3.0, 4.0, 4.0]), np.array([0.0, 0.0, 2.0, 3.0, 3.0, 6.0])
    place_error = np.array([9.0, 9.0, 3.0, 0.0, -4.0, 0.0])
    reference_place = np.array([0.0, 0.0, 0.1, 0.4, 0.7, 1.1])
    command = 1e3 * np.array([0.0, 2.0, 5.0, 5.0, -1.0, 3.0])
    zeros = np.zeros((6, 1))
    six = recording_of(
        0.1 * np.arange(6), position=(reference_place + place_error)[:, None], velocity=speed[:, None],
        front_position=reference_place + place_error, front_velocity=speed,
        coupler_draft_max=np.zeros(6), coupler_buff_max=np.zeros(6),
        applied=zeros, command=command[:, None], estimate=zeros, disturbance=zeros,
        reference_position=reference_place, reference_velocity=reference, reference_acceleration=np.zeros(6),
    )  # fmt: skip
    totals = {
        "plant": {
            "coupler_draft_max": "1.5e6", "coupler_buff_max": "-0.25e6", "energy_traction": "7.2e6",
            "energy_regenerated": "1.8e6", "saturated": "0.3",
        },
        "profile": {"replans": "2"},
        "controller": {"held_steps": "1", "unsound_measurements": "4"},
    }  # fmt: skip
    reports = tuple(Diagnostic(0, node, 0, "", values) for node, values in totals.items())
    end = float(setup_of().profile.position[-1]) - 1.25
    return dataclasses.replace(with_final(six, end, 0.0), kept_reports=reports)


BY_HAND = {
    # Speed errors from the first motion on: -1, 0, 1, -2 m/s; the squares 1, 0, 1, 4 have the mean 1.5.
    "speed_rmse_kmh": 3.6 * 1.224744871391589,
    "speed_error_max_kmh": 7.2,
    # Without an end of the evaluation, the run has the same errors.
    "speed_rmse_run_kmh": 3.6 * 1.224744871391589,
    "speed_error_run_max_kmh": 7.2,
    # Position errors 3, 0, -4, 0 m: squares 9, 0, 16, 0, mean 6.25. The 9 m at standstill before are not scored.
    "position_error_max_m": 4.0,
    "position_rmse_m": 2.5,
    "stop_error_m": -1.25,
    # The profile of demo stops after 766 s.
    "stop_error_max_m": None,
    "running_time_s": None,
    "arrival_delay_max_s": None,
    "overspeed_max_kmh": 0.0,
    "coupler_draft_max_kn": 1500.0,
    "coupler_buff_max_kn": -250.0,
    # Speeds 0, 0, 1, 3, 4, 4 m/s every 0.1 s: accelerations 0, 10, 20, 10, 0 m/s2, jerks 100, 100, -100, -100 m/s3.
    "acceleration_max": 20.0,
    "jerk_max": 100.0,
    # Shorter than two seconds.
    "jerk_1s_max": 0.0,
    # Commands 0, 2, 5, 5, -1, 3 kN change by 2, 3, 0, 6, 4 = 15 kN in 0.6 s.
    "command_variation_kn_per_s": 25.0,
    "energy_traction_kwh": 2.0,
    "energy_regenerated_kwh": 0.5,
    "saturated_s": 0.3,
    "replans": 2,
    "held_steps": 1,
    "unsound_measurements": 4,
    # Counts that a run without faults does not have.
    "commands_lost": 0,
    "commands_missed": 0,
    "commands_refused": 0,
    "commands_late": 0,
}


def test_every_figure_of_six_ticks_is_that_worked_out_by_hand() -> None:
    """Breaks if the definition or the unit of a figure changes, or a new figure has no hand calculation."""
    figures = summarise(setup_of(), by_hand())
    assert figures.pop("stops") == []
    assert figures == pytest.approx(BY_HAND, abs=1e-9)


def test_of_several_units_rms_is_the_mean_and_the_largest_error_that_of_the_worst() -> None:
    """Constant errors of 1, -2 and 6 m/s and of 1, -2 and 6 m: rms 1, 2 and 6, their mean 3; the largest 6."""
    setup = setup_of("xuzhou_metro")
    errors, base = np.array([1.0, -2.0, 6.0]), recording()
    position = base.reference_position[:, None] - setup.model.offsets + errors
    three = np.zeros((10, 3))
    units = {"command": three, "applied": three, "estimate": three, "disturbance": three}
    figures = summarise(setup, recording(velocity=10.0 + errors + three, position=position, **units))
    assert figures["speed_rmse_kmh"] == pytest.approx(3.6 * 3.0)
    assert figures["speed_error_max_kmh"] == pytest.approx(3.6 * 6.0)
    assert figures["position_rmse_m"] == pytest.approx(3.0)
    assert figures["position_error_max_m"] == pytest.approx(6.0)


def test_rms_is_the_square_root_of_the_mean_square() -> None:
    """Paper 000 prints (41) without the square: alternating +-0.1 m/s would then give 0."""
    error = 0.1 * (-1.0) ** np.arange(10)
    figures = summarise(setup_of(), recording(velocity=(10.0 + error)[:, None]))
    assert figures["speed_rmse_kmh"] == pytest.approx(0.36)
    assert figures["speed_error_max_kmh"] == pytest.approx(0.36)


def test_rms_starts_at_first_motion_and_ends_with_the_scored_part() -> None:
    """Breaks if standstill lowers the rms, or the stop is part of the evaluation."""
    still = np.where(np.arange(10) < 4, 0.0, 10.0)
    standing = recording(front_velocity=still, reference_velocity=still, velocity=still[:, None])
    assert evaluated_ticks(setup_of(), standing) == slice(4, 10)
    until = setup_of("demo", "evaluation.until=6.5")
    assert evaluated_ticks(until, recording()) == slice(0, 7)
    assert evaluated_ticks(setup_of("demo", "evaluation.until_time=0.35"), recording()) == slice(0, 4)


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


@pytest.mark.parametrize("tick", [0.05, 0.1, 0.5])
def test_jerk_over_a_second_is_that_of_the_mean_acceleration(tick: float) -> None:
    """Breaks if the change of the mean is divided by another time than a second: 0.2 m/s³ over 5 s."""
    span = max(tick, 0.1)
    assert mean_jerk_1s(0.2 * np.arange(0.0, 5.0, span), tick) == pytest.approx(0.2)


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
    assert overspeed(setup_of(), recording()) == 0.0
    assert overspeed(setup_of(), recording(front_velocity=np.full(10, 23.0))) == pytest.approx(23 - 80 / 3.6)


def test_stop_error_only_of_a_train_that_stands() -> None:
    """Breaks if a moving train has a stop error."""
    setup = setup_of()
    target = float(setup.profile.position[-1])
    assert stop_error(setup, recording()) is None
    assert stop_error(setup, with_final(recording(), target + 0.2, 0.005)) == pytest.approx(0.2)


def test_summary_has_every_key_of_the_design() -> None:
    """Breaks if a key of the summary is missing."""
    outcome = run_engine(setup_of("demo", "duration=5"))
    wanted = """
        scenario controller observer compensation seed ticks simulated_s wall_s real_time_factor speed_rmse_kmh
        speed_error_max_kmh position_error_max_m position_rmse_m stop_error_m overspeed_max_kmh coupler_draft_max_kn
        coupler_buff_max_kn acceleration_max jerk_max command_variation_kn_per_s energy_traction_kwh
        energy_regenerated_kwh saturated_s step_time_us_median step_time_us_p99 version
    """
    assert set(wanted.split()) <= set(outcome.summary)
    assert outcome.summary["ticks"] == 50
