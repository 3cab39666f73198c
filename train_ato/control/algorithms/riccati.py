"""Steady-state gains of linear-quadratic regulator and Kalman filter, by the Riccati difference equation.

    S = Q + A'S (A - B K),   K = (R + B'S B)⁻¹ B'S A

begins at S = Q and ends when K no longer changes: the first command of a horizon so long that its end has no effect
(Anderson and Moore 1990, Optimal Control: Linear Quadratic Methods, section 2.4). Modes without a cost keep S = 0, so
that they need not be stable. The loops are compiled and add in order, with the same bits everywhere.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

import numpy as np

from plant_sim.compiled import compiled
from train_ato.control.algorithms.quadratic_program import inverse, matrix_product
from train_ato.messages.types import Array

MAX_STEPS = 50000
"""Largest number of steps of the difference equation."""
CHANGE = 1e-11
"""Change of a gain in one step, over the largest one, below which the gains are final."""


@compiled
def difference_equation(a, a_transposed, b, b_transposed, cost, weight):
    """Return the gain K, shape (inputs, states), and S, shape (states, states), of the steady state."""
    final = cost.copy()
    last = np.zeros((b.shape[1], a.shape[0]))
    for _ in range(MAX_STEPS):
        ahead, through = matrix_product(final, a), matrix_product(final, b)
        gain = matrix_product(
            inverse(weight + matrix_product(b_transposed, through)), matrix_product(b_transposed, ahead)
        )
        ahead -= matrix_product(through, gain)
        final = cost + matrix_product(a_transposed, ahead)
        largest, change = 0.0, 0.0
        for i in range(gain.shape[0]):
            for j in range(gain.shape[1]):
                largest = max(largest, abs(gain[i, j]))
                change = max(change, abs(gain[i, j] - last[i, j]))
        for i in range(final.shape[0]):
            for j in range(i):
                final[i, j] = final[j, i] = 0.5 * (final[i, j] + final[j, i])
        if change <= CHANGE * largest:
            break
        last = gain
    return gain, final


def regulator_gain(a: Array, b: Array, cost: Array, weight: Array) -> Array:
    """Return the gain K of u = -K x with the smallest sum of x'Qx + u'Ru for x+ = A x + B u.

    Parameters
    ----------
    a, b : Array, shape (states, states) and (states, inputs)
        A and B.
    cost, weight : Array, shape (states, states) and (inputs, inputs)
        Q, at least 0, and R, positive.

    Returns
    -------
    Array, shape (inputs, states)
    """
    gain: Array = _steady(a, b, cost, weight)[0]
    return gain


def filter_gain(a: Array, c: Array, process: Array, noise: Array) -> Array:
    """Return the gain L of the Kalman filter x = x- + L (y - C x-) for x+ = A x + w, y = C x + n.

    Parameters
    ----------
    a, c : Array, shape (states, states) and (outputs, states)
        A and C.
    process, noise : Array, shape (states, states) and (outputs, outputs)
        Covariances of w and n.

    Returns
    -------
    Array, shape (states, outputs)
    """
    covariance = _steady(a.T, c.T, process, noise)[1]
    spread = matrix_product(covariance, np.ascontiguousarray(c.T))
    gain: Array = matrix_product(spread, inverse(noise + matrix_product(np.ascontiguousarray(c), spread)))
    return gain


def _steady(a: Array, b: Array, cost: Array, weight: Array) -> tuple[Array, Array]:
    """Return K and S of contiguous copies of the matrices."""
    matrices = (a, a.T, b, b.T, cost, weight)
    found: tuple[Array, Array] = difference_equation(*map(np.ascontiguousarray, matrices))
    return found
