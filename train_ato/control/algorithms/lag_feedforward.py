"""Force demand of every unit that gives a required total force through delay and lag.

Through the lag Ta the command is F + Ta F'. The line force of a train of wagons is a staircase, one step for every
wagon at a change of the grade, and F' of a step is an impulse. With hauled vehicles the command is therefore F at the
time Ta later, equal to F + Ta F' for a steady slope.
"""

from __future__ import annotations

import numpy as np

from train_ato.messages.types import Array


def feedforward(required: Array, actuators: Array, tick: float, lag: float, later: float) -> list[float]:
    """Return F + Ta F' at the time of effect of every unit [N].

    Parameters
    ----------
    required : Array, shape (entries,)
        Required total force at every tick from now on [N].
    actuators : Array, shape (3, units)
        Delay in traction and braking [s], share of the force.
    tick, lag
        s.
    later
        Time after the begin of the effect, half of a control period [s].
    """
    table = required.tolist()
    found = []
    for share, forward, backward in zip(*actuators[[2, 0, 1]].tolist(), strict=True):
        force = _through_lag(table, (forward + later) / tick, lag / tick)
        if force < 0.0 and backward != forward:
            force = min(0.0, _through_lag(table, (backward + later) / tick, lag / tick))
        found.append(force * share)
    return found


def hauled_feedforward(times: Array, forces: Array, actuators: Array, later: float) -> list[float]:
    """Return the required force of every unit at the time of its effect and the lag later [N].

    Parameters
    ----------
    times, forces : Array, shape (entries,)
        Rising times from now on [s] and required total force there [N].
    actuators : Array, shape (3, units)
        Delay in traction and braking [s], share of the force.
    later
        Half of a control period and the lag [s].
    """
    found = []
    for share, forward, backward in zip(*actuators[[2, 0, 1]].tolist(), strict=True):
        force = float(np.interp(forward + later, times, forces))
        if force < 0.0 and backward != forward:
            force = min(0.0, float(np.interp(backward + later, times, forces)))
        found.append(force * share)
    return found


def _through_lag(table: list[float], place: float, lag: float) -> float:
    """Return F + Ta F' at a place of a table, with the lag in entries."""
    index = min(int(place + 1e-9), len(table) - 2)
    rise = table[index + 1] - table[index]
    return table[index] + (place - index) * rise + lag * rise
