"""Results with chosen figures, for tests of judges."""

from typing import Any

import numpy as np
from recordings import recording_of

from train_ato.judge.recording import Recording
from train_ato.loop.engine import run_engine
from train_ato.messages.types import Array
from train_ato.papers.claims import Claim, Paper, Result, printed
from train_ato.scenario.scenario import load_scenario
from train_ato.scenario.setup import prepare

FIGURES = {
    "speed_rmse_kmh": 0.01, "speed_error_max_kmh": 0.05, "coupler_draft_max_kn": 500.0, "coupler_buff_max_kn": -400.0,
    "command_variation_kn_per_s": 8.0, "saturated_s": 0.0, "stop_error_m": 0.01, "position_error_max_m": 0.1,
    "overspeed_max_kmh": 0.1,
}  # fmt: skip


def series(error: Array, command: Array, period: float = 0.05) -> Recording:
    """Return the series of a train at 20 m/s with this speed error [m/s] and command [N]."""
    time, speed = period * np.arange(error.size), np.full(error.size, 20.0)
    place = 20.0 * time
    return recording_of(
        time, 1, position=place, velocity=speed + error, front_position=place, front_velocity=speed + error,
        applied=command, command=command, reference_position=place, reference_velocity=speed,
    )  # fmt: skip


def drive(name: str, **changes: Any) -> Recording:
    """Return the recording of a run with the printed train of a paper."""
    outcome = run_engine(prepare(*printed(*load_scenario(name, changes=changes))))
    assert outcome.recording is not None
    return outcome.recording


def result(recording: Recording | None = None, **figures: float | None) -> Result:
    """Return a result with the given figures in place of ordinary ones."""
    return Result({**FIGURES, **figures}, recording)


def claim(paper: Paper, text: str) -> Claim:
    """Return the one claim of a paper whose text begins so."""
    (found,) = (entry for entry in paper.claims if entry.text.startswith(text))
    return found
