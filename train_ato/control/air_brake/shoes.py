"""Prediction of the air-brake force on the train and on the vehicles of the units."""

from __future__ import annotations

import copy
from typing import NamedTuple

import numpy as np

from plant_sim.air_brake import BrakeForecast
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array

COMMIT_EVERY = 50
"""Calls after which the forecast restarts from its present state, so that its list of events stays short."""


class ShoeForces(NamedTuple):
    """Shoe force of the train and of every unit's own vehicle, shape (units,) [N], > 0 retards."""

    total: float
    own: Array


class ShoeForecast:
    """Forecast of the shoe forces from the pressures demanded so far; 0 for a train without an air brake.

    Attributes
    ----------
    forecast : BrakeForecast or None
        Forecast of the brake events; None without an air brake.
    idle : bool
        True if all forces are 0: no air brake, or no event that acts or propagates.
    """

    def __init__(self, model: TrainModel) -> None:
        self._consist = model.consist
        self.units = np.array(model.units, dtype=np.int64)
        self.fitted = model.consist.air_brake is not None
        self._none = ShoeForces(0.0, np.zeros(model.n_units))
        self.reset()

    def reset(self) -> None:
        """Clear all events: brake released."""
        self.forecast = BrakeForecast(self._consist) if self.fitted else None
        self._calls = 0
        self.pressure: float | None = None
        self.idle = True

    def demand(self, t: float, pressure: float | None) -> None:
        """Add the pressure demanded from a time on [s, Pa]; None without an air brake."""
        if self.forecast is None or pressure is None:
            return
        if pressure != self.pressure:
            self.forecast.demand(t, pressure)
            self.pressure, self.idle = pressure, self.forecast.idle
        self._calls += 1
        if self._calls % COMMIT_EVERY == 0 and not self.idle:
            self.forecast.commit(t)
            self.idle = self.forecast.idle

    def skip(self, calls: int) -> None:
        """Count calls of :meth:`demand` with the present pressure that do not reach the next restart."""
        self._calls += calls if self.fitted else 0

    def calls_to_restart(self) -> int:
        """Return the number of calls of :meth:`demand` up to the next restart of the forecast."""
        return COMMIT_EVERY - self._calls % COMMIT_EVERY

    def at_each(self, times: Array, velocity: Array) -> Array:
        """Return :meth:`at` for many times [s] and speeds [m/s]: totals, then units, shape (times, 1 + units)."""
        found = np.zeros((len(times), 1 + len(self.units)))
        if self.forecast is not None and not self.idle:
            forces = self.forecast.forces_at(times, velocity[:, None])
            found[:, 0], found[:, 1:] = forces.sum(axis=1), forces[:, self.units]
        return found

    def slow_forces_at(self, times: Array) -> Array:
        """Return the forces of all vehicles at standstill for many times [s], shape (times, vehicles)."""
        assert self.forecast is not None
        return self.forecast.slow_forces_at(times)

    def copy(self) -> ShoeForecast:
        """Return a forecast with the same events."""
        other = copy.copy(self)
        other.forecast = copy.copy(self.forecast)  # its steps replace arrays and lists, they do not change them
        return other

    def at(self, t: float, velocity: float) -> ShoeForces:
        """Return the forces at a time [s], not before the last demand, and a speed of the train [m/s]."""
        if self.forecast is None or self.idle:
            return self._none
        forces = self.forecast.forces(t, velocity)
        return ShoeForces(float(forces.sum()), forces[self.units])
