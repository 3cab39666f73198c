"""Template of a disturbance observer: copy this file, rename the class, change ``estimate``.

The estimate is the low-pass filtered force that the model of the train does not explain. Test it with::

    train-ato check-observer my_observer:MyObserver
    train-ato run demo --observer my_observer:MyObserver --set observers.my_observer:MyObserver.filter_time=2

or in Python, without registration::

    train_ato.run("demo", observer=MyObserver(filter_time=2.0))

A short name needs a registration by the entry-point group ``train_ato.observers`` (``pyproject.toml``).
"""

import math
from dataclasses import dataclass
from typing import Any

from train_ato.control.contract import parameter
from train_ato.control.observers.contract import ObserverInput
from train_ato.control.observers.force_balance import BalanceState, ForceBalance
from train_ato.control.observers.record_observer import GuardedObserver


@dataclass
class MyObserver(GuardedObserver):
    """Filtered force balance (template). Each parameter: default, unit, lowest and highest value, description."""

    filter_time: float = parameter(1.0, "s", 0.01, 100.0, "time constant of the low-pass filter")

    def bind(self, model: Any, period: float) -> None:
        """Take the train and the tick [s]; raise ValueError for a train on which the observer cannot work."""
        super().bind(model, period)
        self.balance = ForceBalance(model, "auto", 0.0, period)
        self.weight = 1.0 - math.exp(-period / self.filter_time)

    def clear_state(self) -> None:
        """Set the estimate to 0."""
        self.filtered = [0.0] * self.balance.count
        self.before: list[BalanceState] = []

    def on_missed_sample(self) -> None:
        """Restart the difference quotient after an invalid measurement."""
        self.before = []

    def estimate(self, inputs: ObserverInput) -> list[float]:
        """Return the disturbance of every unit [N]; GuardedObserver checks the inputs and the result."""
        now = self.balance.known(inputs)
        for body, (last, state) in enumerate(zip(self.before, now, strict=False)):
            rate = (state.speed - last.speed) / self.period
            unexplained = rate - self.balance.known_rate(last, state)
            self.filtered[body] += self.weight * (unexplained - self.filtered[body])
        self.before = now
        return self.balance.forces(self.filtered)
