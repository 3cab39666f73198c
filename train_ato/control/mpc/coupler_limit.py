"""Range of the total force in which no coupler of the train exceeds a force, for a train without waves.

With the share s_j of the total force F, the part mu_j of the inertia and the resistance W_j of the vehicles in front of
coupler j, and a = (F - W)/M for all vehicles::

    C_j = s_j F - W_j - mu_j M a = (s_j - mu_j) F - (W_j - mu_j W)

C_j > 0 is draft. |C_j| <= L is a range of F for every coupler; the range of the train is their intersection. If it is
empty, because the grade alone exceeds L, the range is the force between the two bounds.
"""

# mypy: allow-untyped-defs

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.railway import DRY_FRICTION_SPEED, between_entries, running_resistance
from train_ato.control.train_model import GRID, TrainModel
from train_ato.messages.types import Array

MIN_PART = 1e-3
"""Smallest |s_j - mu_j| for which the total force changes the force of a coupler."""


@compiled
def force_range(positions, speeds, vehicles, specific, begin, limit, found):
    """Compute the smallest and largest total force at some positions [m] and speeds [m/s] of vehicle 0's centre.

    ``vehicles``, shape (7, vehicles), has distance behind vehicle 0 [m], part of the inertia, mass [kg], share of the
    force, and running resistance as a polynomial of the speed [N, N s/m, N s²/m²]. ``specific`` is the line force per
    mass [N/kg], one entry per metre from ``begin`` [m] on; ``limit`` the largest coupler force [N]; ``found``, shape
    (2, nodes), the result [N].
    """
    count = vehicles.shape[1]
    before = np.empty(count)
    for k in range(positions.size):
        speed = abs(speeds[k])
        rolling = np.sign(speeds[k]) * min(1.0, speed / DRY_FRICTION_SPEED)
        total = 0.0
        for i in range(count):
            line = between_entries(specific, (positions[k] - vehicles[0, i] - begin) / GRID)
            running = running_resistance(vehicles[4, i], vehicles[5, i], vehicles[6, i], speed)
            total += vehicles[2, i] * line + running * rolling
            before[i] = total
        low, high = -np.inf, np.inf
        inertia = share = 0.0
        for j in range(count - 1):
            inertia += vehicles[1, j]
            share += vehicles[3, j]
            part, rest = share - inertia, before[j] - inertia * total
            if abs(part) > MIN_PART:
                ends = (rest - limit) / part, (rest + limit) / part
                low, high = max(low, min(ends)), min(high, max(ends))
        if low > high:
            low = high = 0.5 * (low + high)
        found[0, k], found[1, k] = low, high


class CouplerLimit:
    """Range of the total force for a largest coupler force.

    Parameters
    ----------
    model
        The nominal train.
    limit
        Largest draft and buff [N].
    """

    def __init__(self, model: TrainModel, limit: float) -> None:
        consist = model.consist
        mass = np.array([vehicle.mass for vehicle in consist.vehicles])
        inertia = mass * [vehicle.rotating_mass_factor for vehicle in consist.vehicles]
        share = np.zeros(mass.size)
        share[list(model.units)] = model.share
        running = [each.resistance.polynomial(each.mass, consist.gravity) for each in consist.vehicles]
        columns = (np.array(consist.offsets), inertia / model.inertia, mass, share, np.array(running).T)
        self._vehicles = np.ascontiguousarray(np.vstack(columns))
        self._specific, self._begin = model.specific_line_force()
        self._limit = limit

    def force_range(self, position: Array, velocity: Array) -> Array:
        """Return the range of the total force at positions [m] and speeds [m/s] of vehicle 0 [N], shape (2, nodes)."""
        found = np.empty((2, position.size))
        force_range(position, velocity, self._vehicles, self._specific, self._begin, self._limit, found)
        return found
