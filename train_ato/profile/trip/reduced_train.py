"""Reduced model of a train for the search: one speed, masses along the length, shoe force over time.

The line force is that of every vehicle at its own place. The shoe force of an application or release is the sum over
the vehicles of the plant's own closed form (:class:`plant_sim.air_brake.BrakeForecast`): wave along the train, then
filling or emptying of every cylinder. Longitudinal motion between the vehicles is omitted; :mod:`.driven_run` adds it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from plant_sim.air_brake import BrakeForecast, braking_factor
from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.packing import pipe_distances
from plant_sim.summation import plain_sum
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.profile.planner.line_tables import SpeedLimits
from train_ato.profile.trip.quasi_static_couplers import CouplerTables, coupler_tables
from train_ato.profile.trip.settings import TripSettings

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


def nominal_train_model(consist: Consist, line: Line, tick: float = 0.1) -> TrainModel:
    """Return the nominal model of a train with ideal actuators."""
    none = np.zeros(len(consist.power_units))
    return TrainModel(consist, line, none, none, 0.0, tick)


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
class Reservoirs:
    """Recharge of the reservoirs of a train.

    Attributes
    ----------
    recharge : float
        Time constant [s]; 0 for reservoirs that applications do not use up.
    wave_loss : float
        Mean factor of the vehicles on the missing filling: every vehicle recharges from the wave of a release to that
        of the next application, and the first one is slower.
    """

    recharge: float = 0.0
    wave_loss: float = 1.0


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
    traction, brake, running : Array, shape (speeds,)
        Largest planned traction and electric brake, running resistance [N].
    inertia : float
        Mass with rotating parts [kg].
    responses : tuple of ShoeResponse
        One for each permitted reduction; empty without an air brake.
    couplers : CouplerTables
        Sums over the vehicles in front of selected couplers.
    reservoirs : Reservoirs
        Recharge of the reservoirs.
    """

    begin: float
    cell: float
    line_force: Array
    limit: Array
    speed: Array
    traction: Array
    brake: Array
    running: Array
    inertia: float
    responses: tuple[ShoeResponse, ...]
    couplers: CouplerTables
    reservoirs: Reservoirs

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


def reservoirs_of(consist: Consist) -> Reservoirs:
    """Return the recharge of the reservoirs of a train."""
    brake = consist.air_brake
    if brake is None or brake.reservoir_use == 0.0:
        return Reservoirs()
    later = pipe_distances(consist) * (1.0 / brake.release_wave - 1.0 / brake.apply_wave)
    forces = np.array(consist.friction_forces)
    factors = np.array([math.exp(time / brake.recharge_time) for time in later.tolist()])
    return Reservoirs(brake.recharge_time, float(np.average(factors, weights=forces)))


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
    line_force = np.array([[model.line_force(place) for place in row] for row in places.tolist()]).mean(axis=1)
    limits = SpeedLimits(model.line, _top_speed(model))
    front: Array = begin + cell * np.arange(cells + 1, dtype=np.float64) + consist.vehicles[0].length / 2
    at_ends = limits.at(front, consist.length) - settings.speed_margin
    limit = np.minimum(at_ends, np.concatenate((at_ends[1:], at_ends[-1:])))
    speed: Array = SPEED_STEP * np.arange(int(limit.max() / SPEED_STEP) + 4, dtype=np.float64)
    high = np.array([plain_sum(model.limits_of_units([v] * model.n_units)[1]) for v in speed.tolist()])
    low = np.array([plain_sum(model.limits_of_units([v] * model.n_units)[0]) for v in speed.tolist()])
    traction = settings.traction * high
    if settings.traction_max is not None:
        traction = np.minimum(traction, settings.traction_max)
    running = np.array([model.running_resistance(max(v, 0.5)) for v in speed.tolist()])
    couplers = coupler_tables(model, places[:, 0] + cell * 7 / 16)
    responses = tuple(shoe_response(consist, reduction, couplers.numbers) for reduction in reductions)
    return ReducedTrain(
        begin, cell, line_force, limit, speed, traction, -settings.brake * low, running, model.inertia, responses,
        couplers, reservoirs_of(consist),
    )  # fmt: skip


def _top_speed(model: TrainModel) -> float:
    """Return the last speed with traction of a unit [m/s], at most :data:`UNLIMITED`."""
    ends = [float(rows.rows[-1, 0]) for rows in model.traction if len(rows.rows)]
    return min([UNLIMITED, *ends])
