"""Nonlinear disturbance observer of paper 000, eqs. (30)-(34), sampled exactly.

What the measured acceleration is off from what the known forces explain, low-passed: grades, wind, wrong masses.

With p(x) = omega v, (30) is a first-order filter of what the model does not explain::

    d' = omega (v' - f - u_applied/m - d)

and with the model held over a sample of Tc::

    E = exp(-omega Tc);  d_k = E d_{k-1} + (1 - E) [(v_k - v_{k-1})/Tc - f_{k-1} - u_applied/m]

which is stable for any omega (explicit Euler needs omega Tc < 2). The estimate is the force m d. ``u_applied`` is
what acted over the sample after delay, lag and limit: its mean, from the values measured at both ends. omega = 1000 of
the paper is a bare difference quotient and dies of 0.01 m/s of speed noise; 20 suffices.  "Lumped": whatever f does not
explain is in the estimate, a network's delta included.

Over what the balance is drawn:

* ``vehicle``: every unit's own vehicle, with the measured forces of its couplers; what `smc` needs.  f_hat is
  f/(1 + model_error), the law's model, so the part of f that it lacks stands in the estimate beside the disturbance.
* ``train``: the whole train as one rigid mass, the estimate shared out over the units; what laws with a feed-forward
  need. On a long train the couplers' waves are then "disturbance": omega at most about .03 1/s with lag and delay.
* ``auto``: ``vehicle`` where the couplers beside all units have known forces (a sensor, or a linear spring
  between two units), else ``train``.

With an air brake the predicted shoe force is part of the model.

Needs: measured speed and acting force. ``scope: vehicle`` also the force of every coupler beside a power unit, and is
refused by the coupler's name without; ``auto`` falls back on the whole train.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from train_ato.control.contract import parameter
from train_ato.observe.balance import Balance, State, scope
from train_ato.observe.contract import ObserverInput
from train_ato.observe.guard import GuardedObserver

if TYPE_CHECKING:
    from train_ato.model import TrainModel


@dataclass(frozen=True)
class NdoParameters:
    """Parameters of :class:`Ndo`."""

    omega: float = parameter(20.0, "1/s", 0.0, 1e6, "bandwidth; the paper's 1000 is a difference quotient")
    scope: str = scope()
    model_error: float = parameter(0.01, "1", -0.5, 10.0, "f_hat = f/(1 + model_error), vehicle scope only")


class Ndo(GuardedObserver):
    """Nonlinear disturbance observer (paper 000), exactly sampled for any bandwidth."""

    Parameters: ClassVar[type] = NdoParameters

    def __init__(self, parameters: NdoParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._balance = Balance(model, parameters.scope, parameters.model_error, "ndo", period)
        self._keep = math.exp(-parameters.omega * period)
        self.forget()

    def forget(self) -> None:
        """Set the estimate back to 0."""
        self._filtered = [0.0] * self._balance.count
        self._before: list[State] | None = None

    def missed(self) -> None:
        """Leave the gap out of the difference quotient."""
        self._before = None

    def estimate(self, inputs: ObserverInput) -> list[float]:
        """Return the disturbance force of every unit [N]."""
        now = self._balance.known(inputs)
        if self._before is not None:
            for index, (state, before) in enumerate(zip(now, self._before, strict=True)):
                push = self._balance.mean_push(before.push, state.push)
                unexplained = (state.speed - before.speed) / self.period - push + before.resisting
                self._filtered[index] = self._keep * self._filtered[index] + (1.0 - self._keep) * unexplained
        self._before = now
        return self._balance.forces(self._filtered)
