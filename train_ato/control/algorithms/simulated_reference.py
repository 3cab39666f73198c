"""Force on the reference from a simulated train, in place of that of the rigid train.

With it a predictive law plans the deviation from the simulated train: e_v' = (F - F_c - W(v) + W(v_d))/M + d, with the
force F_c of the simulated train up to the effect of the last command. d has then only what the simulation lacks. The
forces of the rigid train lack the waves in the couplers, so that every stretch of the train counts as a disturbance.
"""

from __future__ import annotations

import numpy as np

from train_ato.messages.types import Array

SIMULATED_SHARE = 2.0
"""Gain on the position error over omega²: the speed has no cost of its own, and the position error is the integral."""
SIMULATED_WAVES = 0.01
"""Standard deviation of the speed of a unit against its train beyond the waves of the simulated train [m/s]."""


def follow_simulation(required: Array, simulated: Array, count: int) -> Array:
    """Return the total force on the reference [N], that of the simulated train up to the effect of the last command.

    Parameters
    ----------
    required : Array, shape (h,)
        Force of the rigid train [N].
    simulated : Array, shape (k,)
        Force of the simulated train at the first times [N]; without entries ``required`` is returned.
    count
        Number of times up to the effect of the last command; beyond k the last difference of the forces lasts.
    """
    if not simulated.size:
        return required
    known = min(simulated.size, count)
    lasting = simulated[known - 1] - required[known - 1]
    return np.concatenate((simulated[:known], required[known:count] + lasting, required[count:]))
