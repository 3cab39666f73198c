"""Paper 004: series of the judges; short runs on sampling period and couplers."""

import numpy as np
import pytest
from judge_results import tracked
from recordings import with_series
from reproduce_results import series

from train_ato.loop.engine import run_engine
from train_ato.papers.checks import largest_speed_error
from train_ato.papers.claims import Result, printed
from train_ato.papers.p004_gpc import checks as gpc_judges
from train_ato.papers.p004_gpc.cases import CASES
from train_ato.papers.p004_gpc.checks import command_oscillation
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare


def test_largest_speed_error_leaves_the_standstill_out() -> None:
    """Breaks if the last cm/s under the holding brake count as tracking."""
    result = tracked(0.1, 0.5, until=100.0)
    assert result.recording is not None
    halted = with_series(result.recording, reference_velocity=np.zeros(result.recording.time.size))
    assert largest_speed_error(result) == pytest.approx(0.5)
    with pytest.raises(ValueError):
        largest_speed_error(Result(result.summary, halted))


def test_oscillation_of_the_command_is_measured_at_constant_speed() -> None:
    """A square wave of 30 kN and 2 s on a ramp: 30 kN, 2 s, 60 kN/s; breaks if the accelerating part counts."""
    tick, count = 0.1, 1200
    time = tick * np.arange(count)
    wave = 30e3 * np.where(np.arange(count) // 10 % 2, 1.0, -1.0)
    command = np.where(time < 40.0, 1e6 * np.sin(5.0 * time), wave)
    base = with_series(series(np.zeros(count), command, tick), reference_acceleration=np.where(time < 50.0, 0.5, 0.0))
    amplitude, period, changes = command_oscillation(base, 10.0)
    assert amplitude == pytest.approx(30.0)
    assert period == pytest.approx(2.0, rel=0.05)
    assert changes == pytest.approx(60.0, rel=0.05)
    with pytest.raises(ValueError, match="no constant speed"):
        command_oscillation(base, 115.0)


def drive(key: str, duration: float) -> Result:
    case = CASES[key]
    scenario = printed(*load_scenario(case.scenario, changes={**case.changes, "duration": duration}))
    outcome = run_engine(prepare(*scenario))
    return Result(outcome.summary, outcome.recording, outcome.failure)


def test_three_laws_lean_on_each_other_through_the_couplers() -> None:
    """Breaks if independent loops are stable with couplers or unstable without them, or the common loop is unstable."""
    duration = 260.0
    assert gpc_judges.coupler(drive("per unit", duration)) > 60.0
    assert gpc_judges.coupler(drive("gpc normal", duration)) < 20.0
    assert gpc_judges.speed_rms(drive("per unit, free", duration)) < 0.02


def test_jump_is_held_on_increments_alone() -> None:
    """Two minutes after the jump a loop identified on the speed itself oscillates by 1 m/s."""
    increments, absolute = (largest_speed_error(drive(f"{key} jump", 260.0)) for key in ("gpc", "gpc absolute"))
    assert increments < 0.6
    assert absolute > 2 * increments
