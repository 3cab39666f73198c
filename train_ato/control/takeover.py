"""Takeover of the train during a run: the demand begins at the force that acts and follows with limited jerk."""

from __future__ import annotations

import numpy as np

from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array


class TakeoverRamp:
    """Demand of the power units from the force that acts to the wanted one.

    Parameters
    ----------
    model
        The nominal train.
    jerk
        Largest jerk of the train by the change of the demand [m/s³].

    Attributes
    ----------
    ended : bool
        True after the demand has reached the wanted one.
    """

    def __init__(self, model: TrainModel, jerk: float) -> None:
        self._largest_step: Array = jerk * model.tick * model.inertia * model.share
        self._force: Array | None = None
        self.ended = False

    def step(self, wanted: Array, applied: Array) -> Array:
        """Return the demand of one tick [N].

        Parameters
        ----------
        wanted, applied : Array, shape (units,)
            Final demand, and measured force of every unit [N]; the demand begins at the first measured force.
        """
        if self._force is None:
            self._force = np.where(np.isfinite(applied), applied, 0.0)
        change = wanted - self._force
        self.ended = bool((np.abs(change) <= self._largest_step).all())
        self._force = self._force + np.clip(change, -self._largest_step, self._largest_step)
        return self._force.copy()
