"""Gaussian radial-basis-function network: a hidden layer of bells, a linear output."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import mul

CENTRES = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""The five centres that papers 000 and 001 use, up to a scale."""


def bells(inputs: Sequence[float], centres: Sequence[float], width: float) -> list[float]:
    """Return h_j = exp(-|x - c_j|²/(2 b²)) with c_j the point whose coordinates are all ``centres[j]``.

    Parameters
    ----------
    inputs
        x, any number of coordinates.
    centres
        One number per bell.
    width
        b > 0.
    """
    scale, exp = -0.5 / (width * width), math.exp
    if len(inputs) == 1:
        x = inputs[0]
        return [exp(scale * (x - centre) * (x - centre)) for centre in centres]
    if len(inputs) == 2:
        x, y = inputs
        return [exp(scale * ((x - c) * (x - c) + (y - c) * (y - c))) for c in centres]
    return [exp(scale * sum([(x - centre) * (x - centre) for x in inputs])) for centre in centres]


class Weights:
    """Weights of the output layer, bounded, learning by steps with or without momentum.

    Parameters
    ----------
    start
        Weights at the start.
    bound
        Largest magnitude of a weight; learning can never take one beyond it.
    momentum
        alpha in w(l) = w(l-1) + dw + alpha (w(l-1) - w(l-2)).
    """

    def __init__(self, start: Sequence[float], bound: float, momentum: float = 0.0) -> None:
        self._start = list(start)
        self._bound = bound
        self._momentum = momentum
        self.reset()

    def reset(self) -> None:
        """Go back to the weights of the start."""
        self.values = list(self._start)
        self._moved = [0.0] * len(self._start)

    def output(self, hidden: Sequence[float]) -> float:
        """Return W'h."""
        total: float = sum(map(mul, self.values, hidden))
        return total

    def learn(self, rate: float, hidden: Sequence[float]) -> None:
        """Move every weight by ``rate h_j`` and the momentum of the last move."""
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
