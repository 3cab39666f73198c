"""Forces of the couplers beside the power units: from their sensors, or between two units from the units' states."""

from __future__ import annotations

from typing import TYPE_CHECKING

from plant_sim.gears import LinearGear

if TYPE_CHECKING:
    from train_ato.model import TrainModel


class UnitCouplers:
    """What the couplers pull every unit's vehicle back with.

    A coupler's force is known if it carries a sensor, or if it is a linear spring without slack between two units.

    Attributes
    ----------
    missing : tuple of int
        Couplers whose force is not known; empty if all are.
    """

    def __init__(self, model: TrainModel) -> None:
        last = len(model.consist.vehicles) - 1
        gears = model.consist.gears
        self._sensor = {coupler: index for index, coupler in enumerate(model.sensors)}
        self._unit = {vehicle: unit for unit, vehicle in enumerate(model.units)}
        self._offset = model.offsets.tolist()
        self._beside: list[tuple[int | None, int | None]] = []
        self._spring: dict[int, tuple[int, int, float, float]] = {}
        missing = set()
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
                    missing.add(coupler)
        self.missing = tuple(sorted(missing))

    def refusal(self) -> str:
        """Return the names of the couplers that are missing: ``coupler_0, coupler_7``."""
        return ", ".join(f"coupler_{coupler}" for coupler in self.missing)

    def pull(self, position: list[float], velocity: list[float], measured: list[float]) -> list[float]:
        """Return the force that pulls every unit's vehicle back [N].

        Parameters
        ----------
        position, velocity
            Of every unit [m, m/s].
        measured
            Forces of the sensors, in the order of ``model.sensors`` [N].
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
