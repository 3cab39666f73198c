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

from typing import TYPE_CHECKING, Any, ClassVar

from plant_sim.compiled import compiled
from train_ato.control.observers.cascade import (
    CASCADES,
    CascadeBody,
    CascadedConstants,
    CascadedParameters,
    cascade_constants,
)
from train_ato.control.observers.force_balance import ForceBalance
from train_ato.control.observers.record_observer import ObserverForm, RecordObserver

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel


def cascaded_form(cascade: Any) -> ObserverForm:
    """Return the observer with a compiled step of a cascade."""

    @compiled
    def cascaded(
        p: CascadedConstants, own: CascadeBody, position: float, speed: float, driven: float, resistance: float
    ) -> float:
        cascade(p, own, position, speed, driven - 0.5 * (own.resistance + resistance))
        return own.d2 + (1.0 if p.unmatched else 0.0) * own.d1_rate

    return ObserverForm(cascaded, CascadedConstants, CascadeBody)


FORMS = {method: cascaded_form(step) for method, step in CASCADES.items()}
"""The observer by method."""


class Cascaded(RecordObserver):
    """Cascaded observer of matched and unmatched disturbance (paper 002)."""

    Parameters: ClassVar[type] = CascadedParameters

    def __init__(self, parameters: CascadedParameters, model: TrainModel, period: float) -> None:
        self.form = FORMS[parameters.method]
        balance = ForceBalance(model, "auto", 0.0, period)
        super().__init__(parameters, model, period, balance, **cascade_constants(parameters, period))
