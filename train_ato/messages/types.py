"""Messages between the stages of the loop, free of ROS.

Stamps are integer nanoseconds since the start of the run; arrays are float64 over power units, front first, unless
a docstring gives another shape.  Forces are > 0 forward, coupler forces > 0 in draft.
"""

from dataclasses import field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from plant_sim.states import (
    Array,
    BrakeShoes,
    Disturbance,
    Measurement,
    Odometry,
    Pipe,
    VehicleStates,
    described,
    frozen_message,
)

__all__ = [
    "Array", "AtoReport", "AtoState", "BrakeRelease", "BrakeShoes", "Command", "Diagnostic", "Disturbance",
    "DisturbanceEstimate", "Measurement", "Odometry", "Pipe", "ProtectionState", "Reference", "SupervisedSpeeds",
    "Tick", "TrainAhead", "Trajectory", "VehicleStates",
]  # fmt: skip


@frozen_message
class Tick:
    """Simulation stamp (topics ``/clock`` and ``recorder/progress``)."""

    stamp: int = field(metadata=described("clock", "s", "simulation time from the epoch 2026-01-01T00:00:00Z"))


@frozen_message
class Reference:
    """Reference of the centre of vehicle 0 (topic ``ato/reference``).

    ``planned`` identifies its profile by the stamp of the planning [ns].
    """

    stamp: int
    position: float = field(metadata=described("position", "m", "of vehicle 0's centre"))
    velocity: float = field(metadata=described("speed", "m/s"))
    acceleration: float = field(metadata=described("acceleration", "m/s²"))
    planned: int = field(
        default=0, metadata=described("planned", "s", "simulation time of the planning of its profile")
    )


@frozen_message
class Trajectory:
    """Knots of a whole profile (``ato/profile``) or the steps of the speed limit (``ato/limits``), shape (k,) each.

    For limits ``time`` is 0 and ``acceleration`` is empty.
    """

    stamp: int = field(metadata=described("planned", "s", "simulation time of the planning; 0 for the first"))
    name: str
    time: NDArray[np.int64] = field(metadata=described("time", "s", "from simulation time 0"))
    position: Array = field(metadata=described("position", "m", "of vehicle 0's centre"))
    velocity: Array = field(metadata=described("speed", "m/s"))
    acceleration: Array = field(metadata=described("acceleration", "m/s²"))


@frozen_message
class DisturbanceEstimate:
    """Disturbance force per power unit (topic ``ato/estimate``)."""

    stamp: int
    force: Array = field(metadata=described("disturbance_force", "N", "> 0 forward"))


@frozen_message
class Command:
    """Force demand per power unit as sent (topic ``ato/command``)."""

    stamp: int
    force: Array = field(metadata=described("force", "N", "> 0 traction, < 0 electric brake"))


@frozen_message
class ForceParts:
    """Parts of the force demand per power unit (topic ``ato/force_parts``)."""

    stamp: int
    feed_forward: Array = field(metadata=described("force", "N", "part of the force demand"))
    feedback: Array = field(metadata=described("force", "N", "part of the force demand"))
    estimate: Array = field(metadata=described("force", "N", "part of the force demand"))


@frozen_message
class Diagnostic:
    """State of one node (topic ``/diagnostics``, one message per node), or end of the run (``train/end``)."""

    stamp: int
    node: str = field(metadata=described("node", "", "name of the node"))
    level: int = field(metadata=described("level", "", "0 ok, 1 warning, 2 error"))
    message: str = field(metadata=described("message", "", "state in words"))
    values: dict[str, str] = field(default_factory=dict, metadata=described("", "", "key and value as text, SI"))


@frozen_message
class BrakeRelease:
    """Release of traction, service brake and emergency brake by the supervisor (topic ``atp/brake_release``).

    The plant brakes without this message.
    """

    stamp: int
    released: Array = field(
        metadata=described("released", "", "1 released; 0 traction cut off, or brake demanded", permitted=(0.0, 1.0))
    )
    alive: Array = field(metadata=described("alive", "", "alive counter: number of the message, the same for all"))


@frozen_message
class ProtectionState:
    """Traction cut-off and brakes in effect for any reason (topic ``train/protection``)."""

    stamp: int
    active: Array = field(
        metadata=described(
            "active", "", "1 traction cut off, or brake applied; 0 as the ATO commands", permitted=(0.0, 1.0)
        )
    )


@frozen_message
class SupervisedSpeeds:
    """Estimated speed and limits of the supervisor (topic ``atp/speeds``), shape (5,) each."""

    stamp: int
    position: Array = field(
        metadata=described("position", "m", "front: estimate, for the limits the max safe front they hold for")
    )
    speed: Array = field(metadata=described("speed", "m/s"))


@frozen_message
class TrainAhead:
    """Report of a train for the train behind it (topics ``train/report`` and ``train/ahead``), shape (3,) each.

    ``time`` is that of its odometry [ns]; the stamp of ``train/ahead`` is that of its use.

    The last report of a run has NaN as positions and speeds.
    """

    stamp: int
    position: Array = field(
        metadata=described("position", "m", "estimated front, and safe rear; of stop: shortest way to standstill")
    )
    speed: Array = field(metadata=described("speed", "m/s", "estimated, for all the same"))
    time: int = field(metadata=described("reported", "s", "simulation time of the odometry of the report"))


@frozen_message
class FormerTrainAhead:
    """Report of a train in logs of a JointState: the time is in seconds, three times."""

    stamp: int
    position: Array = field(metadata=described("position", "m"))
    speed: Array = field(metadata=described("speed", "m/s"))
    time: Array = field(metadata=described("time", "s"))

    def today(self) -> TrainAhead:
        """Return the report; the last one of a run, with NaN, has the time of its stamp."""
        time = self.time.item(0)
        return TrainAhead(self.stamp, self.position, self.speed, round(time * 1e9) if time == time else self.stamp)


class WordEnum(IntEnum):
    """Numbers whose names are words."""

    @property
    def text(self) -> str:
        """Name in words."""
        return self.name.lower().replace("_", " ")


class Protection(WordEnum):
    """Reaction of the train, by rising severity."""

    NONE = 0
    COAST = 1
    SERVICE_BRAKE = 2
    EMERGENCY_BRAKE = 3

    @property
    def active(self) -> tuple[bool, bool, bool]:
        """Traction cut off, service brake and emergency brake in effect."""
        return self >= Protection.COAST, self is Protection.SERVICE_BRAKE, self is Protection.EMERGENCY_BRAKE


class AtoState(WordEnum):
    """State of the ATO: SUBSET-125, 6.3, without the states of its configuration."""

    NOT_AVAILABLE = 0
    AVAILABLE = 1
    READY = 2
    ENGAGED = 3
    DISENGAGING = 4
    FAILURE = 5


@frozen_message
class AtoReport:
    """State of the ATO with its measured motion (topic ``ato/state``), shape (1,) each."""

    stamp: int
    position: Array = field(metadata=described("position", "m", "measured, of vehicle 0's centre"))
    velocity: Array = field(metadata=described("speed", "m/s", "measured, of the first power unit"))
    state: Array = field(
        metadata=described(
            "state",
            "",
            ", ".join(f"{state.value} {state.text}" for state in AtoState),
            permitted=tuple(float(state) for state in AtoState),
        )
    )
