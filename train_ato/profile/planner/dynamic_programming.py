"""Switching curve of the energy-optimal run by dynamic programming.

The run with minimum traction work in a given time minimises work + price x time for some price of time.  The value
V(s, E) of that sum from place s with E = v²/2 to the end satisfies Bellman's equation.  A small increase of E at s
costs its traction work and reduces the remaining cost by -dV/dE.  Traction is optimal below the speed at which both are
equal; above it the train coasts.  This speed over the place is the switching curve.  It is the complete optimal
feedback, because brakes only keep limits (Howlett and Pudney, "Energy-Efficient Train Control", 1995).  On a level line
it is a constant cruise with coasting before a stop; it decreases before a steep descent, so that the descent needs no
braking, and increases before a climb.

All energies are divided by the inertia.  All compiled code of the value is in this file, because numba's cache detects
changes of this file only.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from plant_sim.compiled import compiled
from train_ato.messages.types import Array
from train_ato.profile.planner.passes import COAST, TRACTION

MAX_CELLS, MIN_CELL = 500, 1.0
"""Maximum number of cells of a section, and minimum length of a cell [m]."""
ENERGY_POINTS = 300
"""Number of grid points of E."""
UNREACHABLE = 1e12
"""Value of a state from which the end cannot be reached."""
MIN_SPEED = 0.05
"""Lower bound of the speed in the cost of time [m/s]."""


class CoarseGrid:
    """A section on a coarse grid for the dynamic programming.

    Parameters
    ----------
    places : Array, shape (n + 1,)
        Places of the fine grid [m].
    top : Array, shape (n + 1,)
        Largest E that keeps every limit ahead, at the places.
    line_mean : Array, shape (n,)
        Mean line force of every fine cell, divided by the inertia [m/s²].
    table : Array
        Rows of the passes, see :mod:`train_ato.profile.planner.passes`.
    service, deceleration
        Service acceleration and deceleration [m/s²].
    end
        E at the end.
    """

    def __init__(
        self,
        places: Array,
        top: Array,
        line_mean: Array,
        table: Array,
        service: float,
        deceleration: float,
        end: float,
    ) -> None:
        count = int(np.clip((places[-1] - places[0]) / MIN_CELL, 10, MAX_CELLS))
        self.places: Array = np.linspace(places[0], places[-1], count + 1)
        work = np.concatenate(([0.0], np.cumsum(line_mean * np.diff(places))))
        self.steps: Array = np.diff(self.places)
        self.line_mean: Array = np.diff(np.interp(self.places, places, work)) / self.steps
        self.top: Array = np.interp(self.places, places, top)
        self.top[-1] = end
        self.table = table
        self.service = service
        self.deceleration = deceleration


def switching_curve(grid: CoarseGrid, price: float, spacing: float) -> tuple[Array, Array]:
    """Return places [m] and the E at them above which traction is not optimal.

    Parameters
    ----------
    price
        Price of time, power divided by inertia [W/kg]; a higher price gives a faster run.
    spacing
        Speed step of the table [m/s].
    """
    energies = np.linspace(0.0, float(grid.top.max()) * (1 + 1e-9), ENERGY_POINTS)
    curve = _curve(
        energies, grid.top, grid.line_mean, grid.steps, grid.table, spacing, (grid.service, grid.deceleration), price
    )
    return grid.places, curve


@compiled
def _value(values: Array, energy: float, spacing: float) -> Any:
    place = energy / spacing
    i = min(int(place), values.size - 2)
    return values[i] + (place - i) * (values[i + 1] - values[i])


@compiled
def _value_slope(values: Array, energy: float, spacing: float) -> Any:
    """Return dV/dE, interpolated between the slopes in the middle of the cells."""
    place = energy / spacing - 0.5
    i = min(max(int(np.floor(place)), 0), values.size - 3)
    share = min(max(place - i, 0.0), 1.0)
    low, high = values[i + 1] - values[i], values[i + 2] - values[i + 1]
    return (low + share * (high - low)) / spacing


@compiled
def _cost(price: float, step: float, speed: float, end: float, values: Array, spacing: float) -> Any:
    """Return price x time of a step to the energy ``end``, plus the value there."""
    if end <= 0.0:
        return UNREACHABLE
    return price * 2.0 * step / (speed + np.sqrt(2.0 * end)) + _value(values, end, spacing)


@compiled
def _least_cost(
    price: float, step: float, speed: float, slow: float, fast: float, values: Array, energies: Array
) -> Any:
    """Return the least cost of a step to an energy between coasting (``slow``) and full traction (``fast``)."""
    spacing = energies[1]
    best = _cost(price, step, speed, slow, values, spacing)
    best = min(best, fast - slow + _cost(price, step, speed, fast, values, spacing))
    for q in range(max(int(slow / spacing) + 1, 1), min(int(fast / spacing), energies.size - 1) + 1):
        best = min(best, energies[q] - slow + price * 2.0 * step / (speed + np.sqrt(2.0 * energies[q])) + values[q])
    return min(best, UNREACHABLE)


@compiled
def _marginal_cost(price: float, step: float, speed: float, slow: float, values: Array, spacing: float) -> Any:
    """Return the marginal cost of more energy than by coasting, minus its benefit; < 0: traction is optimal."""
    if slow <= 0.0:
        return -1.0
    u = np.sqrt(2.0 * slow)
    quicker = price * 2.0 * step / ((speed + u) ** 2 * max(u, MIN_SPEED))
    return 1.0 - quicker + _value_slope(values, slow, spacing)


@compiled
def _curve(
    energies: Array,
    top: Array,
    line_mean: Array,
    steps: Array,
    table: Array,
    speed_step: float,
    service: tuple[float, float],
    price: float,
) -> Array:
    """Return the switching curve; ``service`` are the acceleration and deceleration limits [m/s²]."""
    n, m = steps.size, energies.size
    spacing = energies[1]
    values, new, marginal = np.zeros(m), np.empty(m), np.ones(m)
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
            fast = min(energy + step * min(service[0], pull - line_mean[k]), ceiling)
            coast = energy - step * (drag + line_mean[k])
            slow = energy - step * min(service[1], drag + line_mean[k])
            if fast > slow:
                new[i] = slow - coast + _least_cost(price, step, speed, slow, fast, values, energies)
                marginal[i] = _marginal_cost(price, step, speed, slow, values, spacing)
            else:  # braking to the ceiling, or no traction
                end = min(slow, ceiling)
                stop = k == n - 1 and end == 0.0
                new[i] = (
                    price * 2.0 * step / max(speed, MIN_SPEED)
                    if stop
                    else _cost(price, step, speed, end, values, spacing)
                )
                marginal[i] = 1.0
        values, new = new, values
        curve[k] = _switching_energy(marginal, energies, top[k])
    return curve


@compiled
def _switching_energy(marginal: Array, energies: Array, top: float) -> Any:
    """Return the largest E at which traction is optimal; above the top if it is at every E."""
    i = min(int(top / energies[1]), energies.size - 1)
    if marginal[i] < 0.0:
        return 4.0 * energies[-1]
    while i > 0 and marginal[i - 1] >= 0.0:
        i -= 1
    if i == 0:
        return 0.0
    share = marginal[i - 1] / (marginal[i - 1] - marginal[i])
    return energies[i - 1] + share * (energies[i] - energies[i - 1])
