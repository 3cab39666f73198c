"""Figures of a run: how each is defined."""

from __future__ import annotations

from typing import Any

import numpy as np

from plant_sim.line import Line
from train_ato.history import History
from train_ato.run_setup import RunSetup
from train_ato.types import Array

MOVING = 0.01
"""Speed from which the train counts as moving [m/s]."""
JERK_SPAN = 0.1
"""Spacing of the differences that acceleration and jerk are taken from [s]."""


def summarise(setup: RunSetup, history: History) -> dict[str, Any]:
    """Return the figures of a run that follow from its series and the plant's totals.

    Errors are taken on the truth, v - v_d at the same stamp, every tick from first motion to the end of the scored
    part; vehicle 0, or with several driven units the mean over units for rms and the worst unit for maxima.
    """
    part = scored_part(setup, history)
    velocity_error = history.velocity[part] - history.reference_velocity[part, None]
    position_error = (
        history.position[part] + setup.model.offsets - history.reference_position[part, None]
        if setup.shape.n_units
        else np.zeros((0, 1))
    )
    totals = history.totals
    duration = history.time.size * setup.tick
    acceleration, jerk = differences(history.front_velocity, setup.tick)
    return {
        "speed_rmse_kmh": 3.6 * _rms(velocity_error),
        "speed_error_max_kmh": 3.6 * _largest(velocity_error),
        "position_error_max_m": _largest(position_error),
        "position_rmse_m": _rms(position_error),
        "stop_error_m": stop_error(setup, history),
        "overspeed_max_kmh": 3.6 * overspeed(setup, history),
        "coupler_draft_max_kn": totals.get("coupler_draft_max", 0.0) / 1e3,
        "coupler_buff_max_kn": totals.get("coupler_buff_max", 0.0) / 1e3,
        "acceleration_max": _largest(acceleration),
        "jerk_max": _largest(jerk),
        "command_variation_kn_per_s": float(np.abs(np.diff(history.command, axis=0)).sum()) / duration / 1e3,
        "energy_traction_kwh": totals.get("energy_traction", 0.0) / 3.6e6,
        "energy_regenerated_kwh": totals.get("energy_regenerated", 0.0) / 3.6e6,
        "saturated_s": totals.get("saturated", 0.0),
        "replans": int(totals.get("replans", 0)),
        "held_steps": int(totals.get("held_steps", 0)),
        "unsound_measurements": int(totals.get("unsound_measurements", 0)),
    }


def scored_part(setup: RunSetup, history: History) -> slice:
    """Return the ticks from first motion to the end of the scored part."""
    moving = np.flatnonzero((np.abs(history.front_velocity) > MOVING) | (np.abs(history.reference_velocity) > MOVING))
    first = int(moving[0]) if moving.size else 0
    last = history.time.size
    score = setup.score
    if score.until is not None:
        beyond = np.flatnonzero(history.reference_position > score.until)
        last = min(last, int(beyond[0])) if beyond.size else last
    if score.until_time is not None:
        last = min(last, int(np.searchsorted(history.time, score.until_time, side="right")))
    return slice(min(first, last), last)


def _rms(errors: Array) -> float:
    """Mean over the columns of each column's root mean square."""
    if errors.size == 0:
        return 0.0
    return float(np.sqrt((errors**2).mean(axis=0)).mean())


def _largest(values: Array) -> float:
    return float(np.abs(values).max()) if values.size else 0.0


def differences(velocity: Array, tick: float) -> tuple[Array, Array]:
    """Return acceleration [m/s²] and jerk [m/s³] from differences over 0.1 s (over a tick, where that is longer)."""
    stride = max(1, round(JERK_SPAN / tick))
    span = stride * tick
    acceleration = np.diff(velocity[::stride]) / span
    return acceleration, np.diff(acceleration) / span


def stop_error(setup: RunSetup, history: History) -> float | None:
    """Return front minus target [m] if the train stands at the end (|v| < .01 m/s), else None."""
    if abs(history.final_velocity) >= MOVING:
        return None
    return history.final_position - float(setup.profile.position[-1])


def overspeed(setup: RunSetup, history: History) -> float:
    """Return the largest speed over the limit that holds for the whole train [m/s], 0 if it was kept."""
    if not setup.line.speed_limits:
        return 0.0
    front = history.front_position + setup.consist.vehicles[0].length / 2
    limit = limit_over_train(setup.line, front, setup.consist.length)
    return float(np.maximum(0.0, history.front_velocity - limit).max())


def limit_over_train(line: Line, front: Array, length: float) -> Array:
    """Return the lowest limit between the train's rear and front [m/s], one value per front position."""
    places = np.array([limit.at for limit in line.speed_limits])
    speeds = np.array([limit.speed for limit in line.speed_limits])
    first = np.searchsorted(places, front - length, side="right") - 1
    last = np.searchsorted(places, front, side="right") - 1
    result = np.where(last >= 0, speeds[np.maximum(last, 0)], np.inf)
    for index in range(speeds.size):
        inside = (index >= first) & (index <= last)
        result = np.where(inside, np.minimum(result, speeds[index]), result)
    return np.asarray(result)
