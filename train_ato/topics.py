"""The topic table: every topic once, with its type, its publisher and readers, its QoS and its meaning.

Publishers, subscriptions, the recorder, the replayer and ``msgs_docs/topics.md`` are made from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

EPOCH_NS = 1_767_225_600_000_000_000
"""Simulation time 0 on the wire: 2026-01-01T00:00:00Z. Tools show stamps near 1970 badly, so runs do not start at 0."""


class Role(Enum):
    """Which node publishes or reads a topic."""

    PLANT = "plant"
    PROFILE = "profile"
    OBSERVER = "observer"
    CONTROLLER = "controller"
    RECORDER = "recorder"


class Rate(Enum):
    """How often a topic is sent."""

    ONCE = "once, latched"
    TICK = "every tick"
    SECOND = "every simulated second and at the end"


@dataclass(frozen=True)
class Topic:
    """One topic: relative name (absolute for /clock and /diagnostics), type, who sends and who reads it."""

    name: str
    type: str
    publishers: tuple[Role, ...]
    readers: tuple[Role, ...]
    rate: Rate
    meaning: str
    fields: tuple[tuple[str, str, str], ...]
    recorded: bool = True
    latched: bool = False
    depth: int = 1000


TOPICS: tuple[Topic, ...] = (
    Topic(
        "/clock",
        "rosgraph_msgs/msg/Clock",
        (Role.PLANT,),
        (),
        Rate.TICK,
        "simulation time, for tools; nothing in the loop waits for it",
        (("clock", "s", "simulation time from the epoch 2026-01-01T00:00:00Z"),),
    ),
    Topic(
        "train/cars",
        "sensor_msgs/msg/JointState",
        (Role.PLANT,),
        (),
        Rate.TICK,
        "truth, one entry per vehicle, front first",
        (
            ("name", "", "car_0 ... car_n"),
            ("position", "m", "vehicle centre along the line"),
            ("velocity", "m/s", "speed"),
            ("effort", "N", "force of the coupler behind the vehicle, > 0 draft; 0 behind the last"),
        ),
    ),
    Topic(
        "train/measurement",
        "sensor_msgs/msg/JointState",
        (Role.PLANT,),
        (Role.PROFILE, Role.OBSERVER, Role.CONTROLLER),
        Rate.TICK,
        "what the onboard ATO sees, with noise; starts a step",
        (
            ("name", "", "unit_0 ... per power unit, then coupler_i behind vehicle i where a sensor is fitted"),
            ("position", "m", "unit: position; coupler: deflection, > 0 draft"),
            ("velocity", "m/s", "unit: speed; coupler: rate of deflection"),
            ("effort", "N", "unit: force now applied, after delay, lag and limit; coupler: force"),
        ),
    ),
    Topic(
        "train/brake_pipe",
        "sensor_msgs/msg/FluidPressure",
        (Role.PLANT,),
        (),
        Rate.TICK,
        "brake-pipe pressure at the head (only with an air brake)",
        (("fluid_pressure", "Pa", "absolute; 600 kPa charged"), ("variance", "Pa²", "0: truth")),
    ),
    Topic(
        "train/brake_cylinders",
        "sensor_msgs/msg/JointState",
        (Role.PLANT,),
        (),
        Rate.TICK,
        "air brake of every vehicle (only with an air brake)",
        (("name", "", "car_0 ... car_n"), ("effort", "N", "retarding shoe force")),
    ),
    Topic(
        "train/disturbance",
        "sensor_msgs/msg/JointState",
        (Role.PLANT,),
        (),
        Rate.TICK,
        "truth of the outside forces (only where the scenario has disturbances)",
        (
            ("name", "", "car_0 ... car_n"),
            ("effort", "N", "mean over the last tick, > 0 forward; unmodelled grades apart"),
        ),
    ),
    Topic(
        "ato/profile",
        "trajectory_msgs/msg/JointTrajectory",
        (Role.PROFILE,),
        (Role.CONTROLLER,),
        Rate.ONCE,
        "the whole operational speed profile; again when it was planned anew",
        (
            ("joint_names", "", "train"),
            ("points[].positions", "m", "of vehicle 0's centre"),
            ("points[].velocities", "m/s", ""),
            ("points[].accelerations", "m/s²", ""),
            ("points[].time_from_start", "s", "from simulation time 0"),
            ("header.stamp", "s", "when it was planned; simulation time 0 for the first"),
        ),
        latched=True,
        depth=10,
    ),
    Topic(
        "ato/limits",
        "trajectory_msgs/msg/JointTrajectory",
        (Role.PROFILE,),
        (),
        Rate.ONCE,
        "speed limit over the line, as steps",
        (
            ("joint_names", "", "limit"),
            ("points[].positions", "m", "place from which the limit holds"),
            ("points[].velocities", "m/s", "limit"),
        ),
        latched=True,
        depth=1,
    ),
    Topic(
        "ato/reference",
        "trajectory_msgs/msg/JointTrajectory",
        (Role.PROFILE,),
        (Role.CONTROLLER,),
        Rate.TICK,
        "reference now, one point",
        (
            ("points[0].positions", "m", "of vehicle 0's centre"),
            ("points[0].velocities", "m/s", ""),
            ("points[0].accelerations", "m/s²", ""),
            ("points[0].time_from_start", "s", "simulation time at which the profile it is read from was planned"),
        ),
    ),
    Topic(
        "ato/estimate",
        "sensor_msgs/msg/JointState",
        (Role.OBSERVER,),
        (Role.CONTROLLER,),
        Rate.TICK,
        "disturbance force per power unit",
        (("name", "", "unit_0 ..."), ("effort", "N", "> 0 forward")),
    ),
    Topic(
        "ato/command",
        "sensor_msgs/msg/JointState",
        (Role.CONTROLLER,),
        (Role.PLANT,),
        Rate.TICK,
        "force demand per power unit as sent; ends a step",
        (("name", "", "unit_0 ..."), ("effort", "N", "> 0 traction, < 0 electric brake")),
    ),
    Topic(
        "ato/brake_pipe",
        "sensor_msgs/msg/FluidPressure",
        (Role.CONTROLLER,),
        (Role.PLANT,),
        Rate.TICK,
        "brake-pipe pressure demanded at the head (only with an air brake)",
        (("fluid_pressure", "Pa", "absolute; 600 kPa releases"), ("variance", "Pa²", "0")),
    ),
    Topic(
        "/diagnostics",
        "diagnostic_msgs/msg/DiagnosticArray",
        (Role.PLANT, Role.PROFILE, Role.OBSERVER, Role.CONTROLLER),
        (),
        Rate.SECOND,
        "mode, law, delays, limits, interventions, per node; at once too when something happens",
        (("status[].values", "", "key and value as text, SI"),),
    ),
    Topic(
        "record/acknowledged",
        "rosgraph_msgs/msg/Clock",
        (Role.RECORDER,),
        (Role.PLANT,),
        Rate.SECOND,
        "stamp up to which the recorder has everything; the plant never runs more than half a queue ahead of it",
        (("clock", "s", "simulation time"),),
        recorded=False,
    ),
)

DIAGNOSTIC_UNITS: dict[str, str] = {
    "coupler_draft_max": "N",
    "coupler_buff_max": "N",
    "energy_traction": "J",
    "energy_regenerated": "J",
    "energy_running": "J",
    "energy_curve": "J",
    "energy_grade": "J",
    "energy_air_brake": "J",
    "energy_couplers": "J",
    "energy_outside": "J",
    "energy_kinetic": "J",
    "saturated": "s",
    "period": "s",
    "remaining": "s",
    "planned": "s",
    "delay": "s",
    "delay_brake": "s",
    "lag": "s",
}
"""Units of the values in ``/diagnostics`` by their key; counts, names and reasons have none."""

BY_NAME: dict[str, Topic] = {topic.name: topic for topic in TOPICS}


def published_by(role: Role) -> tuple[Topic, ...]:
    """Return the topics that a node publishes."""
    return tuple(topic for topic in TOPICS if role in topic.publishers)


def read_by(role: Role) -> tuple[Topic, ...]:
    """Return the topics that a node subscribes to."""
    return tuple(topic for topic in TOPICS if role in topic.readers)
