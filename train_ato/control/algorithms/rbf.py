"""Gaussian radial-basis-function network: hidden layer of Gaussian functions, linear output."""

# mypy: allow-untyped-defs, allow-untyped-decorators

from __future__ import annotations

import math
from collections.abc import Sequence

from plant_sim.compiled import also_compiled
from plant_sim.summation import plain_dot, plain_sum
from train_ato.control.algorithms.sliding import clamped

RBF_CENTERS = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""The five centres of papers 000 and 001, up to a scale."""


def activations(inputs: Sequence[float], centres: Sequence[float], width: float) -> list[float]:
    """Return the outputs of the hidden layer, h_j = exp(-|x - c_j|²/(2 b²)).

    Parameters
    ----------
    inputs
        Point x, any number of coordinates.
    centres
        Centres; all coordinates of c_j are ``centres[j]``.
    width
        Width b > 0.
    """
    scale, exp = -0.5 / (width * width), math.exp
    if len(inputs) == 1:
        x = inputs[0]
        return [exp(scale * (x - centre) * (x - centre)) for centre in centres]
    if len(inputs) == 2:
        x, y = inputs
        return [exp(scale * ((x - c) * (x - c) + (y - c) * (y - c))) for c in centres]
    if len(inputs) == 3:
        x, y, z = inputs
        return [exp(scale * ((x - c) * (x - c) + (y - c) * (y - c) + (z - c) * (z - c))) for c in centres]
    return [exp(scale * plain_sum([(x - centre) * (x - centre) for x in inputs])) for centre in centres]


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


class Weights:
    """Bounded weights of the output layer, with learning by steps with or without momentum.

    Parameters
    ----------
    start
        Initial weights.
    bound
        Largest magnitude of a weight.
    momentum
        Factor alpha in w(l) = w(l-1) + dw + alpha (w(l-1) - w(l-2)).
    """

    def __init__(self, start: Sequence[float], bound: float, momentum: float = 0.0) -> None:
        self._start = list(start)
        self._bound = bound
        self._momentum = momentum
        self.reset()

    def reset(self) -> None:
        """Return to the initial weights."""
        self.values = list(self._start)
        self._moved = [0.0] * len(self._start)

    def output(self, hidden: Sequence[float]) -> float:
        """Return the output W'h."""
        return plain_dot(self.values, hidden)

    def learn(self, rate: float, hidden: Sequence[float]) -> None:
        """Move every weight by ``rate h_j`` plus the momentum of its last step."""
        bound, momentum, values = self._bound, self._momentum, self.values
        least = -bound
        if not momentum:
            for j, h in enumerate(hidden):
                new = values[j] + rate * h
                values[j] = new if least <= new <= bound else min(max(new, least), bound)
            return
        moved = self._moved
        for j, h in enumerate(hidden):
            old = values[j]
            new = old + rate * h + momentum * moved[j]
            if not least <= new <= bound:
                new = min(max(new, least), bound)
            moved[j] = new - old
            values[j] = new
