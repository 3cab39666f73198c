"""Places of the switches from traction to coasting, moved until net energy + price x time is least.

The dynamic programming finds the order of traction and coasting, and each switch within about a cell of its grid. A
switch before a descent that is late by some metres costs all of the additional energy there, because the run then
reaches the limit and brakes. A search moves one switch after the other and uses the run itself. This removes the error.
Every cost is that of a feasible run, so that no step increases it.
"""

from dataclasses import replace

import numpy as np

from train_ato.messages.types import Array
from train_ato.profile.planner.driving_strategy import DrivingStrategy
from train_ato.profile.planner.section import PlanSection, section_energy, section_force

STEPS = (32.0, 16.0, 8.0, 4.0, 2.0, 1.0)
"""Distances by which a switch is moved, one after the other [m]."""
MIN_COASTING = 30.0
"""Least length of coasting behind a switch [m]."""
COASTING_FORCE = 1e-3
"""Largest traction of a coasting train, over its inertia [m/s²]."""
MAX_PART = 0.4
"""Largest change of the distance of two switches, relative to it."""


def moved(strategy: DrivingStrategy, switches: Array, distances: Array) -> DrivingStrategy:
    """Return a strategy with its curve moved by distances at places [m], linearly between them.

    Parameters
    ----------
    switches, distances : Array, shape (n,)
        Increasing places and the distances to move the curve there, > 0 forward [m].
    """
    assert strategy.curve is not None
    places, energies = strategy.curve
    at = np.concatenate((places[:1], switches, places[-1:]))
    by = np.concatenate(([0.0], distances, [0.0]))
    room = MAX_PART * np.diff(at)
    for k in range(1, by.size - 1):
        by[k] = min(max(by[k], by[k - 1] - room[k - 1], -room[k]), room[k])
    return replace(strategy, curve=(places + np.interp(places, at, by), energies))


def switches_to_coasting(section: PlanSection, strategy: DrivingStrategy) -> Array:
    """Return the places at which traction changes to coasting [m], increasing."""
    grid = section.grid
    driven = section_force(section, section.energy_profile(strategy)) > COASTING_FORCE * section.inputs.train.inertia
    change = np.flatnonzero(np.diff(driven.astype(np.int8)))
    places = grid.places[change + 1]
    ends = np.append(places[1:], grid.end)
    return np.asarray(places[driven[change] & (ends - places > MIN_COASTING)])


def best_distances(section: PlanSection, strategy: DrivingStrategy, switches: Array, price: float) -> Array:
    """Return the distances to move the switches to coasting for the least net energy + price x time [m], shape (n,).

    Parameters
    ----------
    switches : Array, shape (n,)
        Places of the switches [m].
    price
        Price of time [W/kg].
    """
    distances = np.zeros(switches.size)

    def cost(by: Array) -> float:
        found = moved(strategy, switches, by)
        try:
            energy = section.energy_profile(found)
        except ValueError:
            return np.inf
        return section_energy(section, energy) / section.inputs.train.inertia + price * section.time_of(energy)

    least = cost(distances)
    for step in STEPS:
        for number in range(switches.size):
            for sign in (1.0, -1.0):
                trial = distances.copy()
                trial[number] += sign * step
                found = cost(trial)
                if found < least:
                    least, distances = found, trial
                    break
    return distances
