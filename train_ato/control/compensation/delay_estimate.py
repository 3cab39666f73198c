"""Delay of the actuators estimated while the train runs: the one that explains the measured force best."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.model import TrainModel

MEMORY = 60.0
"""Time over which the candidates' errors are remembered [s]."""
MARGIN = 0.8
"""A candidate must have less than this part of the present one's error to replace it."""


class DelayEstimate:
    """A bank of delays, each a whole number of ticks, followed by the model's lag.

    Parameters
    ----------
    model
        The nominal train; its delay is the first guess.
    longest
        Largest delay that is looked for [s].
    """

    def __init__(self, model: TrainModel, longest: float) -> None:
        self._tick = model.tick
        self._count = math.ceil(longest / model.tick) + 1
        self._keep = math.exp(-model.tick / model.lag) if model.lag > 0.0 else 0.0
        self._forget = math.exp(-model.tick / MEMORY)
        self._first = min(round(float(model.delay.mean()) / model.tick), self._count - 1)
        self.reset()

    def reset(self) -> None:
        """Go back to the first guess."""
        self._best = self._first
        self._sent: deque[Array] = deque(maxlen=self._count)
        self._modelled = np.zeros(self._count)
        self._error = np.zeros(self._count)

    @property
    def delay(self) -> float:
        """The present estimate [s]."""
        return self._best * self._tick

    def step(self, under_way: Array, applied: float, ticks: int = 1) -> Array:
        """Take the total force measured; return the commands under way by the estimate.

        Parameters
        ----------
        under_way : Array, shape (d, units)
            Commands sent, one per tick, the last one a tick ago [N].
        applied
            Total force that acts now [N].
        ticks
            Since the call before: more than one where the law is slower than the loop, or missed measurements.
        """
        for back in range(ticks, 0, -1):
            self._sent.append(np.array(under_way[-min(back, len(under_way))]))
            total = [float(command.sum()) for command in reversed(self._sent)]
            commands = np.array(total + [0.0] * (self._count - len(total)))
            self._modelled = commands + (self._modelled - commands) * self._keep
        self._error *= self._forget**ticks
        self._error += (applied - self._modelled) ** 2
        best = int(np.argmin(self._error))
        if self._error[best] < MARGIN * self._error[self._best]:
            self._best = best
        length = max(1, self._best)
        return np.array(list(self._sent)[-length:])
