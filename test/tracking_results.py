"""Runs with chosen position and speed errors, for the judges of papers 002, 003 and 004."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from reproduce_results import FIGURES, series

from train_ato.history import History
from train_ato.reproduce.claims import Result
from train_ato.types import Array


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
) -> History:
    """Return the series of a train with constant errors [m, m/s] up to a time [s] and none later."""
    count = round(duration / tick)
    base = series(np.zeros(count), np.full(count, force), tick)
    t = base.time
    off = np.where(t < until, 1.0, 0.0)
    columns = np.ones(units)
    position = base.reference_position + place * off
    velocity = base.reference_velocity + speed * off
    return replace(
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
    history = run(place, speed, **more)  # type: ignore[arg-type]
    return Result({**FIGURES, **figures}, history)


def with_command(result: Result, command: Array) -> Result:
    """Return the result with another command [N]."""
    assert result.history is not None
    history = replace(result.history, command=command[:, None], applied=command[:, None])
    return Result(result.summary, history)
