"""Extended-state observer in discrete time (ours): speed and disturbance as states, both poles at exp(-omega Tc).

Predicts the next speed from the known forces and the disturbance found so far, and corrects both by what the
measurement is off. Quieter than `ndo` at the same bandwidth, and the one to take from 10 ms on.

Of what the balance is drawn (every unit's vehicle, or the whole train) and what counts as known is as in
:mod:`train_ato.observe.ndo`. With the known acceleration a averaged over the sample::

    v- = v_k-1 + Tc (a + d_k-1),   r = v_measured - v-
    v_k = v- + (1 - b²) r,   d_k = d_k-1 + (1 - b)²/Tc r,   b = exp(-omega Tc)

A constant disturbance is found without offset and the error falls like (1 + k (1 - b)) b^k whatever omega Tc is.
The estimate is the force m d.

Needs: what `ndo` needs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from train_ato.control.contract import parameter
from train_ato.control.parts.two_poles import TwoPoles
from train_ato.observe.balance import Balance, State, scope
from train_ato.observe.contract import ObserverInput
from train_ato.observe.guard import GuardedObserver

if TYPE_CHECKING:
    from train_ato.model import TrainModel


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
        self._balance = Balance(model, parameters.scope, 0.0, "eso", period)
        self._vehicles = [TwoPoles(parameters.omega, period) for _ in range(self._balance.count)]
        self.forget()

    def forget(self) -> None:
        """Start anew with the next sample."""
        self._before: list[State] | None = None
        for vehicle in self._vehicles:
            vehicle.reset()

    def missed(self) -> None:
        """Begin again with the next measured speed; the disturbance is held."""
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
