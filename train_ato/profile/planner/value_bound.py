"""Lower bound of the net energy of a timetable from the value of a price of time, for short sections and little time.

Let V(s, E) be the least value of W + p T from place s with E = v²/2 to the end. With a price p of time, every run
within the time T* of the timetable has an energy W >= W + p (T - T*) >= V(0) - p T*. Any p gives a bound, and the best
p gives a bound without a gap of its own. Dynamic programming finds V backward over slabs of the line. Each of its steps
is below the true value. W is divided by the inertia, without auxiliaries.

Jerk limit and limits of forces by place, except the air of tunnels, are left out, which lowers the bound only.  The gap
has two causes: the plan is not optimal or keeps the jerk limit, and the slabs are finite.

Least energy + price x time of a section, from below: dynamic programming backward over slabs, compiled.

For a run through a slab of length h from E to E', with the mean grade force g, efficiency 1 / a, recovered share c:

* Traction and brake work is E' - E + int r ds + h g, at least with the resistance r at the lowest E of the run. Within
  the slab E changes by at most alpha upward and beta downward. Hence this E is at least min(E, E') - alpha beta h /
  (alpha + beta). r is concave in E, so that a chord is below it. The cost increases with the work: less r, less cost.
* Tunnel air is a part of r, the least of the slab; it is linear in E.
* The time is int ds / sqrt(2 E) >= h / sqrt(2 mean E) (Jensen), with the mean of the highest run from E to E', up with
  alpha and down with beta.
* More traction and as much more brake work, x, costs (a - c) x. It raises E by at most x, which saves at most x h / (2
  E)^(3/2) of time. Or it lowers E by at most x, with h r'(E) x less resistance work. Where this is worth less, x = 0 is
  a lower bound. With work > 0 E then falls only by coasting, else it rises only by coasting, and both rates of the mean
  and of the lowest E are smaller.
* Speed limits apply only at the borders of the slabs, and forces have the largest value of the slab. A train that would
  stall is at rest with the force that it lacks.

V at the border of a slab is stored at points of a grid of E with spacing d. Between the points the chord must be below
V. Let the run from E, between two points, end at E'. The runs from both points with the same work end at E' - x d and
E' + (1 - x) d. The chord of their values exceeds the value of the run by at most the excess of the next V over an
interval d. This is at most d / 4 times the increase of the slope there, which is therefore subtracted from the next V.
From a chord over the time, half the curvature times d² / 4 is subtracted twice: for the point and for the end between
two points. Forces, resistance and time of a run from a grid point are those of the best E within d, so that both runs
exist.

All energies and forces are divided by the inertia.  All compiled code of the values is in this file, because numba's
cache detects changes of this file only.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import plain_dot, plain_sum
from train_ato.messages.types import Array
from train_ato.profile.planner.dynamic_programming import EnergyWeights, Resolution, ServiceLimits
from train_ato.profile.planner.passes import BRAKE, COAST, ELECTRIC, TRACTION, durations
from train_ato.profile.planner.section import PlanSection, energy_weights
from train_ato.profile.planner.train_tables import SPEED_STEP

RESISTANCE, PULL, STOPPING, RECOVERING = range(4)
"""Rows of the table: resistance, largest traction, whole brake, electric brake [m/s²]."""
MIN_RATE = 0.02
"""Least rise and fall of E of a coasting train that is assumed, against a large curvature of the time [m/s²]."""


class RunRates(NamedTuple):
    """Largest rise and fall of E of a run without brake work, of one without traction work, and excess of E of it."""

    driven_rise: float
    driven_fall: float
    braked_rise: float
    braked_fall: float
    excess: float


class Chord(NamedTuple):
    """Resistance at an E [m/s²], its decrease per E below [1/m], and the span of E for which it holds."""

    resistance: float
    slope: float
    span: float


class SlabForce(NamedTuple):
    """Least, mean and largest line force of a slab, over the inertia [m/s²]."""

    least: float
    mean: float
    largest: float


class Ends(NamedTuple):
    """E at the begin and at the end of a section."""

    begin: float
    end: float


@compiled
def _number(energy: float, width: float) -> int:
    """Return the number of the cell of an E."""
    return int(np.sqrt(2.0 * max(energy, 0.0)) / width)


@compiled
def _largest(row: Array, first: float, last: float, width: float) -> Any:
    """Return the largest value of a row of cells between two E."""
    i = min(_number(first, width), row.size - 1)
    found = row[i]
    for k in range(i + 1, min(_number(last, width), row.size - 1) + 1):
        found = max(found, row[k])
    return found


@compiled
def _at(row: Array, energy: float, width: float, last: int) -> Any:
    """Return a row at an E by a chord between its points up to ``last``; beyond them the chord continues."""
    i = min(_number(energy, width), last - 1)
    first = 0.5 * (i * width) ** 2
    return row[i] + (energy - first) / ((i + 0.5) * width**2) * (row[i + 1] - row[i])


@compiled
def _braking_rate(table: Array, energy: float, reach: float, line: float, service: float, width: float) -> Any:
    """Return an upper bound of the decrease of E per metre [m/s²], for values within ``reach`` of ``energy``."""
    drag = table[RESISTANCE, min(_number(energy + reach, width) + 1, table.shape[1] - 1)] + line
    brake = _largest(table[STOPPING], energy - reach, energy + reach, width)
    return max(min(service, brake + drag), drag, 1e-6)


@compiled
def _step_value(
    end: float, energy: float, h: float, line: float, price: float, gap: float, weights: EnergyWeights,
    rates: RunRates, drag: Chord, electric: float,
) -> Any:  # fmt: skip
    """Return the cost of a run through a slab to an E, from below; ``drag`` is that at the E before it."""
    resistance = drag.resistance - drag.slope * min(max(energy - end, 0.0), drag.span)
    work = end - energy + h * (resistance + line)
    cost = weights.traction * max(work, 0.0) - weights.recovered * min(max(-work, 0.0), h * electric)
    up, down, excess = rates.braked_rise, rates.braked_fall, rates.excess
    if work >= 0.0:
        up, down, excess = rates.driven_rise, rates.driven_fall, 0.0
    rise = min(max((end - energy + down * h) / (up + down), 0.0), h)
    fall = h - rise
    mean = ((energy + 0.5 * up * rise) * rise + (end + 0.5 * down * fall) * fall) / h + excess
    time = h / np.sqrt(2.0 * max(mean + 2.0 * gap, gap))
    if mean > 2.0 * gap:  # the curvature of the time is the smaller loss
        slow = 1.0 / (2.0 * (mean - gap))
        bend = np.sqrt(slow) * slow * (6.0 * h * slow + 1.0 / (up + down))
        time = max(time, h / np.sqrt(2.0 * mean) - 0.125 * gap**2 * bend)
    return cost + price * time


@compiled
def _end_of_work(work: float, energy: float, h: float, line: float, drag: Chord) -> Any:
    """Return the E at the end of a slab after traction less brake work."""
    lack = h * (drag.resistance + line) - work
    if lack <= 0.0:
        return energy - lack
    part = min(lack, drag.span * (1.0 + h * drag.slope))  # the chord of the resistance falls over its span
    return energy - part / (1.0 + h * drag.slope) - (lack - part)


@compiled
def _run_rates(
    energy: float, gap: float, h: float, line: SlabForce, price: float, weights: EnergyWeights,
    extreme: tuple[float, float], table: Array, width: float,
) -> Any:  # fmt: skip
    """Return the rates of :func:`_step_value`, and the largest fall of E in a slab below both of its ends.

    Where traction and brake in the same slab cost more than their time and resistance are worth, a run has one of them.
    """
    up, down = extreme
    dip = up * down * h / (up + down)
    lowest, size = energy - gap - dip - h * down, table.shape[1]
    i = _number(lowest, width) - 1
    if lowest > 0.0 and i >= 0:
        steepest = (table[RESISTANCE, i + 1] - table[RESISTANCE, i]) / ((i + 0.5) * width**2)
        gain = price * h / (2.0 * lowest) ** 1.5 + weights.traction * h * steepest
        if gain < weights.traction - weights.recovered:
            least = _at(table[RESISTANCE], lowest, width, size - 1)
            most = _at(table[RESISTANCE], energy + gap + h * up, width, size - 1)
            most = max(most, table[RESISTANCE, min(_number(energy + gap + h * up, width) + 1, size - 1)])
            rising, falling = max(-least - line.least, MIN_RATE), max(most + line.largest, MIN_RATE)
            rising, falling, excess = min(rising, up), min(falling, down), h * (most - least)
            dip = max(up * falling / (up + falling), rising * down / (rising + down)) * h + excess
            return RunRates(up, falling, rising, down, excess), dip
    return RunRates(up, down, up, down, 0.0), dip


@compiled
def _point_value(
    energy: float, h: float, line: SlabForce, price: float, width: float, ceiling: float, table: Array,
    service: ServiceLimits, weights: EnergyWeights, steepest: float, values: Array, last: int,
) -> Any:  # fmt: skip
    """Return the least value of the runs through a slab from an E."""
    gap = (_number(energy + h * steepest, width) + 2) * width**2
    down = _braking_rate(table, energy, h * steepest + gap, line.largest, service.deceleration, width)
    pull = _largest(table[PULL], energy - h * down - gap, energy + h * steepest + gap, width)
    up = max(min(service.acceleration, pull - table[RESISTANCE, 0] - line.least), 1e-6)
    rates, dip = _run_rates(energy, gap, h, line, price, weights, (up, down), table, width)
    low_from = max(energy - gap - dip, 0.0)
    low_to = max(low_from - h * down, 0.0)
    drag, span = _at(table[RESISTANCE], low_from, width, table.shape[1] - 1), low_from - low_to
    slope = (drag - _at(table[RESISTANCE], low_to, width, table.shape[1] - 1)) / span if span > 0.0 else 0.0
    pull = _largest(table[PULL], low_from, energy + h * up + gap, width)
    rate = pull - drag - line.mean
    fast = (
        energy + h * min(service.acceleration, rate) if rate > 0.0 else min(energy, energy + h * (rate + slope * span))
    )
    fast = max(min(fast, ceiling + gap), -gap)
    low = min(max(energy - h * down, -gap), fast)
    electric = _largest(table[RECOVERING], energy - h * down - gap, energy + gap, width)
    chord = Chord(drag, slope, span)
    coast = _end_of_work(0.0, energy, h, line.mean, chord)
    brake = _end_of_work(-h * electric, energy, h, line.mean, chord)
    best = np.inf
    for corner in (low, fast, coast, brake, energy, energy - span):
        end = min(max(corner, low), fast)
        cost = _step_value(end, energy, h, line.mean, price, gap, weights, rates, chord, electric)
        best = min(best, cost + _at(values, end, width, last))
    for j in range(_number(low, width), min(_number(fast, width), last) + 1):
        end = 0.5 * (j * width) ** 2
        if end >= low:
            cost = _step_value(end, energy, h, line.mean, price, gap, weights, rates, chord, electric)
            best = min(best, cost + values[j])
    return best


@compiled
def _lower_by_bends(values: Array, last: int, reach: float, width: float, found: Array) -> None:
    """Write the values less the excess of their chords over an interval of a grid of runs that end near them.

    The interval is the spacing of the grid at most ``reach`` above the point.
    """
    for j in range(last + 1):
        energy = 0.5 * (j * width) ** 2
        interval = (_number(energy + reach, width) + 2) * width**2
        first = max(_number(energy - 2.0 * interval, width), 1)
        largest, bend, left = 0.0, 0.0, first
        for k in range(first, last):
            at = 0.5 * (k * width) ** 2
            if at > energy + 2.0 * interval:
                break
            bend += _bend(values, k, width)
            while 0.5 * (left * width) ** 2 < at - interval:
                bend -= _bend(values, left, width)
                left += 1
            largest = max(largest, bend)
        found[j] = values[j] - 0.25 * interval * largest


@compiled
def _bend(values: Array, k: int, width: float) -> Any:
    """Return the increase of the slope of the chords at a point, or 0."""
    before = (values[k] - values[k - 1]) / ((k - 0.5) * width**2)
    return max((values[k + 1] - values[k]) / ((k + 0.5) * width**2) - before, 0.0)


@compiled
def _continue_chord(values: Array, first: int, width: float) -> None:
    """Lower the values below a point to the chord above it, where the grid is finer than a step of E in a slab."""
    slope = (values[first + 1] - values[first]) / ((first + 0.5) * width**2)
    for j in range(first):
        values[j] = min(values[j], values[first] - 0.5 * slope * (first**2 - j**2) * width**2)


@compiled
def least_value(
    steps: Array, line: Array, air: Array, limit: Array, open_table: Array, width: float, service: ServiceLimits,
    ends: Ends, price: float, weights: EnergyWeights,
) -> Any:  # fmt: skip
    """Return a lower bound of the least energy + price x time from the begin to the end.

    Parameters
    ----------
    steps : Array, shape (n,)
        Lengths of the slabs [m].
    line, air : Array, shape (3, n) and (n,)
        Least, mean and largest line force, over the inertia [m/s²], and least tunnel air over v² [1/m].
    limit : Array, shape (n + 1,)
        E of the speed limit at the borders.
    open_table : Array, shape (4, m)
        Resistance at the points of the grid; largest traction, whole and electric brake of the cells beyond them.
    width
        Distance of the points of the grid of E as speeds [m/s].
    service, ends
        Service acceleration and deceleration [m/s²], and E at the begin and at the end.
    price, weights
        Price of time [W/kg], cost of traction work and gain of electric-brake work.
    """
    size, table = open_table.shape[1], open_table.copy()
    values, lowered = np.zeros(size), np.zeros(size)
    for j in range(size):
        values[j] = weights.traction * max(ends.end - 0.5 * (j * width) ** 2, 0.0)
    top, last = ends.end, size - 1
    pull, brake = table[PULL].max(), table[STOPPING].max()
    for k in range(steps.size - 1, -1, -1):
        h, force = steps[k], SlabForce(line[0, k], line[1, k], line[2, k])
        for j in range(size):
            table[RESISTANCE, j] = open_table[RESISTANCE, j] + air[k] * (j * width) ** 2
        drag = table[RESISTANCE].max()
        fall = min(service.deceleration, brake + drag + force.largest)
        steepest = max(min(service.acceleration, pull - force.least), fall, drag + force.largest, 1e-6)
        _lower_by_bends(values, last, h * steepest, width, lowered)
        down = _braking_rate(table, top, h * steepest, force.largest, service.deceleration, width)
        higher = min(limit[k], top + h * down)
        number = min(max(_number(higher, width) + 1, 1), size - 1)
        for j in range(number + 1):
            energy = 0.5 * (j * width) ** 2
            values[j] = _point_value(
                energy, h, force, price, width, top, table, service, weights, steepest, lowered, last
            )
        top, last = higher, number
        _continue_chord(values, min(_number(h * steepest, width) + 1, last - 1), width)
    return _at(values, ends.begin, width, last)


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
        values = [_value_of(section, Resolution(cells, size.points), weights) for section in sections]
        return lambda price: plain_sum(value(price) for value in values) - price * time

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


def _value_of(section: PlanSection, size: Resolution, weights: EnergyWeights) -> Callable[[float], float]:
    """Return the value of a price of time on a section without a jerk limit [J/kg].

    The slabs are by distance, and by change of speed and time of the fastest run.
    """
    inputs, settings = section.inputs, section.inputs.settings
    free = section.without_places()
    places, fastest = free.grid.places, free.energy_profile()
    shares = (free.grid.steps, np.abs(np.diff(np.sqrt(2.0 * fastest))), durations(fastest, free.grid.steps))
    share = np.concatenate(([0.0], np.cumsum([part / max(float(part.sum()), 1e-9) for part in shares], axis=1).sum(0)))
    border = np.searchsorted(share, np.linspace(0.0, share[-1], size.cells + 1)[:-1])
    border = np.union1d(border, np.searchsorted(places, inputs.force.steps()))
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
    table = _table(free.tables.rates, width, size.points + 3)
    service = ServiceLimits(settings.acceleration or np.inf, settings.deceleration or np.inf)
    ends = Ends(free.begin_speed**2 / 2, free.end_speed**2 / 2)
    return lambda price: float(least_value(steps, line, air, limit, table, width, service, ends, price, weights))


def _table(rates: Array, width: float, count: int) -> Array:
    """Return the table of :func:`least_value`."""
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
