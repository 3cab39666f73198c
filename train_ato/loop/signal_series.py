"""Series of the signals of requirements, from a recording; names, units and meanings are in the scenario layer."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from train_ato.loop.metrics import JERK_SPAN, limit_over_train
from train_ato.loop.recording import BRAKE_PIPE, BRAKE_PIPE_TAIL, BRAKE_SHOES, SUPERVISED_SPEEDS, Recording
from train_ato.loop.setup import RunSetup
from train_ato.loop.stops import PlannedStop, planned_stops
from train_ato.messages.types import Array
from train_ato.scenario.signals import find_signal

__all__ = ["SERIES", "signal_series"]

PERMITTED, EMERGENCY = 1, 4
"""Columns of the permitted speed and of the emergency-brake speed in ``atp/speeds``."""


def signal_series(names: Iterable[str], setup: RunSetup, recording: Recording) -> dict[str, Array]:
    """Return the samples of signals at the complete ticks, shape (k,) each [SI].

    A signal of a slower topic keeps its value to the next message; before the first message it has the first value.
    """
    found = {}
    for name in names:
        signal, unit = _known(name)
        values = SERIES[signal](setup, recording)
        found[name] = values.sum(axis=1) if values.ndim == 2 and unit is None else values
        if unit is not None:
            found[name] = values[:, unit]
    return found


def _known(name: str) -> tuple[str, int | None]:
    found = find_signal(name)
    assert found is not None, name
    return found[0].name, found[1]


def _front(setup: RunSetup, recording: Recording) -> Array:
    return np.asarray(recording.front_position + setup.consist.vehicles[0].length / 2.0)


def _limit(setup: RunSetup, recording: Recording) -> Array:
    return limit_over_train(setup.line, _front(setup, recording), setup.consist.length)


def _held(topic: str, name: str, column: int) -> Callable[[RunSetup, Recording], Array]:
    """Return the function of a value that is held between the messages of a topic."""

    def values(setup: RunSetup, recording: Recording) -> Array:
        found = recording.of(topic, name)
        if found is None or not found[0].size:
            return np.full(recording.time.size, np.nan)
        rows = np.searchsorted(found[0], recording.time, side="right") - 1
        return np.asarray(found[1][np.maximum(rows, 0), column], dtype=np.float64)

    return values


def _change(values: Array, samples: int) -> Array:
    """Return the change over the last samples; before the start the first value is assumed."""
    earlier = np.append(np.full(min(samples, values.size), values[0]), values[:-samples])
    return np.asarray(values - earlier)


def _acceleration(setup: RunSetup, recording: Recording) -> Array:
    samples = max(1, round(JERK_SPAN / setup.tick))
    return _change(recording.front_velocity, samples) / (samples * setup.tick)


def _jerk(setup: RunSetup, recording: Recording) -> Array:
    samples = max(1, round(1.0 / setup.tick))
    return _change(_change(recording.front_velocity, samples), samples) / (samples * setup.tick) ** 2


def _distance_to_stop(setup: RunSetup, recording: Recording) -> Array:
    """Return the distance to the next stop [m]: a stop is the next one up to its planned departure."""
    stops = planned_stops(setup.profile) or [PlannedStop(float(setup.profile.position[-1]), 0.0, np.inf)]
    rows = np.searchsorted([stop.departure for stop in stops], recording.time, side="right")
    places = np.array([stop.position for stop in stops])[np.minimum(rows, len(stops) - 1)]
    sign = 1.0 if setup.profile.position[-1] >= setup.profile.position[0] else -1.0
    return np.asarray(sign * (places - recording.front_position))


SERIES: dict[str, Callable[[RunSetup, Recording], Array]] = {
    "time": lambda setup, recording: recording.time,
    "speed": lambda setup, recording: recording.front_velocity,
    "reference_speed": lambda setup, recording: recording.reference_velocity,
    "speed_error": lambda setup, recording: recording.front_velocity - recording.reference_velocity,
    "limit": _limit,
    "permitted_speed": _held(SUPERVISED_SPEEDS, "speed", PERMITTED),
    "emergency_brake_speed": _held(SUPERVISED_SPEEDS, "speed", EMERGENCY),
    "acceleration": _acceleration,
    "jerk": _jerk,
    "position": lambda setup, recording: recording.front_position,
    "front": _front,
    "reference_position": lambda setup, recording: recording.reference_position,
    "position_error": lambda setup, recording: recording.front_position - recording.reference_position,
    "distance_to_stop": _distance_to_stop,
    "command": lambda setup, recording: recording.command,
    "effort": lambda setup, recording: recording.applied,
    "coupler_draft": lambda setup, recording: np.maximum(0.0, recording.coupler_draft_max),
    "coupler_buff": lambda setup, recording: np.minimum(0.0, recording.coupler_buff_max),
    "pipe_pressure": _held(BRAKE_PIPE, "pressure", 0),
    "pipe_pressure_tail": _held(BRAKE_PIPE_TAIL, "pressure", 0),
    "shoe_force": _held(BRAKE_SHOES, "total", 0),
}
"""Series of every signal; shape (k, u) for one with a value for each power unit."""
