"""Sizes of a train that define the topics of a run and the lengths of their messages."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Owner(Enum):
    """Parts of a train with one value each in a message; the enum value is the prefix of their names (``unit_0``)."""

    VEHICLE = "vehicle"
    UNIT = "unit"
    COUPLER = "coupler"

    @property
    def meaning(self) -> str:
        """Meaning and order of the parts, as text."""
        return {
            Owner.VEHICLE: "every vehicle, front first",
            Owner.UNIT: "every power unit, front first",
            Owner.COUPLER: "the coupler behind vehicle I where a sensor is fitted",
        }[self]


FORMER_OWNERS = {"car": Owner.VEHICLE}
"""Prefixes of names in logs of version 0.1.0, read until 0.3."""


def present_name(name: str) -> str:
    """Return the present name of a vehicle, power unit or sensor: ``vehicle_3`` for ``car_3``."""
    kind, _, number = name.rpartition("_")
    owner = FORMER_OWNERS.get(kind)
    return name if owner is None else f"{owner.value}_{number}"


@dataclass(frozen=True)
class TrainLayout:
    """Sizes that define the layout of the messages of a run.

    Parameters
    ----------
    n_vehicles, n_units
        Vehicles and power units of the train.
    sensors
        Numbers of the vehicles with a coupler sensor behind them.
    air_brake, disturbed
        True for a train with an air brake, and for a run with disturbances; otherwise their topics do not exist.
    """

    n_vehicles: int
    n_units: int
    sensors: tuple[int, ...] = ()
    air_brake: bool = False
    disturbed: bool = False

    def names(self, owner: Owner) -> tuple[str, ...]:
        """Return the names of the vehicles, power units or coupler sensors, front first."""
        numbers = {
            Owner.VEHICLE: range(self.n_vehicles),
            Owner.UNIT: range(self.n_units),
            Owner.COUPLER: self.sensors,
        }[owner]
        return tuple(f"{owner.value}_{number}" for number in numbers)
