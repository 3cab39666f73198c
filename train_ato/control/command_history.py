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


def commands_in_flight(model: TrainModel, tick: float) -> Array:
    """Return the commands that are not yet in effect, one per tick, oldest first: 0 N before the first one.

    Their number, shape (d, units), follows from the largest delay of a train and the period of the loop [s].
    """
    longest = max(float(model.delay.max()), float(model.delay_brake.max()))
    return np.zeros((math.ceil(longest / tick - 1e-9), model.n_units))
