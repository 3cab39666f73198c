"""Switching curves of the energy-optimal run by dynamic programming.

The run with minimum net energy in a given time minimises energy + price x time for some price of time. V(s, E) is the
value of this sum from place s with E = v²/2 to the end. It satisfies Bellman's equation. A small increase of E at s
reduces the remaining cost by -dV/dE. By traction the increase costs 1 / efficiency, and the electric brake recovers a
share of it. Traction is optimal below the speed at which -dV/dE is 1 / efficiency. The electric brake is optimal above
the speed at which -dV/dE is the recovered share. Between them the train coasts. These speeds over the place are the
switching curves. They are the complete optimal feedback, because friction brakes only keep limits (Howlett and Pudney,
"Energy-Efficient Train Control", 1995; with recovery: Scheepmaker, Goverde and Kroon, European Journal of Operational
Research 257, 2017). On a level line the first speed is a constant cruise, and the train coasts before a stop. The speed
decreases before a steep descent, so that the descent needs no braking, and increases before a climb.

All energies are divided by the inertia.  All compiled code of the value is in this file, because numba's cache detects
changes of this file only.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from plant_sim.compiled import compiled
from train_ato.messages.types import Array
from train_ato.profile.planner.passes import COAST, ELECTRIC, TRACTION

MIN_CELL = 1.0
"""Minimum mean length of a cell [m]."""
BRAKING_SLOPE = 1.5
"""Largest slope of the ceiling that attracts cells, in units of the service deceleration; steeper is a jump."""
UNREACHABLE = 1e12
"""Value of a state from which the end cannot be reached."""
MISSED_SPEED = 1e3
"""Cost of a lack of E at a place with a least speed [1]."""
MIN_SPEED = 0.05
"""Lower bound of the speed in the cost of time [m/s]."""
CEILING_GAP = 1e-3
"""Part of a grid cell of E below which the slope at the ceiling is taken from the cell below."""


@dataclass(frozen=True, slots=True)
class Resolution:
    """Largest number of cells of a section, and number of grid points of E."""

    cells: int
    points: int


class EnergyWeights(NamedTuple):
    """Cost of traction work, and gain of electric-brake work: 1 / efficiency and recovered share [1]."""

    traction: float = 1.0
    recovered: float = 0.0


class ServiceLimits(NamedTuple):
    """Service acceleration and deceleration [m/s²]."""

    acceleration: float
    deceleration: float


class StepRange(NamedTuple):
    """E by electric braking, by coasting within the deceleration limit, and by coasting alone, at the end of a step."""

    low: float
    slow: float
    coast: float


class CoarseGrid:
    """A section on a coarse grid for the dynamic programming.

    The distance determines one half of the cells. The change of the ceiling along its braking curves determines the
    other half. So a line with many limits has its cells where the limits change.

    Parameters
    ----------
    places : Array, shape (n + 1,)
        Places of the fine grid [m].
    top : Array, shape (n + 1,)
        Largest E that keeps every limit ahead, at the places.
    floor : Array, shape (n + 1,)
        Least E at the places; 0 without.
    line_mean : Array, shape (n,)
        Mean line force of every fine cell, divided by the inertia [m/s²].
    air : Array, shape (n,)
        Tunnel air of every fine cell over v² and inertia [1/m].
    table : Array
        Rows of the passes, see :mod:`train_ato.profile.planner.passes`.
    service, deceleration
        Service acceleration and deceleration [m/s²].
    end
        E at the end.
    resolution
        Numbers of cells and of grid points of E.
    """

    def __init__(
        self,
        places: Array,
        top: Array,
        floor: Array,
        *,
        line_mean: Array,
        air: Array,
        table: Array,
        service: float,
        deceleration: float,
        end: float,
        resolution: Resolution,
    ) -> None:
        length, steps = float(places[-1] - places[0]), np.diff(places)
        count = int(np.clip(length / MIN_CELL, 10, resolution.cells))
        slope = BRAKING_SLOPE * (deceleration if np.isfinite(deceleration) else 1.0)
        change = np.concatenate(([0.0], np.cumsum(np.minimum(np.abs(np.diff(top)), slope * steps))))
        share = 0.5 * (places - places[0]) / length + 0.5 * change / max(float(change[-1]), 1e-9)
        self.places: Array = np.interp(np.linspace(0.0, share[-1], count + 1), share, places)
        self.steps: Array = np.diff(self.places)

        def mean(values: Array) -> Array:
            total = np.concatenate(([0.0], np.cumsum(values * steps)))
            return np.asarray(np.diff(np.interp(self.places, places, total)) / self.steps)

        self.line_mean, self.air = mean(line_mean), mean(air)
        self.top: Array = np.interp(self.places, places, top)
        self.top[-1] = end
        self.floor: Array = np.interp(self.places, places, floor)
        self.table = table
        self.service = service
        self.deceleration = deceleration
        self.points = resolution.points

    def coasting_rate(self, energies: Array, spacing: float) -> Array:
        """Return the fall of E over the distance of a coasting train in the cell before each place [m/s²].

        Parameters
        ----------
        energies : Array, shape (n + 1,)
            E at the places.
        spacing
            Speed step of the table [m/s].
        """
        speeds = np.sqrt(2.0 * np.maximum(energies, 0.0))
        drag = np.interp(speeds, spacing * np.arange(self.table.shape[1]), self.table[COAST])
        line, air = (np.concatenate((values[:1], values)) for values in (self.line_mean, self.air))
        return np.asarray(drag + line + 2.0 * air * energies)


def switching_curve(
    grid: CoarseGrid, price: float | Array, spacing: float, weights: EnergyWeights
) -> tuple[Array, Array, Array]:
    """Return places [m], the E at them above which traction is not optimal, and that above which braking is.

    Parameters
    ----------
    price : float or Array, shape (n,)
        Price of time, power divided by inertia [W/kg], of all cells or of each; a higher price gives a faster run.
    spacing
        Speed step of the table [m/s].
    weights
        Cost of traction work and gain of electric-brake work.
    """
    energies = np.linspace(0.0, float(grid.top.max()) * (1 + 1e-9), grid.points)
    prices = np.broadcast_to(np.asarray(price, dtype=np.float64), grid.steps.shape).copy()
    traction, electric = _curves(
        energies, grid.top, grid.floor, grid.line_mean, grid.air, grid.steps, grid.table, spacing,
        ServiceLimits(grid.service, grid.deceleration), prices, weights,
    )  # fmt: skip
    return grid.places, traction, electric


@compiled
def _drag_at(table: Array, speed_step: float, energy: float) -> Any:
    """Return the resistance at an E [m/s²]."""
    place = np.sqrt(2.0 * energy) / speed_step
    j = min(int(place), table.shape[1] - 2)
    return table[COAST, j] + (place - j) * (table[COAST, j + 1] - table[COAST, j])


@compiled
def _value(values: Array, energies: Array, energy: float) -> Any:
    place = (energy - energies[0]) / (energies[2] - energies[1])
    i = min(int(place), values.size - 2)
    return values[i] + (place - i) * (values[i + 1] - values[i])


@compiled
def _value_slope(values: Array, energies: Array, energy: float) -> Any:
    """Return dV/dE, interpolated between the slopes in the middle of the cells."""
    spacing = energies[2] - energies[1]
    place = (energy - energies[0]) / spacing - 0.5
    i = min(max(int(np.floor(place)), 0), values.size - 3)
    share = min(max(place - i, 0.0), 1.0)
    low, high = values[i + 1] - values[i], values[i + 2] - values[i + 1]
    return (low + share * (high - low)) / spacing


@compiled
def _cost(
    price: float, step: float, speed: float, end: float, range_: StepRange,
    weights: EnergyWeights, values: Array, energies: Array,
) -> Any:  # fmt: skip
    """Return the cost of a step to the energy ``end``: net energy, price x time, and the value there."""
    if end <= 0.0:
        return UNREACHABLE
    low, slow, coast = range_
    work = weights.traction * max(end - coast, 0.0) - weights.recovered * min(max(slow - end, 0.0), slow - low)
    return work + price * 2.0 * step / (speed + np.sqrt(2.0 * end)) + _value(values, energies, end)


@compiled
def _least_cost(
    price: float, step: float, speed: float, least: float, most: float, range_: StepRange,
    weights: EnergyWeights, values: Array, energies: Array, speeds: Array,
) -> Any:  # fmt: skip
    """Return the least cost of a step to an energy between two ends; ``speeds`` are those of the energies [m/s]."""
    first, spacing = energies[0], energies[2] - energies[1]
    best = min(
        _cost(price, step, speed, least, range_, weights, values, energies),
        _cost(price, step, speed, most, range_, weights, values, energies),
    )
    if least < range_.slow < most:
        best = min(best, _cost(price, step, speed, range_.slow, range_, weights, values, energies))
    low, slow, coast = range_
    lowest, highest = int((least - first) / spacing) + 1, int((most - first) / spacing)
    for q in range(max(lowest, 1), min(highest, energies.size - 1) + 1):
        end = energies[q]
        work = weights.traction * max(end - coast, 0.0) - weights.recovered * min(max(slow - end, 0.0), slow - low)
        best = min(best, work + price * 2.0 * step / (speed + speeds[q]) + values[q])
    return min(best, UNREACHABLE)


@compiled
def _marginal_cost(
    price: float, step: float, speed: float, slow: float, weight: float, values: Array, energies: Array
) -> Any:
    """Return the marginal cost of more energy than by coasting, minus its benefit; < 0: traction is optimal."""
    if slow <= 0.0:
        return -1.0
    u = np.sqrt(2.0 * slow)
    quicker = price * 2.0 * step / ((speed + u) ** 2 * max(u, MIN_SPEED))
    return weight - quicker + _value_slope(values, energies, slow)


@compiled
def _step_range(
    energy: float, place: float, step: float, line: float, table: Array, service: ServiceLimits, recovered: float
) -> Any:  # fmt: skip
    """Return the E at the end of a step by traction, and those at its end without traction."""
    j = min(int(place), table.shape[1] - 2)
    pull = table[TRACTION, j] + (place - j) * (table[TRACTION, j + 1] - table[TRACTION, j])
    drag = table[COAST, j] + (place - j) * (table[COAST, j + 1] - table[COAST, j])
    brake = table[ELECTRIC, j] + (place - j) * (table[ELECTRIC, j + 1] - table[ELECTRIC, j])
    slow = energy - step * min(service.deceleration, drag + line)
    low = min(energy - step * min(service.deceleration, brake + line), slow) if recovered > 0.0 else slow
    coast = energy - step * (drag + line)
    return energy + step * min(service.acceleration, pull - line), StepRange(low, slow, coast)


@compiled
def _curves(
    energies: Array, top: Array, floor: Array, line_mean: Array, air: Array, steps: Array, table: Array,
    speed_step: float, service: ServiceLimits, prices: Array, weights: EnergyWeights,
) -> tuple[Array, Array]:  # fmt: skip
    """Return both switching curves."""
    n, m = steps.size, energies.size
    spacing, gap = energies[1], weights.traction - weights.recovered
    ahead, here = energies.copy(), energies.copy()
    speeds = np.sqrt(2.0 * energies)
    values, new, marginal, ends = np.zeros(m), np.empty(m), np.empty(2 * m), np.empty(2 * m)
    curve, onset = np.empty(n + 1), np.empty(n + 1)
    shift = 0.0
    for k in range(n - 1, -1, -1):
        step, ceiling, price, free = steps[k], top[k + 1], prices[k], 0
        shift -= step * (_drag_at(table, speed_step, top[k]) + line_mean[k] + 2.0 * air[k] * top[k])
        for i in range(m):
            here[i] = energies[i] - shift % spacing
        for i in range(m):
            if i > 1 and here[i - 1] > top[k]:
                new[i] = 2.0 * new[i - 1] - new[i - 2]
                continue
            energy = min(max(here[i], 0.0), top[k])
            speed = np.sqrt(2.0 * energy)
            line = line_mean[k] + 2.0 * air[k] * energy
            fast, range_ = _step_range(energy, speed / speed_step, step, line, table, service, weights.recovered)
            low, slow, coast = range_
            fast = min(fast, ceiling)
            end = fast if fast > slow else min(slow, ceiling)  # braking to the ceiling, or no traction
            if k == n - 1 and ceiling <= 0.0:  # the stop
                new[i] = price * 2.0 * step / max(speed, MIN_SPEED) + weights.traction * max(-coast, 0.0)
                new[i] -= weights.recovered * min(max(slow, 0.0), slow - low)
            elif low < end:
                new[i] = _least_cost(price, step, speed, low, end, range_, weights, values, ahead, speeds)
            else:
                new[i] = _cost(price, step, speed, end, range_, weights, values, ahead)
            if slow < ceiling:
                marginal[free] = _marginal_cost(price, step, speed, slow, weights.traction, values, ahead)
                ends[free] = slow
                free += 1
            new[i] += MISSED_SPEED * max(floor[k] - energy, 0.0)
            if here[i] > top[k]:  # straight on from the value at the ceiling, or its slope would be too small
                last = i - 1 if i > 0 and top[k] - here[i - 1] > CEILING_GAP * spacing else i - 2
                if last >= 0 and max(new[i], new[last]) < UNREACHABLE:
                    new[i] += (new[i] - new[last]) / (top[k] - here[last]) * (here[i] - top[k])
        if free > 0:  # states that the ceiling keeps out of reach of coasting: the switching place is within the cell
            for i in range(1, m - 1):
                if ends[free - 1] + 0.1 * spacing < ahead[i] < ceiling:
                    marginal[free] = _marginal_cost(
                        price, step, np.sqrt(2.0 * top[k]), ahead[i], weights.traction, values, ahead
                    )
                    ends[free] = ahead[i]
                    free += 1
        values, new, ahead, here = new, values, here, ahead
        for i in range(m):
            speeds[i] = np.sqrt(2.0 * max(ahead[i], 0.0))
        unlimited = 4.0 * energies[-1]
        curve[k + 1] = _switching_energy(marginal[:free], ends, 0.0, unlimited)
        onset[k + 1] = _switching_energy(marginal[:free], ends, gap, unlimited)
    curve[0], onset[0], curve[n], onset[n] = curve[1], onset[1], top[n], top[n]
    return curve, onset


@compiled
def _switching_energy(marginal: Array, ends: Array, level: float, unlimited: float) -> Any:
    """Return the largest E at the end of a cell at which the marginal cost is below a level.

    The states without braking to the ceiling are in the order of E; if the cost of all is below the level, the result
    is ``unlimited``.
    """
    i = marginal.size - 1
    if i < 0 or marginal[i] < level:
        return unlimited
    while i > 0 and marginal[i - 1] >= level:
        i -= 1
    if i == 0:
        return 0.0
    share = (level - marginal[i - 1]) / (marginal[i] - marginal[i - 1])
    return max(ends[i - 1] + share * (ends[i] - ends[i - 1]), 0.0)
