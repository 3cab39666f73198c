"""Commands under way: sent, and not yet acting."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.model import TrainModel


class SentCommands:
    """Commands that were sent and do not act yet, one per tick, oldest first."""

    def __init__(self, model: TrainModel, tick: float) -> None:
        longest = max(float(model.delay.max()), float(model.delay_brake.max()))
        self._length = math.ceil(longest / tick - 1e-9)
        self._none = np.zeros((0, model.n_units))
        self._queue: deque[Array] = deque(
            (np.zeros(model.n_units) for _ in range(self._length)), maxlen=max(1, self._length)
        )

    def push(self, force: Array) -> None:
        """Take note of a command."""
        if self._length:
            self._queue.append(force)

    def under_way(self) -> Array:
        """Return the commands under way, shape (d, units)."""
        return np.array(self._queue) if self._length else self._none
