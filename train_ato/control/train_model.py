"""The nominal train and line as laws, observers and compensations know them (the scenario's ``model:`` block).

The plant may differ from it: mismatch overlays change ``plant:`` only.
"""

from __future__ import annotations

import math

import numpy as np

from plant_sim.air_brake import BrakeForecast
from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.track import Track
from plant_sim.traction import Envelope
from train_ato.types import Array

GRID = 1.0
"""Spacing of the table of line forces [m]."""
STANDSTILL = 0.05
"""Speed below which the dry part of the model's resistance is faded out [m/s]."""


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
        Couplers that carry a sensor, numbered by the vehicle in front of them.
    over_length
        Average grades over each vehicle's length (trains taken as one mass).
    reversing
        A negative force also drives backwards.

    Attributes
    ----------
    units : tuple of int
        Vehicle numbers of the power units, front first.
    offsets : Array, shape (units,)
        Nominal distance of every unit behind vehicle 0's centre [m].
    mass, inertia : float
        Mass of the train and the same with rotating masses [kg].
    unit_mass : Array, shape (units,)
        Mass of every unit's own vehicle [kg].
    unit_inertia : Array, shape (units,)
        The same with rotating masses: what a force accelerates.
    share : Array, shape (units,)
        Part of a total force that every unit takes: in proportion to its largest traction force.
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

    def _table(self, table: Array, position: float) -> float:
        place = (position - self._begin) / GRID
        if place <= 0:
            return float(table[0])
        index = int(place)
        if index >= table.size - 1:
            return float(table[-1])
        low = float(table[index])
        return low + (place - index) * (float(table[index + 1]) - low)

    def running_resistance(self, velocity: float) -> float:
        """Return the running resistance of the whole train, odd in the speed and faded to 0 at standstill [N]."""
        speed = abs(velocity)
        return (self._c0 + self._c1 * speed + self._c2 * speed * speed) * math.tanh(velocity / STANDSTILL)

    def line_force(self, position: float) -> float:
        """Return grade, curve and tunnel force on the train, vehicle 0's centre at ``position`` [N], > 0 resists."""
        return self._table(self._total, position)

    def own_resistance(self, velocity: Array, position: Array) -> Array:
        """Return every unit vehicle's own running and line resistance [N], shape (units,)."""
        result = np.empty(self.n_units)
        for unit, (c0, c1, c2) in enumerate(self._unit_polynomials):
            v = float(velocity[unit])
            speed = abs(v)
            result[unit] = (c0 + c1 * speed + c2 * speed * speed) * math.tanh(v / STANDSTILL)
            result[unit] += float(self.unit_mass[unit]) * self._table(self._specific, float(position[unit]))
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
        """Return the total force that gives the train, taken as rigid, this acceleration here [N]."""
        return self.inertia * acceleration + self.running_resistance(velocity) + self.line_force(position) + shoe_force


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
