"""Nominal model of train and line for laws, observers and compensations (block ``model:`` of the scenario).

The plant may differ from it: a mismatch changes the block ``plant:`` only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from plant_sim.air_brake import BrakeForecast
from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.track import Track
from plant_sim.traction import Envelope
from train_ato.messages.types import Array

GRID = 1.0
"""Spacing of the table of line forces [m]."""
DRY_FRICTION_SPEED = 0.05
"""Speed below which the resistance of the model fades out [m/s]."""
STANDSTILL_SPEED = 0.05
"""Speed below which a train counts as standing [m/s]; the default of ``plant.holding_speed``."""


class TrainModel:
    """Nominal longitudinal model of the whole train.

    Parameters
    ----------
    consist, line
        Nominal data.
    delay, delay_brake
        Command delay of every power unit in traction and in braking [s], shape (units,).
    lag
        First-order lag of the actuators [s].
    tick
        Period of the loop [s].
    sensors
        Numbers of the couplers that carry a sensor, by the vehicle in front of them.
    over_length
        Average grades over the length of the first vehicle (for a train as one mass).
    reversing
        A negative force also drives backwards.

    Attributes
    ----------
    units : tuple of int
        Vehicle numbers of the power units, front first.
    offsets : Array, shape (units,)
        Nominal distance of every unit behind vehicle 0's centre [m].
    mass, inertia : float
        Mass of the train, without and with rotating masses [kg].
    unit_mass : Array, shape (units,)
        Mass of every unit's own vehicle [kg].
    unit_inertia : Array, shape (units,)
        The same with rotating masses [kg].
    share : Array, shape (units,)
        Part of a total force for every unit, in proportion to its largest traction force; the sum is 1.
    """

    def __init__(
        self,
        consist: Consist,
        line: Line,
        delay: Array,
        delay_brake: Array,
        lag: float,
        tick: float,
        sensors: tuple[int, ...] = (),
        *,
        over_length: bool = False,
        reversing: bool = False,
    ) -> None:
        self.consist = consist
        self.line = line
        self.delay = delay
        self.delay_brake = delay_brake
        self.lag = lag
        self.tick = tick
        self.sensors = sensors
        self.reversing = reversing
        vehicles = consist.vehicles
        self.units = consist.power_units
        self.n_units = len(self.units)
        self.offsets: Array = np.array([consist.offsets[unit] for unit in self.units])
        self.mass = consist.mass
        self.inertia = sum(vehicle.mass * vehicle.rotating_mass_factor for vehicle in vehicles)
        self.unit_mass: Array = np.array([vehicles[unit].mass for unit in self.units])
        self.unit_inertia: Array = self.unit_mass * [vehicles[unit].rotating_mass_factor for unit in self.units]
        self.traction = tuple(Envelope(vehicles[unit].traction) for unit in self.units)
        self.brake = tuple(Envelope(vehicles[unit].brake) for unit in self.units)
        self.share = self._shares()
        self.air_brake = BrakeForecast(consist) if consist.air_brake is not None else None
        polynomials = np.array([vehicle.resistance.polynomial(vehicle.mass, consist.gravity) for vehicle in vehicles])
        self._c0, self._c1, self._c2 = (float(total) for total in polynomials.sum(axis=0))
        self._unit_polynomials = [tuple(float(c) for c in polynomials[unit]) for unit in self.units]
        self._specific, self._begin = _specific_line_force(consist, line, over_length)
        self._total = self._weighted(np.array([vehicle.mass for vehicle in vehicles]), np.array(consist.offsets))

    def _shares(self) -> Array:
        largest = np.array([envelope.largest() for envelope in self.traction])
        if largest.sum() <= 0:
            largest = np.array([envelope.largest() for envelope in self.brake])
        shares: Array = (
            largest / largest.sum() if largest.sum() > 0 else np.full(self.n_units, 1 / max(1, self.n_units))
        )
        return shares

    def _weighted(self, masses: Array, offsets: Array) -> Array:
        """Sum the line force over the train for vehicle 0 at every grid point [N]."""
        total = np.zeros_like(self._specific)
        for mass, offset in zip(masses, offsets, strict=True):
            shift = round(float(offset) / GRID)
            total[shift:] += mass * self._specific[: total.size - shift]
            total[:shift] += mass * self._specific[0]
        return total

    def running_resistance(self, velocity: float) -> float:
        """Return the running resistance of the train [N]: odd in the speed, 0 at standstill."""
        speed = abs(velocity)
        return (self._c0 + self._c1 * speed + self._c2 * speed * speed) * math.tanh(velocity / DRY_FRICTION_SPEED)

    def line_force(self, position: float) -> float:
        """Return grade, curve and tunnel force on the train [N], > 0 resists, for vehicle 0's centre at a position."""
        return interpolated(self._total, (position - self._begin) / GRID)

    def resisting_force(self, position: float, velocity: float, shoe_force: float = 0.0) -> float:
        """Return running, line and shoe force on the train [N], > 0 resists, for vehicle 0's centre at a position."""
        return self.running_resistance(velocity) + self.line_force(position) + shoe_force

    def front(self, position: Array) -> float:
        """Return the position of vehicle 0's centre [m] for positions of the units, shape (units,)."""
        return float(position[0] + self.offsets[0])

    def own_resistance(self, velocity: Array, position: Array) -> Array:
        """Return running and line resistance of every unit's own vehicle [N], shape (units,)."""
        result = np.empty(self.n_units)
        for unit, (c0, c1, c2) in enumerate(self._unit_polynomials):
            v = float(velocity[unit])
            speed = abs(v)
            result[unit] = (c0 + c1 * speed + c2 * speed * speed) * math.tanh(v / DRY_FRICTION_SPEED)
            result[unit] += float(self.unit_mass[unit]) * interpolated(
                self._specific, (float(position[unit]) - self._begin) / GRID
            )
        return result

    def force_limits(self, velocity: Array) -> tuple[Array, Array]:
        """Return the smallest and largest force of every unit at its speed [N], each of shape (units,)."""
        low, high = np.empty(self.n_units), np.empty(self.n_units)
        for unit in range(self.n_units):
            speed = abs(float(velocity[unit]))
            low[unit] = -self.brake[unit].force(speed)
            high[unit] = self.traction[unit].force(speed)
        return low, high

    def rigid_force(self, position: float, velocity: float, acceleration: float, shoe_force: float = 0.0) -> float:
        """Return the total force that accelerates the rigid train at ``acceleration`` [N]; arguments in SI."""
        return self.inertia * acceleration + self.running_resistance(velocity) + self.line_force(position) + shoe_force


def interpolated(table: Sequence[float] | Array, place: float) -> float:
    """Return the value of a table at a place between its entries, 0 the first; the ends hold beyond them."""
    if place <= 0.0:
        return float(table[0])
    index = int(place)
    if index >= len(table) - 1:
        return float(table[-1])
    low = float(table[index])
    return low + (place - index) * (float(table[index + 1]) - low)


def _specific_line_force(consist: Consist, line: Line, over_length: bool) -> tuple[Array, float]:
    """Tabulate grade, curve and tunnel force per mass [N/kg] over the line, a train's length beyond both ends."""
    margin = consist.length + 2 * GRID
    begin = line.begin - margin
    count = math.ceil((line.end + margin - begin) / GRID) + 1
    places = begin + GRID * np.arange(count)
    track = Track(line)
    piece = np.searchsorted(track.breaks, places, side="right")
    specific: Array = consist.gravity * (track.grade[piece] + track.dry[piece])
    if over_length:
        width = max(1, round(consist.vehicles[0].length / GRID))
        specific = np.convolve(np.pad(specific, width, mode="edge"), np.full(width, 1 / width), mode="same")[
            width:-width
        ]
    return specific, begin
