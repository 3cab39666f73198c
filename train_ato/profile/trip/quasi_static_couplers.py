"""Quasi-static coupler forces of the reduced train: vehicles without motion against each other.

All vehicles in front of coupler j have the acceleration a of the train. Its force, > 0 draft, is therefore::

    f_j = S_j F - M_j a - L_j(x) - r_j R(v) - B_j(age) phi(v)

with the sums over these vehicles: S_j share of the force F of the drives, M_j mass with rotating parts, L_j line force,
r_j share of the running resistance R, B_j shoe force at standstill, and the friction law phi of the shoes. The search
needs it for a train with power units inside: there a part of the train pushes or pulls against another one although the
force of the drives is small, for example after a release with the rear part in a fall.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from train_ato.control.train_model import GRID, LineForceTable, TrainModel
from train_ato.messages.types import Array

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
