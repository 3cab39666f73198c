"""The planner's compiled passes over the way of the front.

All work with E = v²/2, since dE/ds = a: constant acceleration over a cell is a straight line.  Accelerations are per
inertial mass.  ``table`` rows over the speed: traction less resistance, brake plus resistance, resistance, all over
the inertial mass.  All compiled code of the passes stands in this one file: numba's cache notices changes here only.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from plant_sim.compiled import compiled
from train_ato.types import Array

__all__ = ["backward", "clip_peaks", "durations", "forward", "spread"]

TRACTION, BRAKE, COAST = range(3)


@compiled
def _read(table: Array, row: int, energy: float, spacing: float) -> Any:
    place = np.sqrt(2.0 * max(energy, 0.0)) / spacing
    k = min(int(place), table.shape[1] - 2)
    return table[row, k] + (place - k) * (table[row, k + 1] - table[row, k])


@compiled
def backward(
    limit: Array, table: Array, spacing: float, down: Array, flat: Array, steps: Array,
    service: float, end_energy: float, coast_above: float,
) -> tuple[Array, int]:  # fmt: skip
    """Return the largest E from which every limit ahead can still be kept, and where none is left (or -1).

    Parameters
    ----------
    limit : Array, shape (n + 1,)
        E of the speed limit of the whole train.
    down, flat : Array, shape (n,)
        Smallest and mean line force over every cell, over the inertial mass [m/s²].
    steps : Array, shape (n,)
        Length of every cell [m].
    service
        Largest deceleration [m/s²].
    coast_above
        E above which the train only coasts towards what lies ahead; inf: it always brakes.
    """
    n = limit.size - 1
    energy = limit.copy()
    energy[n] = min(limit[n], end_energy)
    for k in range(n - 1, -1, -1):
        at = energy[k + 1]
        for stage in range(2):
            rate = min(service, _read(table, BRAKE, at, spacing) + down[k])
            if at > coast_above:
                own = _read(table, COAST, at, spacing)
                coast = own + flat[k]
                if coast > 0.25 * own:
                    rate = min(rate, coast)
            at = energy[k + 1] + (0.5 if stage == 0 else 1.0) * steps[k] * rate
        if at <= 0.0 and k > 0:
            return energy, k
        energy[k] = min(energy[k], max(at, 0.0))
    return energy, -1


@compiled
def forward(
    ceiling: Array, table: Array, spacing: float, up: Array, flat: Array, down: Array, steps: Array,
    service: float, service_down: float, begin_energy: float, cut_off: Array,
) -> tuple[Array, int]:  # fmt: skip
    """Return E of the fastest run under a ceiling from the backward pass, and the cell in which it stalls (or -1).

    Above ``cut_off``, E at every place, the train has no traction: it holds that speed, or coasts where it would gain
    speed by itself or the cut-off falls faster.  A train that is above the ceiling brakes as it can until it is not.
    """
    n = ceiling.size - 1
    energy = np.empty(n + 1)
    energy[0] = begin_energy
    for k in range(n):
        at = energy[k]
        above = energy[k] > ceiling[k] * (1.0 + 1e-9) + 1e-12
        for stage in range(2):
            if above:
                rate = -min(service_down, _read(table, BRAKE, at, spacing) + down[k])
            else:
                rate = min(service, _read(table, TRACTION, at, spacing) - up[k])
            last = at
            at = energy[k] + (0.5 if stage == 0 else 1.0) * steps[k] * rate
        if at > cut_off[k + 1]:
            coast = energy[k] - steps[k] * (_read(table, COAST, last, spacing) + flat[k])
            at = min(at, max(coast, cut_off[k + 1]))
        at = max(at, min(ceiling[k + 1], energy[k])) if above else min(at, ceiling[k + 1])
        if at <= 0.0 and (k + 1 < n or ceiling[n] > 0.0):
            return energy, k
        energy[k + 1] = max(at, 0.0)
    return energy, -1


@compiled
def durations(energy: Array, steps: Array) -> Array:
    """Return the time every cell takes [s], shape (n,); constant acceleration in each."""
    n = energy.size - 1
    time = np.empty(n)
    for k in range(n):
        time[k] = 2.0 * steps[k] / (np.sqrt(2.0 * energy[k]) + np.sqrt(2.0 * energy[k + 1]))
    return time


@compiled
def spread(values: Array, width: Array, places: Array, largest: bool) -> Array:
    """Return the largest (or smallest) value within ``width`` on either side of every cell, n log n.

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
def clip_peaks(energy: Array, places: Array, hold: float, jump: float) -> int:
    """Flatten, in place, every peak where the acceleration would fall by more than ``jump`` in less than ``hold`` s.

    The speed of the flat part is the highest that lasts ``hold``, or that of a dip beside the peak.  Returns how many
    peaks were flattened.
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
        reach = hold * np.sqrt(2.0 * cap)
        rise, fall = 0.0, 0.0
        i = left
        while i > 0 and places[right] - places[i] < reach:
            rise = max(rise, (energy[i] - energy[i - 1]) / (places[i] - places[i - 1]))
            i -= 1
        i = right
        while i < n and places[i] - places[left] < reach:
            fall = max(fall, (energy[i] - energy[i + 1]) / (places[i + 1] - places[i]))
            i += 1
        if rise + fall > jump and fall > 0.0:
            while places[right] - places[left] < hold * np.sqrt(2.0 * cap) and left > 0 and right < n:
                before, after = energy[left - 1], energy[right + 1]
                if before > cap or after > cap:  # a dip: from or into it the run goes on without the peak
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
