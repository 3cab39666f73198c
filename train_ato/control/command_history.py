"""Commands in flight: sent and not yet in effect."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from plant_sim.compiled import compiled
from train_ato.messages.types import Array

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel


@compiled
def newest_arrived(sent: Array, unit: int, later: float, tick: float, forward: float, backward: float) -> float:
    """Return the newest command of a unit that has arrived ``later`` seconds from now [N]; the oldest if none has.

    Parameters
    ----------
    sent : Array, shape (d, units)
        Commands in flight, oldest first [N]; 0 N without one.
    unit
        Number of the unit.
    later, tick
        Time from now, and between two commands [s].
    forward, backward
        Delay of a command forwards and backwards [s].
    """
    count = len(sent)
    if count == 0:
        return 0.0
    back = max(math.ceil((min(forward, backward) - later) / tick - 1e-9), 1)
    while back < count:
        command = float(sent[count - back, unit])
        if (backward if command < 0.0 else forward) - back * tick <= later + 1e-9:
            return command
        back += 1
    return float(sent[0, unit])


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
        self.commands = np.zeros((self._length, model.n_units))

    def append(self, force: Array) -> None:
        """Add the command of a tick [N], shape (units,)."""
        if self._length:
            self.commands[:-1] = self.commands[1:]
            self.commands[-1] = force

    def replace(self, force: Array) -> None:
        """Replace the newest command by another one [N], shape (units,)."""
        if self._length:
            self.commands[-1] = force

    def in_flight(self) -> Array:
        """Return the commands in flight [N], shape (d, units)."""
        return self.commands.copy() if self._length else self.commands
