"""Commands in flight: sent and not yet in effect."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from train_ato.messages.types import Array

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel


class CommandHistory:
    """Commands sent and not yet in effect, one per tick, oldest first; 0 N before the first.

    Parameters
    ----------
    model
        The nominal train; its largest delay gives the number of commands.
    tick
        Period of the loop [s].
    """

    def __init__(self, model: TrainModel, tick: float) -> None:
        longest = max(float(model.delay.max()), float(model.delay_brake.max()))
        self._length = math.ceil(longest / tick - 1e-9)
        self._commands = np.zeros((self._length, model.n_units))

    def append(self, force: Array) -> None:
        """Add the command of a tick [N], shape (units,)."""
        if self._length:
            self._commands[:-1] = self._commands[1:]
            self._commands[-1] = force

    def replace(self, force: Array) -> None:
        """Replace the newest command by another one [N], shape (units,)."""
        if self._length:
            self._commands[-1] = force

    def in_flight(self) -> Array:
        """Return the commands in flight [N], shape (d, units)."""
        return self._commands.copy() if self._length else self._commands
