"""Air-brake force that the model predicts: on the whole train and on the units' own vehicles."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from plant_sim.air_brake import BrakeForecast
from train_ato.types import Array

if TYPE_CHECKING:
    from train_ato.model import TrainModel

COMMIT_EVERY = 50
"""Questions after which the forecast is begun anew from its present state, so that it stays short."""


class Shoes(NamedTuple):
    """Shoe force of the whole train and of every unit's own vehicle [N], > 0 retards."""

    total: float
    own: Array


class ShoeForecast:
    """Forecast of the shoe forces from the pressures demanded so far; all 0 for a train without an air brake."""

    def __init__(self, model: TrainModel) -> None:
        self._consist = model.consist
        self._units = list(model.units)
        self.fitted = model.consist.air_brake is not None
        self._none = Shoes(0.0, np.zeros(model.n_units))
        self.reset()

    def reset(self) -> None:
        """Forget all events: brake released."""
        self._forecast = BrakeForecast(self._consist) if self.fitted else None
        self._asked = 0

    def tell(self, t: float, pressure: float | None) -> None:
        """Take note of the pressure demanded from ``t`` on [s, Pa]."""
        if self._forecast is not None and pressure is not None:
            self._forecast.demand(t, pressure)
            self._asked += 1
            if self._asked % COMMIT_EVERY == 0 and not self._forecast.idle:
                self._forecast.commit(t)

    def at(self, t: float, velocity: float) -> Shoes:
        """Return the forces at a time not before the last pressure told of, at a speed of the train [m/s]."""
        if self._forecast is None or self._forecast.idle:
            return self._none
        forces = self._forecast.forces(t, velocity)
        return Shoes(float(forces.sum()), forces[self._units])
