"""Tables of a train for the planner: forces over the speed, masses along its length."""

from dataclasses import dataclass

import numpy as np

from plant_sim.air_brake import braking_factor
from plant_sim.consist import Consist
from plant_sim.elementary import plain_sum
from plant_sim.railway import shoe_force
from plant_sim.traction import Envelope
from train_ato.messages.types import Array

SPEED_STEP = 0.02
"""Spacing of the tables over the speed [m/s]."""
MAX_TABLE_SPEED = 200.0
"""Upper end of every table [m/s]."""
ROUNDING = 1e-6
"""Relative excess over the top speed that counts as rounding of a planned speed."""
OVERSPEED = 0.02
"""Fraction of the speed kept as a distance from the end of the brake envelope, so that a small overspeed can brake."""


@dataclass(frozen=True, slots=True)
class AvailableForce:
    """Available force of a train: reduced after a fault, at low adhesion, or by a limit.

    Attributes
    ----------
    traction, brake : float
        Available fraction of the envelopes.
    traction_max, brake_max : float
        Largest force of the whole train [N].
    """

    traction: float = 1.0
    brake: float = 1.0
    traction_max: float = np.inf
    brake_max: float = np.inf


class TrainTables:
    """Forces of a whole train over its speed, and its masses along its length.

    Parameters
    ----------
    consist
        The train.
    speed_max
        Top speed of the train [m/s]. None: end of the traction envelope, at most 98 % of the end of the brake envelope.
    air_brake
        Include the air brake.
    point_mass
        All mass at the front: no train length for limits, grades and curves.
    available
        Available force; None: the nominal envelopes.
    reduction
        Brake-pipe reduction of the air brake [Pa]. None: the reduction of the largest braking factor.

    Attributes
    ----------
    speed : Array, shape (n,)
        Grid of the tables [m/s].
    traction, brake, resistance : Array, shape (n,)
        Largest traction, largest brake force (air included) and running resistance [N].
    electric : Array, shape (n,)
        Electric part of ``brake`` [N].
    mass, inertia : float
        Mass, and mass with rotating parts [kg].
    behind : Array, shape (vehicles,)
        Distance of every vehicle's centre behind the front [m].
    half : float
        From vehicle 0's centre to the front [m].
    length : float
        Length over which a speed limit holds [m].

    Raises
    ------
    ValueError
        If the train has no brake.
    """

    def __init__(
        self,
        consist: Consist,
        speed_max: float | None = None,
        *,
        air_brake: bool = True,
        point_mass: bool = False,
        available: AvailableForce | None = None,
        reduction: float | None = None,
    ) -> None:
        vehicles = consist.vehicles
        self.name = consist.name
        self.available = available or AvailableForce()
        self.gravity = consist.gravity
        self.masses: Array = np.array([vehicle.mass for vehicle in vehicles])
        self.lengths: Array = np.array([vehicle.length for vehicle in vehicles])
        self.mass = float(self.masses.sum())
        self.inertia = plain_sum(vehicle.mass * vehicle.rotating_mass_factor for vehicle in vehicles)
        self.half = vehicles[0].length / 2
        self.behind: Array = np.array(consist.offsets) + self.half
        self.length = consist.length
        if point_mass:
            self.behind, self.length = np.zeros(len(vehicles)), 0.0
        self._traction = [Envelope(vehicle.traction) for vehicle in vehicles if vehicle.traction]
        self._brakes = [
            (Envelope(vehicle.brake), Envelope(vehicle.electric_brake or vehicle.brake))
            for vehicle in vehicles
            if vehicle.brake
        ]
        self._shoes = _shoe_force(consist, reduction) if air_brake else 0.0
        polynomials = np.array([vehicle.resistance.polynomial(vehicle.mass, consist.gravity) for vehicle in vehicles])
        self._polynomial: Array = polynomials.sum(axis=0)
        if not self._brakes and self._shoes <= 0:
            raise ValueError(
                f"train '{self.name}' has neither an electric brake nor an air brake in use; give a vehicle "
                "type a brake envelope, or shoes and a brake.policy that applies them"
            )
        ends = [
            max((float(e.rows[-1, 0]) for e in units), default=np.inf)
            for units in (self._traction, [whole for whole, _ in self._brakes])
        ]
        braked = ends[1] if self._shoes > 0 else (1.0 - OVERSPEED) * ends[1]
        self.highest_speed = min(ends[0], braked, MAX_TABLE_SPEED)
        self.speed_max = min(self.highest_speed if speed_max is None else speed_max, MAX_TABLE_SPEED)
        self.speed: Array = SPEED_STEP * np.arange(int(np.ceil(self.speed_max / SPEED_STEP)) + 3, dtype=np.float64)
        traction = np.zeros(self.speed.size) + sum(self._tabulated(self._traction))
        pairs = [tuple(self._tabulated(list(pair))) for pair in self._brakes]
        self.traction, self.electric, air = self._with_friction(traction, pairs, self.speed)
        self.brake = self.electric + air
        self.resistance = self.resistance_at(self.speed)

    def resistance_at(self, speed: Array) -> Array:
        """Return the running resistance [N] at speeds >= 0."""
        c0, c1, c2 = self._polynomial
        return np.asarray(c0 + speed * (c1 + speed * c2), dtype=np.float64)

    def forces_at(self, speed: Array) -> tuple[Array, Array, Array]:
        """Return maximum traction, electric and air brake force at speeds >= 0 [N], without interpolation.

        Speeds beyond the top speed by rounding have the forces of the top speed, where an envelope may end.
        """
        speed = np.where(speed <= self.speed_max * (1.0 + ROUNDING), np.minimum(speed, self.speed_max), speed)
        traction = np.zeros(speed.size) + sum(envelope.forces(speed) for envelope in self._traction)
        pairs = [tuple(envelope.forces(speed) for envelope in pair) for pair in self._brakes]
        return self._with_friction(traction, pairs, speed)

    def _tabulated(self, envelopes: list[Envelope]) -> list[Array]:
        return [envelope_table(envelope, self.speed, self.speed_max) for envelope in envelopes]

    def _with_friction(
        self, traction: Array, pairs: list[tuple[Array, ...]], speed: Array
    ) -> tuple[Array, Array, Array]:
        """Return the available forces [N] with the friction part of the units' brakes as air brake."""
        electric = np.zeros(speed.size) + sum(np.minimum(whole, part) for whole, part in pairs)
        friction = np.zeros(speed.size) + sum(np.maximum(whole - part, 0.0) for whole, part in pairs)
        left, air = self.available, np.asarray(shoe_force(self._shoes, speed)) + friction
        electric = np.minimum(electric * left.brake, left.brake_max)
        traction = np.minimum(traction * left.traction, left.traction_max)
        return traction, electric, np.minimum(air * left.brake, left.brake_max - electric)


def envelope_table(envelope: Envelope, speed: Array, speed_max: float) -> Array:
    """Return the table of an envelope [N]; linear interpolation never exceeds the envelope at a jump.

    An envelope that ends at the top speed of the train [m/s] continues beyond it. Otherwise the table would have no
    force in the last step below the top speed.
    """
    table = envelope.forces(speed)
    rows = envelope.rows
    if rows[-1, 0] >= speed_max:
        _, constant, slope, power = rows[-1]
        beyond = speed > rows[-1, 0]
        table[beyond] = np.maximum(constant + slope * speed[beyond] + power / speed[beyond], 0.0)
        rows = rows[:-1]
    borders = rows[:, 0]
    below, above = envelope.forces(borders), envelope.forces(borders * (1 + 1e-12) + 1e-12)
    for border, left, right in zip(borders, below, above, strict=True):
        k = int(border / SPEED_STEP)
        if abs(left - right) > 1e-6 * max(left, right) and k + 1 < table.size:
            table[k], table[k + 1] = min(table[k], left, right), min(table[k + 1], left, right)
    return table


def _shoe_force(consist: Consist, reduction: float | None) -> float:
    """Return the shoe force of the whole train at standstill [N]; reduction [Pa], None: the deepest.

    Paper 000, eqs. (10)-(15): beta_c phi n K with phi = friction (K + 200)/(4 K + 200), K in kN; the
    speed-dependent factor of phi is applied by :class:`TrainTables`.
    """
    if consist.air_brake is None:
        return 0.0
    brake = consist.air_brake
    factor = max(brake.braking_factor) if reduction is None else braking_factor(brake, brake.charged - reduction)
    total = 0.0
    for vehicle in consist.vehicles:
        if vehicle.shoes is not None:
            kn = vehicle.shoes.force / 1e3
            total += vehicle.shoes.count * vehicle.shoes.force * vehicle.shoes.friction * (kn + 200) / (4 * kn + 200)
    return factor * total


def balancing_speed(consist: Consist, grade: float) -> float:
    """Return the balancing speed on a grade at full traction [m/s]; 0 if the train cannot start.

    Parameters
    ----------
    grade
        > 0 uphill, 1 per mille = 0.001.
    """
    train = TrainTables(consist, MAX_TABLE_SPEED)
    left = train.traction - train.resistance - train.mass * train.gravity * grade
    above = np.flatnonzero(left[:-1] > 0)
    if not above.size:
        return 0.0
    k = int(above[-1])
    return float(train.speed[k] + (train.speed[k + 1] - train.speed[k]) * left[k] / (left[k] - left[k + 1]))


def steepest_start(consist: Consist) -> float:
    """Return the steepest starting grade at full traction [1]."""
    train = TrainTables(consist)
    return float((train.traction[0] - train.resistance[0]) / (train.mass * train.gravity))


def holding_force(consist: Consist, speed: float, grade: float) -> float:
    """Return the force that keeps a speed [m/s] on a grade [N]; < 0: braking."""
    train = TrainTables(consist)
    resistance = float(train.resistance_at(np.array([speed]))[0])
    return resistance + train.mass * train.gravity * grade
