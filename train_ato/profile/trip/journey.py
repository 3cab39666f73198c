"""Journey of least cost: tables of the search, its prices, and the forward pass with the brake events.

Method after Howlett and Pudney, "Energy-Efficient Train Control" (1995), for the price of time; the brake states and
the recharge pause are an extension for long trains with an automatic air brake.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant_sim.record import records_of
from train_ato.messages.types import Array
from train_ato.profile.trip import search as s
from train_ato.profile.trip.reduced_train import AGE_STEP, SPEED_STEP, ReducedTrain
from train_ato.profile.trip.settings import TripSettings

ROLLING = 0.7
"""Lowest speed of a rolling train in the search [m/s]."""
LEVELS = np.array([1.0, 0.8, 0.6, 0.4, 0.2, 0.0, -0.2, -0.4, -0.6, -0.8, -1.0])
"""Fractions of traction (> 0) and electric brake (< 0) in the search."""
FINE_LEVELS = np.linspace(1.0, -1.0, 81)
"""The same in the forward pass."""
Tables = tuple[Array, Array, Array, Any, Array, Any]
"""Arguments of the compiled search: cells, drives, shoes, ranges, couplers, constants."""
QUASI_STATIC = 0.75
"""Part of the largest coupler force permitted in the first search; the rest is for the motion between the vehicles."""
SUPPLIES = 6
"""Number of supplies in the search of a train with exhaustible reservoirs."""
APPLICATION_PRICE = 5e6
"""Price of an application [J]: of two journeys of nearly equal energy, the one with fewer applications is chosen."""


@dataclass(frozen=True)
class Application:
    """Application of the air brake on a journey.

    Attributes
    ----------
    apply, release : float
        Places of vehicle 0's centre [m].
    reduction : float
        Reduction of the brake pipe [Pa].
    supply : float
        Mean filling of the reservoirs at the begin: the part of the full shoe force with which it brakes.
    """

    apply: float
    release: float
    reduction: float
    supply: float


@dataclass(frozen=True)
class Journey:
    """Journey of the reduced model, at the ends of the cells.

    Attributes
    ----------
    place, speed, time : Array, shape (cells + 1,)
        Vehicle 0's centre [m], m/s, s.
    force, shoes : Array, shape (cells,)
        Force of the drives and of the shoes in a cell [N].
    applications : tuple of Application
        In the order of the journey.
    """

    place: Array
    speed: Array
    time: Array
    force: Array
    shoes: Array
    applications: tuple[Application, ...]


class JourneySearch:
    """Search on one train and line, for several prices of time.

    Parameters
    ----------
    train
        Tables of train and line.
    settings
        Weights, final speed and rules of the air brake.
    quasi_static
        Part of the largest coupler force permitted in the search.
    """

    def __init__(self, train: ReducedTrain, settings: TripSettings, quasi_static: float = QUASI_STATIC) -> None:
        self._coupler_limit = quasi_static * settings.coupler_max
        self._train, self._settings = train, settings
        self._shoes, self._ranges = _brake_states(train, settings.air_brake.pause)
        self._supplies = _supplies(train, self._shoes, self._ranges)
        self._oldest = math.ceil(settings.air_brake.min_application / AGE_STEP)
        rows = s.TRACTION + 2.0 * train.section
        self._cells = np.vstack((train.line_force, train.limit[1:], rows, train.couplers.line_force))
        self._drives = np.vstack((train.running, *(row for pair in train.drives for row in pair)))

    def _constants(self, price: float) -> Any:
        """Return the records of the constants for a price of time [J/s]."""
        train, settings = self._train, self._settings
        constants = s.SearchConstants(
            inertia=train.inertia, cell_length=train.cell, speed_grid=SPEED_STEP, age_grid=AGE_STEP, price=price,
            recovered=settings.recovered, rolling=ROLLING, end_energy=0.5 * settings.final_speed**2,
            application=APPLICATION_PRICE, oldest=self._oldest, release_speed=settings.air_brake.min_release_speed,
            coupler_limit=self._coupler_limit,
        )  # fmt: skip
        if self._supplies.size > 1:
            constants.recharge, constants.wave_loss = train.recharge, train.wave_loss
            constants.min_supply, constants.supply_grid = self._supplies[0], self._supplies[1] - self._supplies[0]
        return records_of(s.SearchConstants, [constants])

    def journey(self, price: float) -> Journey:
        """Return the journey of least work plus price [J/s] times time.

        Raises
        ------
        ValueError
            With the place at which train and brakes permit no continuation.
        """
        ranges, constants = records_of(s.BrakeRange, self._ranges), self._constants(price)
        tables = (self._cells, self._drives, self._shoes, ranges, self._train.couplers.constant, constants)
        value = s.solve_values(self._supplies, LEVELS, *tables)
        return self._forward(value, tables)

    def _forward(self, value: Array, tables: Tables) -> Journey:
        train = self._train
        braked = list(zip(self._ranges, train.responses, strict=True))
        speed, state, supply, time = 0.0, 0.0, 1.0, 0.0
        rows: list[tuple[float, float, float, float]] = []
        changes: list[tuple[float, float, float]] = []
        for k in range(train.cells):
            state, cost, force, after = self._decide(speed, k, state, supply, value[k + 1], tables)
            if cost >= s.IMPOSSIBLE:
                raise ValueError(
                    f"no journey beyond km {train.place(k) / 1e3:.2f}: traction or brakes are too weak there; permit "
                    "more of them, or a lower minimum release speed"
                )
            applied = (entry.reduction for row, entry in braked if row.applied_first <= state <= row.applied_last)
            reduction = next(applied, 0.0)
            if reduction != (changes[-1][1] if changes else 0.0):
                changes.append((train.place(k), reduction, supply))
            shoe = supply * float(np.interp(state, np.arange(self._shoes.shape[1]), self._shoes[s.SHOE_FORCE]))
            rows.append((speed, time, force, shoe))
            duration = 2.0 * train.cell / (speed + after)
            supply = s.later_supply(state, supply, duration, self._shoes, tables[3], tables[-1])
            state = s.older_state(state, duration, tables[3], AGE_STEP)
            speed, time = after, time + duration
        table = np.array(rows)
        place: Array = train.begin + train.cell * np.arange(train.cells + 1, dtype=np.float64)
        return Journey(
            place, np.append(table[:, 0], speed), np.append(table[:, 1], time), table[:, 2], table[:, 3],
            _applications(changes),
        )  # fmt: skip

    def _decide(
        self, speed: float, k: int, state: float, supply: float, value: Array, tables: Tables
    ) -> tuple[float, float, float, float]:
        """Return brake state, cost [J], force [N] and next speed [m/s] of the best continuation."""
        choices = [(state, 0.0)]
        for row in self._ranges:
            if state == 0.0:
                choices.append((float(row.applied_first), APPLICATION_PRICE))
            old = min(row.applied_first + self._oldest, row.applied_last)
            if old <= state <= row.applied_last and speed >= self._settings.air_brake.min_release_speed:
                choices.append((float(row.released_first), 0.0))
        found = []
        for choice, price in choices:
            cost, force, after = s.best_force(speed, k, choice, supply, value, FINE_LEVELS, *tables)
            found.append((choice, cost + price, force, after))
        return min(found, key=lambda row: row[1])


def _brake_states(train: ReducedTrain, pause: float) -> tuple[Array, list[s.BrakeRange]]:
    """Return the rows of the brake states for the search and the ranges of the states.

    The rows are the shoe force at standstill with full reservoirs, that of the complete application, the part of the
    supply that this application uses, and the forces in front of the couplers [N].
    """
    none = np.zeros((1, len(train.couplers.numbers)))
    force, ahead, largest, used, ranges = [0.0], [none], [1.0], [0.0], []
    for response in train.responses:
        count = max(response.release.size, int(np.ceil(pause / AGE_STEP)) + 1)
        longer = count - response.release.size
        first = len(force)
        middle = first + response.apply.size
        ranges.append(s.BrakeRange(first, middle - 1, middle, middle + count - 1))
        force += [*response.apply.tolist(), *response.release.tolist(), *[0.0] * longer]
        ahead += [response.apply_ahead, response.release_ahead, np.repeat(none, longer, axis=0)]
        largest += [float(response.apply[-1])] * (response.apply.size + count)
        used += [response.used] * (response.apply.size + count)
    rows = np.vstack(([*force, 0.0], [*largest, 1.0], [*used, 0.0], np.vstack([*ahead, none]).T))
    return rows, ranges


def _supplies(train: ReducedTrain, shoes: Array, ranges: list[s.BrakeRange]) -> Array:
    """Return the supplies of the search, from that of endless applications with the shortest pause to 1."""
    if train.recharge == 0.0 or not ranges:
        return np.ones(1)
    lowest = 1.0
    for row in ranges:
        pause = AGE_STEP * (row.released_last - row.released_first)
        missing = min(train.wave_loss * math.exp(-pause / train.recharge), 1.0)
        left = 1.0 - float(shoes[s.USED, row.applied_first])
        lowest = min(lowest, (1.0 - missing) / (1.0 - left * missing))
    return np.linspace(lowest, 1.0, SUPPLIES)


def _applications(changes: list[tuple[float, float, float]]) -> tuple[Application, ...]:
    """Return the applications of changes of the reduction: place [m], reduction [Pa], supply."""
    pairs = zip(changes[::2], changes[1::2], strict=True)
    return tuple(Application(begin, end, reduction, supply) for (begin, reduction, supply), (end, _, _) in pairs)
