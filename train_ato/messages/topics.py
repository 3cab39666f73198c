"""Topic table: the single definition of every topic.

Codecs, publishers, subscriptions, the recorder, the tables of a log, the live view and ``msgs_docs/topics.md`` use
it.  A new topic needs a message dataclass and an entry here.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train_ato.messages import types as msg
from train_ato.messages.topic import (
    AIR_BRAKE,
    BEHIND,
    DIAGNOSTICS,
    DISTURBED,
    FIXED_NAMES,
    JOINT_STATE,
    REPORTS,
    SUPERVISED,
    TRAJECTORY,
    Owner,
    Place,
    Rate,
    Role,
    Topic,
    TrainLayout,
    joint_states,
    knots,
    states,
)

__all__ = [
    "AHEAD", "BY_NAME", "DIAGNOSTIC_UNITS", "END_TOPIC", "EPOCH_NS", "EXTERNAL", "FORCE_PARTS", "FORMER", "LINE_FRAME",
    "REPORT", "TOPICS", "Place", "Rate", "Role", "Topic", "published_by", "read_by", "tick_topics", "topic_of",
    "topic_with", "topics_of",
]  # fmt: skip

EPOCH_NS = 1_767_225_600_000_000_000
"""Simulation time 0 in messages [ns]: 2026-01-01T00:00:00Z, because tools display stamps near 1970 badly."""

EXTERNAL = ("controller", "observer", "profile", "supervisor", "plant")
"""Nodes in whose place another program can run."""
LINE_FRAME = "line"
"""Frame of positions along the line: chainages."""
END_TOPIC = "train/end"
"""Notice of the end of the run."""
REPORT, AHEAD = "train/report", "train/ahead"
"""Report of a train for the train behind it, and the newest one that has reached that train."""
FORCE_PARTS = "ato/force_parts"
"""Parts of the force demand of the law."""
_CLOCK, _HEADER = "rosgraph_msgs/msg/Clock", "std_msgs/msg/Header"
_PRESSURE = "sensor_msgs/msg/FluidPressure"
_STATUS = (
    Place("status[].name", "node"),
    Place("status[].level", "level"),
    Place("status[].message", "message"),
    Place("status[].values", "values"),
)
"""State of one node."""
_REPORTED = (
    Place("points[0].positions", "position", Owner.TRAIN_END),
    Place("points[0].velocities", "speed", Owner.TRAIN_END),
    Place(
        "points[0].time_from_start", "time",
        meaning="time of the odometry of the report, in the message from `header.stamp`, <= 0",
    ),
)  # fmt: skip

_truth = partial(Topic, publishers=(Role.PLANT,), optional=True)
_supervised = partial(Topic, rate=Rate.SUPERVISION, condition=SUPERVISED)
_TABLE: tuple[Topic, ...] = (
    _truth(
        "/clock", _CLOCK, msg.Tick, (Place("clock", "stamp"),),
        meaning="simulation time, for tools; nothing in the loop waits for it",
    ),
    _truth(
        "train/vehicles", JOINT_STATE, msg.VehicleStates,
        joint_states(Owner.VEHICLE, position="position", velocity="velocity", effort="coupler_force"),
        meaning="truth, one entry per vehicle, front first", finite=False,
    ),
    Topic(
        "train/measurement", JOINT_STATE, msg.Measurement,
        (
            *joint_states(Owner.UNIT, position="position", velocity="velocity", effort="applied"),
            *joint_states(Owner.COUPLER, position="deflection", velocity="rate", effort="force"),
        ),
        publishers=(Role.PLANT,), readers=(Role.PROFILE, Role.OBSERVER, Role.CONTROLLER),
        meaning="measurement of the onboard ATO, with noise; starts a tick",
    ),
    _truth(
        "train/brake_pipe", _PRESSURE, msg.Pipe, (Place("fluid_pressure", "pressure"),),
        meaning="brake-pipe pressure at the head", frame=0, condition=AIR_BRAKE,
    ),
    _truth(
        "train/brake_pipe_tail", _PRESSURE, msg.Pipe, (Place("fluid_pressure", "pressure"),),
        meaning="brake-pipe pressure at the tail", frame=-1, condition=AIR_BRAKE,
    ),
    _truth(
        "train/brake_shoes", JOINT_STATE, msg.BrakeShoes, joint_states(Owner.VEHICLE, effort="shoe_force"),
        meaning="air brake of every vehicle", condition=AIR_BRAKE, finite=False,
    ),
    _truth(
        "train/disturbance", JOINT_STATE, msg.Disturbance, joint_states(Owner.VEHICLE, effort="force"),
        meaning="true external disturbance forces", condition=DISTURBED, finite=False,
    ),
    _supervised(
        "train/odometry", JOINT_STATE, msg.Odometry,
        (
            *joint_states(Owner.ODOMETER, position="position", velocity="speed"),
            *joint_states(Owner.SINCE_BALISE, position="since_balise", velocity="speed"),
        ),
        publishers=(Role.PLANT,), readers=(Role.SUPERVISOR,),
        meaning="odometry of the supervisor, independent of the measurement; starts its step",
    ),
    _supervised(
        "train/protection", DIAGNOSTICS, msg.ProtectionState, states(Owner.BRAKE_LINE, "active"),
        publishers=(Role.PLANT,), readers=(Role.CONTROLLER,),
        meaning="traction cut-off and brakes in effect, demanded by the supervisor, a fail-safe reaction or a request",
    ),
    Topic(
        REPORT, TRAJECTORY, msg.TrainAhead, _REPORTED, publishers=(Role.PLANT,), readers=(Role.PLANT,),
        rate=Rate.REPORT,
        meaning="report for the train behind, read by the plant of that train; latched for one that starts later",
        condition=REPORTS, recorded=False, latched=True, depth=10_000, finite=False, awaited=False,
    ),
    Topic(
        AHEAD, TRAJECTORY, msg.TrainAhead, _REPORTED, publishers=(Role.PLANT,),
        readers=(Role.SUPERVISOR, Role.PROFILE, Role.CONTROLLER), rate=Rate.REPORT,
        meaning="newest report of the train ahead that has reached the train; each reader has a link of its own",
        condition=BEHIND,
    ),
    _supervised(
        "atp/brake_release", DIAGNOSTICS, msg.BrakeRelease, states(Owner.BRAKE_LINE, "released", "alive"),
        publishers=(Role.SUPERVISOR,), readers=(Role.PLANT,),
        meaning="release of traction and brakes; the plant brakes without it",
    ),
    _supervised(
        "atp/speeds", JOINT_STATE, msg.SupervisedSpeeds,
        joint_states(Owner.SUPERVISED_SPEED, position="position", velocity="speed"), publishers=(Role.SUPERVISOR,),
        readers=(Role.CONTROLLER,),
        meaning="speed of the train and limits of the supervision: permitted, warning, service brake, emergency brake",
    ),
    _supervised(
        "ato/state", DIAGNOSTICS, msg.AtoReport, states(Owner.ATO, "state", "position", "velocity"),
        publishers=(Role.CONTROLLER,), readers=(Role.PROFILE,), meaning="state of the ATO and its measured motion",
        finite=False, optional=True,
    ),
    Topic(
        "ato/profile", TRAJECTORY, msg.Trajectory,
        (
            *knots(""),
            Place("points[].time_from_start", "time", meaning="time of the knot, in the message from `header.stamp`"),
            Place("header.stamp", "stamp"),
        ),
        publishers=(Role.PROFILE,), readers=(Role.CONTROLLER,), rate=Rate.ONCE,
        meaning="the whole operational speed profile; again after re-planning", frame=LINE_FRAME,
        texts=(("joint_names", ("train",)),), latched=True, depth=10,
    ),
    Topic(
        "ato/limits", TRAJECTORY, msg.Trajectory,
        knots("", acceleration=False, position="place from which the limit holds"), publishers=(Role.PROFILE,),
        rate=Rate.ONCE, meaning="speed limit over the line, as steps", frame=LINE_FRAME,
        texts=(("joint_names", ("limit",)),), latched=True, depth=1, optional=True,
    ),
    Topic(
        "ato/reference", TRAJECTORY, msg.Reference,
        (
            *knots("0"),
            Place(
                "points[0].time_from_start", "planned",
                meaning="time of the planning of its profile, in the message from `header.stamp`, <= 0",
            ),
        ),
        publishers=(Role.PROFILE,), readers=(Role.CONTROLLER,), meaning="reference at the stamp, one point",
        frame=LINE_FRAME, texts=(("joint_names", ("train",)),),
    ),
    Topic(
        "ato/estimate", JOINT_STATE, msg.DisturbanceEstimate, joint_states(Owner.UNIT, effort="force"),
        publishers=(Role.OBSERVER,), readers=(Role.CONTROLLER,), meaning="disturbance force per power unit",
    ),
    Topic(
        "ato/command", JOINT_STATE, msg.Command, joint_states(Owner.UNIT, effort="force"),
        publishers=(Role.CONTROLLER,), readers=(Role.PLANT,),
        meaning="force demand per power unit as sent; ends a tick",
    ),
    Topic(
        FORCE_PARTS, JOINT_STATE, msg.ForceParts,
        (
            *joint_states(Owner.FEED_FORWARD, effort="feed_forward"),
            *joint_states(Owner.FEEDBACK, effort="feedback"), *joint_states(Owner.ESTIMATE, effort="estimate"),
        ),
        publishers=(Role.CONTROLLER,), rate=Rate.HEARD,
        meaning="parts of the force demand, for debugging; their sum is `ato/command`", recorded=False, awaited=False,
        optional=True,
    ),
    Topic(
        "ato/brake_pipe_command", _PRESSURE, msg.Pipe,
        (Place("fluid_pressure", "pressure", meaning="absolute; 600 kPa releases"),), publishers=(Role.CONTROLLER,),
        readers=(Role.PLANT,), meaning="brake-pipe pressure demanded at the head", frame=0, condition=AIR_BRAKE,
        optional=True,
    ),
    Topic(
        "/diagnostics", DIAGNOSTICS, msg.Diagnostic, _STATUS,
        publishers=(Role.PLANT, Role.PROFILE, Role.OBSERVER, Role.CONTROLLER, Role.SUPERVISOR), rate=Rate.SECOND,
        meaning="mode, law, delays, limits, interventions, per node; also immediately after an event",
    ),
    Topic(
        END_TOPIC, DIAGNOSTICS, msg.Diagnostic, _STATUS, publishers=(Role.PLANT,),
        readers=(Role.SUPERVISOR, Role.PROFILE, Role.OBSERVER, Role.CONTROLLER, Role.RECORDER),
        rate=Rate.END,
        meaning="end notice: status `done`, `interrupted` or `failed`, complete ticks; message: reason; a plant "
        "that leaves without it has failed", recorded=False, latched=True, depth=1, awaited=False,
    ),
    Topic(
        "recorder/progress", _HEADER, msg.Tick, (Place("stamp", "stamp"),),
        publishers=(Role.RECORDER,), readers=(Role.PLANT,), rate=Rate.SECOND,
        meaning="newest stamp up to which the topics of the plant are recorded; the plant is at most half a queue "
        "ahead of it; before the start 0: the recorder receives every publisher",
        recorded=False,
    ),
)  # fmt: skip

DIAGNOSTIC_UNITS: dict[str, str] = {
    "coupler_draft_max": "N", "coupler_buff_max": "N", "energy_traction": "J", "energy_regenerated": "J",
    "energy_running": "J", "energy_curve": "J", "energy_grade": "J", "energy_air_brake": "J",
    "energy_couplers": "J", "energy_outside": "J", "energy_kinetic": "J", "saturated": "s", "period": "s",
    "remaining": "s", "planned": "s", "delay": "s", "delay_brake": "s", "lag": "s", "front": "m",
    "position_error": "m", "acceleration": "m/s²", "plan.times": "s", "plan.position": "m", "plan.speed": "m/s",
    "plan.force": "N", "plan.slack": "m/s",
}  # fmt: skip
"""Units of the values in ``/diagnostics`` by key; counts, names and reasons have no unit."""

BY_NAME: dict[str, Topic] = {topic.name: topic for topic in _TABLE}
"""Topics by name; a new topic can be added here."""
TOPICS = BY_NAME.values()
"""Topics in the order of the table."""


def _former(name: str, message: type[Any], *places: Place) -> Topic:
    """Return the entry of a topic in logs of a JointState."""
    return replace(BY_NAME[name], type=JOINT_STATE, message=message, places=places)


_FORMER_ENDS = joint_states(Owner.TRAIN_END, position="position", velocity="speed", effort="time")
FORMER: dict[str, Topic] = {
    topic.name: topic
    for topic in (
        _former("train/odometry", msg.Odometry,
                *joint_states(Owner.ODOMETER, position="position", velocity="speed", effort="since_balise")),
        _former("train/protection", msg.ProtectionState, *joint_states(Owner.BRAKE_LINE, position="active")),
        _former(REPORT, msg.FormerTrainAhead, *_FORMER_ENDS),
        _former(AHEAD, msg.FormerTrainAhead, *_FORMER_ENDS),
        _former("atp/brake_release", msg.BrakeRelease,
                *joint_states(Owner.BRAKE_LINE, position="released", velocity="alive")),
        _former("ato/state", msg.AtoReport,
                *joint_states(Owner.ATO, position="position", velocity="velocity", effort="state")),
    )
}  # fmt: skip
"""Entries of the topics whose states, counters, distances and times were in a JointState, for the logs of that time."""


def topic_of(name: str, type_name: str) -> Topic | None:
    """Return the entry of a topic with a ROS type, also a former one; None for a type that the topic never had."""
    for entry in (BY_NAME[name], FORMER.get(name)):
        if entry is not None and entry.type == type_name:
            return entry
    return None


def topic_with(entry: Topic, names: Sequence[str]) -> Topic:
    """Return the entry of a topic for a message with some names: the former one if these are its names."""
    former = FORMER.get(entry.name)
    if former is None or former.type != entry.type:
        return entry
    return former if list(names) == [name for owner in former.owners for name in FIXED_NAMES[owner]] else entry


def published_by(role: Role) -> tuple[Topic, ...]:
    """Return the topics that a node publishes."""
    return tuple(topic for topic in TOPICS if role in topic.publishers)


def read_by(role: Role) -> tuple[Topic, ...]:
    """Return the topics that a node subscribes to."""
    return tuple(topic for topic in TOPICS if role in topic.readers)


def topics_of(layout: TrainLayout) -> tuple[Topic, ...]:
    """Return the topics of a run with a train."""
    return tuple(topic for topic in TOPICS if topic.exists(layout))


def tick_topics(layout: TrainLayout) -> tuple[str, ...]:
    """Return the names of the recorded topics with one message per tick."""
    return tuple(topic.name for topic in topics_of(layout) if topic.recorded and topic.rate is Rate.TICK)


Values = dict[str, NDArray[Any]]
"""Values of the messages of a topic by field, each of shape (ticks, n); durations [ns] as integers."""


@dataclass(frozen=True)
class TickBlock:
    """Messages of consecutive ticks.

    Attributes
    ----------
    stamps : Array of int, shape (ticks,)
        Stamps [ns].
    rows : list of tuple
        Topic and values of the messages of every tick, in the order of publication.
    between : dict of list
        Other messages by the number of their tick, in order: number of the message of ``rows`` before which it is
        published, topic, message.
    """

    stamps: NDArray[np.int64]
    rows: list[tuple[str, Values]]
    between: dict[int, list[tuple[int, str, Any]]]

    def part(self, begin: int, end: int) -> "TickBlock":
        """Return the block of some of its ticks."""
        rows = [(topic, {field: part[begin:end] for field, part in values.items()}) for topic, values in self.rows]
        between = {tick - begin: messages for tick, messages in self.between.items() if begin <= tick < end}
        return TickBlock(self.stamps[begin:end], rows, between)

    def copy(self) -> "TickBlock":
        """Return the block with arrays of its own."""
        rows = [(topic, {field: part.copy() for field, part in values.items()}) for topic, values in self.rows]
        return replace(self, rows=rows)

    def messages(self) -> Iterator[tuple[int, list[tuple[str, Any]]]]:
        """Yield the stamp [ns] of every tick, and its messages with their topics in the order of publication."""
        for tick, stamp in enumerate(self.stamps.tolist()):
            found = [(topic, message_at(topic, stamp, values, tick)) for topic, values in self.rows]
            for number, topic, message in reversed(self.between.get(tick, ())):
                found.insert(number, (topic, message))
            yield stamp, found


def message_at(topic: str, stamp: int, values: Values, tick: int) -> Any:
    """Return the message of a tick from the values of its topic."""
    entry = BY_NAME[topic]
    row = {place.field: values[place.field][tick] for place in entry.places if place.field != "stamp"}
    single = {place.field: row[place.field].item() for place in entry.places if place.field in row and not place.owner}
    return entry.message(stamp, **row | single)
