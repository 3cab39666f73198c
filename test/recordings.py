"""Recordings with chosen series, for tests of figures and of judges, and the number of messages in a log."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from train_ato.judge.recording import COMMAND, DISTURBANCE, ESTIMATE, MEASUREMENT, REFERENCE, TRUTH, Recording
from train_ato.judge.series import TopicSamples
from train_ato.log.bag_layout import PARTIAL
from train_ato.log.mcap_records import stream
from train_ato.log.reading import log_file

PLACES = {
    "position": (TRUTH, "unit_position"), "velocity": (TRUTH, "unit_velocity"),
    "front_position": (TRUTH, "front_position"), "front_velocity": (TRUTH, "front_velocity"),
    "coupler_draft_max": (TRUTH, "coupler_draft_max"), "coupler_buff_max": (TRUTH, "coupler_buff_max"),
    "applied": (MEASUREMENT, "applied"), "command": (COMMAND, "force"), "estimate": (ESTIMATE, "force"),
    "disturbance": (DISTURBANCE, "unit_force"), "reference_position": (REFERENCE, "position"),
    "reference_velocity": (REFERENCE, "velocity"), "reference_acceleration": (REFERENCE, "acceleration"),
}  # fmt: skip
"""Series of a recording at the ticks, and their samples."""


def recording_of(time: np.ndarray, units: int = 0, **series: Any) -> Recording:
    """Return a recording with these series at these times [s]; for a number of units, all others are 0."""
    found = Recording({topic: TopicSamples(time, {}) for topic, _ in PLACES.values()})
    own = ("position", "velocity", "applied", "command", "estimate", "disturbance")
    zeros = {name: np.zeros((time.size, units if name in own else 1)) for name in PLACES if units}
    return with_series(found, **{**zeros, **series})


def with_series(recording: Recording, **series: Any) -> Recording:
    """Return the recording with other values of some series."""
    topics = dict(recording.topics)
    for name, values in series.items():
        topic, key = PLACES[name]
        time = recording.topics[topic].time
        rows = np.asarray(values, dtype=np.float64).reshape(recording.topics[COMMAND].time.size, -1)
        rows = np.concatenate((rows, np.repeat(rows[-1:], time.size - len(rows), axis=0)))
        topics[topic] = TopicSamples(time, {**topics[topic].values, key: rows})
    return replace(recording, topics=topics)


def with_final(recording: Recording, position: float, velocity: float) -> Recording:
    """Return the recording with a last state of vehicle 0 [m, m/s] that no command follows."""
    truth, last = recording.topics[TRUTH], {"front_position": position, "front_velocity": velocity}
    values = {
        name: np.concatenate((rows, np.full_like(rows[-1:], last.get(name, rows[-1, 0]))))
        for name, rows in truth.values.items()
    }
    time = np.append(truth.time, truth.time[-1] + 0.1)
    return replace(recording, topics={**recording.topics, TRUTH: TopicSamples(time, values)})


def commands_in(run: Path) -> int:
    """Return the number of commands in the closed chunks of a log that is being written."""
    log = run / PARTIAL
    return sum(m.channel.topic == "/ato/command" for m in stream(log, broken=True)) if log.exists() else 0


def message_counts(run: Path) -> dict[str, int]:
    """Return the number of messages per topic in a log."""
    return dict(Counter(message.channel.topic for message in stream(log_file(run))))
