"""State of a train in the arrays of the kernel, read as numbers per vehicle, per unit and of the whole train."""

from __future__ import annotations

import numpy as np

from plant_sim import kernel as k
from plant_sim.packing import Arrays
from plant_sim.states import Array
from plant_sim.totals import kinetic_energy


class KernelState:
    """Present state of a train.

    Parameters
    ----------
    arrays
        Arrays of the kernel; every call of the kernel changes them.
    n
        Number of vehicles.
    """

    def __init__(self, arrays: Arrays, n: int) -> None:
        self.arrays, self.n = arrays, n

    @property
    def position(self) -> Array:
        """Centre of every vehicle [m], shape (n,)."""
        return self.arrays.state[k.X, : self.n].copy()

    @property
    def velocity(self) -> Array:
        """Speed of every vehicle [m/s], shape (n,)."""
        return self.arrays.state[k.V, : self.n].copy()

    @property
    def coupler_force(self) -> Array:
        """Force of the coupler behind every vehicle [N], shape (n,); the last is 0."""
        return self.arrays.state[k.COUPLER, 1 : self.n + 1].copy()

    @property
    def applied(self) -> Array:
        """Force of every power unit after delay, lag and limit [N], shape (units,)."""
        return np.array(self.arrays.unit[k.APPLIED])

    @property
    def shoe_force(self) -> Array:
        """Shoe force of every vehicle [N], >= 0, shape (n,)."""
        return self.arrays.state[k.SHOE_FORCE, : self.n].copy()

    @property
    def kinetic_energy(self) -> float:
        """Kinetic energy, rotating masses included [J]."""
        return kinetic_energy(self.arrays, self.n)

    @property
    def momentum(self) -> float:
        """Momentum, rotating masses included [kg m/s]."""
        return float((self.arrays.vehicle[k.MASS] * self.arrays.state[k.V, : self.n]).sum())
