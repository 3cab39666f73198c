"""Feed-forward through a Padé approximation of the delay, paper 001, eqs. (4), (5), without preview of the profile.

The delay becomes a rational function, as in the papers. Only the feed-forward is changed.

    exp(-sigma s) = (lam - s)/(lam + s),  lam = 2/sigma                                             (4)
    a = b1 a'' + b2 a' + b3 a_s' + a_s                                                              (5)
    b1 = -tau/lam,  b2 = -(lam tau + 1)/lam,  b3 = -1/lam

Corrections: the paper prints b1 = -2/lam and omits the dot on a_s. Solved for the demand, a_s = a - b1 a'' - b2 a' - b3
a_s' has an unstable root at +2/sigma in a_s'. Measured derivatives of a also make the loop unstable. Therefore a is
taken from the reference, and a_s' is a' + tau a'', from the demand without delay::

    u_ff = F - b1 F'' - b2 F' - b3 (F' + tau F'') = F + (sigma + tau) F' + sigma tau F''

with F the force of the nominal train along the profile. This is a preview to first order; only the difference
quotients read the profile ahead, by (sigma + tau)/2.

Needs: a law that uses the feed-forward (`pid`, `rbf_switching_smc`, `smc` with ``equivalent: feedforward``). Other laws
are rejected, because the compensation has no effect on them. Delay and lag of the model.
"""

from typing import Any, ClassVar

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.record import Records
from train_ato.control.compensation.base import AlongProfile, CompensationBase
from train_ato.control.compensation.rigid import demand_ahead
from train_ato.control.contract import NoParameters
from train_ato.control.train_model import Actuator, TrainModel
from train_ato.messages.types import Array


@compiled
def pade_coefficients(lag: float, delay: float) -> tuple[float, float, float]:
    """Return the corrected b1, b2, b3 of (5) [s², s, s] for a lag and a delay [s]."""
    half = delay / 2.0
    return -lag * half, -(lag + half), -half


@compiled
def pade_feedforwards(
    all_p: Records[AlongProfile], actuators: Records[Actuator], h: float, forces: Array, times: Array, shoes: Array
) -> Array:
    """Return the feed-forward through delay and lag [N], shape (times, units).

    Parameters
    ----------
    all_p, actuators, forces, times, shoes
        See :func:`train_ato.control.compensation.base.feedforwards`; shoe forces at the times.
    h
        Time from one force to the next in the difference quotients [s].
    """
    p, found = all_p[0], np.empty((times.size, actuators.size))
    for i in range(times.size):
        before = demand_ahead(forces, p.begin, p.spacing, 0.0, times[i] - h)
        force = demand_ahead(forces, p.begin, p.spacing, 0.0, times[i])
        after = demand_ahead(forces, p.begin, p.spacing, 0.0, times[i] + h)
        slope, bend = (after - before) / (2.0 * h), (after - 2.0 * force + before) / (h * h)
        force += shoes[i]
        for u in range(actuators.size):
            a = actuators[u]
            b1, b2, b3 = pade_coefficients(p.lag, a.forward if force >= 0.0 else a.backward)
            found[i, u] = a.share * (force - b1 * bend - b2 * slope - b3 * (slope + p.lag * bend))
    return found


class Pade(CompensationBase):
    """Feed-forward through the Padé form of delay and lag, from derivatives of the reference (paper 001)."""

    Parameters: ClassVar[type] = NoParameters
    feedforward_only: ClassVar[bool] = True

    def __init__(self, parameters: Any, model: TrainModel, period: float) -> None:
        super().__init__(parameters, model, period)
        self.actuators["forward"], self.actuators["backward"] = model.delay, model.delay_brake
        self._along["lag"] = model.lag
        self._spacing = max(model.tick, 0.5 * (model.lag + float(model.delay.mean())))

    def feedforwards(self, times: Array, shoes: Array) -> Array:
        """Return the feed-forward of the units [N], shape (times, units).

        Parameters
        ----------
        times : Array, shape (times,)
            Times at which the commands are sent [s].
        shoes : Array, shape (times,)
            Shoe force of the train at these times [N].
        """
        forces = self.rigid.forces
        return np.asarray(pade_feedforwards(self._along, self.actuators, self._spacing, forces, times, shoes))
