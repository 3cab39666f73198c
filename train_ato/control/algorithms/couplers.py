"""Forces of the couplers beside the power units, from sensors or from the states of both units."""

from __future__ import annotations

from operator import add
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from plant_sim.gears import LinearGear
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array

NO_COUPLERS = np.zeros((0, 2), dtype=np.int64), np.zeros((0, 4))
"""Arrays of a law or observer that uses no coupler forces."""


class UnitForces(Protocol):
    """Inputs of :meth:`UnitCouplers.opposing`: those of a law or of an observer."""

    @property
    def position(self) -> Array:
        """Of every unit [m]."""

    @property
    def velocity(self) -> Array:
        """Of every unit [m/s]."""

    @property
    def coupler_force(self) -> Array:
        """Of the couplers that carry a sensor [N]."""

    @property
    def shoe_force(self) -> Array:
        """Of every unit's own vehicle [N]."""


class OpposingForces(NamedTuple):
    """Forces against the motion of one unit's vehicle [N]: its couplers, its resistance, its shoes."""

    couplers: float
    resistance: float
    shoes: float

    @property
    def total(self) -> float:
        """Sum of the three [N]."""
        return self.couplers + self.resistance + self.shoes


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
    unknown : tuple of int
        Couplers beside a unit without an available force.
    """

    def __init__(self, model: TrainModel) -> None:
        self._model = model
        last = len(model.consist.vehicles) - 1
        gears = model.consist.gears
        sensor = {coupler: index for index, coupler in enumerate(model.sensors)}
        unit_of = {vehicle: unit for unit, vehicle in enumerate(model.units)}
        self._offset = model.offsets.tolist()
        self._beside: list[tuple[int | None, int | None]] = []
        self._sensor: dict[int, int] = {}
        self._spring: dict[int, tuple[int, int, float, float]] = {}
        unknown = set()
        for vehicle in model.units:
            front, behind = (vehicle - 1 if vehicle > 0 else None), (vehicle if vehicle < last else None)
            self._beside.append((front, behind))
            for coupler in (front, behind):
                if coupler is None:
                    continue
                gear = gears[coupler]
                between = coupler in unit_of and coupler + 1 in unit_of
                if coupler in sensor:
                    self._sensor[coupler] = sensor[coupler]
                elif between and isinstance(gear, LinearGear) and gear.slack == 0.0:
                    a, b = unit_of[coupler], unit_of[coupler + 1]
                    self._spring[coupler] = (a, b, gear.stiffness, gear.damping)
                else:
                    unknown.add(coupler)
        self.unknown = tuple(sorted(unknown))

    @property
    def arrays(self) -> tuple[NDArray[np.int64], Array]:
        """Couplers beside the units as arrays, if all forces are available.

        Returns
        -------
        beside : Array of int, shape (units, 2)
            Coupler in front of and behind every unit: number of its sensor, or number of sensors plus that of its
            spring; -1 for none.
        springs : Array, shape (springs, 4)
            Units in front of and behind a spring, its stiffness [N/m] and damping [N s/m].
        """
        first = len(self._model.sensors)
        number = {coupler: first + index for index, coupler in enumerate(self._spring)} | self._sensor
        beside = [[-1 if coupler is None else number[coupler] for coupler in pair] for pair in self._beside]
        springs = np.array(list(self._spring.values()), dtype=np.float64).reshape(-1, 4)
        return np.array(beside, dtype=np.int64).reshape(-1, 2), springs

    def unknown_names(self) -> str:
        """Return the names of the unknown couplers: ``coupler_0, coupler_7``."""
        return ", ".join(f"coupler_{coupler}" for coupler in self.unknown)

    def sensors_text(self) -> str:
        """Return the setting that fits the missing sensors: ``fit the sensors (plant.sensors.couplers: [0, 7])``."""
        return f"fit the sensors (plant.sensors.couplers: {sorted({*self._model.sensors, *self.unknown})})"

    def opposing(self, inputs: UnitForces) -> list[OpposingForces]:
        """Return the forces against the motion of every unit's vehicle, front first."""
        position, velocity = inputs.position.tolist(), inputs.velocity.tolist()
        pulls = self.pull(position, velocity, inputs.coupler_force.tolist())
        own = self._model.own_resistances(velocity, position)
        return list(map(OpposingForces, pulls, own, inputs.shoe_force.tolist()))

    def pull(self, position: list[float], velocity: list[float], measured: list[float]) -> list[float]:
        """Return the coupler force against the motion of every unit's vehicle [N], front first.

        Parameters
        ----------
        position, velocity
            Position and speed of every unit [m, m/s].
        measured
            Measured coupler forces [N], in the order of ``model.sensors``.
        """
        force: dict[int | None, float] = {None: 0.0}
        for coupler, index in self._sensor.items():
            force[coupler] = measured[index]
        if self._spring:
            place = list(map(add, position, self._offset))
            for coupler, (a, b, stiffness, damping) in self._spring.items():
                force[coupler] = stiffness * (place[a] - place[b]) + damping * (velocity[a] - velocity[b])
        return [force[behind] - force[front] for front, behind in self._beside]
