"""Gaussian radial-basis-function network: a hidden layer of bells, a linear output."""

from __future__ import annotations

import math
from collections.abc import Sequence

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
    scale = -0.5 / (width * width)
    if len(inputs) == 1:
        x = inputs[0]
        return [math.exp(scale * (x - centre) * (x - centre)) for centre in centres]
    return [math.exp(scale * sum((x - centre) * (x - centre) for x in inputs)) for centre in centres]


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
        return sum(w * h for w, h in zip(self.values, hidden, strict=True))

    def learn(self, rate: float, hidden: Sequence[float]) -> None:
        """Move every weight by ``rate h_j`` and the momentum of the last move."""
        bound = self._bound
        for j, h in enumerate(hidden):
            old = self.values[j]
            new = min(max(old + rate * h + self._momentum * self._moved[j], -bound), bound)
            self._moved[j] = new - old
            self.values[j] = new
