"""Lower bound of the net energy of a timetable: the certificate of a plan.

A run has E = v²/2 over the place s, the traction or brake force u (divided by the inertia) and the resistance r(E) +
g(s). Its motion is dE/ds = u - r(E) - g(s), and its time is T = int ds / sqrt(2 E). Let a be 1 / efficiency, c the
recovered share, and b(E) the electric brake. Without auxiliaries the net energy is W = int a max(u, 0) - c min(max(-u,
0), b(E)) ds.

The bound holds for every continuous, piecewise linear function m(s) >= 0 and every price of time p >= 0. t(E) is the
largest traction. Each feasible u <= t(E) has an energy of at least m u - max(m - a, 0) t(E) - max(c - m, 0) b(E). For u
>= 0 the difference without the last term is (a - m)(u - t) >= 0 if m > a, and (a - m) u >= 0 otherwise. For u < 0 the
difference without the second term is m |u| - c min(|u|, b) + max(c - m, 0) b >= 0. The next line takes u from the
motion and integrates by parts over a section. T is at most the time T* of the timetable::

    W >= W + p (T - T*)
      >= [m E] + int m g ds + int (-m' E + m r(E) - max(m - a, 0) t(E) - max(c - m, 0) b(E) + p / sqrt(2 E)) ds - p T*
      >= [m E] + int m g ds + int min over E of (the bracket) ds - p T*,

The minimum is over all E up to that of the fastest run, which no run exceeds at any place. The forward pass uses the
largest line force of a cell. Therefore E of the fastest run is increased by the range of that force times the length,
at most to the speed limit. Where m is linear, the minimum is a concave function of s, because it is a minimum of
functions that are linear or concave in m. So its integral is not below the mean of the values at both ends times the
length. The minimum over E is the least of lower bounds on the intervals of a grid: each monotone term has the lower of
its values at both ends. No step needs an optimal m; a poor m gives a low bound. m and p are the solution of a linear
program with the bracket at some E of every cell. Where the minimum lies elsewhere, its E is added, until the bound is
close to the value of the program. Jerk limit and service braking are left out, which only lowers the bound.

The gap has three causes. The plan is not optimal. It keeps the jerk limit, which is the largest part on short sections.
And m depends only on the place, so that t(E), which is convex, counts with its mean over slow and fast runs.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plant_sim.elementary import plain_dot
from train_ato.messages.types import Array
from train_ato.profile.planner.dynamic_programming import EnergyWeights
from train_ato.profile.planner.passes import COAST, ELECTRIC, TRACTION
from train_ato.profile.planner.section import PlanSection, energy_weights
from train_ato.profile.planner.train_tables import SPEED_STEP

SPEED_POINTS = 2000
"""Number of grid points of the speed in the minimum."""
CELLS, MIN_CELLS = 500, 60
"""Number of cells of the multiplier on all sections together, and least number of cells on one section."""
FIRST_POINTS = 12
"""Number of E of every cell in the first linear program."""
MAX_PROGRAMS = 5
"""Largest number of linear programs."""
GAP = 2e-3
"""Distance of the bound from the value of the program that ends the search, relative to the bound."""
MAX_MULTIPLIER, MAX_PRICE = 20.0, 1e3
"""Range of m, and of the price of time [W/kg]."""


@dataclass(frozen=True, slots=True)
class _Bounded:
    """A section for the bound; all forces are divided by the inertia [m/s²].

    Attributes
    ----------
    nodes : Array, shape (n + 1,)
        Places of the nodes of the multiplier [m].
    steps : Array, shape (n,)
        Distance between them [m].
    table : Array
        Rows of the passes, see :mod:`train_ato.profile.planner.passes`.
    weights : EnergyWeights
        Cost of traction work and gain of electric-brake work.
    largest : Array, shape (n,)
        E of the fastest run in every cell, the largest of the cell.
    line_work : Array, shape (n + 1,)
        Factor of every node of m in the work against the line force, and of m E at both ends [J/kg].
    spread : Array, shape (n,)
        Factor of the change of m in a cell, the largest error of that work [J/kg].
    air : Array, shape (n,)
        Least tunnel air of every cell over v² [1/m].
    """

    nodes: Array
    steps: Array
    table: Array
    weights: EnergyWeights
    largest: Array
    line_work: Array
    spread: Array
    air: Array

    def bracket(self, price: float, weight: float, slope: float, speed: Array, air: float) -> Array:
        """Return lower bounds of the bracket [m/s²] between increasing speeds [m/s], for one m and its slope."""
        resistance, traction, electric = self.forces(speed)
        energy = speed**2 / 2
        resistance = resistance + air * speed**2
        pull = max(weight - self.weights.traction, 0.0) * np.maximum(traction[1:], traction[:-1])
        pull = pull + max(self.weights.recovered - weight, 0.0) * np.maximum(electric[1:], electric[:-1])
        moved = -slope * (energy[1:] if slope > 0 else energy[:-1])
        return np.asarray(moved + weight * resistance[:-1] - pull + price / speed[1:])

    def forces(self, speed: Array) -> tuple[Array, Array, Array]:
        """Return resistance, largest traction and electric brake at speeds [m/s²]."""
        columns = SPEED_STEP * np.arange(self.table.shape[1])
        resistance = np.interp(speed, columns, self.table[COAST])
        traction = np.interp(speed, columns, self.table[TRACTION]) + resistance
        return resistance, traction, np.interp(speed, columns, self.table[ELECTRIC]) - resistance


def energy_lower_bound(sections: list[PlanSection], time: float) -> float:
    """Return a lower bound of the net energy, without auxiliaries, of every run within a running time [J].

    Parameters
    ----------
    sections
        Sections between two stops.
    time
        Running time of all sections without dwell times [s].
    """
    bounded = [_prepared(section, max(MIN_CELLS, CELLS // len(sections))) for section in sections]
    program = _Program(bounded, time)
    best = -np.inf
    for _ in range(MAX_PROGRAMS):
        value, price, weights = program.solve()
        found = -price * time
        for number, (section, weight) in enumerate(zip(bounded, weights, strict=True)):
            least, speeds = _least_bracket(section, weight, price)
            program.add(number, speeds)
            change = plain_dot(section.spread, np.abs(np.diff(weight)))
            found += plain_dot(weight, section.line_work) - change + plain_dot(least, section.steps)
        best = max(best, found)
        if value - best <= GAP * abs(best):
            break
    traction_only = sections[0].inputs.settings.recovered == 0.0
    return max(best, 0.0 if traction_only else best) * sections[0].inputs.train.inertia


def _prepared(section: PlanSection, cells: int) -> _Bounded:
    """Return a section without the window of the jerk limit, so that no feasible run exceeds its largest E."""
    free = section.without_places()
    places, fastest, table = free.grid.places, free.energy_profile(), free.tables.rates
    nodes = np.linspace(places[0], places[-1], cells + 1)
    steps = np.diff(nodes)
    low, mean, high = (force / section.inputs.train.inertia for force in section.inputs.force.over_cells(free.grid))
    top = fastest + plain_dot(high - low, free.grid.steps)  # the passes use the largest force of a cell, not its mean
    top = np.minimum(top, section.inputs.limits.highest(places, section.inputs.train.length) ** 2 / 2)
    first = np.maximum(np.searchsorted(places, nodes[:-1], side="right") - 2, 0)
    last = np.minimum(np.searchsorted(places, nodes[1:], side="left") + 1, places.size - 1)
    largest = np.array([top[a : b + 1].max() for a, b in zip(first, last, strict=True)])
    work = 0.5 * mean * free.grid.steps
    cell = np.clip(np.searchsorted(nodes, places, side="right") - 1, 0, cells - 1)
    share = np.clip((places - nodes[cell]) / steps[cell], 0.0, 1.0)
    at_places = np.concatenate((work, [0.0])) + np.concatenate(([0.0], work))
    line_work = np.zeros(nodes.size)
    np.add.at(line_work, cell, (1.0 - share) * at_places)
    np.add.at(line_work, cell + 1, share * at_places)
    line_work[0] -= fastest[0]
    line_work[-1] += fastest[-1]
    spread = np.zeros(cells)
    np.add.at(spread, cell[:-1], 0.25 * (high - low) * free.grid.steps**2 / steps[cell[:-1]])
    air = np.zeros(cells)
    if section.inputs.places is not None:
        least = section.inputs.places.least_air(free.grid)
        air = np.array([least[a:b].min() for a, b in zip(first, last, strict=True)])
    return _Bounded(nodes, steps, table, energy_weights(section.inputs.settings), largest, line_work, spread, air)


def _least_bracket(section: _Bounded, weight: Array, price: float) -> tuple[Array, Array]:
    """Return a lower bound of the mean of the minimum in every cell [m/s²], and the speed of the minimum [m/s]."""
    speed = np.linspace(0.0, float(np.sqrt(2.0 * section.largest.max())) * (1 + 1e-9), SPEED_POINTS)
    slope = np.diff(weight) / section.steps
    least, at = np.empty(slope.size), np.empty(slope.size)
    for k in range(slope.size):
        count = min(int(np.searchsorted(speed, np.sqrt(2.0 * section.largest[k]), side="left")), speed.size - 1)
        both = [
            section.bracket(price, float(m), float(slope[k]), speed[: count + 1], float(section.air[k]))
            for m in weight[k : k + 2]
        ]
        least[k] = 0.5 * (float(both[0].min()) + float(both[1].min()))
        at[k] = speed[1 + int(np.argmin(both[0] + both[1]))]
    return least, np.minimum(at, np.sqrt(2.0 * section.largest))


class _Program:
    """Linear program for price and multipliers: columns p, then those of every section.

    They are m, max(m - a, 0), max(c - m, 0) and the bracket.
    """

    def __init__(self, bounded: list[_Bounded], time: float) -> None:
        sizes = [section.steps.size for section in bounded]
        self._first = np.concatenate(([1], 1 + np.cumsum([4 * n + 3 for n in sizes])))
        self._bounded, self._sizes = bounded, sizes
        self._cost = np.zeros(self._first[-1])
        self._cost[0] = time
        self._limits: list[tuple[float | None, float | None]] = [(0.0, MAX_PRICE)]
        self._rows: list[tuple[NDArray[np.int64], Array, Array]] = []
        for number, (section, n) in enumerate(zip(bounded, sizes, strict=True)):
            m, w, z, y = self._columns(number)
            self._cost[m : m + n + 1] = -section.line_work
            self._cost[y : y + n] = -section.steps
            self._limits += [(0.0, MAX_MULTIPLIER)] * (n + 1) + [(0.0, None)] * (2 * n + 2) + [(None, None)] * n
            node = np.arange(n + 1)
            for other, sign, weight in ((w, 1.0, section.weights.traction), (z, -1.0, -section.weights.recovered)):
                columns = np.stack((m + node, other + node), axis=1)
                self._rows.append((columns, np.tile([sign, -1.0], (n + 1, 1)), np.full(n + 1, weight)))
            top = np.sqrt(2.0 * section.largest)
            for part in np.linspace(1.0, 1.0 / FIRST_POINTS, FIRST_POINTS):
                self.add(number, part * top)

    def _columns(self, number: int) -> tuple[int, int, int, int]:
        first, n = int(self._first[number]), self._sizes[number]
        return first, first + n + 1, first + 2 * n + 2, first + 3 * n + 3

    def add(self, number: int, speed: Array) -> None:
        """Add the bracket of every cell at a speed [m/s], shape (n,), as a bound of its minimum."""
        section, cell = self._bounded[number], np.arange(self._sizes[number])
        m, w, z, y = self._columns(number)
        speed = np.maximum(speed, 1e-3)
        resistance, traction, electric = section.forces(speed)
        rate = speed**2 / 2 / section.steps
        columns = np.stack(
            (y + cell, 0 * cell, m + cell, m + cell + 1, w + cell, w + cell + 1, z + cell, z + cell + 1), axis=1
        )  # y <= p / v + m r - (m - a)+ t - (c - m)+ b - m' E
        half = 0.5 * (resistance + section.air * speed**2)
        pull, brake = 0.5 * traction, 0.5 * electric
        factors = np.stack(
            (np.ones(cell.size), -1.0 / speed, -half - rate, -half + rate, pull, pull, brake, brake), axis=1
        )
        self._rows.append((columns, factors, np.zeros(cell.size)))

    def solve(self) -> tuple[float, float, list[Array]]:
        """Return value [J/kg], price of time [W/kg] and the multipliers of every section."""
        from scipy.optimize import linprog
        from scipy.sparse import csr_matrix

        counts = [np.full(columns.shape[0], columns.shape[1]) for columns, _, _ in self._rows]
        starts = np.concatenate(([0], np.cumsum(np.concatenate(counts))))
        columns = np.concatenate([entry.ravel() for entry, _, _ in self._rows])
        factors = np.concatenate([entry.ravel() for _, entry, _ in self._rows])
        matrix = csr_matrix((factors, columns, starts), shape=(starts.size - 1, self._cost.size))
        right = np.concatenate([entry for _, _, entry in self._rows])
        result = linprog(self._cost, matrix, right, bounds=self._limits, method="highs")
        if result.x is None:
            raise ValueError(f"the energy bound has no solution: {result.message}; report the line and the train")
        weights = []
        for number, n in enumerate(self._sizes):
            m = self._columns(number)[0]
            weights.append(np.maximum(result.x[m : m + n + 1], 0.0))
        return -float(result.fun), max(float(result.x[0]), 0.0), weights
