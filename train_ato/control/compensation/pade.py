"""Feed-forward through a Padé approximation of the delay, paper 001, eqs. (4), (5), without preview of the profile.

The delay becomes a rational function, as in the papers. Only the feed-forward is changed.

    exp(-sigma s) = (lam - s)/(lam + s),  lam = 2/sigma                                             (4)
    a = b1 a'' + b2 a' + b3 a_s' + a_s                                                              (5)
    b1 = -tau/lam,  b2 = -(lam tau + 1)/lam,  b3 = -1/lam

Corrections: the paper prints b1 = -2/lam and omits the dot on a_s. Solved for the demand, a_s = a - b1 a'' - b2 a' -
b3 a_s' has an unstable root at +2/sigma in a_s', and measured derivatives of a make the loop unstable. Therefore a is
that of the reference and a_s' that of the demand without delay, a' + tau a''::

    u_ff = F - b1 F'' - b2 F' - b3 (F' + tau F'') = F + (sigma + tau) F' + sigma tau F''

with F the force of the nominal train along the profile. This is a preview to first order; only the difference
quotients read the profile ahead, by (sigma + tau)/2.

Needs: a law that uses the feed-forward (`pid`, `rbf_switching_smc`, `smc` with ``equivalent: feedforward``); others are
rejected, because the compensation has no effect on them. Delay and lag of the model.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from train_ato.control.compensation.base import CompensationBase
from train_ato.control.compensation.contract import CompensationInput
from train_ato.control.contract import LawInput, NoParameters
from train_ato.messages.types import Array

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel


def pade_coefficients(lag: float, delay: float) -> tuple[float, float, float]:
    """Return the corrected b1, b2, b3 of (5) [s², s, s] for a lag and a delay [s]."""
    half = delay / 2.0
    return -lag * half, -(lag + half), -half


class Pade(CompensationBase):
    """Feed-forward through the Padé form of delay and lag, from derivatives of the reference (paper 001)."""

    Parameters: ClassVar[type] = NoParameters
    feedforward_only: ClassVar[bool] = True

    def __init__(self, parameters: Any, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._forward = [pade_coefficients(model.lag, delay) for delay in model.delay.tolist()]
        self._spacing = max(model.tick, 0.5 * (model.lag + float(model.delay.mean())))
        self._backward = [pade_coefficients(model.lag, delay) for delay in model.delay_brake.tolist()]

    def step(self, inputs: CompensationInput) -> LawInput:
        """Return the measured state with the feed-forward through delay and lag."""
        t = inputs.t
        self.shoes.demand(t, inputs.pressure)
        shoes = self.shoes.at(t, inputs.reference.velocity)
        return self.law_input(inputs, t, self.feedforwards(np.array([t]), np.array([shoes.total]))[0], shoes)

    def feedforwards(self, t: Array, shoes: Array) -> Array:
        """Return the feed-forward at many times [N], shape (times, units).

        Parameters
        ----------
        t : Array, shape (times,)
            Times at which the commands are sent [s].
        shoes : Array, shape (times,)
            Shoe force of the train at these times [N].
        """
        h, lag, rigid = self._spacing, self.model.lag, self.rigid
        before, force, after = rigid.totals(t - h), rigid.totals(t), rigid.totals(t + h)
        slope, bend = (after - before) / (2.0 * h), (after - 2.0 * force + before) / (h * h)
        found = np.empty((t.size, self.model.n_units))
        for unit, share in enumerate(self._share):
            kinds = zip(self._forward[unit], self._backward[unit], strict=True)
            b1, b2, b3 = (np.where(force + shoes >= 0.0, forward, backward) for forward, backward in kinds)
            found[:, unit] = share * (force + shoes - b1 * bend - b2 * slope - b3 * (slope + lag * bend))
        return found
