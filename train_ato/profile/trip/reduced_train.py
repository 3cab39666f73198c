"""Reduced model of a train for the search: one speed, masses along the length, shoe force over time.

Every vehicle has the line force at its own place. The shoe force of an application or release is the sum over the
vehicles of the plant's own closed form (:class:`plant_sim.air_brake.BrakeForecast`): a wave along the train, then
filling or emptying of every cylinder. Longitudinal motion between the vehicles is omitted; :mod:`.driven_run` adds it.

Quasi-static coupler forces of the reduced train: vehicles without motion against each other.

All vehicles in front of coupler j have the acceleration a of the train. Its force, > 0 draft, is therefore::

    f_j = S_j F - M_j a - L_j(x) - r_j R(v) - B_j(age) phi(v)

The sums over these vehicles are S_j (share of the force F of the drives), M_j (mass with rotating parts), L_j (line
force), r_j (share of the running resistance R) and B_j (shoe force at standstill). phi is the friction law of the
shoes. The search needs this for a train with power units inside. There a part of the train can push or pull against
another part although the force of the drives is small, for example after a release with the rear part in a fall.

Traction and electric brake of a trip in neutral sections, power limits, and sections with another adhesion.

The limits are those of the planner for shorter trains (:class:`train_ato.profile.planner.line_tables.PlaceLimits`). The
units share a force in proportion, so that the most limited unit limits the train. The profile is an average of the run
over time. Therefore the limits of a section apply from :data:`MARGIN` before it to the same distance after it, and the
force changes to them with the rate of the settings. Only the plant of :mod:`.driven_run` limits the shoes at low
adhesion.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plant_sim.air_brake import BrakeForecast, braking_factor
from plant_sim.consist import Consist
from plant_sim.elementary import plain_sum
from plant_sim.packing import pipe_distances
from train_ato.control.train_model import GRID, LineForceTable, TrainModel
from train_ato.messages.types import Array
from train_ato.profile.planner.line_tables import PlaceLimits, SpeedLimits
from train_ato.profile.planner.train_tables import SPEED_STEP as TABLE_STEP
from train_ato.profile.planner.train_tables import TrainTables
from train_ato.profile.trip.settings import TripSettings

Integers = NDArray[np.int64]
MARGIN = 7.5
"""Time before and after a section with its limits [s]: half of the window of the average of the speed."""


class SectionForces:
    """Largest traction and electric brake of a train by the place of vehicle 0's centre.

    Parameters
    ----------
    model
        Nominal train on its line.
    top_speed
        Largest speed of the tables [m/s].

    Attributes
    ----------
    breaks : Array, shape (m,)
        Rising places at which the forces change [m]; empty for a line without such sections.
    """

    def __init__(self, model: TrainModel, top_speed: float) -> None:
        line, consist = model.line, model.consist
        self.breaks: Array = np.zeros(0)
        if not (line.neutral_sections or line.power_limits or line.adhesion):
            return
        vehicles = sorted({*model.units, *(consist.supplies[unit] for unit in model.units)})
        offsets = np.array(consist.offsets)[vehicles]
        limits = PlaceLimits(line, model.consist, TrainTables(model.consist, top_speed))
        self.breaks = np.unique(limits.breaks[:, None] + offsets)
        inside = np.concatenate(([self.breaks[0] - 1.0], self.breaks))
        zones = np.zeros((inside.size, len(model.consist.vehicles)), dtype=np.int64)
        zones[:, vehicles] = limits.zones_at(inside[:, None] - offsets)
        rows, which = np.unique(zones, axis=0, return_inverse=True)
        tables = np.stack([np.stack(limits.available(tuple(row), equal_parts=True)[:2]) for row in rows.tolist()])
        self._tables = tables[which.ravel()]

    def over_cells(self, edges: Array, limit: Array, speed: Array) -> tuple[Array, Integers]:
        """Return the tables of the cells and the table of every cell, with the margin at the limit of the speed.

        Parameters
        ----------
        edges : Array, shape (cells + 1,)
            Limits of the cells [m].
        limit : Array, shape (cells + 1,)
            Highest speed there [m/s].
        speed : Array, shape (speeds,)
            Speeds of the tables [m/s].

        Returns
        -------
        tables : Array, shape (tables, 2, speeds)
            Traction and electric brake [N].
        which : Array, shape (cells,)
            Number of the table.
        """
        way = MARGIN * limit
        firsts = np.searchsorted(self.breaks, edges[:-1] - way[:-1], side="right")
        lasts = np.searchsorted(self.breaks, edges[1:] + way[1:], side="right")
        found = np.stack([self._tables[a : b + 1].min(axis=0) for a, b in zip(firsts, lasts, strict=True)])
        index = np.minimum(np.rint(speed / TABLE_STEP).astype(np.int64), found.shape[2] - 1)
        tables, which = np.unique(found[:, :, index], axis=0, return_inverse=True)
        return tables, which.ravel()

    def at(self, position: float, velocity: float, slew: float) -> tuple[float, float]:
        """Return the largest traction and electric brake at a place and speed, with the change before a section [N].

        Parameters
        ----------
        position, velocity
            Of vehicle 0 [m, m/s].
        slew
            Largest rate of the force [N/s].
        """
        way, speed = MARGIN * velocity, max(velocity, 0.1)
        first, last = np.searchsorted(self.breaks, (position - way, position + way), side="right")
        column = self._tables[first:, :, min(round(velocity / TABLE_STEP), self._tables.shape[2] - 1)]
        present, ahead = column[: last - first + 1].min(axis=0), column[last - first + 1 :]
        if len(ahead):
            time = (self.breaks[last:] - position - way) / speed
            present = np.minimum(present, (ahead + slew * time[:, None]).min(axis=0))
        return float(present[0]), float(present[1])


NUMBER = 12
"""Number of couplers along the train beside those of the power units; every 18th one of 212 vehicles."""
TYPICAL_SPEED = 60 / 3.6
"""Speed of the shares of the running resistance [m/s]."""


@dataclass(frozen=True)
class CouplerTables:
    """Sums over the vehicles in front of selected couplers.

    Attributes
    ----------
    numbers : tuple of int
        Couplers, by the vehicle in front of them.
    constant : Array, shape (3, couplers)
        Mass with rotating parts [kg], share of the force of the drives, share of the running resistance.
    line_force : Array, shape (couplers, cells)
        Grade, curve and tunnel force [N], > 0 resists.
    """

    numbers: tuple[int, ...]
    constant: Array
    line_force: Array


def coupler_tables(model: TrainModel, places: Array) -> CouplerTables:
    """Return the tables of a train with several power units; without couplers for another train.

    Parameters
    ----------
    model
        Nominal train on its line.
    places
        Middle of every cell, as places of vehicle 0's centre [m], shape (cells,).
    """
    consist = model.consist
    vehicles = consist.vehicles
    if model.n_units < 2:
        return CouplerTables((), np.zeros((3, 0)), np.zeros((0, places.size)))
    numbers = selected_couplers(len(vehicles), model.units)
    chosen = list(numbers)
    inertia = np.array([vehicle.mass * vehicle.rotating_mass_factor for vehicle in vehicles])
    share = np.zeros(len(vehicles))
    share[list(model.units)] = model.share
    polynomials = np.array([vehicle.resistance.polynomial(vehicle.mass, consist.gravity) for vehicle in vehicles])
    running = polynomials @ np.array([1.0, TYPICAL_SPEED, TYPICAL_SPEED**2])
    constant = np.stack([column.cumsum()[chosen] for column in (inertia, share, running / running.sum())])
    table = LineForceTable(consist, model.line)
    grid = table.begin + GRID * np.arange(len(table.specific))
    masses = np.array([vehicle.mass for vehicle in vehicles])
    offsets = np.array(consist.offsets)
    specific = np.interp(places[:, None] - offsets, grid, table.specific)
    return CouplerTables(numbers, constant, np.ascontiguousarray((specific * masses).cumsum(axis=1)[:, chosen].T))


def selected_couplers(vehicles: int, units: tuple[int, ...]) -> tuple[int, ...]:
    """Return couplers along the train and those in front of and behind every power unit, by the vehicle in front."""
    along = np.linspace(0, vehicles - 2, NUMBER).round().astype(int).tolist()
    beside = [number for unit in units for number in (unit - 1, unit) if 0 <= number <= vehicles - 2]
    return tuple(sorted({*along, *beside}))


CELL = 100.0
"""Length of a cell of the search [m]."""
SPEED_STEP = 0.5 / 3.6
"""Spacing of the speed grid [m/s]."""
AGE_STEP = 4.0
"""Spacing of the ages of an application or a release [s]."""
SETTLED = 0.01
"""Part of the shoe force below which a release, or above whose complement an application, counts as complete."""
UNLIMITED = 120 / 3.6
"""Speed limit of a line without limits, if the traction envelope has no end [m/s]."""


@dataclass(frozen=True)
class ShoeResponse:
    """Shoe force of the train at standstill over the age of an application and of its release [N].

    Attributes
    ----------
    reduction : float
        Reduction of the brake pipe [Pa].
    apply, release : Array, shape (ages,)
        Force at the ages of a grid of :data:`AGE_STEP`; the last entry holds for longer ages.
    apply_ahead, release_ahead : Array, shape (ages, couplers)
        Part of it by the vehicles in front of selected couplers.
    used : float
        Part of the filling of the reservoirs that the application uses.
    """

    reduction: float
    apply: Array
    release: Array
    apply_ahead: Array
    release_ahead: Array
    used: float


@dataclass(frozen=True)
class ReducedTrain:
    """Tables of train and line over the cells and the speed grid.

    Attributes
    ----------
    begin : float
        Place of vehicle 0's centre at the begin [m].
    cell : float
        Length of a cell [m].
    line_force : Array, shape (cells,)
        Mean grade, curve and tunnel force in a cell [N], > 0 resists.
    limit : Array, shape (cells + 1,)
        Highest planned speed at the ends of the cells [m/s].
    speed : Array, shape (speeds,)
        Speed grid [m/s].
    running : Array, shape (speeds,)
        Running resistance [N].
    drives : Array, shape (tables, 2, speeds)
        Largest planned traction and electric brake [N]; one table, and others in the sections of the line.
    section : Array, shape (cells,)
        Number of the table of a cell.
    inertia : float
        Mass with rotating parts [kg].
    responses : tuple of ShoeResponse
        One for each permitted reduction; empty without an air brake.
    couplers : CouplerTables
        Sums over the vehicles in front of selected couplers.
    recharge : float
        Time constant of the recharge of the reservoirs [s]; 0 for reservoirs that applications do not use up.
    wave_loss : float
        Mean factor of the vehicles on the missing filling. Every vehicle recharges from the wave of a release to the
        wave of the next application. The first of these waves is slower.
    """

    begin: float
    cell: float
    line_force: Array
    limit: Array
    speed: Array
    running: Array
    drives: Array
    section: Integers
    inertia: float
    responses: tuple[ShoeResponse, ...]
    couplers: CouplerTables
    recharge: float
    wave_loss: float

    @property
    def cells(self) -> int:
        """Number of cells."""
        return self.line_force.size

    def place(self, number: int) -> float:
        """Return the place of vehicle 0's centre at the begin of a cell [m]."""
        return self.begin + number * self.cell


def shoe_response(consist: Consist, reduction: float, couplers: tuple[int, ...] = ()) -> ShoeResponse:
    """Return the shoe force of the train after an application of a reduction [Pa] and after its release.

    Parameters
    ----------
    consist
        Train with an air brake.
    reduction
        Reduction of the brake pipe [Pa].
    couplers
        Couplers with the shoe force in front of them, by the vehicle in front.
    """
    brake = consist.air_brake
    assert brake is not None
    forecast = BrakeForecast(consist)
    forecast.demand(0.0, brake.charged - reduction)
    applied, applied_ahead = _until_settled(forecast, 0.0, couplers)
    begin = AGE_STEP * applied.size
    forecast.commit(begin)
    forecast.demand(begin, brake.charged)
    released, released_ahead = _until_settled(forecast, begin, couplers)
    used = brake.reservoir_use * braking_factor(brake, brake.charged - reduction) / brake.braking_factor[-1]
    return ShoeResponse(reduction, applied, released, applied_ahead, released_ahead, used)


def _recharge(consist: Consist) -> tuple[float, float]:
    """Return the time constant of the recharge of the reservoirs [s], and the factor on the missing filling."""
    brake = consist.air_brake
    if brake is None or brake.reservoir_use == 0.0:
        return 0.0, 1.0
    later = pipe_distances(consist) * (1.0 / brake.release_wave - 1.0 / brake.apply_wave)
    forces = np.array(consist.friction_forces)
    factors = np.array([math.exp(time / brake.recharge_time) for time in later.tolist()])
    return brake.recharge_time, float(np.average(factors, weights=forces))


def _until_settled(forecast: BrakeForecast, begin: float, couplers: tuple[int, ...]) -> tuple[Array, Array]:
    """Return total force and force ahead of couplers at ages 0, AGE_STEP, ... until constant by :data:`SETTLED` [N]."""
    ages: Array = AGE_STEP * np.arange(400, dtype=np.float64)
    forces = forecast.forces_at(begin + ages, 0.0)
    force, ahead = forces.sum(axis=1), forces.cumsum(axis=1)[:, list(couplers)]
    span = abs(force[-1] - force[0])
    settled = np.flatnonzero(np.abs(force - force[-1]) <= SETTLED * span)
    count = int(settled[0]) + 1
    return np.asarray(force[:count]), np.asarray(ahead[:count])


def reduced_train(
    model: TrainModel, settings: TripSettings, begin: float, end: float, reductions: tuple[float, ...]
) -> ReducedTrain:
    """Return the tables for a journey of vehicle 0's centre from a place to another one [m].

    Parameters
    ----------
    model
        Nominal train and line.
    settings
        Limits of the plan.
    begin, end
        Begin, and place at which the last part of the braking starts.
    reductions
        Permitted reductions of the brake pipe [Pa].
    """
    consist = model.consist
    cells = max(2, math.ceil((end - begin) / CELL))
    cell = (end - begin) / cells
    inside = cell * (np.arange(8) + 0.5) / 8
    places = (begin + cell * np.arange(cells))[:, None] + inside
    line_force = model.line_forces(places.ravel()).reshape(places.shape).mean(axis=1)
    driven = [float(envelope.rows[-1, 0]) for envelope in model.traction if len(envelope.rows)]  # last speeds
    limits = SpeedLimits(model.line, min([UNLIMITED, *driven]))
    edges: Array = begin + cell * np.arange(cells + 1, dtype=np.float64)
    at_ends = limits.at(edges + consist.vehicles[0].length / 2, consist.length) - settings.speed_margin
    limit = np.minimum(np.minimum(at_ends, np.append(at_ends[1:], np.inf)), np.append(np.inf, at_ends[:-1]))
    speed: Array = SPEED_STEP * np.arange(int(limit.max() / SPEED_STEP) + 4, dtype=np.float64)
    forces_at = [model.limits_of_units([v] * model.n_units) for v in speed.tolist()]
    low, high = np.array([[plain_sum(side) for side in sides] for sides in forces_at]).T
    traction = settings.traction * high
    if settings.traction_max is not None:
        traction = np.minimum(traction, settings.traction_max)
    drives = np.stack((traction, -settings.brake * low))[None]
    section: Integers = np.zeros(cells, dtype=np.int64)
    forces = SectionForces(model, float(speed[-1]))
    if forces.breaks.size:
        tables, section = forces.over_cells(edges, limit, speed)
        drives = np.minimum(drives, tables)
    running = np.array([model.running_resistance(max(v, 0.5)) for v in speed.tolist()])
    couplers = coupler_tables(model, places[:, 0] + cell * 7 / 16)
    responses = tuple(shoe_response(consist, reduction, couplers.numbers) for reduction in reductions)
    return ReducedTrain(
        begin, cell, line_force, limit, speed, running, drives, section, model.inertia, responses, couplers,
        *_recharge(consist),
    )  # fmt: skip
