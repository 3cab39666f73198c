"""Backward and forward pass of the planner over the place of the front, compiled.

The passes use E = v²/2, since dE/ds = a: constant acceleration over a cell is a straight line.  The rows of ``table``
over the speed are traction minus resistance, brake plus resistance, resistance, and electric brake plus resistance,
each divided by the inertia [m/s²].
All compiled code of the passes is in this file, because numba's cache detects changes of this file only.

``reserves`` are the fractions of traction and brakes that are not used. It has the fractions of every cell (2, n), of
limits by place over the speed (rows, 2, columns), and the row of every cell (n,). Without limits by place there are no
rows.
"""

from typing import Any

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.packing import Integers
from train_ato.messages.types import Array

Reserves = tuple[Array, Array, Integers]
"""Reserves of the cells, rows of limits by place over the speed, and row of every cell."""
TRACTION, BRAKE, COAST, ELECTRIC = range(4)
BALANCE_STEPS = 40
"""Bisections of a balancing speed."""


@compiled
def _read(table: Array, row: int, energy: float, spacing: float) -> Any:
    place = np.sqrt(2.0 * max(energy, 0.0)) / spacing
    k = min(int(place), table.shape[1] - 2)
    return table[row, k] + (place - k) * (table[row, k + 1] - table[row, k])


@compiled
def _reduced(table: Array, row: int, energy: float, spacing: float, reserves: Reserves, cell: int) -> Any:
    """Return the acceleration of a row with the reserve of a cell."""
    rate, side = _read(table, row, energy, spacing), min(row, BRAKE)
    cells, placed, which = reserves
    reserve = cells[side, cell]
    if placed.shape[0] > 0:
        reserve = 1.0 - (1.0 - reserve) * (1.0 - _read(placed[which[cell]], side, energy, spacing))
    if reserve <= 0.0:
        return rate
    resistance = _read(table, COAST, energy, spacing)
    return rate - reserve * (rate + resistance if row == TRACTION else rate - resistance)


@compiled
def _at_balance(
    table: Array, spacing: float, reserves: Reserves, cell: int, line: float, air: float, begin: float, end: float
) -> Any:
    """Return E at the end of a cell, or E of the balancing speed if the step from ``begin`` has passed it."""
    first = _reduced(table, TRACTION, begin, spacing, reserves, cell) - line - 2.0 * air * begin
    last = _reduced(table, TRACTION, end, spacing, reserves, cell) - line - 2.0 * air * end
    if end <= 0.0 or first * last >= 0.0 or (end - begin) * first <= 0.0:
        return end
    for _ in range(BALANCE_STEPS):
        middle = 0.5 * (begin + end)
        if (_reduced(table, TRACTION, middle, spacing, reserves, cell) - line - 2.0 * air * middle) * first > 0.0:
            begin = middle
        else:
            end = middle
    return begin if first > 0.0 else end


@compiled
def backward(
    limit: Array, table: Array, spacing: float, line_min: Array, line_mean: Array, air: Array, steps: Array,
    reserves: Reserves, service: float, end_energy: float, coast_above: float,
) -> tuple[Array, int]:  # fmt: skip
    """Return the largest E that keeps every limit ahead, and the cell without a solution (or -1).

    Parameters
    ----------
    limit : Array, shape (n + 1,)
        E of the speed limit of the whole train.
    line_min, line_mean : Array, shape (n,)
        Minimum and mean line force of every cell, divided by the inertia [m/s²].
    air : Array, shape (3, n)
        Least, own and largest tunnel air of every cell over v² and inertia [1/m].
    steps : Array, shape (n,)
        Length of every cell [m].
    service
        Service deceleration [m/s²].
    coast_above
        E above which the train coasts before it brakes; inf: no coasting.
    """
    n = limit.size - 1
    energy = limit.copy()
    energy[n] = min(limit[n], end_energy)
    for k in range(n - 1, -1, -1):
        at = energy[k + 1]
        for stage in range(2):
            drag = 2.0 * air[0, k] * max(at, 0.0)
            rate = min(service, _reduced(table, BRAKE, at, spacing, reserves, k) + line_min[k] + drag)
            if at > coast_above:
                own = _read(table, COAST, at, spacing) + 2.0 * air[1, k] * at
                coast = own + line_mean[k]
                if coast > 0.25 * own:
                    rate = min(rate, coast)
            at = energy[k + 1] + (0.5 if stage == 0 else 1.0) * steps[k] * rate
        if at <= 0.0 and k > 0:
            return energy, k
        energy[k] = min(energy[k], max(at, 0.0))
    return energy, -1


@compiled
def forward(
    ceiling: Array, table: Array, spacing: float, line_max: Array, line_mean: Array, line_min: Array, air: Array,
    steps: Array, reserves: Reserves, service: float, service_deceleration: float, begin_energy: float,
    cut_off: Array, brake_onset: Array,
) -> tuple[Array, int]:  # fmt: skip
    """Return E of the fastest solution under the ceiling of the backward pass, and the cell of a stall (or -1).

    Above ``cut_off`` (E at every place) the train has no traction. It keeps that speed, or it coasts if the line force
    accelerates it or the cut-off decreases faster. On a climb it coasts with the service deceleration at most. Above
    ``brake_onset`` (E at every place) it uses its electric brake. Above the ceiling it brakes until it is below.
    """
    n = ceiling.size - 1
    energy = np.empty(n + 1)
    energy[0] = begin_energy
    for k in range(n):
        at = energy[k]
        above = energy[k] > ceiling[k] * (1.0 + 1e-9) + 1e-12
        for stage in range(2):
            if above:
                rate = _reduced(table, BRAKE, at, spacing, reserves, k) + line_min[k]
                rate = -min(service_deceleration, rate + 2.0 * air[0, k] * max(at, 0.0))
            else:
                rate = _reduced(table, TRACTION, at, spacing, reserves, k) - line_max[k]
                rate = min(service, rate - 2.0 * air[2, k] * max(at, 0.0))
            last = at
            at = energy[k] + (0.5 if stage == 0 else 1.0) * steps[k] * rate
        if not above:
            at = _at_balance(table, spacing, reserves, k, line_max[k], air[2, k], energy[k], at)
        if at > cut_off[k + 1]:
            line = line_mean[k] + 2.0 * air[1, k] * max(last, 0.0)
            coast = energy[k] - steps[k] * min(service_deceleration, _read(table, COAST, last, spacing) + line)
            if coast > brake_onset[k + 1]:
                rate = _reduced(table, ELECTRIC, last, spacing, reserves, k) + line
                braked = energy[k] - steps[k] * min(service_deceleration, rate)
                coast = min(coast, max(braked, brake_onset[k + 1]))
            at = min(at, max(coast, cut_off[k + 1]))
        at = max(at, min(ceiling[k + 1], energy[k])) if above else min(at, ceiling[k + 1])
        if at <= 0.0 and (k + 1 < n or ceiling[n] > 0.0):
            return energy, k
        energy[k + 1] = max(at, 0.0)
    return energy, -1


@compiled
def traction_floor(
    energy: float, last: int, table: Array, spacing: float, line_max: Array, air: Array, steps: Array,
    reserves: Reserves, service: float,
) -> Array:  # fmt: skip
    """Return the least E at every place from which full traction reaches an E at a later place, shape (n + 1,).

    Parameters
    ----------
    energy, last
        E, and the place at which it is needed; the floor is 0 behind it.
    """
    floor = np.zeros(steps.size + 1)
    floor[last] = energy
    for k in range(last - 1, -1, -1):
        rate = _reduced(table, TRACTION, floor[k + 1], spacing, reserves, k) - line_max[k]
        rate = min(service, rate - 2.0 * air[2, k] * floor[k + 1])
        floor[k] = floor[k + 1] - steps[k] * rate
        if floor[k] <= 0.0:
            floor[k] = 0.0
            break
    return floor


@compiled
def durations(energy: Array, steps: Array) -> Array:
    """Return the running time of every cell [s], shape (n,), at constant acceleration."""
    n = energy.size - 1
    time = np.empty(n)
    for k in range(n):
        time[k] = 2.0 * steps[k] / (np.sqrt(2.0 * energy[k]) + np.sqrt(2.0 * energy[k + 1]))
    return time


@compiled
def sliding_extreme(values: Array, width: Array, places: Array, largest: bool) -> Array:
    """Return the maximum (or minimum) of the values within ``width`` on either side of every cell, in n log n.

    ``places`` are the borders of the cells, one more than values.
    """
    n = values.size
    sign = 1.0 if largest else -1.0
    levels = 1
    while (1 << levels) <= n:
        levels += 1
    best = np.empty((levels, n))
    best[0] = sign * values
    for level in range(1, levels):
        half = 1 << (level - 1)
        for k in range(n - 2 * half + 1):
            best[level, k] = max(best[level - 1, k], best[level - 1, k + half])
    result = np.empty(n)
    for k in range(n):
        low = max(0, np.searchsorted(places, places[k] - width[k], side="right") - 1)
        high = min(n, np.searchsorted(places, places[k + 1] + width[k], side="left"))
        level = 0
        while (2 << level) <= high - low:
            level += 1
        result[k] = sign * max(best[level, low], best[level, high - (1 << level)])
    return result


@compiled
def flatten_peaks(energy: Array, places: Array, min_duration: float, max_change: float) -> int:
    """Flatten peaks of E in place and return their number.

    A peak is flattened where the acceleration decreases by more than ``max_change`` [m/s²] within ``min_duration`` [s].
    The speed of the flat part is the highest that lasts ``min_duration``, or that of a dip beside the peak.
    """
    n = energy.size - 1
    clipped, k = 0, 1
    while k < n:
        if not (energy[k] > energy[k - 1] and energy[k] >= energy[k + 1]):
            k += 1
            continue
        left, right = k, k
        while right < n and abs(energy[right + 1] - energy[k]) <= 1e-9 * energy[k]:
            right += 1
        if right < n and energy[right + 1] > energy[k]:
            k = right + 1
            continue
        cap = energy[k]
        distance = min_duration * np.sqrt(2.0 * cap)
        rise, fall = 0.0, 0.0
        i = left
        while i > 0 and places[right] - places[i] < distance:
            rise = max(rise, (energy[i] - energy[i - 1]) / (places[i] - places[i - 1]))
            i -= 1
        i = right
        while i < n and places[i] - places[left] < distance:
            fall = max(fall, (energy[i] - energy[i + 1]) / (places[i + 1] - places[i]))
            i += 1
        if rise + fall > max_change and fall > 0.0:
            while places[right] - places[left] < min_duration * np.sqrt(2.0 * cap) and left > 0 and right < n:
                before, after = energy[left - 1], energy[right + 1]
                if before > cap or after > cap:  # a dip: the solution continues from it without the peak
                    break
                if before >= after:
                    left, cap = left - 1, before
                else:
                    right, cap = right + 1, after
            for i in range(left, right + 1):
                energy[i] = min(energy[i], cap)
            clipped += 1
        k = max(k + 1, right + 1)
    return clipped
