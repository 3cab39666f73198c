"""Numbers of a log by their places in its messages: the addresses of curves in a layout.

Topics and names are those of the log, also those of a namespace.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from train_ato.apps.scene.train_scene import MARKERS
from train_ato.log.bag_layout import table_name
from train_ato.log.mcap_records import MAX_TIME_NS, RawMessage
from train_ato.log.reading import log_file, stream
from train_ato.messages.codec.cdr import typestore
from train_ato.messages.codec.variable import decode_trajectory
from train_ato.messages.topics import BY_NAME

DIAGNOSTICS = "/diagnostics"
SPEED_EVERY = 7
"""Only measurements at multiples of this number of messages are searched for the top speed, for the time of an hour."""


@dataclass(frozen=True)
class Signal:
    """Number in the messages of a topic.

    Attributes
    ----------
    topic : str
        Name in the log.
    field : str
        Field of the message; ``points[0].velocities[0]`` for a trajectory.
    joint : str or None
        Name of the entry of a JointState; None for other messages, and for all entries.
    index : int or None
        Number of this entry.
    """

    topic: str
    field: str
    joint: str | None = None
    index: int | None = None


@dataclass(frozen=True)
class LogSignals:
    """Topics of a log with the content of one message each.

    Attributes
    ----------
    path : Path
        The log.
    begin_ns, end_ns : int
        Publish time of the first and the last message [ns since 1970].
    names : dict
        Topics in the log, by their names in the table.
    joints : dict
        Names of the entries of JointStates, by the name of the topic in the table.
    reports : dict
        Keys with numbers in the diagnostics, by node; each with the path of its value for PlotJuggler.
    hardware : dict
        ``hardware_id`` in the diagnostics, by node.
    scene : bool
        True if the log has the train on its line.
    top_speed : float
        Largest speed of train and profile [m/s].
    """

    path: Path
    begin_ns: int
    end_ns: int
    names: dict[str, str]
    joints: dict[str, tuple[str, ...]]
    reports: dict[str, dict[str, str]]
    hardware: dict[str, str]
    scene: bool
    top_speed: float

    @property
    def duration(self) -> float:
        """Time from the first message to the last [s]."""
        return (self.end_ns - self.begin_ns) * 1e-9

    def joint(self, topic: str, name: str, field: str) -> Signal | None:
        """Return an entry of a JointState by its name; None if the log does not have it."""
        names = self.joints.get(topic, ())
        if name not in names:
            return None
        index = names.index(name)
        return Signal(self.names[topic], field, name, index)

    def field(self, topic: str, field: str) -> Signal | None:
        """Return a field of a message; None if the log does not have the topic."""
        return Signal(self.names[topic], field) if topic in self.names else None

    def count(self, topic: str, kind: str) -> int:
        """Return the number of vehicles, units or sensors in a topic, by the first part of their names."""
        return sum(entry.startswith(f"{kind}_") for entry in self.joints.get(topic, ()))


def read_signals(run: Path) -> LogSignals:
    """Read the signals of a run folder or a log.

    Raises
    ------
    ValueError
        If it is not a log, damaged, or has no message of a run.
    """
    path = log_file(run)
    names: dict[str, str] = {}
    joints: dict[str, tuple[str, ...]] = {}
    reports: dict[str, dict[str, str]] = {}
    hardware: dict[str, str] = {}
    begin, end, speed, scene = MAX_TIME_NS, 0, 0.0, False
    for number, message in enumerate(stream(path)):
        scene = scene or message.channel.topic == MARKERS.name
        topic = table_name(message.channel.topic)
        if topic is None or BY_NAME[topic].type != message.schema.name:
            continue
        begin, end = min(begin, message.publish_ns), max(end, message.publish_ns)
        if names.setdefault(topic, message.channel.topic) != message.channel.topic:
            continue  # another train of the same log
        if topic == DIAGNOSTICS:
            _add_reports(reports, hardware, message)
        elif topic == "ato/profile":
            speed = max(speed, float(decode_trajectory(message.data).velocity.max(initial=0.0)))
        elif topic == "train/measurement" and number % SPEED_EVERY == 0:
            speed = max(speed, float(np.abs(_content(message).velocity[:1]).max(initial=0.0)))
        if topic not in joints and message.schema.name == "sensor_msgs/msg/JointState":
            joints[topic] = tuple(_content(message).name)
    if not names:
        raise ValueError(f"{path}: has no message of a run; name the log of a run of train_ato")
    return LogSignals(path, begin, end, names, joints, reports, hardware, scene, speed)


def _content(message: RawMessage) -> Any:
    return typestore().deserialize_cdr(message.data, message.schema.name)


def _add_reports(reports: dict[str, dict[str, str]], hardware: dict[str, str], message: RawMessage) -> None:
    """Add the keys with numbers; PlotJuggler names them by hardware, node and key."""
    for status in _content(message).status:
        hardware[status.name] = status.hardware_id
        for pair in status.values:
            try:
                float(pair.value)
            except ValueError:
                continue
            parts = (message.channel.topic, status.hardware_id, status.name, pair.key)
            reports.setdefault(status.name, {})[pair.key] = "/".join(part for part in parts if part)
