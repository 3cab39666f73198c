"""Messages of the plant at each tick: the truth, and the measurement of it.

Stamps are integer nanoseconds since the start of the run.  Forces are > 0 forward, coupler forces > 0 in draft.
Name in tables, unit and meaning of every field are defined only here (:func:`described`).
"""

import dataclasses
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from typing import dataclass_transform
else:  # Python 3.10 does not have it

    def dataclass_transform(**_: Any) -> Any:
        """Return a decorator without an effect."""
        return lambda decorator: decorator


Array = NDArray[np.float64]
Message = TypeVar("Message")


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
def frozen_message(kind: type[Message]) -> type[Message]:
    """Make a frozen dataclass without the check at run time; mypy refuses assignments to its fields all the same.

    The check is 80 % of the time of a constructor: 0.8 us become 0.15 us for a measurement; a tick makes 20 messages
    (``python bench/tick.py``).
    """
    message = dataclass(frozen=True, slots=True)(kind)
    entries = dataclasses.fields(message)  # type: ignore[arg-type]
    plain = dataclasses.make_dataclass(
        message.__name__,
        [(e.name, e.type, field(default=e.default, default_factory=e.default_factory)) for e in entries],
    )
    message.__init__ = plain.__init__  # type: ignore[method-assign, misc]
    del message.__setattr__, message.__delattr__
    return message


@dataclass(frozen=True)
class FieldDescription:
    """Name in tables, SI unit, meaning and permitted values of a field.

    Times are integer nanoseconds in the program, s in tables; without permitted values every number is permitted.
    """

    column: str
    unit: str
    meaning: str = ""
    permitted: tuple[float, ...] = ()


def described(
    column: str, unit: str, meaning: str = "", permitted: tuple[float, ...] = ()
) -> dict[str, FieldDescription]:
    """Return the metadata of a dataclass field that has a description."""
    return {"description": FieldDescription(column, unit, meaning, permitted)}


@frozen_message
class VehicleStates:
    """True state of every vehicle, shape (n,) each (topic ``train/vehicles``)."""

    stamp: int
    position: Array = field(metadata=described("position", "m", "vehicle centre along the line"))
    velocity: Array = field(metadata=described("speed", "m/s", "speed"))
    coupler_force: Array = field(
        metadata=described(
            "coupler_force", "N", "force of the coupler behind the vehicle, > 0 draft; 0 behind the last"
        )
    )


@frozen_message
class Measurement:
    """Measured state (topic ``train/measurement``), with noise, quantisation and faults.

    Position, velocity and applied force have the shape (units,), the fields of the coupler sensors (sensors,).
    """

    stamp: int
    position: Array = field(metadata=described("position", "m", "position"))
    velocity: Array = field(metadata=described("speed", "m/s", "speed"))
    applied: Array = field(metadata=described("applied_force", "N", "force now applied, after delay, lag and limit"))
    deflection: Array = field(metadata=described("deflection", "m", "deflection, > 0 draft"))
    rate: Array = field(metadata=described("deflection_rate", "m/s", "rate of deflection"))
    force: Array = field(metadata=described("force", "N", "force"))

    def copy(self) -> "Measurement":
        """Return the measurement in arrays of its own: a law or an observer may write into them, a recording not."""
        return Measurement(
            self.stamp, self.position.copy(), self.velocity.copy(), self.applied.copy(), self.deflection.copy(),
            self.rate.copy(), self.force.copy(),
        )  # fmt: skip


@frozen_message
class BrakeShoes:
    """Air brake of every vehicle, shape (n,) (topic ``train/brake_shoes``)."""

    stamp: int
    shoe_force: Array = field(metadata=described("shoe_force", "N", "retarding shoe force"))


@frozen_message
class Disturbance:
    """True outside force on every vehicle, shape (n,) (topic ``train/disturbance``)."""

    stamp: int
    force: Array = field(
        metadata=described("disturbance_force", "N", "mean over the last tick, > 0 forward; without unmodelled grades")
    )


@frozen_message
class Pipe:
    """Pressure of the brake pipe.

    True at the head (``train/brake_pipe``) and at the tail (``train/brake_pipe_tail``), or demanded at the head
    (``ato/brake_pipe_command``).
    """

    stamp: int
    pressure: float = field(metadata=described("pressure", "Pa", "absolute; 600 kPa charged"))


@frozen_message
class Odometry:
    """Odometry of the supervisor, wheel first, then radar, shape (2,) each (topic ``train/odometry``).

    It is independent of the measurement of the ATO. Every odometer counts from the last balise.
    """

    stamp: int
    position: Array = field(metadata=described("position", "m", "front of the train, from the last balise"))
    speed: Array = field(metadata=described("speed", "m/s"))
    since_balise: Array = field(metadata=described("since_balise", "m", "distance counted since the last balise"))


class Observation(NamedTuple):
    """Messages of the plant at one stamp; those of the brake are None without an air brake.

    ``brake_pipe`` is the pressure at vehicle 0, ``brake_pipe_tail`` that at the last vehicle.
    """

    vehicles: VehicleStates
    measurement: Measurement
    brake_pipe: Pipe | None
    brake_pipe_tail: Pipe | None
    brake_shoes: BrakeShoes | None
