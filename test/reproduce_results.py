"""Results with chosen figures, for tests of judges."""

import numpy as np
from recordings import recording_of

from train_ato.judge.recording import Recording
from train_ato.messages.types import Array
from train_ato.papers.claims import Claim, Paper, Result

FIGURES = {
    "speed_rmse_kmh": 0.01, "speed_error_max_kmh": 0.05, "coupler_draft_max_kn": 500.0, "coupler_buff_max_kn": -400.0,
    "command_variation_kn_per_s": 8.0, "saturated_s": 0.0, "stop_error_m": 0.01, "position_error_max_m": 0.1,
    "overspeed_max_kmh": 0.1,
}  # fmt: skip


def series(error: Array, command: Array, period: float = 0.05) -> Recording:
    """Return the series of a train at 20 m/s with this speed error [m/s] and command [N]."""
    count = error.size
    time = period * np.arange(count)
    speed = np.full(count, 20.0)
    return recording_of(
        time, position=20.0 * time, velocity=speed + error, front_position=20.0 * time, front_velocity=speed + error,
        coupler_draft_max=np.zeros(count), coupler_buff_max=np.zeros(count), applied=command, command=command,
        estimate=np.zeros(count), disturbance=np.zeros(count), reference_position=20.0 * time, reference_velocity=speed,
        reference_acceleration=np.zeros(count),
    )  # fmt: skip


def result(recording: Recording | None = None, **figures: float | None) -> Result:
    """Return a result with the given figures in place of ordinary ones."""
    return Result({**FIGURES, **figures}, recording)


def claim(paper: Paper, text: str) -> Claim:
    """Return the one claim of a paper whose text begins so."""
    (found,) = (entry for entry in paper.claims if entry.text.startswith(text))
    return found
