"""Cascaded observer of paper 002, eqs. (6)-(11), in sampled form, for every driven vehicle.

It estimates two disturbances: an acceleration of the vehicle (d2), and an offset between its speed and the rate of its
position (d1).

Per unit, with the modelled acceleration a = (u_applied - couplers - resistance - shoes)/m::

    x' = v + d1,  v' = a + d2;     estimate = m (d2 + d1')

the force after the change of variable v~ = v + d1 of the paper (12), (35). The sampled forms are in
:mod:`train_ato.control.observers.cascade`; ``method: levant`` is best up to 1 ms, `eso` is better from 10 ms on.
``explicit`` is the printed form.
``unmatched: false`` omits d1 (the estimate is then m d2).

Needs: measured position, speed and force. As in `ndo`, the balance is that of every unit's vehicle if the coupler
forces are available, otherwise that of the train. A fast loop: from 50 ms on, or with noise on the position, d1' is
noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from train_ato.control.contract import parameter
from train_ato.control.observers.cascade import Cascade, ExplicitCascade, ImplicitCascade, LevantCascade
from train_ato.control.observers.contract import ObserverInput
from train_ato.control.observers.force_balance import BalanceState, ForceBalance
from train_ato.control.observers.guard import GuardedObserver

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel


@dataclass(frozen=True)
class CascadedParameters:
    """Parameters of :class:`Cascaded`."""

    method: str = parameter(
        "implicit",
        "",
        0,
        0,
        "implicit signs, Levant's differentiators, or explicit signs as in the paper",
        choices=("implicit", "levant", "explicit"),
    )
    k1: float = parameter(20.0, "m/s", 0.0, 1e4, "gain of the position channel")
    k2: float = parameter(20.0, "m/s²", 0.0, 1e4, "gain of the speed channel")
    k3: float = parameter(10.0, "1/s", 0.0, 1e4, "gain of the second stage")
    k4: float = parameter(100.0, "m/s²", 0.0, 1e5, "switching gain of the second stage")
    filter_time: float = parameter(0.02, "s", 0.0, 10.0, "low-pass filter of the switching signals")
    jerk_offset: float = parameter(100.0, "m/s³", 1e-6, 1e6, "bound of |d1''|, levant only")
    jerk: float = parameter(30.0, "m/s³", 1e-6, 1e6, "bound of |d2'|, levant only")
    unmatched: bool = parameter(True, "", 0, 1, "estimate the speed offset d1 as well")


def make_cascade(parameters: CascadedParameters, period: float) -> Cascade:
    """Return the cascade of one vehicle."""
    p = parameters
    if p.method == "levant":
        return LevantCascade(period, p.jerk_offset, p.jerk)
    form = ExplicitCascade if p.method == "explicit" else ImplicitCascade
    return form(period, p.k1, p.k2, p.k3, p.k4, p.filter_time)


class Cascaded(GuardedObserver):
    """Cascaded observer of matched and unmatched disturbance (paper 002)."""

    Parameters: ClassVar[type] = CascadedParameters

    def __init__(self, parameters: CascadedParameters, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._balance = ForceBalance(model, "auto", 0.0, period)
        self._unmatched = parameters.unmatched
        self.cascades = [make_cascade(parameters, period) for _ in range(self._balance.count)]
        self.clear_state()

    def clear_state(self) -> None:
        """Set the estimates to 0 and restart at the next sample."""
        for cascade in self.cascades:
            cascade.reset()
        self._before: list[BalanceState] | None = None

    def on_missed_sample(self) -> None:
        """Handle a missed sample: restart at the next one with the present estimates."""
        for cascade in self.cascades:
            cascade.restart()
        self._before = None

    def estimate(self, inputs: ObserverInput) -> list[float]:
        """Return the disturbance force of every unit [N]."""
        now = self._balance.known(inputs)
        places = inputs.position.tolist()
        for index, (cascade, state) in enumerate(zip(self.cascades, now, strict=True)):
            modelled = 0.0
            if self._before is not None:
                modelled = self._balance.known_rate(self._before[index], state)
            cascade.step(places[index], state.speed, modelled)
        self._before = now
        offset = 1.0 if self._unmatched else 0.0
        return self._balance.forces([cascade.d2 + offset * cascade.d1_rate for cascade in self.cascades])
