"""Forces of the couplers beside the power units, from sensors or from the states of both units."""

from dataclasses import dataclass
from typing import Any

from plant_sim.compiled import compiled
from plant_sim.gears import LinearGear
from plant_sim.record import Records, quantity, zeros
from train_ato.control.guard import LawUnit
from train_ato.control.train_model import TrainModel, UnitVehicle, own_resistance
from train_ato.messages.types import Array

NONE, SENSOR, SPRING = range(3)
"""Sources of the force of a coupler."""


@dataclass
class UnitCoupler:
    """Coupler in front of or behind a unit's vehicle."""

    source: int = quantity("", "`NONE` at an end of the train, `SENSOR` or `SPRING`")
    sensor: int = quantity("", "number of the sensor")
    front: int = quantity("", "unit in front of a spring")
    behind: int = quantity("", "unit behind a spring")
    stiffness: float = quantity("N/m", "stiffness of a spring")
    damping: float = quantity("N s/m", "damping of a spring")


@compiled
def _force(coupler: UnitCoupler, measured: Array, vehicles: Records[UnitVehicle], units: Records[LawUnit]) -> float:
    """Return the force of a coupler [N], > 0 pulls."""
    if coupler.source == SENSOR:
        return float(measured[coupler.sensor])
    if coupler.source == NONE:
        return 0.0
    a, b = units[coupler.front], units[coupler.behind]
    place, other = a.position + vehicles[coupler.front].offset, b.position + vehicles[coupler.behind].offset
    return coupler.stiffness * (place - other) + coupler.damping * (a.velocity - b.velocity)


@compiled
def opposing(
    couplers: Records[UnitCoupler], measured: Array, vehicles: Records[UnitVehicle], specific: Array, learned: Array,
    units: Records[LawUnit],
) -> None:  # fmt: skip
    """Write coupler force and resistance against the motion of every unit's vehicle for its position and speed.

    Parameters
    ----------
    couplers
        Couplers in front of and behind every unit, two per unit; empty: no force is written.
    measured
        Measured coupler forces [N].
    vehicles, specific, learned
        Vehicles and tables of the nominal model.
    units
        Inputs of a law or of an observer, in which the forces are written.
    """
    for u in range(couplers.size // 2):
        x = units[u]
        pull = _force(couplers[2 * u + 1], measured, vehicles, units)
        x.coupler_force = pull - _force(couplers[2 * u], measured, vehicles, units)
        x.resistance = own_resistance(vehicles[u], specific, learned, x.velocity, x.position)


NO_COUPLERS = zeros(UnitCoupler, 0)
"""Couplers of a law that does not use their forces."""


class UnitCouplers:
    """Coupler forces on the vehicles of the units.

    The force of a coupler is available if the coupler carries a sensor, or if it is a linear spring without slack
    between two units.

    Parameters
    ----------
    model
        The nominal train.

    Attributes
    ----------
    records : Records of UnitCoupler, shape (2 units,)
        Couplers in front of and behind every unit.
    unknown : tuple of int
        Couplers beside a unit without an available force.
    """

    def __init__(self, model: TrainModel) -> None:
        self._model = model
        last = len(model.consist.vehicles) - 1
        gears = model.consist.gears
        sensor = {coupler: index for index, coupler in enumerate(model.sensors)}
        unit_of = {vehicle: unit for unit, vehicle in enumerate(model.units)}
        self.records = zeros(UnitCoupler, 2 * len(model.units))
        unknown = set()
        for unit, vehicle in enumerate(model.units):
            for side, coupler in enumerate((vehicle - 1, vehicle)):
                if not 0 <= coupler < last:
                    continue
                gear, row = gears[coupler], 2 * unit + side
                between = coupler in unit_of and coupler + 1 in unit_of
                if coupler in sensor:
                    self.records[row] = (SENSOR, sensor[coupler], 0, 0, 0.0, 0.0)
                elif between and isinstance(gear, LinearGear) and gear.slack == 0.0:
                    ends = unit_of[coupler], unit_of[coupler + 1]
                    self.records[row] = (SPRING, 0, *ends, gear.stiffness, gear.damping)
                else:
                    unknown.add(coupler)
        self.unknown = tuple(sorted(unknown))

    def unknown_names(self) -> str:
        """Return the names of the unknown couplers: ``coupler_0, coupler_7``."""
        return ", ".join(f"coupler_{coupler}" for coupler in self.unknown)

    def sensors_text(self) -> str:
        """Return the setting that fits the missing sensors: ``fit the sensors (plant.sensors.couplers: [0, 7])``."""
        return f"fit the sensors (plant.sensors.couplers: {sorted({*self._model.sensors, *self.unknown})})"

    def write(self, measured: Array, units: Any) -> None:
        """Write the forces against the motion of every unit's vehicle, see :func:`opposing`."""
        specific, _, learned = self._model.tables
        opposing(self.records, measured, self._model.vehicles, specific, learned, units)
