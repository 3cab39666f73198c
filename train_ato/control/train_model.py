"""Nominal model of train and line for laws, observers and compensations (block ``model:`` of the scenario).

The plant may differ from it: a mismatch changes the block ``plant:`` only.
"""

import copy
import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from plant_sim.air_brake import BrakeForecast
from plant_sim.compiled import compiled
from plant_sim.consist import Consist
from plant_sim.elementary import plain_sum
from plant_sim.line import Line
from plant_sim.railway import (
    DRY_FRICTION_SPEED,
    between_entries,
    each_between_entries,
    envelope_force,
    fading_resistance,
    running_resistance,
)
from plant_sim.record import Records, quantity, zeros
from plant_sim.track import Track
from plant_sim.traction import Envelope
from train_ato.control.learned_resistance import LearnedResistance
from train_ato.messages.types import Array

GRID = 1.0
"""Spacing of the table of line forces [m]."""
STANDSTILL_SPEED = 0.05
"""Speed below which a train counts as standing [m/s]; the default of ``plant.holding_speed``."""
RELEASE_FORCE = 1.0
"""Demand that releases the holding brake for a departure on a falling grade without traction [N]."""


@dataclass
class UnitVehicle:
    """Vehicle of one power unit in the nominal model."""

    mass: float = quantity("kg", "mass")
    c0: float = quantity("N", "running resistance c0 + c1 v + c2 v²")
    c1: float = quantity("N s/m", "running resistance per speed")
    c2: float = quantity("N s²/m²", "running resistance per squared speed")
    offset: float = quantity("m", "distance behind the centre of vehicle 0")
    line_begin: float = quantity("m", "position of the first entry of the tables of the line")


@compiled
def own_resistance(x: UnitVehicle, specific: Array, learned: Array, velocity: float, position: float) -> float:
    """Return running and line resistance of a unit's own vehicle [N]; ``learned`` is empty without a learned part."""
    line = between_entries(specific, (position - x.line_begin) / GRID)
    resistance: float = fading_resistance(x.c0, x.c1, x.c2, velocity) + x.mass * line
    if learned.size:
        resistance += x.mass * between_entries(learned, (position + x.offset - x.line_begin) / GRID)
    return resistance


@compiled
def own_resistances(
    vehicles: Records[UnitVehicle], specific: Array, learned: Array, velocity: Array, position: Array
) -> Array:
    """Return :func:`own_resistance` of every unit [N], shape (units,)."""
    found = np.empty(vehicles.size)
    for u in range(vehicles.size):
        found[u] = own_resistance(vehicles[u], specific, learned, velocity[u], position[u])
    return found


@compiled
def unit_limits(limits: Array, segments: NDArray[np.int64], velocity: float) -> tuple[float, float]:
    """Return the smallest and the largest force of a unit [N] at a speed [m/s], from its row of the envelopes."""
    speed = abs(velocity)
    brake = envelope_force(limits, segments[0], segments[1], speed)
    return -brake, envelope_force(limits, segments[2], segments[3], speed)


@compiled
def stands(velocity: Array) -> bool:
    """Return True if all units are slower than :data:`STANDSTILL_SPEED`."""
    fastest = 0.0
    for v in velocity:
        fastest = max(fastest, abs(v))
    return fastest < STANDSTILL_SPEED


@compiled
def limits_of_all(limits: Array, segments: NDArray[np.int64], velocity: Array) -> Array:
    """Return :func:`unit_limits` of all units [N], shape (2, units)."""
    found = np.empty((2, len(segments)))
    for u in range(len(segments)):
        found[0, u], found[1, u] = unit_limits(limits, segments[u], velocity[u])
    return found


@dataclass
class Actuator:
    """Delays of one power unit."""

    share: float = quantity("1", "part of a force of the train")
    forward: float = quantity("s", "delay of a command forwards")
    backward: float = quantity("s", "delay of a command backwards")


@compiled
def newest_arrived(sent: Array, unit: int, later: float, tick: float, forward: float, backward: float) -> float:
    """Return the newest command of a unit that has arrived ``later`` seconds from now [N]; the oldest if none has.

    Parameters
    ----------
    sent : Array, shape (d, units)
        Commands in flight, oldest first [N]; 0 N without one.
    unit
        Number of the unit.
    later, tick
        Time from now, and between two commands [s].
    forward, backward
        Delay of a command forwards and backwards [s].
    """
    count = len(sent)
    if count == 0:
        return 0.0
    back = max(math.ceil((min(forward, backward) - later) / tick - 1e-9), 1)
    while back < count:
        command = float(sent[count - back, unit])
        if (backward if command < 0.0 else forward) - back * tick <= later + 1e-9:
            return command
        back += 1
    return float(sent[0, unit])


class LineForceTable:
    """Grade, curve and tunnel force of a train over its line.

    Parameters
    ----------
    consist, line
        Nominal data.
    over_length
        Average grades over the length of the first vehicle.

    Attributes
    ----------
    begin : float
        Position of the first entry [m]; the others follow at :data:`GRID`.
    specific : Array, shape (places,)
        Force per mass at a place [N/kg].
    totals : array of float
        Force on the train with vehicle 0's centre at a place [N].
    total : Array, shape (places,)
        The same numbers, for vectors: a single entry is read from ``totals`` in a third of the time.
    """

    def __init__(self, consist: Consist, line: Line, *, over_length: bool = False) -> None:
        self.specific, self.begin = _specific_line_force(consist, line, over_length=over_length)
        total = np.zeros_like(self.specific)
        for vehicle, offset in zip(consist.vehicles, consist.offsets, strict=True):
            shift = round(offset / GRID)
            total[shift:] += vehicle.mass * self.specific[: total.size - shift]
            total[:shift] += vehicle.mass * self.specific[0]
        self.totals = array("d", total.tobytes())
        self.total: Array = np.frombuffer(self.totals)


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
    line_force
        Table of another model with this consist, line and ``over_length``; default: a new one.
    learned
        Resistance that former runs have shown in addition; default: none.

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
    running : tuple of float
        c0, c1, c2 of the running resistance of the train c0 + c1 v + c2 v² [N, N s/m, N s²/m²].
    share : Array, shape (units,)
        Part of a total force for every unit, in proportion to its largest traction force; the sum is 1.
    vehicles : Records of UnitVehicle, shape (units,)
        Vehicles of the power units.
    envelopes : tuple of Array
        Segments of all envelopes, shape (segments, 4), and rows of the units: first segment and end of the brake, then
        those of the traction.
    tables : tuple of Array
        Line force per mass [N/kg], line force on the whole train [N], and learned part of the force per mass [N/kg]
        (empty without one). They begin at the ``line_begin`` of the vehicles, with a value at every :data:`GRID`.
    totals : array of float
        The second of these tables, for single entries, see :class:`LineForceTable`.
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
        line_force: LineForceTable | None = None,
        learned: LearnedResistance | None = None,
    ) -> None:
        self.consist = consist
        self.line = line
        self.delay: Array = np.array(delay, dtype=np.float64)
        self.delay_brake: Array = np.array(delay_brake, dtype=np.float64)
        self.lag = lag
        self.tick = tick
        self.sensors = sensors
        self.reversing = reversing
        vehicles = consist.vehicles
        self.units = consist.power_units
        self.n_units = len(self.units)
        self.offsets: Array = np.array([consist.offsets[unit] for unit in self.units])
        self.mass = consist.mass
        self.inertia = plain_sum(vehicle.mass * vehicle.rotating_mass_factor for vehicle in vehicles)
        self.unit_mass: Array = np.array([vehicles[unit].mass for unit in self.units])
        self.unit_inertia: Array = self.unit_mass * [vehicles[unit].rotating_mass_factor for unit in self.units]
        self.traction = tuple(Envelope(vehicles[unit].traction) for unit in self.units)
        self.brake = tuple(Envelope(vehicles[unit].brake) for unit in self.units)
        self.envelopes = _envelope_arrays(self.brake, self.traction)
        self.share = self._shares()
        of_units = (self.offsets, self.unit_mass, self.unit_inertia, self.share, self.delay, self.delay_brake)
        for values in of_units:  # a law has this model itself; compiled functions take arrays that are not read-only
            values.flags.writeable = False
        self.air_brake = BrakeForecast(consist) if consist.air_brake is not None else None
        polynomials = np.array([vehicle.resistance.polynomial(vehicle.mass, consist.gravity) for vehicle in vehicles])
        self.running: tuple[float, ...] = tuple(polynomials.sum(axis=0).tolist())
        table = line_force or LineForceTable(consist, line, over_length=over_length)
        self._begin = table.begin
        self.tables, self.totals = (table.specific, table.total, np.zeros(0)), table.totals
        self.learned = learned
        if learned is not None:
            more = self.inertia * learned.at(
                np.asarray(table.begin + GRID * np.arange(table.total.size), dtype=np.float64)
            )
            self.totals = array("d", (table.total + more).tobytes())
            self.tables = (table.specific, np.frombuffer(self.totals), more / self.mass)
        self._table = table
        self.vehicles = zeros(UnitVehicle, self.n_units)
        for i, (unit, offset) in enumerate(zip(self.units, self.offsets.tolist(), strict=True)):
            self.vehicles[i] = (vehicles[unit].mass, *polynomials[unit].tolist(), offset, table.begin)

    def _shares(self) -> Array:
        for kind in (self.traction, self.brake):
            largest = np.array([envelope.largest() for envelope in kind])
            if largest.sum() > 0:
                shares: Array = largest / largest.sum()
                return shares
        return np.full(self.n_units, 1 / max(1, self.n_units))

    @cached_property
    def uneven(self) -> bool:
        """True if the force of a unit differs from its share of all forces by 1 % of the largest sum."""
        for kind in (self.traction, self.brake):
            speeds = np.arange(0.0, max((unit.rows[-1, 0] for unit in kind if len(unit.rows)), default=0.0), 0.5)
            forces = np.array([unit.forces(speeds) for unit in kind])
            whole = forces.sum(axis=0)
            if (np.abs(forces - self.share[:, None] * whole) > 0.01 * whole.max(initial=0.0)).any():
                return True
        return False

    @property
    def longest_delay(self) -> float:
        """Longest delay of a command to a power unit [s]."""
        return max(float(self.delay.max(initial=0.0)), float(self.delay_brake.max(initial=0.0)))

    def commands_in_flight(self) -> Array:
        """Return the commands not yet in effect, shape (d, units), one per tick, oldest first: 0 N before the first."""
        return np.zeros((math.ceil(self.longest_delay / self.tick - 1e-9), self.n_units))

    def running_resistance(self, velocity: float) -> float:
        """Return the running resistance of the train [N]: odd in the speed, 0 at standstill."""
        return float(fading_resistance(*self.running, velocity))

    def line_force(self, position: float) -> float:
        """Return grade, curve, tunnel and learned force on the train [N], > 0 resists, for vehicle 0's centre there."""
        return float(between_entries(self.totals, (position - self._begin) / GRID))

    def line_forces(self, position: Array) -> Array:
        """Return :meth:`line_force` at many positions [N], equal to it bit for bit."""
        return np.asarray(each_between_entries(self.tables[1], (position - self._begin) / GRID))

    def resisting_force(self, position: float, velocity: float, shoe_force: float = 0.0) -> float:
        """Return running, line and shoe force on the train [N], > 0 resists, for vehicle 0's centre at a position."""
        return self.running_resistance(velocity) + self.line_force(position) + shoe_force

    def resisting_forces(self, position: Array, velocity: Array) -> Array:
        """Return :meth:`resisting_force` without shoes at many positions and speeds [N], equal to it bit for bit."""
        fading = np.array(list(map(math.tanh, (velocity / DRY_FRICTION_SPEED).tolist())))  # np.tanh has other bits
        running = running_resistance(*self.running, velocity) * fading
        return np.asarray(running + self.line_forces(position))

    def specific_line_force(self) -> tuple[Array, float]:
        """Return the line force per mass at every :data:`GRID` [N/kg] and the position of the first one [m]."""
        return self.tables[0], self._begin

    def front(self, position: Array) -> float:
        """Return the position of vehicle 0's centre [m] for positions of the units, shape (units,)."""
        return float(position[0] + self.offsets[0])

    def own_resistance(self, velocity: Array, position: Array) -> Array:
        """Return running and line resistance of every unit's own vehicle [N], shape (units,)."""
        specific, _, learned = self.tables
        return np.asarray(own_resistances(self.vehicles, specific, learned, velocity, position))

    def learned_force(self, position: float) -> float:
        """Return the learned force on the train [N], > 0 resists, for vehicle 0's centre at a position."""
        learned = self.tables[2]
        return float(self.mass * between_entries(learned, (position - self._begin) / GRID)) if learned.size else 0.0

    @cached_property
    def without_learned(self) -> "TrainModel":
        """The same model without the learned resistance."""
        bare = copy.copy(self)
        bare.learned = None
        bare.tables, bare.totals = (self._table.specific, self._table.total, np.zeros(0)), self._table.totals
        return bare

    def force_limits(self, velocity: Array) -> tuple[Array, Array]:
        """Return the smallest and largest force of every unit at its speed [N], each of shape (units,)."""
        if len(velocity) != self.n_units:  # compiled code would read beyond the array
            raise ValueError(f"{len(velocity)} speeds for {self.n_units} power units; give one for each unit")
        low, high = limits_of_all(*self.envelopes, velocity)
        return low, high

    def limits_of_units(self, velocity: list[float]) -> tuple[list[float], list[float]]:
        """Return :meth:`force_limits` for and as lists."""
        low, high = self.force_limits(np.array(velocity))
        return low.tolist(), high.tolist()

    def rigid_force(self, position: float, velocity: float, acceleration: float, shoe_force: float = 0.0) -> float:
        """Return the total force that accelerates the rigid train at ``acceleration`` [N]; arguments in SI."""
        return self.inertia * acceleration + self.running_resistance(velocity) + self.line_force(position) + shoe_force


def _envelope_arrays(brakes: Sequence[Envelope], tractions: Sequence[Envelope]) -> tuple[Array, NDArray[np.int64]]:
    """Return the envelopes of all units as arrays, see :class:`TrainModel`."""
    segments, bounds, end = [np.zeros((0, 4))], [], 0
    for brake, traction in zip(brakes, tractions, strict=True):
        middle, last = end + len(brake.rows), end + len(brake.rows) + len(traction.rows)
        segments += [brake.rows, traction.rows]
        bounds.append((end, middle, middle, last))
        end = last
    return np.concatenate(segments), np.array(bounds, dtype=np.int64).reshape(-1, 4)


def _specific_line_force(consist: Consist, line: Line, *, over_length: bool) -> tuple[Array, float]:
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
