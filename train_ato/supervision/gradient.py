"""Acceleration by the gradient under a train: SUBSET-026, 3.13.4."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from train_ato.supervision.fixed_values import STANDARD_GRAVITY, FixedValues
from train_ato.supervision.step_function import StepFunction


def lowest_under_train(grades: Sequence[tuple[float, float]], length: float) -> StepFunction:
    """Return the lowest grade between front and rear over the position of the front: 3.13.4.2.

    Parameters
    ----------
    grades
        Pairs of start [m] and grade [‰, > 0 uphill] by rising start; the last one is open-ended. The grade before the
        first start is 0 (3.13.4.1.3).
    length
        Length of the train [m].
    """
    if not grades:
        return StepFunction.constant(0.0)
    local = StepFunction(tuple(start for start, _ in grades), (0.0, *(value for _, value in grades)))
    bounds = sorted({*local.bounds, *(bound + length for bound in local.bounds)})
    middles = [bounds[0] - 1.0, *((a + b) / 2 for a, b in pairwise(bounds)), bounds[-1] + 1.0]
    lowest = []
    first = last = 0  # pieces under rear and front; both only move forward
    for front in middles:
        while last < len(local.bounds) and local.bounds[last] < front:
            last += 1
        while first < len(local.bounds) and local.bounds[first] <= front - length:
            first += 1
        lowest.append(min(local.values[first : last + 1]))
    return _merged(bounds, lowest)


def _merged(bounds: Sequence[float], values: Sequence[float]) -> StepFunction:
    """Return a step function without bounds between equal values."""
    kept = [i for i in range(len(bounds)) if values[i] != values[i + 1]]
    return StepFunction(tuple(bounds[i] for i in kept), (values[0], *(values[i + 1] for i in kept)))


def gradient_acceleration(
    grades: Sequence[tuple[float, float]], length: float, m_rotating_nom: float | None, fixed: FixedValues
) -> StepFunction:
    """Return the deceleration by the gradient [m/s²] over the position of the front [m]: 3.13.4.3.2.

    Parameters
    ----------
    grades
        As in :func:`lowest_under_train`.
    length
        Length of the train [m].
    m_rotating_nom
        Nominal rotating mass [% of the mass]; None: the fixed values for uphill and downhill.
    fixed
        Fixed values.
    """
    lowest = lowest_under_train(grades, length)

    def acceleration(grade: float) -> float:
        rotating = m_rotating_nom
        if rotating is None:
            rotating = fixed.m_rotating_max if grade > 0 else fixed.m_rotating_min
        return STANDARD_GRAVITY * grade / (1000.0 + 10.0 * rotating)

    return StepFunction(lowest.bounds, tuple(acceleration(grade) for grade in lowest.values))
