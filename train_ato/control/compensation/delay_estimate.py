"""Online estimate of the actuator delay from the commands sent and the measured force."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from train_ato.messages.types import Array

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel

MEMORY_TIME = 60.0
"""Time constant of the error sums of the candidates [s]."""
SWITCH_RATIO = 0.8
"""Error sum of a new delay over that of the present one, below which the estimate switches."""


class DelayEstimate:
    """Bank of candidate delays, each a whole number of ticks, followed by the lag of the model.

    Parameters
    ----------
    model
        The nominal train; its delay is the initial estimate.
    longest
        Largest candidate [s].
    """

    def __init__(self, model: TrainModel, longest: float) -> None:
        self._tick = model.tick
        self._count = math.ceil(longest / model.tick) + 1
        self._lag_decay = math.exp(-model.tick / model.lag) if model.lag > 0.0 else 0.0
        self._error_decay = math.exp(-model.tick / MEMORY_TIME)
        self._first = min(round(float(model.delay.mean()) / model.tick), self._count - 1)
        self.reset()

    def reset(self) -> None:
        """Return to the initial estimate."""
        self._best = self._first
        self._sent: deque[Array] = deque(maxlen=self._count)
        self._modelled = np.zeros(self._count)
        self._error = np.zeros(self._count)

    @property
    def delay(self) -> float:
        """Present estimate [s]."""
        return self._best * self._tick

    def step(self, commands_in_flight: Array, applied: float, ticks: int = 1) -> Array:
        """Update the estimate; return the commands in flight for the estimated delay [N], shape (d', units).

        Parameters
        ----------
        commands_in_flight : Array, shape (d, units)
            Commands sent, one per tick, the last one a tick ago [N].
        applied
            Measured total force [N].
        ticks
            Ticks since the previous call: more than one for a law slower than the loop, or after missed samples.
        """
        for back in range(ticks, 0, -1):
            self._sent.append(np.array(commands_in_flight[-min(back, len(commands_in_flight))]))
            total = [float(command.sum()) for command in reversed(self._sent)]
            commands = np.array(total + [0.0] * (self._count - len(total)))
            self._modelled = commands + (self._modelled - commands) * self._lag_decay
        self._error *= self._error_decay**ticks
        self._error += (applied - self._modelled) ** 2
        best = int(np.argmin(self._error))
        if self._error[best] < SWITCH_RATIO * self._error[self._best]:
            self._best = best
        length = max(1, self._best)
        return np.array(list(self._sent)[-length:])
