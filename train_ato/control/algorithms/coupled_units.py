"""A train whose every vehicle is driven and joined to the next by a linear spring: exact motion over a short time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from plant_sim.gears import LinearGear
from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.compensate.contract import Situation
    from train_ato.model import TrainModel


def exponential(matrix: Array) -> Array:
    """Return the matrix exponential, by scaling, a Taylor series to rounding, and squaring."""
    norm = float(np.abs(matrix).sum(axis=1).max())
    halvings = max(0, int(np.ceil(np.log2(norm))) + 4) if norm > 0 else 0
    small = matrix / 2.0**halvings
    term = np.eye(matrix.shape[0])
    total = term.copy()
    for order in range(1, 15):
        term = term @ small / order
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


class Chain:
    """Units joined by linear springs.

    Parameters
    ----------
    model
        The nominal train.

    Raises
    ------
    ValueError
        If a vehicle is not driven or a draft gear is not a linear spring without slack.
    """

    def __init__(self, model: TrainModel) -> None:
        vehicles, gears = model.consist.vehicles, model.consist.gears
        if len(vehicles) != model.n_units:
            raise ValueError(
                f"a chain of units needs every vehicle driven, here {model.n_units} of {len(vehicles)} are"
            )
        springs = [gear for gear in gears if isinstance(gear, LinearGear) and gear.slack == 0.0]
        if len(springs) != len(gears):
            raise ValueError("a chain of units needs linear draft gears without slack")
        n = self.n = model.n_units
        self.mass: Array = np.array([vehicle.mass * vehicle.rotating_mass_factor for vehicle in vehicles])
        self.weight: Array = self.mass / self.mass.sum()
        self._offsets = model.offsets
        stiffness, damping = np.zeros((n, n)), np.zeros((n, n))
        for i, gear in enumerate(springs):
            block = np.array([[-1.0, 1.0], [1.0, -1.0]])
            stiffness[i : i + 2, i : i + 2] += gear.stiffness * block
            damping[i : i + 2, i : i + 2] += gear.damping * block
        self._rates = np.zeros((3 * n, 3 * n))
        self._rates[:n, n : 2 * n] = np.eye(n)
        self._rates[n : 2 * n, :n] = stiffness / self.mass[:, None]
        self._rates[n : 2 * n, n : 2 * n] = damping / self.mass[:, None]
        self._rates[n : 2 * n, 2 * n :] = np.diag(1.0 / self.mass)
        self._steps: dict[float, Array] = {}

    def step_matrix(self, h: float) -> Array:
        """Return the map of (place, speed, force) to (place, speed) after ``h`` seconds, force held, shape (2n, 3n)."""
        found = self._steps.get(h)
        if found is None:
            if len(self._steps) > 64:
                self._steps.clear()
            found = self._steps[h] = exponential(self._rates * h)[: 2 * self.n]
        return found

    def predict(
        self, now: Situation, due: Array, h: float, keep: float, lasting: float, forces: Array
    ) -> tuple[Array, Array, Array]:
        """Return position, speed and applied force of every unit after the commands that are due.

        Parameters
        ----------
        now
            The measured state.
        due : Array, shape (count, units)
            Commands due in every sub-interval [N].
        h
            Length of a sub-interval [s].
        keep, lasting
            Part of the applied force that is left at the end of a sub-interval, and its mean over it.
        forces : Array, shape (count, units)
            All other outside forces on every unit, > 0 forward [N].
        """
        n, step = self.n, self.step_matrix(h)
        place = now.position + self._offsets
        origin = float(place[0])
        state = np.concatenate((place - origin, now.velocity, np.zeros(n)))
        applied = now.applied
        for command, force in zip(due, forces, strict=True):
            state[2 * n :] = command + (applied - command) * lasting + force
            state[: 2 * n] = step @ state
            applied = command + (applied - command) * keep
        return state[:n] + origin - self._offsets, state[n : 2 * n].copy(), np.asarray(applied)
