"""Time and place of the worst value of every metric that a criterion uses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from train_ato.loop.metrics import (
    JERK_SPAN,
    differences,
    evaluated_ticks,
    excess_speed,
    km_of_front,
    mean_jerk_1s,
    position_errors,
    speed_errors,
)
from train_ato.loop.recording import Recording
from train_ato.loop.setup import RunSetup
from train_ato.loop.stops import StopResult, stops_of_run
from train_ato.messages.types import Array


def worst_places(setup: RunSetup, recording: Recording, metrics: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """Return ``at_s`` [s] and ``km`` of the train's front at the worst value, by metric.

    Parameters
    ----------
    setup, recording
        Run with at least one complete tick.
    metrics
        Metrics of the run (:func:`train_ato.loop.metrics.summarise`) and of its protection.

    Returns
    -------
    dict
        A root mean square has the place of its largest error, a stop that of the standstill, a stop that was not made
        that of the planned arrival, interventions that of the first one. A metric with the value 0 has no place.
    """
    return {
        metric: {"at_s": at_s, "km": km_of_front(setup, recording, at_s)}
        for metric, at_s in _worst_times(setup, recording, metrics)
        if at_s is not None and metrics.get(metric, 0) != 0
    }


def _worst_times(
    setup: RunSetup, recording: Recording, metrics: Mapping[str, Any]
) -> Iterator[tuple[str, float | None]]:
    """Yield every metric and the time of its worst value [s]."""
    time, part = recording.time, evaluated_ticks(setup, recording)
    yield from _stop_times(stops_of_run(setup, recording))
    yield "overspeed_max_kmh", _at_largest(time, excess_speed(setup, recording))
    yield "speed_rmse_kmh", _at_largest(time[part], np.abs(speed_errors(recording, part)))
    run = slice(part.start, None)
    yield "speed_error_run_max_kmh", _at_largest(time[run], np.abs(speed_errors(recording, run)))
    yield "position_error_max_m", _at_largest(time[part], np.abs(position_errors(setup, recording, part)))
    yield "coupler_draft_max_kn", _coupler_time(recording, "coupler_draft_max", recording.coupler_draft_max)
    yield "coupler_buff_max_kn", _coupler_time(recording, "coupler_buff_max", -recording.coupler_buff_max)
    acceleration, _ = differences(recording.front_velocity, setup.tick)
    jerk = mean_jerk_1s(acceleration, setup.tick)
    begins = time[:: max(1, round(JERK_SPAN / setup.tick))]
    second = (acceleration.size + 1 - jerk.size) // 2
    yield "acceleration_max", _at_largest((begins[:-1] + begins[1:]) / 2, np.abs(acceleration))
    yield "jerk_1s_max", _at_largest(begins[second : second + jerk.size], np.abs(jerk))
    yield "brake_interventions", metrics.get("first_intervention_s")


def _stop_times(stops: list[StopResult]) -> Iterator[tuple[str, float | None]]:
    """Yield the metrics of the stops with the time of the worst one, or of the first one that was not made."""
    missed = [stop.planned for stop in stops if stop.arrival is None]
    made = [(stop.error, stop.arrival, stop.planned) for stop in stops if stop.arrival is not None]
    worst = max(made, key=lambda stop: abs(stop[0] or 0.0), default=(0.0, None, 0.0))[1]
    latest = max(made, key=lambda stop: stop[1] - stop[2], default=(0.0, None, 0.0))[1]
    yield "stop_error_max_m", missed[0] if missed else worst
    yield "arrival_delay_max_s", missed[0] if missed else latest


def _at_largest(time: Array, values: Array) -> float | None:
    """Return the time of the largest value, shape (k,) or (k, n); None without values."""
    return float(time[int(values.argmax()) // (values.size // time.size)]) if values.size and time.size else None


def _coupler_time(recording: Recording, key: str, forces: Array) -> float | None:
    """Return the time of the largest coupler force of the run.

    The plant has the largest force of all its steps since the start in its diagnostics, once a second; the tick with
    the largest force in the second of its last increase is less than a tick beside it. A run for its summary only
    keeps no forces of the ticks, and its coupler forces have no time.
    """
    reported = recording.reported("plant", key)
    if reported is None:
        return _at_largest(recording.time, forces)
    changed = np.flatnonzero(np.diff(reported[1])) + 1
    last = int(changed[-1]) if changed.size else 0
    end, begin = reported[0][last], reported[0][last - 1] if last else -np.inf
    rows = np.flatnonzero((recording.time >= begin) & (recording.time <= end))
    return None if np.isnan(forces[rows]).any() else _at_largest(recording.time[rows], forces[rows])
