"""Nominal train as arrays of the compiled laws and observers: resistance, and couplers beside the power units."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from train_ato.control.algorithms.couplers import UnitCouplers
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array


def train_constants(model: TrainModel) -> list[float]:
    """Return the constants of the train as one mass, by :mod:`train_ato.control.compiled.entries`."""
    return [model.inertia, *model.running]


def coupler_arrays(couplers: UnitCouplers | None) -> tuple[NDArray[np.int64], Array]:
    """Return the couplers beside the units as arrays.

    Parameters
    ----------
    couplers
        Couplers of which all forces are available; None if none is used.

    Returns
    -------
    beside : Array of int, shape (units, 2)
        Coupler in front of and behind every unit: number of its sensor, or number of sensors plus that of its spring;
        -1 for none. Without couplers the shape is (0, 2).
    springs : Array, shape (springs, 4)
        Units in front of and behind a spring, its stiffness [N/m] and damping [N s/m].
    """
    if couplers is None:
        return np.zeros((0, 2), dtype=np.int64), np.zeros((0, 4))
    first = len(couplers._model.sensors)
    number = {coupler: first + index for index, coupler in enumerate(couplers._spring)}
    number |= couplers._sensor
    beside = [[-1 if coupler is None else number[coupler] for coupler in pair] for pair in couplers._beside]
    springs = np.array(list(couplers._spring.values()), dtype=np.float64).reshape(-1, 4)
    return np.array(beside, dtype=np.int64).reshape(-1, 2), springs
