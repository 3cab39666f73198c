"""Extended-state observer in discrete time (ours): speed and disturbance as states, both poles at exp(-omega Tc).

Of what the balance is drawn (every unit's vehicle, or the whole train) and what counts as known is as in
:mod:`train_ato.observe.ndo`. With the known acceleration a averaged over the sample::

    v- = v_k-1 + Tc (a + d_k-1),   r = v_measured - v-
    v_k = v- + (1 - b²) r,   d_k = d_k-1 + (1 - b)²/Tc r,   b = exp(-omega Tc)

A constant disturbance is found without offset and the error falls like (1 + k (1-b)/b) b^k whatever omega Tc is.
The estimate is the force m d.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from train_ato.control.contract import parameter
from train_ato.observe.balance import Balance, State
from train_ato.observe.contract import ObserverInput
from train_ato.observe.guard import GuardedObserver

if TYPE_CHECKING:
    from train_ato.model import TrainModel


@dataclass(frozen=True)
class EsoParameters:
    """Parameters of :class:`Eso`."""

    omega: float = parameter(2.0, "1/s", 0.0, 1e6, "bandwidth: both poles at exp(-omega Tc)")
    scope: str = parameter(
        "auto",
        "",
        0,
        0,
        "balance over every unit's vehicle, over the train, or as the couplers allow",
        choices=("auto", "vehicle", "train"),
    )


class Eso(GuardedObserver):
    """Discrete extended-state observer: speed and disturbance, one bandwidth."""

    Parameters: ClassVar[type] = EsoParameters

    def __init__(self, parameters: EsoParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._balance = Balance(model, parameters.scope, 0.0, "eso", period)
        pole = math.exp(-parameters.omega * period)
        self._speed_gain = 1.0 - pole * pole
        self._gain = (1.0 - pole) ** 2 / period
        self.forget()

    def forget(self) -> None:
        """Start anew with the next sample."""
        self._before: list[State] | None = None
        self._speed: list[float] = []
        self._found = [0.0] * self._balance.count

    def missed(self) -> None:
        """Begin again with the next measured speed; the disturbance is held."""
        self._before = None

    def estimate(self, inputs: ObserverInput) -> list[float]:
        """Return the disturbance force of every unit [N]."""
        now = self._balance.known(inputs)
        if self._before is None:
            self._speed = [state.speed for state in now]
        else:
            for index, (state, before) in enumerate(zip(now, self._before, strict=True)):
                known = self._balance.mean_push(before.push, state.push) - 0.5 * (before.resisting + state.resisting)
                predicted = self._speed[index] + self.period * (known + self._found[index])
                miss = state.speed - predicted
                self._speed[index] = predicted + self._speed_gain * miss
                self._found[index] += self._gain * miss
        self._before = now
        return self._balance.forces(self._found)
