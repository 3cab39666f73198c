"""What the planner knows of a train: forces over the speed, masses along its length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant_sim.air_brake import braking_factor
from plant_sim.consist import Consist
from plant_sim.traction import Envelope
from train_ato.types import Array

__all__ = ["HIGHEST", "AvailableForce", "TrainTables"]

STEP = 0.02
"""Spacing of the tables over the speed [m/s]."""
HIGHEST = 200.0
"""No table reaches beyond this speed [m/s]."""
OVERSPEED = 0.02
"""Part of the speed that a plan stays below the end of the brakes: a train that runs a little faster must brake."""


@dataclass(frozen=True, slots=True)
class AvailableForce:
    """What is left of the forces of a train: after a fault, on bad rails, or under a limit.

    Attributes
    ----------
    traction, brake : float
        Part of the envelopes that is there.
    traction_max, brake_max : float
        Largest force of the whole train [N].
    """

    traction: float = 1.0
    brake: float = 1.0
    traction_max: float = np.inf
    brake_max: float = np.inf

    def __post_init__(self) -> None:
        for name in ("traction", "brake", "traction_max", "brake_max"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"available force: {name} = {getattr(self, name)} must not be negative")


class TrainTables:
    """Forces of a whole train over its speed, and its masses along it.

    Parameters
    ----------
    consist
        The train.
    speed_max
        Of the train [m/s]; None: where its envelopes end, and a little below where its brakes do.
    air_brake
        Count on the shoes.
    point_mass
        Put everything at the front: limits, grades and curves see a train without length.
    available
        What is left of its forces.
    reduction
        Of the brake pipe, at which the shoes brake [Pa]; None: the largest of the braking factor's table.

    Attributes
    ----------
    speed : Array, shape (n,)
        Grid of the tables [m/s].
    traction, brake, resistance : Array, shape (n,)
        Largest traction, largest brake force (air included) and running resistance [N].
    electric : Array, shape (n,)
        Part of ``brake`` that is electric [N].
    mass, inertia : float
        Mass and the same with rotating masses [kg].
    behind : Array, shape (vehicles,)
        Distance of every vehicle's centre behind the front [m].
    half : float
        From vehicle 0's centre to the front [m].
    length : float
        Over which limits hold [m].

    Raises
    ------
    ValueError
        If the train has no traction or nothing that brakes it.
    """

    def __init__(
        self,
        consist: Consist,
        speed_max: float | None = None,
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
        self.inertia = float(sum(vehicle.mass * vehicle.rotating_mass_factor for vehicle in vehicles))
        self.half = vehicles[0].length / 2
        self.behind: Array = np.array(consist.offsets) + self.half
        self.length = consist.length
        if point_mass:
            self.behind, self.length = np.zeros(len(vehicles)), 0.0
        self._traction = [Envelope(vehicle.traction) for vehicle in vehicles if vehicle.traction]
        self._electric = [Envelope(vehicle.brake) for vehicle in vehicles if vehicle.brake]
        self._shoes = _shoe_force(consist, reduction) if air_brake else 0.0
        polynomials = np.array([vehicle.resistance.polynomial(vehicle.mass, consist.gravity) for vehicle in vehicles])
        self._polynomial: Array = polynomials.sum(axis=0)
        self._refuse_helpless()
        self.speed_max = min(self._fastest() if speed_max is None else speed_max, HIGHEST)
        self.speed: Array = STEP * np.arange(int(np.ceil(self.speed_max / STEP)) + 3, dtype=np.float64)
        self.traction, self.electric, air = self._forces_on_grid()
        self.brake = self.electric + air
        self.resistance = self.resistance_at(self.speed)

    def _fastest(self) -> float:
        """Return where traction ends, or a little below the end of the brakes if that is slower [m/s]."""
        ends = [
            max((float(e.rows[-1, 0]) for e in units), default=np.inf) for units in (self._traction, self._electric)
        ]
        return min(ends[0], ends[1] if self._shoes > 0 else (1.0 - OVERSPEED) * ends[1], HIGHEST)

    def _refuse_helpless(self) -> None:
        if not self._electric and self._shoes <= 0:
            raise ValueError(
                f"train '{self.name}' has neither an electric brake nor an air brake that may be used: nothing stops "
                "it; give a vehicle type a brake envelope, or shoes and a brake.policy that applies them"
            )

    def resistance_at(self, speed: Array) -> Array:
        """Return the running resistance [N] at speeds >= 0."""
        c0, c1, c2 = self._polynomial
        return np.asarray(c0 + speed * (c1 + speed * c2), dtype=np.float64)

    def forces_at(self, speed: Array) -> tuple[Array, Array, Array]:
        """Return largest traction, electric and air brake force at speeds >= 0, from the envelopes themselves [N]."""
        traction = np.zeros(speed.size) + sum(envelope_at(envelope, speed) for envelope in self._traction)
        electric = np.zeros(speed.size) + sum(envelope_at(envelope, speed) for envelope in self._electric)
        return self._limited(traction, electric, self._air(speed))

    def _air(self, speed: Array) -> Array:
        kmh = 3.6 * speed
        return np.asarray(self._shoes * (2 * kmh + 150) / (3 * kmh + 150))

    def _limited(self, traction: Array, electric: Array, air: Array) -> tuple[Array, Array, Array]:
        left = self.available
        traction = np.minimum(traction * left.traction, left.traction_max)
        electric, air = electric * left.brake, air * left.brake
        electric = np.minimum(electric, left.brake_max)
        return traction, electric, np.minimum(air, left.brake_max - electric)

    def _forces_on_grid(self) -> tuple[Array, Array, Array]:
        traction = np.zeros(self.speed.size) + sum(_on_grid(envelope, self.speed) for envelope in self._traction)
        electric = np.zeros(self.speed.size) + sum(_on_grid(envelope, self.speed) for envelope in self._electric)
        return self._limited(traction, electric, self._air(self.speed))


def envelope_at(envelope: Envelope, speed: Array) -> Array:
    """Return the force of an envelope at many speeds [N]; as :meth:`Envelope.force` at each."""
    rows = envelope.rows
    index = np.searchsorted(rows[:, 0], speed, side="left")
    inside = index < len(rows)
    _, constant, slope, power = rows[np.minimum(index, len(rows) - 1)].T
    force = constant + slope * speed + power / np.maximum(speed, 0.1)
    return np.asarray(np.where(inside, np.maximum(force, 0.0), 0.0))


def _on_grid(envelope: Envelope, speed: Array) -> Array:
    """Tabulate an envelope so that linear interpolation never exceeds it where it jumps."""
    table = envelope_at(envelope, speed)
    borders = envelope.rows[:, 0]
    below, above = envelope_at(envelope, borders), envelope_at(envelope, borders * (1 + 1e-12) + 1e-12)
    for border, left, right in zip(borders, below, above, strict=True):
        k = int(border / STEP)
        if abs(left - right) > 1e-6 * max(left, right) and k + 1 < table.size:
            table[k], table[k + 1] = min(table[k], left, right), min(table[k + 1], left, right)
    return table


def _shoe_force(consist: Consist, reduction: float | None) -> float:
    """Return the shoes' force of the whole train at standstill, a reduction of the brake pipe [Pa] or the deepest [N].

    Paper 000, eqs. (10)-(15): beta_c phi n K with phi = friction (K + 200)/(4 K + 200), K in kN; the part of phi that
    falls with the speed is put on by :meth:`TrainTables._air`.
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
