"""Numbers of a log by their places in its messages: the addresses of curves in a layout.

Topics and names are those of the log, also those of a namespace.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from plant_sim.units import KMH
from train_ato.log.bag_layout import table_name
from train_ato.log.mcap_records import RawMessage, stream
from train_ato.log.reading import log_file
from train_ato.messages.cdr import typestore
from train_ato.messages.topic import FIXED_NAMES, JOINT_STATE, Owner
from train_ato.messages.topics import topic_of
from train_ato.messages.variable_codec import decode_trajectory, node_of
from train_ato.report.quantities import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION
from train_ato.view.train_scene import MARKERS

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
    series : str
        Name in PlotJuggler of a value of a status; "" for other numbers.
    """

    topic: str
    field: str
    joint: str | None = None
    index: int | None = None
    series: str = ""


@dataclass(frozen=True)
class LogSignals:
    """Topics of a log with the content of one message each.

    Attributes
    ----------
    path : Path
        The log.
    names : dict
        Topics in the log, by their names in the table.
    joints : dict
        Names of the entries of JointStates, by the name of the topic in the table.
    states : dict
        States and counters by key, by the name of the topic in the table.
    reports : dict
        Keys with numbers in the diagnostics, by node; each with the path of its value for PlotJuggler.
    statuses : dict
        ``hardware_id`` and name of the status in the diagnostics, by node.
    scene : bool
        True if the log has the train on its line.
    top_speed : float
        Largest speed of train and profile [m/s].
    """

    path: Path
    names: dict[str, str]
    joints: dict[str, tuple[str, ...]]
    states: dict[str, dict[str, Signal]]
    reports: dict[str, dict[str, str]]
    statuses: dict[str, tuple[str, str]]
    scene: bool
    top_speed: float

    def joint(self, topic: str, name: str, field: str) -> Signal | None:
        """Return an entry of a JointState by its name; None if the log does not have it."""
        names = self.joints.get(topic, ())
        if name not in names:
            return None
        index = names.index(name)
        return Signal(self.names[topic], field, name, index)

    def state(self, topic: str, key: str, name: str, field: str) -> Signal | None:
        """Return a state by its key, in a log of the former type the field of a JointState's entry."""
        return self.states.get(topic, {}).get(key) or self.joint(topic, name, field)

    def field(self, topic: str, field: str) -> Signal | None:
        """Return a field of a message; None if the log does not have the topic."""
        return Signal(self.names[topic], field) if topic in self.names else None

    def count(self, topic: str, kind: str) -> int:
        """Return the number of vehicles, units or sensors in a topic, by the first part of their names."""
        return sum(entry.startswith(f"{kind}_") for entry in self.joints.get(topic, ()))


def read_signals(run: Path) -> LogSignals:
    """Read the signals of a run folder or a log."""
    path = log_file(run)
    names: dict[str, str] = {}
    joints: dict[str, tuple[str, ...]] = {}
    states: dict[str, dict[str, Signal]] = {}
    reports: dict[str, dict[str, str]] = {}
    statuses: dict[str, tuple[str, str]] = {}
    speed, scene = 0.0, False
    for number, message in enumerate(stream(path)):
        scene = scene or message.channel.topic == MARKERS.name
        topic = table_name(message.channel.topic)
        entry = None if topic is None else topic_of(topic, message.schema.name)
        if topic is None or entry is None:
            continue
        if names.setdefault(topic, message.channel.topic) != message.channel.topic:
            continue  # another train of the same log
        if topic == DIAGNOSTICS:
            _add_reports(reports, statuses, message)
        elif topic == "ato/profile":
            speed = max(speed, float(decode_trajectory(message.data).velocity.max(initial=0.0)))
        elif topic == "train/measurement" and number % SPEED_EVERY == 0:
            speed = max(speed, float(np.abs(_content(message).velocity[:1]).max(initial=0.0)))
        if topic not in joints and message.schema.name == JOINT_STATE:
            joints[topic] = tuple(_content(message).name)
        elif topic not in states and entry.has_states:
            states[topic] = _states(message)
    if not names:
        raise ValueError(f"{path}: has no message of a run; name the log of a run of train_ato")
    return LogSignals(path, names, joints, states, reports, statuses, scene, speed)


def _content(message: RawMessage) -> Any:
    return typestore().deserialize_cdr(message.data, message.schema.name)


def _states(message: RawMessage) -> dict[str, Signal]:
    """Return the values of the first status by key."""
    found = {}
    for status in _content(message).status[:1]:
        for index, pair in enumerate(status.values):
            field, series = f"status[0].values[{index}].value", _series(message, status, pair.key)
            found[pair.key] = Signal(message.channel.topic, field, series=series)
    return found


def _series(message: RawMessage, status: Any, key: str) -> str:
    """Return the name of a value of a status in PlotJuggler."""
    return "/".join(part for part in (message.channel.topic, status.hardware_id, status.name, key) if part)


def _add_reports(reports: dict[str, dict[str, str]], statuses: dict[str, tuple[str, str]], message: RawMessage) -> None:
    """Add the keys with numbers."""
    for status in _content(message).status:
        node = node_of(status.name)
        statuses[node] = status.hardware_id, status.name
        for pair in status.values:
            try:
                float(pair.value)
            except ValueError:
                continue
            reports.setdefault(node, {})[pair.key] = _series(message, status, pair.key)


CYCLE = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILION, BLACK, GREY)
"""Colours of several parts of a train."""
MAX_CURVES = 5
"""Vehicles, and power units, in one panel."""
KILO = 1e-3


@dataclass(frozen=True)
class LayoutCurve:
    """Curve of a panel: signal, label and colour."""

    signal: Signal
    label: str
    color: str


@dataclass(frozen=True)
class LayoutPanel:
    """Panel with curves of one unit.

    Attributes
    ----------
    key, title : str
        Name in the layout, and text above the panel.
    unit, si_unit : str
        Unit after the multiplication with ``factor``, and that of the messages.
    steps : bool
        Values that hold until the next one.
    along : bool
        Values of all vehicles at one time, in place of values over time.
    """

    key: str
    title: str
    unit: str
    si_unit: str
    factor: float
    curves: tuple[LayoutCurve, ...]
    steps: bool = False
    along: bool = False


def panels_of(log: LogSignals) -> dict[str, LayoutPanel]:
    """Return the panels with at least one curve, by key."""
    made = (
        LayoutPanel("speed", "speed, profile and limits of the supervisor", "km/h", "m/s", KMH, _curves(_speeds(log))),
        LayoutPanel("force", "force of the power units", "kN", "N", KILO, _curves(_forces(log))),
        LayoutPanel("coupler", "coupler forces (draft > 0)", "kN", "N", KILO, _curves(_couplers(log))),
        LayoutPanel("pipe", "brake pipe", "kPa", "Pa", KILO, _curves(_pressures(log))),
        LayoutPanel("ato", "state of the ATO, 3 engaged", "", "", 1.0, _curves(_ato(log)), steps=True),
        LayoutPanel("protection", "traction cut-off and brakes", "", "", 1.0, _curves(_brakes(log)), steps=True),
        LayoutPanel(
            "along", "coupler forces along the train (draft > 0)", "kN", "N", KILO,
            _curves(_all(log, "train/vehicles", "coupler behind the vehicle", VERMILION)), along=True,
        ),
        LayoutPanel(
            "shoes", "shoe forces along the train", "kN", "N", KILO,
            _curves(_all(log, "train/brake_shoes", "shoes", "#8c510a")), along=True,
        ),
    )  # fmt: skip
    return {panel.key: panel for panel in made if panel.curves}


Wanted = Iterator[tuple[Signal | None, str, str]]
"""Signal or None, label, colour."""


def _curves(wanted: Wanted) -> tuple[LayoutCurve, ...]:
    return tuple(LayoutCurve(signal, label, color) for signal, label, color in wanted if signal is not None)


def spread(count: int) -> list[int]:
    """Return at most :data:`MAX_CURVES` numbers below ``count``, from the first to the last one in equal distances."""
    if count <= MAX_CURVES:
        return list(range(count))
    return [round(place * (count - 1) / (MAX_CURVES - 1)) for place in range(MAX_CURVES)]


def _speeds(log: LogSignals) -> Wanted:
    names = FIXED_NAMES[Owner.SUPERVISED_SPEED][1:]
    for name, color in zip(names, (GREEN, ORANGE, PURPLE, BLACK), strict=True):
        yield log.joint("atp/speeds", name, "velocity"), name.replace("_", " "), color
    yield log.field("ato/reference", "points[0].velocities[0]"), "profile", GREY
    truth = log.joint("train/vehicles", "vehicle_0", "velocity")
    yield truth or log.joint("train/measurement", "unit_0", "velocity"), "train", BLUE


def _forces(log: LogSignals) -> Wanted:
    count = log.count("train/measurement", "unit")
    for number, unit in enumerate(spread(count)):
        name, which = f"unit_{unit}", f" {unit}" if count > 1 else ""
        color = CYCLE[number]
        yield log.joint("ato/command", name, "effort"), f"command{which}", ORANGE if count == 1 else color
        yield log.joint("train/measurement", name, "effort"), f"applied{which}", color
        if count == 1:
            yield log.joint("ato/estimate", name, "effort"), "disturbance estimate", GREEN


def _couplers(log: LogSignals) -> Wanted:
    couplers = log.count("train/vehicles", "vehicle") - 1
    for number, vehicle in enumerate(spread(couplers)):
        signal = log.joint("train/vehicles", f"vehicle_{vehicle}", "effort")
        yield signal, f"behind vehicle {vehicle}", CYCLE[number]


def _pressures(log: LogSignals) -> Wanted:
    yield log.field("ato/brake_pipe_command", "fluid_pressure"), "command", ORANGE
    yield log.field("train/brake_pipe", "fluid_pressure"), "head", BLUE
    yield log.field("train/brake_pipe_tail", "fluid_pressure"), "tail", SKY


def _ato(log: LogSignals) -> Wanted:
    signal = log.state("ato/state", "ato_state", "ato", "effort")
    if signal is not None and signal.series:
        signal = replace(signal, field="status[0].message")  # its name, for the transitions of Foxglove
    yield signal, "state of the ATO", BLUE


def _brakes(log: LogSignals) -> Wanted:
    for name, color in zip(FIXED_NAMES[Owner.BRAKE_LINE], (ORANGE, PURPLE, BLACK), strict=True):
        signal = log.state("train/protection", f"{name}_active", name, "position")
        yield signal, name.replace("_", " "), color


def _all(log: LogSignals, topic: str, label: str, color: str) -> Wanted:
    more_than_one = log.count(topic, "vehicle") > 1
    yield log.field(topic, "effort") if more_than_one else None, label, color
