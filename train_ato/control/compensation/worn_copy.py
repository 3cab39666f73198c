"""Copy of the simulated train of the twin with worn draft gears, for the effect of wear on the measured speed.

The copy has the force of the twin, the same brake pipe, and draft gears with ``WEAR_STEP`` more wear. Its units then
move against those of the twin by the waves of its couplers alone, as a real train with these gears does. So that the
copy does not drift away along the grades, a slow loop holds its units to those of the twin::

    dF = -M (SPEED_GAIN dv + POSITION_GAIN dx)

To first order in the wear, a train with the force F of the twin plus dF has the speed of the twin plus dv. dF and dv
over ``WEAR_STEP`` are therefore the sensitivities of force and speed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from train_ato.control.algorithms.force_shares import mean_over_units, total_of_units
from train_ato.control.algorithms.worn_gears import CONSTANTS, worn_constants
from train_ato.control.compensation.nominal_train import nominal_copy

if TYPE_CHECKING:
    from plant_sim.train import Train
    from train_ato.control.compensation.rigid import ProfileLike
    from train_ato.control.train_model import TrainModel

WEAR_STEP = 0.1
"""Wear of the draft gears of the copy beyond that of the twin."""
SPEED_GAIN, POSITION_GAIN = 0.1, 0.0025
"""Gains of the loop between copy and twin [1/s, 1/s²]: .05 rad/s, well below the first coupler mode of a long train."""


def set_wear(train: Train, wear: float) -> None:
    """Give a simulated train draft gears with wear, from its next step on."""
    train.arrays.gear[list(CONSTANTS)] = worn_constants(train.consist, wear)


class WornCopy:
    """Copy of the train of the twin with worn draft gears.

    Parameters
    ----------
    model
        The nominal train.
    profile
        Profile that gives the initial state.
    start
        Time of the initial state [s].
    period
        Control period of the twin [s].
    step
        Integration step of the twin [s].
    """

    def __init__(self, model: TrainModel, profile: ProfileLike, start: float, period: float, step: float) -> None:
        self.train = nominal_copy(model, profile, start, period, step)
        self._model = model
        self._share = model.share.tolist()
        self._demand = np.zeros((self.train.substeps, model.n_units))
        self.set_wear(0.0)

    def set_wear(self, wear: float) -> None:
        """Set the wear of the twin."""
        set_wear(self.train, wear + WEAR_STEP)

    def step(self, twin: Train, places: list[float], speeds: list[float], pressure: float | None) -> list[float]:
        """Advance by a control period, after the twin.

        Parameters
        ----------
        twin
            Train of the twin at the end of the period.
        places, speeds
            Positions [m] and speeds [m/s] of its units at the begin of the period.
        pressure
            Pressure demanded at the head of the brake pipe [Pa]; None keeps the present one.

        Returns
        -------
        list of float
            Changes of the total force [N] and of the mean speed of the units [m/s] by a wear of 1, over the period and
            at its begin.
        """
        units, position, velocity = self._model.units, self.train.position, self.train.velocity
        far = mean_over_units(self._share, [position.item(i) - x for i, x in zip(units, places, strict=True)])
        fast = mean_over_units(self._share, [velocity.item(i) - v for i, v in zip(units, speeds, strict=True)])
        pull = -self._model.inertia * (SPEED_GAIN * fast + POSITION_GAIN * far)
        force = twin.applied
        self._demand[:] = force + pull * self._model.share
        self.train.advance(self._demand, pressure)
        change = total_of_units(self.train.applied) - total_of_units(force)
        return [change / WEAR_STEP, fast / WEAR_STEP]
