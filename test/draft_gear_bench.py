"""Force of a single draft gear along a path of deflections, as on a test bench."""

from __future__ import annotations

import numpy as np

from plant_sim import kernel as k
from plant_sim.gears import DraftGear, RigidGear
from plant_sim.packing import pack_gears
from plant_sim.states import Array


def force_along(gear: DraftGear, deflection: Array, step: float) -> Array:
    """Return the force of an initially relaxed gear along a path of deflections.

    Parameters
    ----------
    gear : DraftGear
        Any kind except a rigid one.
    deflection : Array, shape (m,)
        Deflection of the coupler at every step [m], slack included, > 0 draft; relaxed at 0.
    step : float
        Time between the entries [s], for the rates.

    Returns
    -------
    Array, shape (m,)
        Force [N], > 0 draft.

    Raises
    ------
    ValueError
        If the gear is rigid.

    Examples
    --------
    >>> from plant_sim.gears import LinearGear
    >>> float(force_along(LinearGear(kind="linear", stiffness=1e6), np.array([0.0, 0.01]), 1.0)[-1])
    10000.0
    """
    if isinstance(gear, RigidGear):
        raise ValueError("a rigid gear has no deflection; choose another kind")
    columns, table, run, _ = pack_gears([gear], 2)
    rate = np.diff(deflection, prepend=deflection[:1]) / step
    state, vehicle = np.zeros((k.STATE_ROWS, 3)), np.zeros((k.VEHICLE_ROWS, 2))
    x, v = state[k.X], state[k.V]
    force = np.empty(deflection.size)
    for j, (stretch, speed) in enumerate(zip(deflection, rate, strict=True)):
        x[0] = x[1] + vehicle[k.GAP, 0] + stretch
        v[0] = v[1] + speed
        k.coupler_forces(x, v, state, vehicle, columns, table, run, k._longest_run(run))
        force[j] = state[k.COUPLER, 1]
    return force
