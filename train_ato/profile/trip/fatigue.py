"""Fatigue of the couplers: rainflow cycles after ASTM E1049 and their damage after Miner.

The cycles are those of the library `rainflow`; the force is reduced to its reversals first, which does not change the
cycles and is 100 times faster. Damage is relative: the sum of (range / 1 MN)^k over all cycles, half cycles half, with
the slope k = 5 of the S-N curve of steel without welds (FKM guideline "Analytical strength assessment").
"""

from __future__ import annotations

import numpy as np

from train_ato.messages.types import Array

SLOPE = 5.0
"""Slope of the S-N curve of steel without welds."""
REFERENCE_RANGE = 1e6
"""Range of a cycle of damage 1 [N]."""
MIN_RANGE = 20e3
"""Cycles below this range are omitted [N]: 2 % of the reference range, damage 3e-9."""


def coupler_damage(force: Array, slope: float = SLOPE) -> Array:
    """Return the damage of every coupler, 1 per cycle with a range of 1 MN.

    Parameters
    ----------
    force : Array, shape (n, couplers)
        Coupler forces at increasing times [N].
    slope
        Slope k of the S-N curve.

    Returns
    -------
    Array, shape (couplers,)
        Sum over the cycles of count times (range / 1 MN)^k.
    """
    import rainflow

    found = np.zeros(force.shape[1])
    for number in range(force.shape[1]):
        points = reversals(force[:, number])
        cycles = np.array([(size, count) for size, _, count, _, _ in rainflow.extract_cycles(points)]).reshape(-1, 2)
        large = cycles[:, 0] >= MIN_RANGE
        found[number] = ((cycles[large, 0] / REFERENCE_RANGE) ** slope * cycles[large, 1]).sum()
    return found


def reversals(series: Array) -> Array:
    """Return first and last value and the local extremes of a series."""
    if series.size < 3:
        return series
    step = np.diff(series)
    kept = np.concatenate(([True], step != 0.0))
    values = series[kept]
    turning = np.sign(np.diff(values))
    inner = np.flatnonzero(turning[1:] != turning[:-1]) + 1
    return np.asarray(values[np.concatenate(([0], inner, [values.size - 1]))])
