"""Shoe forces of the balance of an observer in a span: those at standstill, known before the speed is measured."""

from __future__ import annotations

import numpy as np

from train_ato.control.air_brake.shoes import ShoeForecast
from train_ato.control.observers.stack import ObserverStack
from train_ato.messages.types import Array


class ObserverShoes:
    """Forecast of the shoe forces of an observer for the ticks of one span; ticks that were not run are taken back.

    Parameters
    ----------
    stack
        Observer with its forecast, in the state before the span.
    times
        Times of the ticks [s].
    pressure
        Pressure of the brake pipe demanded in the span [Pa]; None without an air brake.
    used
        False for an observer without a balance of forces.

    Attributes
    ----------
    slow : Array, shape (ticks, vehicles)
        Forces at standstill [N]; without rows for released brakes.
    """

    def __init__(self, stack: ObserverStack, times: Array, pressure: float | None, *, used: bool) -> None:
        self._stack, self._times, self._pressure = stack, times, pressure
        self._used = used and stack._shoes.fitted
        self._kept: ShoeForecast | None = None
        self.slow: Array = np.zeros((0, 0))
        if not self._used or stack._shoes.idle:
            return
        known, self._kept = stack._shoes, stack._shoes.copy()
        rows, index = [], 0
        while index < len(times):
            known.demand(float(times[index]), pressure)
            run = min(len(times) - index, known.calls_to_restart())
            known.skip(run - 1)
            rows.append(known.slow_forces_at(times[index : index + run]))
            index += run
        self.slow = np.ascontiguousarray(np.concatenate(rows))

    def take_back(self, done: int, speed: float | None) -> None:
        """Set the forecast to its state after the first ``done`` ticks, with the last measured speed [m/s]."""
        if not self._used:
            return
        if speed is not None:
            self._stack._speed = speed
        if self._kept is None:
            self._stack._shoes.skip(done)
        elif done < len(self._times):
            self._stack._shoes = self._kept
            for t in self._times[:done].tolist():
                self._kept.demand(t, self._pressure)
