"""Padé: the delay as a rational function, paper 001, eqs. (4), (5); the feed-forward of now from the reference alone.

The papers' usual way to put a delay into equations, made usable: it gives a feed-forward alone.

    exp(-sigma s) = (lam - s)/(lam + s),  lam = 2/sigma                                             (4)
    a = b1 a'' + b2 a' + b3 a_s' + a_s                                                              (5)
    b1 = -tau/lam,  b2 = -(lam tau + 1)/lam,  b3 = -1/lam

Corrections: the print has b1 = -2/lam and lost the dot on a_s. Solved for the demand, a_s = a - b1 a'' - b2 a' -
b3 a_s' has an unstable root at +2/sigma in its own a_s', and measured derivatives of a make the loop unstable; so a is
the reference's and a_s' that of the demand without delay, a' + tau a''::

    u_ff = F - b1 F'' - b2 F' - b3 (F' + tau F'') = F + (sigma + tau) F' + sigma tau F''

with F the force of the nominal train along the profile: preview to first order, without looking ahead
beyond the difference quotients, which span (sigma + tau)/2 to either side.

Needs: a law that takes the feed-forward (`pid`, `rbf_switching_smc`, `smc` with ``equivalent: feedforward``); others
are refused, because nothing would change for them. Delay and lag of the model.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from train_ato.compensate.contract import Situation, View
from train_ato.compensate.none import NoCompensation

if TYPE_CHECKING:
    from train_ato.model import TrainModel


def pade_coefficients(lag: float, delay: float) -> tuple[float, float, float]:
    """Return (b1, b2, b3) of (5) as corrected [s², s, s]."""
    half = delay / 2.0
    return -lag * half, -(lag + half), -half


class Pade(NoCompensation):
    """Feed-forward led by the Padé form of delay and lag, from the reference's derivatives (paper 001)."""

    feedforward_only: ClassVar[bool] = True

    def __init__(self, parameters: Any, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self._forward = [pade_coefficients(model.lag, delay) for delay in model.delay.tolist()]
        self._spacing = max(model.tick, 0.5 * (model.lag + float(model.delay.mean())))
        self._backward = [pade_coefficients(model.lag, delay) for delay in model.delay_brake.tolist()]

    def see(self, now: Situation) -> View:
        """Return the measured state with the led feed-forward."""
        self.shoes.tell(now.t, now.pressure)
        _, _, acceleration, jerk = self.rigid.profile.at(now.t)
        shoes = self.shoes.at(now.t, now.reference[1])
        t, h = now.t, self._spacing
        before, force, after = (self.rigid.total(t + k * h) for k in (-1.0, 0.0, 1.0))
        slope, bend = (after - before) / (2.0 * h), (after - 2.0 * force + before) / (h * h)
        coefficients = self._forward if force + shoes.total >= 0.0 else self._backward
        lag = self.model.lag
        wanted = [
            share * (force + shoes.total - b1 * bend - b2 * slope - b3 * (slope + lag * bend))
            for share, (b1, b2, b3) in zip(self._share, coefficients, strict=True)
        ]
        return self.as_measured(now, t, acceleration, jerk, np.array(wanted), shoes)
