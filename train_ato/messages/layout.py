"""Sizes of a train that define the topics of a run and the lengths of their messages."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Owner(Enum):
    """Parts of a train with one value each in a message.

    The enum value of numbered parts is the prefix of their names (``unit_0``); :data:`FIXED_NAMES` has the others.
    """

    VEHICLE = "vehicle"
    UNIT = "unit"
    COUPLER = "coupler"
    ODOMETER = "odometer"
    BRAKE_LINE = "brake_line"
    SUPERVISED_SPEED = "supervised_speed"
    ATO = "ato"

    @property
    def meaning(self) -> str:
        """Meaning and order of the parts, as text."""
        return {
            Owner.VEHICLE: "every vehicle, front first",
            Owner.UNIT: "every power unit, front first",
            Owner.COUPLER: "the coupler behind vehicle I where a sensor is fitted",
            Owner.ODOMETER: "the odometers of the supervisor",
            Owner.BRAKE_LINE: "traction and brakes that the supervisor releases",
            Owner.SUPERVISED_SPEED: "estimated speed and limits of the supervisor",
            Owner.ATO: "the ATO",
        }[self]


FIXED_NAMES: dict[Owner, tuple[str, ...]] = {
    Owner.ODOMETER: ("wheel", "radar"),
    Owner.BRAKE_LINE: ("traction", "service_brake", "emergency_brake"),
    Owner.SUPERVISED_SPEED: ("estimate", "permitted", "warning", "service_brake", "emergency_brake"),
    Owner.ATO: ("ato",),
}
"""Names of the parts that do not depend on the train."""


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
    """

    n_vehicles: int
    n_units: int
    sensors: tuple[int, ...] = ()
    air_brake: bool = False
    disturbed: bool = False
    supervised: bool = False

    def names(self, owner: Owner) -> tuple[str, ...]:
        """Return the names of the parts, of vehicles, power units and coupler sensors front first."""
        if owner in FIXED_NAMES:
            return FIXED_NAMES[owner]
        numbers = {
            Owner.VEHICLE: range(self.n_vehicles),
            Owner.UNIT: range(self.n_units),
            Owner.COUPLER: self.sensors,
        }[owner]
        return tuple(f"{owner.value}_{number}" for number in numbers)
