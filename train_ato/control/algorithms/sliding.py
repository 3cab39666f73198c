"""Smooth signs, powers and networks of the sliding-mode laws and cascades, for Python and compiled code."""

# mypy: allow-untyped-defs, allow-untyped-decorators

from math import copysign

from plant_sim.compiled import also_compiled
from plant_sim.elementary import libm_pow


@also_compiled
def clamped(value, low, high):
    """Return ``min(max(value, low), high)``, with the results of Python for equal values."""
    raised = low if low > value else value
    return high if high < raised else raised


@also_compiled
def saturation(value, width):
    """Return the sign, linear within a boundary layer of ``width``; the sign itself for a width of 0."""
    if width <= 0.0:
        return 1.0 if value > 0.0 else -1.0 if value < 0.0 else 0.0
    return clamped(value / width, -1.0, 1.0)


@also_compiled
def sig(value, power):
    """Return ``|value|^power sign(value)``, written sig^p in paper 002."""
    return copysign(libm_pow(abs(value), power), value) if value != 0.0 else 0.0


RBF_CENTERS = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""The five centres of the radial-basis-function networks of papers 000 and 001, up to a scale."""


@also_compiled
def weighted(weights, hidden):
    """Return the output W'h of a network, added in order."""
    total = 0.0
    for j in range(len(hidden)):
        total += weights[j] * hidden[j]
    return total


@also_compiled
def move_weights(weights, moved, hidden, rate, momentum, bound):
    """Move every weight w by ``rate h`` plus ``momentum`` times its last step ``moved``, within +-``bound``.

    With w(l) = w(l-1) + dw + alpha (w(l-1) - w(l-2)), alpha the momentum.
    """
    for j in range(len(hidden)):
        old = weights[j]
        new = old + rate * hidden[j]
        if momentum != 0.0:
            new = new + momentum * moved[j]
        weights[j] = clamped(new, -bound, bound)
        if momentum != 0.0:
            moved[j] = weights[j] - old
