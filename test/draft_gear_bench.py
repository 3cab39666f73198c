"""One draft gear alone: its force along a path of deflections, as on a test bench."""

from __future__ import annotations

import numpy as np

from plant_sim import kernel as k
from plant_sim.gears import DraftGear, RigidGear
from plant_sim.packing import pack_gears
from plant_sim.states import Array


def force_along(gear: DraftGear, deflection: Array, step: float) -> Array:
    """Return the force of a relaxed gear that is moved along a path.

    Parameters
    ----------
    gear : DraftGear
        Any kind but a rigid one.
    deflection : Array, shape (m,)
        Deflection of the coupling at every step [m], slack included, > 0 draft; starts relaxed at 0.
    step : float
        Time between entries [s]; gives the rates.

    Returns
    -------
    Array, shape (m,)
        Force [N], > 0 draft.

    Raises
    ------
    ValueError
        If the gear is rigid: it has no path.

    Examples
    --------
    >>> from plant_sim.gears import LinearGear
    >>> float(force_along(LinearGear(kind="linear", stiffness=1e6), np.array([0.0, 0.01]), 1.0)[-1])
    10000.0
    """
    if isinstance(gear, RigidGear):
        raise ValueError("a rigid gear has no deflection to move along")
    columns, table, run, _ = pack_gears([gear], 2)
    rate = np.diff(deflection, prepend=deflection[:1]) / step
    state, vehicle = np.zeros((k.STATE_ROWS, 3)), np.zeros((k.VEHICLE_ROWS, 2))
    path = np.ascontiguousarray(deflection, dtype=np.float64)
    return np.asarray(k.force_along(path, rate, state, vehicle, columns, table, run))
