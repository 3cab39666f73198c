"""One topic: its message, the places of its fields in the ROS message, and the condition of its existence."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any

from plant_sim.states import FieldDescription
from plant_sim.units import unit_suffix


class Owner(Enum):
    """Parts of a train with one value each in a message.

    The enum value of numbered parts is the prefix of their names (``unit_0``); :data:`FIXED_NAMES` has the others.
    ``meaning`` is meaning and order of the parts, as text.
    """

    _value_: str
    meaning: str

    def __new__(cls, value: str, meaning: str) -> "Owner":
        """Return a kind of parts with its meaning."""
        found = object.__new__(cls)
        found._value_, found.meaning = value, meaning
        return found

    VEHICLE = "vehicle", "every vehicle, front first"
    UNIT = "unit", "every power unit, front first"
    FEED_FORWARD = "feed_forward", "force of the nominal model on the reference; 0 for a law that does not use it"
    FEEDBACK = "feedback", "rest of the command: law, limits, change of the law"
    ESTIMATE = "estimate", "force against the estimate of the observer"
    COUPLER = "coupler", "the coupler behind vehicle I where a sensor is fitted"
    ODOMETER = "odometer", "the odometers of the supervisor"
    SINCE_BALISE = "since_balise", "the distances that they have counted since the last balise"
    BRAKE_LINE = "brake_line", "traction and brakes that the supervisor releases"
    SUPERVISED_SPEED = "supervised_speed", "estimated speed and limits of the supervisor"
    ATO = "ato", "the ATO"
    TRAIN_END = "train_end", "both ends of a train, and its shortest stop"


FIXED_NAMES: dict[Owner, tuple[str, ...]] = {
    Owner.ODOMETER: ("wheel", "radar"),
    Owner.SINCE_BALISE: ("wheel_since_balise", "radar_since_balise"),
    Owner.BRAKE_LINE: ("traction", "service_brake", "emergency_brake"),
    Owner.SUPERVISED_SPEED: ("estimate", "permitted", "warning", "service_brake", "emergency_brake"),
    Owner.ATO: ("ato",),
    Owner.TRAIN_END: ("front", "rear", "stop"),
}
"""Names of the parts that do not depend on the train."""
JOINT_STATE, DIAGNOSTICS = "sensor_msgs/msg/JointState", "diagnostic_msgs/msg/DiagnosticArray"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
"""ROS types of the positions, speeds and forces of named parts, of states and counters, and of points with a time."""
STATUS_VALUES = "status[].values"
"""Path of the keys and values of states."""


def owns(owner: Owner, name: str) -> bool:
    """Return True if a name in a message is that of a part of one kind."""
    if owner in FIXED_NAMES:
        return name in FIXED_NAMES[owner]
    return name.rstrip("0123456789") == f"{owner.value}_"


@dataclass(frozen=True)
class TrainLayout:
    """Sizes that define the layout of the messages of a run.

    Parameters
    ----------
    n_vehicles, n_units
        Vehicles and power units of the train.
    sensors
        Numbers of the vehicles with a coupler sensor behind them.
    air_brake, disturbed, supervised
        True for a train with an air brake, for a run with disturbances, and for one with a supervisor; otherwise their
        topics do not exist.
    reports, behind
        True for one of several trains in one domain, which reports to the train behind it, and for one that receives
        the reports of the train ahead.
    """

    n_vehicles: int
    n_units: int
    sensors: tuple[int, ...] = ()
    air_brake: bool = False
    disturbed: bool = False
    supervised: bool = False
    reports: bool = False
    behind: bool = False

    def names(self, owner: Owner) -> tuple[str, ...]:
        """Return the names of the parts, of vehicles, power units and coupler sensors front first."""
        if owner in FIXED_NAMES:
            return FIXED_NAMES[owner]
        numbers = {
            Owner.VEHICLE: range(self.n_vehicles),
            **dict.fromkeys((Owner.UNIT, Owner.FEED_FORWARD, Owner.FEEDBACK, Owner.ESTIMATE), range(self.n_units)),
            Owner.COUPLER: self.sensors,
        }[owner]
        return tuple(f"{owner.value}_{number}" for number in numbers)


Message = type[Any]
"""Dataclass of the messages of a topic."""


class Role(Enum):
    """Node that publishes or reads a topic."""

    PLANT = "plant"
    PROFILE = "profile"
    OBSERVER = "observer"
    CONTROLLER = "controller"
    SUPERVISOR = "supervisor"
    RECORDER = "recorder"


class Rate(Enum):
    """Rate of a topic."""

    ONCE = "once, latched"
    TICK = "every tick"
    SUPERVISION = "every supervision period"
    REPORT = "every supervision period, of one of several trains"
    HEARD = "every tick of an engaged law, while it has a reader"
    SECOND = "every simulated second and at the end"
    END = "once at the end, latched"


@dataclass(frozen=True)
class Condition:
    """Condition for the existence of a topic, as a predicate and as text."""

    holds: Callable[[TrainLayout], bool]
    text: str = ""


ALWAYS = Condition(lambda layout: True)
AIR_BRAKE = Condition(lambda layout: layout.air_brake, "only with an air brake")
DISTURBED = Condition(lambda layout: layout.disturbed, "only where the scenario has disturbances")
SUPERVISED = Condition(lambda layout: layout.supervised, "only with a supervisor")
REPORTS = Condition(lambda layout: layout.reports or layout.behind, "only in a namespace, with a supervisor")
BEHIND = Condition(lambda layout: layout.behind, "only with `leader.train`")


@dataclass(frozen=True)
class Place:
    """Place of one field of a message dataclass in the ROS message.

    Attributes
    ----------
    path
        Field of the ROS message: ``effort``, ``points[0].positions``; ``points[].positions`` for all points.
    field
        Field of the dataclass.
    owner
        Parts of the train that have one value each, in the order of their names; None for a single value.
    meaning
        Replacement of the meaning in the dataclass.
    """

    path: str
    field: str
    owner: Owner | None = None
    meaning: str = ""


@dataclass(frozen=True)
class Topic:
    """One topic of the table.

    Attributes
    ----------
    name
        Relative; absolute for ``/clock`` and ``/diagnostics``.
    type
        ROS type of the messages.
    message
        Dataclass of the messages; its first field is the stamp, its other fields carry unit and meaning.
    places
        Fields of the dataclass in the ROS message.  Several places of one path follow each other; of several places
        of one field the first is read.
    texts
        Constant texts of the ROS message by path.
    frame
        Frame of the header: its name, or the number of the vehicle whose frame it is (-1: the last one).
    condition
        Condition for the existence of the topic.
    finite
        Refuse numbers that are not finite, in encoding and decoding.
    awaited
        The plant does not begin before all publishers and readers are connected.
    optional
        A program in place of the publisher may leave it out.

    Raises
    ------
    ValueError
        If the field of a place is not in the dataclass.
    """

    name: str
    type: str
    message: Message
    places: tuple[Place, ...]
    publishers: tuple[Role, ...]
    meaning: str
    readers: tuple[Role, ...] = ()
    rate: Rate = Rate.TICK
    texts: tuple[tuple[str, tuple[str, ...]], ...] = ()
    frame: str | int = ""
    condition: Condition = ALWAYS
    recorded: bool = True
    latched: bool = False
    depth: int = 1000
    finite: bool = True
    awaited: bool = True
    optional: bool = False

    def __post_init__(self) -> None:
        known = {entry.name for entry in dataclasses.fields(self.message)}
        for place in self.places:
            if place.field not in known:
                raise ValueError(f"topic {self.name}: {self.message.__name__} has no field '{place.field}'")

    def exists(self, layout: TrainLayout) -> bool:
        """Return True if a run of this train has the topic."""
        return self.condition.holds(layout)

    def frame_id(self, layout: TrainLayout) -> str:
        """Return the frame of the header of the messages; empty for values of the parts of a train along the line."""
        return self.frame if isinstance(self.frame, str) else layout.names(Owner.VEHICLE)[self.frame]

    @property
    def of_variable_length(self) -> bool:
        """True if the messages of one run differ in length."""
        return any("[]" in place.path for place in self.places)

    @property
    def owners(self) -> tuple[Owner, ...]:
        """Parts of the train with values in the message, in the order of their names."""
        return tuple(dict.fromkeys(place.owner for place in self.places if place.owner is not None))

    def names(self, layout: TrainLayout) -> tuple[str, ...]:
        """Return the names in the messages, in their order; empty for values without owners."""
        return tuple(name for owner in self.owners for name in layout.names(owner))

    @property
    def names_path(self) -> str:
        """Field of the ROS message with the names."""
        return "joint_names" if self.type == TRAJECTORY else "name"

    @property
    def has_states(self) -> bool:
        """True for states and counters by their keys."""
        return any(place.path == STATUS_VALUES and place.owner is not None for place in self.places)

    def description(self, place: Place) -> FieldDescription:
        """Return column, unit and meaning of the values at a place."""
        (entry,) = (entry for entry in dataclasses.fields(self.message) if entry.name == place.field)
        found: FieldDescription = entry.metadata.get("description", FieldDescription(place.field, ""))
        return dataclasses.replace(found, meaning=place.meaning) if place.meaning else found

    def column(self, place: Place, name: str = "") -> str:
        """Return the name of a column, and the key of a state: owner as named in the message, quantity and unit."""
        found = self.description(place)
        unit = unit_suffix(found.unit)
        if name.endswith(f"_{found.column}"):
            return name + unit
        return f"{name}_{found.column}{unit}" if name else found.column + unit


def joint_states(owner: Owner, **fields: str) -> tuple[Place, ...]:
    """Return the places of a JointState: dataclass fields by the array of the message."""
    return tuple(Place(path, field, owner) for path, field in fields.items())


def states(owner: Owner, *fields: str) -> tuple[Place, ...]:
    """Return the places of states and counters as keys and values of one status."""
    return tuple(Place(STATUS_VALUES, field, owner) for field in fields)


def knots(index: str, *, acceleration: bool = True, position: str = "") -> tuple[Place, ...]:
    """Return the places of a JointTrajectory's points; ``index`` is ``0`` for a single point, "" for all points.

    ``position`` replaces the meaning of the positions in the dataclass.
    """
    fields = {"positions": "position", "velocities": "velocity"} | (
        {"accelerations": "acceleration"} if acceleration else {}
    )
    return tuple(
        Place(f"points[{index}].{path}", field, meaning=position if field == "position" else "")
        for path, field in fields.items()
    )
