"""Output layer of a radial-basis-function network, for Python and compiled code: output and learning."""

# mypy: allow-untyped-defs, allow-untyped-decorators

from plant_sim.compiled import also_compiled
from train_ato.control.algorithms.sliding import clamped

RBF_CENTERS = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""The five centres of papers 000 and 001, up to a scale."""


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
