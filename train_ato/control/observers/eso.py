"""Extended-state observer in discrete time: speed and disturbance as states, both poles at exp(-omega Tc).

The observer predicts the next speed from the modelled forces and the estimated disturbance, and corrects both by the
prediction error. It is less noisy than `ndo` at the same bandwidth and preferable from 10 ms on. It is not from a
paper.

The scope of the balance (every unit's vehicle, or the whole train) and its forces are those of
:mod:`train_ato.control.observers.ndo`. With the modelled acceleration a, averaged over the sample::

    v- = v_k-1 + Tc (a + d_k-1),   r = v_measured - v-
    v_k = v- + (1 - b²) r,   d_k = d_k-1 + (1 - b)²/Tc r,   b = exp(-omega Tc)

A constant disturbance is found without offset; the error falls like (1 + k (1 - b)) b^k for any omega Tc. The
estimate is the force m d.

Needs: the same as `ndo`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from train_ato.control.algorithms.luenberger import LuenbergerObserver
from train_ato.control.contract import parameter
from train_ato.control.observers.contract import ObserverInput
from train_ato.control.observers.force_balance import BalanceState, ForceBalance, scope
from train_ato.control.observers.guard import GuardedObserver

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel


@dataclass(frozen=True)
class EsoParameters:
    """Parameters of :class:`Eso`."""

    omega: float = parameter(2.0, "1/s", 0.0, 1e6, "bandwidth: both poles at exp(-omega Tc)")
    scope: str = scope()


class Eso(GuardedObserver):
    """Discrete extended-state observer: speed and disturbance, one bandwidth."""

    Parameters: ClassVar[type] = EsoParameters

    def __init__(self, parameters: EsoParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._balance = ForceBalance(model, parameters.scope, 0.0, period)
        self._vehicles = [LuenbergerObserver(parameters.omega, period) for _ in range(self._balance.count)]
        self.clear_state()

    def clear_state(self) -> None:
        """Set the estimate to 0 and restart at the next sample."""
        self._before: list[BalanceState] | None = None
        for vehicle in self._vehicles:
            vehicle.reset()

    def on_missed_sample(self) -> None:
        """Handle a missed sample: restart at the next one with the present estimate."""
        self._before = None
        for vehicle in self._vehicles:
            vehicle.restart()

    def estimate(self, inputs: ObserverInput) -> list[float]:
        """Return the disturbance force of every unit [N]."""
        now = self._balance.known(inputs)
        before = now if self._before is None else self._before
        self._before = now
        return self._balance.forces(
            [
                vehicle.step(state.speed, self._balance.known_rate(last, state))
                for vehicle, last, state in zip(self._vehicles, before, now, strict=True)
            ]
        )
