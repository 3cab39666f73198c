"""Forces of the couplers beside the power units, from sensors or from the states of both units."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from plant_sim.gears import LinearGear
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array


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
        self._sensor = {coupler: index for index, coupler in enumerate(model.sensors)}
        self._unit = {vehicle: unit for unit, vehicle in enumerate(model.units)}
        self._offset = model.offsets.tolist()
        self._beside: list[tuple[int | None, int | None]] = []
        self._spring: dict[int, tuple[int, int, float, float]] = {}
        unknown = set()
        for vehicle in model.units:
            front, behind = (vehicle - 1 if vehicle > 0 else None), (vehicle if vehicle < last else None)
            self._beside.append((front, behind))
            for coupler in (front, behind):
                if coupler is None or coupler in self._sensor:
                    continue
                gear = gears[coupler]
                between = coupler in self._unit and coupler + 1 in self._unit
                if between and isinstance(gear, LinearGear) and gear.slack == 0.0:
                    a, b = self._unit[coupler], self._unit[coupler + 1]
                    self._spring[coupler] = (a, b, gear.stiffness, gear.damping)
                else:
                    unknown.add(coupler)
        self.unknown = tuple(sorted(unknown))

    def unknown_names(self) -> str:
        """Return the names of the unknown couplers: ``coupler_0, coupler_7``."""
        return ", ".join(f"coupler_{coupler}" for coupler in self.unknown)

    def sensors_text(self) -> str:
        """Return the setting that fits the missing sensors: ``fit the sensors (plant.sensors.couplers: [0, 7])``."""
        return f"fit the sensors (plant.sensors.couplers: {sorted({*self._model.sensors, *self.unknown})})"

    def opposing(self, inputs: UnitForces) -> list[OpposingForces]:
        """Return the forces against the motion of every unit's vehicle, front first."""
        pulls = self.pull(inputs.position.tolist(), inputs.velocity.tolist(), inputs.coupler_force.tolist())
        own = self._model.own_resistance(inputs.velocity, inputs.position).tolist()
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
        place = [x + offset for x, offset in zip(position, self._offset, strict=True)]
        return [
            self._force(behind, place, velocity, measured) - self._force(front, place, velocity, measured)
            for front, behind in self._beside
        ]

    def _force(self, coupler: int | None, place: list[float], velocity: list[float], measured: list[float]) -> float:
        if coupler is None:
            return 0.0
        index = self._sensor.get(coupler)
        if index is not None:
            return measured[index]
        a, b, stiffness, damping = self._spring[coupler]
        return stiffness * (place[a] - place[b]) + damping * (velocity[a] - velocity[b])
