"""Runs with chosen position and speed errors, for the judges of papers 002, 003 and 004."""

from __future__ import annotations

import numpy as np
from recordings import with_series
from reproduce_results import FIGURES, series

from train_ato.loop.recording import Recording
from train_ato.messages.types import Array
from train_ato.papers.claims import Result


def run(
    place: float = 0.0,
    speed: float = 0.0,
    *,
    units: int = 1,
    until: float = 20.0,
    duration: float = 100.0,
    tick: float = 0.05,
    force: float = 0.0,
    spacing: float = 80.0,
) -> Recording:
    """Return the series of a train with constant errors [m, m/s] up to a time [s] and none later."""
    count = round(duration / tick)
    base = series(np.zeros(count), np.full(count, force), tick)
    t = base.time
    off = np.where(t < until, 1.0, 0.0)
    columns = np.ones(units)
    position = base.reference_position + place * off
    velocity = base.reference_velocity + speed * off
    return with_series(
        base,
        position=position[:, None] - spacing * np.arange(units),
        velocity=velocity[:, None] * columns,
        front_position=position,
        front_velocity=velocity,
        applied=base.applied * columns,
        command=base.command * columns,
    )


def tracked(place: float = 0.0, speed: float = 0.0, **more: float) -> Result:
    """Return a result of one unit with a largest position and speed error [m, m/s]."""
    figures = {key: more.pop(key) for key in list(more) if key in FIGURES}
    recording = run(place, speed, **more)  # type: ignore[arg-type]
    return Result({**FIGURES, **figures}, recording)


def with_command(result: Result, command: Array) -> Result:
    """Return the result with another command [N]."""
    assert result.recording is not None
    recording = with_series(result.recording, command=command[:, None], applied=command[:, None])
    return Result(result.summary, recording)
