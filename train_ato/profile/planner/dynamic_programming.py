"""Where traction is worth its energy: the value of a run by dynamic programming, and the switching curve from it.

The run that needs least traction work in a given time minimises work + price x time for some price of time.  The value
V(s, E) of that sum from place s with E = v²/2 to the end obeys Bellman's equation; a little more speed at s costs its
traction work and is worth -dV/dE.  Below the speed at which both are equal traction is worth its energy, above it the
train coasts: that speed over the place, the switching curve, is the whole optimal feedback, because brakes only keep
limits (Howlett and Pudney, "Energy-Efficient Train Control", 1995).  On a level line it is a constant cruise that
falls into coasting before a stop; before a steep fall it drops early enough that the fall need not be braked, before
a climb it rises.

All energies are per inertial mass.  All compiled code of the value stands in this file: numba's cache notices changes
here only.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from plant_sim.compiled import compiled
from train_ato.plan.passes import COAST, TRACTION
from train_ato.types import Array

__all__ = ["Stretches", "switching_curve"]

CELLS, SHORTEST = 500, 1.0
"""Cells of place of a run, and the length of the shortest one [m]."""
ENERGIES = 300
"""Points of E."""
NEVER = 1e12
"""Value of a state from which the end is not reached."""
SLOWEST = 0.05
"""Speed below which a moment costs no more than at it [m/s]."""


class Stretches:
    """A run on a coarse grid for the dynamic programming.

    Parameters
    ----------
    places : Array, shape (n + 1,)
        Of the fine grid [m].
    top : Array, shape (n + 1,)
        E from which every limit ahead can still be kept, at the places.
    flat : Array, shape (n,)
        Mean line force over the inertial mass in every fine cell [m/s²].
    table : Array
        Rows of the passes, see :mod:`train_ato.plan.passes`.
    service
        Largest acceleration [m/s²].
    end
        E at the end.
    """

    def __init__(self, places: Array, top: Array, flat: Array, table: Array, service: float, end: float) -> None:
        count = int(np.clip((places[-1] - places[0]) / SHORTEST, 10, CELLS))
        self.places: Array = np.linspace(places[0], places[-1], count + 1)
        work = np.concatenate(([0.0], np.cumsum(flat * np.diff(places))))
        self.steps: Array = np.diff(self.places)
        self.flat: Array = np.diff(np.interp(self.places, places, work)) / self.steps
        self.top: Array = np.interp(self.places, places, top)
        self.top[-1] = end
        self.table = table
        self.service = service


def switching_curve(run: Stretches, price: float, spacing: float) -> tuple[Array, Array]:
    """Return places [m] and the E above which traction is not worth its energy there.

    Parameters
    ----------
    price
        Of time, as power over the inertial mass [W/kg]: the higher, the faster the run.
    spacing
        Of the table over the speed [m/s].
    """
    energies = np.linspace(0.0, float(run.top.max()) * (1 + 1e-9), ENERGIES)
    curve = _curve(energies, run.top, run.flat, run.steps, run.table, spacing, run.service, price)
    return run.places, curve


@compiled
def _value(values: Array, energy: float, spacing: float) -> Any:
    place = energy / spacing
    i = min(int(place), values.size - 2)
    return values[i] + (place - i) * (values[i + 1] - values[i])


@compiled
def _slope(values: Array, energy: float, spacing: float) -> Any:
    """Return dV/dE, continuous: the slopes between grid points hold in the middle of their cells."""
    place = energy / spacing - 0.5
    i = min(max(int(np.floor(place)), 0), values.size - 3)
    share = min(max(place - i, 0.0), 1.0)
    low, high = values[i + 1] - values[i], values[i + 2] - values[i + 1]
    return (low + share * (high - low)) / spacing


@compiled
def _cost(price: float, step: float, speed: float, end: float, values: Array, spacing: float) -> Any:
    """Return price x time over a step to the energy ``end``, and the value there."""
    if end <= 0.0:
        return NEVER
    return price * 2.0 * step / (speed + np.sqrt(2.0 * end)) + _value(values, end, spacing)


@compiled
def _best(price: float, step: float, speed: float, slow: float, fast: float, values: Array, energies: Array) -> Any:
    """Return the least cost of a step that ends between coasting (``slow``) and full traction (``fast``)."""
    spacing = energies[1]
    best = _cost(price, step, speed, slow, values, spacing)
    best = min(best, fast - slow + _cost(price, step, speed, fast, values, spacing))
    for q in range(max(int(slow / spacing) + 1, 1), min(int(fast / spacing), energies.size - 1) + 1):
        best = min(best, energies[q] - slow + price * 2.0 * step / (speed + np.sqrt(2.0 * energies[q])) + values[q])
    return min(best, NEVER)


@compiled
def _worth(price: float, step: float, speed: float, slow: float, values: Array, spacing: float) -> Any:
    """Return what more energy than by coasting costs, less what it brings; < 0 where traction is worth its work."""
    if slow <= 0.0:
        return -1.0
    u = np.sqrt(2.0 * slow)
    quicker = price * 2.0 * step / ((speed + u) ** 2 * max(u, SLOWEST))
    return 1.0 - quicker + _slope(values, slow, spacing)


@compiled
def _curve(
    energies: Array,
    top: Array,
    flat: Array,
    steps: Array,
    table: Array,
    speed_step: float,
    service: float,
    price: float,
) -> Array:
    n, m = steps.size, energies.size
    spacing = energies[1]
    values, new, worth = np.zeros(m), np.empty(m), np.ones(m)
    curve = np.empty(n + 1)
    curve[n] = top[n]
    for k in range(n - 1, -1, -1):
        step, ceiling = steps[k], top[k + 1]
        for i in range(m):
            energy = min(energies[i], top[k])
            speed = np.sqrt(2.0 * energy)
            place = speed / speed_step
            j = min(int(place), table.shape[1] - 2)
            pull = table[TRACTION, j] + (place - j) * (table[TRACTION, j + 1] - table[TRACTION, j])
            drag = table[COAST, j] + (place - j) * (table[COAST, j + 1] - table[COAST, j])
            fast = min(energy + step * min(service, pull - flat[k]), ceiling)
            slow = energy - step * (drag + flat[k])
            if fast > slow:
                new[i] = _best(price, step, speed, slow, fast, values, energies)
                worth[i] = _worth(price, step, speed, slow, values, spacing)
            else:  # braked to the ceiling, or nothing to pull with
                end = min(slow, ceiling)
                stop = k == n - 1 and end == 0.0
                new[i] = (
                    price * 2.0 * step / max(speed, SLOWEST)
                    if stop
                    else _cost(price, step, speed, end, values, spacing)
                )
                worth[i] = 1.0
        values, new = new, values
        curve[k] = _crossing(worth, energies, top[k])
    return curve


@compiled
def _crossing(worth: Array, energies: Array, top: float) -> Any:
    """Return the largest E at which more speed is worth its work; above the top where it always is."""
    i = min(int(top / energies[1]), energies.size - 1)
    if worth[i] < 0.0:
        return 4.0 * energies[-1]
    while i > 0 and worth[i - 1] >= 0.0:
        i -= 1
    if i == 0:
        return 0.0
    share = worth[i - 1] / (worth[i - 1] - worth[i])
    return energies[i - 1] + share * (energies[i] - energies[i - 1])
