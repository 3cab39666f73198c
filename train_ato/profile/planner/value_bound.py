"""Lower bound of the net energy of a timetable from the value of a price of time, for short sections and little time.

With a price p of time, every run within the time T* of the timetable has an energy W >= W + p (T - T*) >= V(0) - p T*,
where V(s, E) is the least value of W + p T from place s with E = v²/2 to the end.  Any p gives a bound, the best p a
bound without a gap of its own.  V is found by dynamic programming backward over slabs of the line, each step of which
is below the true value; W is divided by the inertia, without auxiliaries.

Jerk limit and limits of forces by place, except the air of tunnels, are left out, which lowers the bound only.  The gap
has two causes: the plan is not optimal or keeps the jerk limit, and the slabs are finite.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from plant_sim.summation import plain_dot, plain_sum
from train_ato.messages.types import Array
from train_ato.profile.planner.dynamic_programming import EnergyWeights, Resolution
from train_ato.profile.planner.net_energy import energy_weights
from train_ato.profile.planner.passes import BRAKE, COAST, ELECTRIC, TRACTION, durations
from train_ato.profile.planner.section import PlanSection
from train_ato.profile.planner.slab_values import least_value
from train_ato.profile.planner.train_tables import SPEED_STEP

FIRST, LAST = Resolution(400, 400), Resolution(800, 1200)
"""Slabs of all sections together and grid points of E, of the search for the price and of the bound."""
MIN_SLABS = 100
"""Least number of slabs of one section."""
PRICE_RANGE = (1e-4, 1e3)
"""Search range of the price of time [W/kg]."""
PRICE_STEPS = 14
"""Steps of the search."""
CLIMB = 1.15
"""Factor between two prices on the last grid."""
MAX_CLIMB = 4
"""Largest number of prices in one direction on the last grid."""


@dataclass(frozen=True, slots=True)
class _Slabs:
    """A section for the bound; all forces are divided by the inertia [m/s²].

    Attributes
    ----------
    steps : Array, shape (n,)
        Lengths of the slabs [m].
    line : Array, shape (3, n)
        Least, mean and largest line force.
    air : Array, shape (n,)
        Least tunnel air over v² [1/m].
    limit : Array, shape (n + 1,)
        E of the speed limit at the borders.
    table : Array, shape (4, m)
        Resistance at the points of the grid; largest traction, whole and electric brake of the cells beyond them.
    width
        Distance of the points of the grid of E as speeds [m/s].
    service : tuple
        Service acceleration and deceleration [m/s²].
    ends : tuple
        E at the begin and at the end.
    """

    steps: Array
    line: Array
    air: Array
    limit: Array
    table: Array
    width: float
    service: tuple[float, float]
    ends: tuple[float, float]


def value_lower_bound(sections: list[PlanSection], time: float) -> float:
    """Return a lower bound of the net energy, without auxiliaries, of every run within a running time [J].

    Parameters
    ----------
    sections
        Sections between two stops.
    time
        Running time of all sections without dwell times [s].
    """
    weights = energy_weights(sections[0].inputs.settings)

    def bound(size: Resolution) -> Callable[[float], float]:
        cells = max(size.cells // len(sections), MIN_SLABS)
        slabs = [_slabs(section, Resolution(cells, size.points)) for section in sections]
        return lambda price: plain_sum(_least_value(entry, price, weights) for entry in slabs) - price * time

    best = _climb(bound(LAST), _best_price(bound(FIRST)))
    return best * sections[0].inputs.train.inertia


def _best_price(bound: Callable[[float], float]) -> float:
    """Return the price of time with the largest bound [W/kg]; the bound is concave in the price."""
    from scipy.optimize import minimize_scalar

    found = minimize_scalar(
        lambda power: -bound(float(np.exp(power))),
        bounds=tuple(np.log(PRICE_RANGE)),
        method="bounded",
        options={"maxiter": PRICE_STEPS},
    )
    return float(np.exp(found.x))


def _climb(bound: Callable[[float], float], price: float) -> float:
    """Return the largest bound near a price of time [J/kg]; that of the coarse slabs is too low or too high."""
    best = bound(price)
    for factor in (CLIMB, 1.0 / CLIMB):
        for power in range(1, MAX_CLIMB + 1):
            found = bound(price * factor**power)
            if found <= best:
                break
            best = found
        if power > 1:
            break
    return best


def _slabs(section: PlanSection, size: Resolution) -> _Slabs:
    """Return a section without a jerk limit; slabs by distance, and by change of speed and time of the fastest run."""
    inputs, settings = section.inputs, section.inputs.settings
    free = PlanSection(
        replace(inputs, places=None),
        section.begin,
        section.end,
        begin_speed=section.begin_speed,
        end_speed=section.end_speed,
    )
    places, fastest = free.grid.places, free.energy_profile()
    shares = (free.grid.steps, np.abs(np.diff(np.sqrt(2.0 * fastest))), durations(fastest, free.grid.steps))
    share = np.concatenate(([0.0], np.cumsum([part / max(float(part.sum()), 1e-9) for part in shares], axis=1).sum(0)))
    border = np.unique(np.searchsorted(share, np.linspace(0.0, share[-1], size.cells + 1)[:-1]))
    border = np.append(border[border < places.size - 1], places.size - 1)
    steps = np.diff(places[border])
    low, mean, high = (force / inputs.train.inertia for force in inputs.force.over_cells(free.grid))
    work = np.concatenate(([0.0], np.cumsum(mean * free.grid.steps)))[border]
    line = np.stack(
        (np.minimum.reduceat(low, border[:-1]), np.diff(work) / steps, np.maximum.reduceat(high, border[:-1]))
    )
    least = np.zeros(free.grid.cells) if inputs.places is None else inputs.places.least_air(free.grid)
    air = np.minimum.reduceat(least, border[:-1])
    at = places[border]
    limits = [inputs.limits.at(at + shift, inputs.train.length) for shift in (-1e-6, 1e-6)]
    near = np.lib.stride_tricks.sliding_window_view(np.pad(fastest, 2, mode="edge"), 5).max(axis=1)  # limits of a cell
    highest = near + plain_dot(high - low, free.grid.steps)  # the fastest run has the largest force of each cell
    limit = np.minimum(np.maximum(*limits) ** 2 / 2, highest[border])
    width = float(np.sqrt(2.0 * limit.max())) / size.points
    return _Slabs(
        steps, line, air, limit, _table(free.tables.rates, width, size.points + 3), width,
        (settings.acceleration or np.inf, settings.deceleration or np.inf),
        (free.begin_speed**2 / 2, free.end_speed**2 / 2),
    )  # fmt: skip


def _table(rates: Array, width: float, count: int) -> Array:
    """Return the table of :class:`_Slabs`."""
    columns = SPEED_STEP * np.arange(rates.shape[1])
    edges = width * np.arange(count + 1)
    rows = [np.interp(edges[:-1], columns, rates[COAST])]
    cell = np.minimum((columns / width).astype(int), count - 1)
    for row, sign in ((TRACTION, 1.0), (BRAKE, -1.0), (ELECTRIC, -1.0)):
        force = rates[row] + sign * rates[COAST]
        ends = np.interp(edges, columns, force)
        largest = np.maximum(ends[:-1], ends[1:])
        np.maximum.at(largest, cell, force)
        rows.append(largest)
    return np.stack(rows)


def _least_value(slabs: _Slabs, price: float, weights: EnergyWeights) -> float:
    """Return a lower bound of energy + price x time of a section [J/kg]."""
    return float(
        least_value(
            slabs.steps, slabs.line, slabs.air, slabs.limit, slabs.table, slabs.width, slabs.service, slabs.ends, price,
            (weights.traction, weights.recovered),
        )
    )  # fmt: skip
