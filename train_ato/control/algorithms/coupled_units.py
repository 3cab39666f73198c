"""Exact motion over a short time of driven vehicles coupled by linear springs."""

import numpy as np

from plant_sim.elementary import matrix_product
from plant_sim.gears import LinearGear
from train_ato.control.algorithms.coupler_modes import chain
from train_ato.control.contract import RefusedParameter
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array


def matrix_exponential(matrix: Array) -> Array:
    """Return the exponential of a square matrix, by scaling, a Taylor series to rounding, and squaring."""
    norm = float(np.abs(matrix).sum(axis=1).max())
    halvings = max(0, int(np.ceil(np.log2(norm))) + 4) if norm > 0 else 0
    small = matrix / 2.0**halvings
    term = np.eye(matrix.shape[0])
    total = term.copy()
    for order in range(1, 15):
        term = matrix_product(term, small) / order
        total = total + term
    for _ in range(halvings):
        total = matrix_product(total, total)
    return total


class CoupledUnits:
    """Power units coupled by linear springs, one in every vehicle.

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
            raise RefusedParameter(
                f"train: chain needs every vehicle driven, here {model.n_units} of {len(vehicles)}", "train: rigid"
            )
        springs = [gear for gear in gears if isinstance(gear, LinearGear) and gear.slack == 0.0]
        if len(springs) != len(gears):
            raise RefusedParameter("train: chain needs linear draft gears without slack", "train: rigid")
        n = self.n = model.n_units
        self.mass: Array = np.array([vehicle.mass * vehicle.rotating_mass_factor for vehicle in vehicles])
        self.weight: Array = self.mass / self.mass.sum()
        self.stiffness: Array = np.array([gear.stiffness for gear in springs])
        stiffness, damping = 0.0 - chain(self.stiffness), 0.0 - chain(np.array([gear.damping for gear in springs]))
        self._rates = np.zeros((3 * n, 3 * n))
        self._rates[:n, n : 2 * n] = np.eye(n)
        self._rates[n : 2 * n, :n] = stiffness / self.mass[:, None]
        self._rates[n : 2 * n, n : 2 * n] = damping / self.mass[:, None]
        self._rates[n : 2 * n, 2 * n :] = np.diag(1.0 / self.mass)
        self.spring: Array = np.ascontiguousarray(self._rates[n : 2 * n, :n])
        self.damper: Array = np.ascontiguousarray(self._rates[n : 2 * n, n : 2 * n])
        self._steps: dict[float, Array] = {}

    def step_matrix(self, h: float) -> Array:
        """Return the map of position, speed and constant force to position and speed ``h`` s later, shape (2n, 3n)."""
        found = self._steps.get(h)
        if found is None:
            if len(self._steps) > 64:
                self._steps.clear()
            found = self._steps[h] = matrix_exponential(self._rates * h)[: 2 * self.n]
        return found

    def driven_step(self, lag: float, h: float) -> Array:
        """Return the map of position, speed, applied force and constant command to the first three ``h`` s later.

        Parameters
        ----------
        lag
            Lag of the applied force [s].
        h
            Time [s].

        Returns
        -------
        Array, shape (3n, 4n)
        """
        n = self.n
        if lag <= 0.0:
            constant = self.step_matrix(h)
            return np.block(
                [[constant[:, : 2 * n], np.zeros((2 * n, n)), constant[:, 2 * n :]], [np.zeros((n, 3 * n)), np.eye(n)]]
            )
        rates = np.zeros((4 * n, 4 * n))
        rates[: 3 * n, : 3 * n] = self._rates
        rates[2 * n : 3 * n, 2 * n : 3 * n], rates[2 * n : 3 * n, 3 * n :] = -np.eye(n) / lag, np.eye(n) / lag
        return matrix_exponential(rates * h)[: 3 * n]
