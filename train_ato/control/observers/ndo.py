"""Nonlinear disturbance observer of paper 000, eqs. (30)-(34), sampled exactly.

The estimate is the low-pass filtered difference between measured and modelled acceleration: grades, wind, wrong masses.

With p(x) = omega v, (30) is a first-order filter of the acceleration that the model does not explain::

    d' = omega (v' - f - u_applied/m - d)

and with a constant model over a sample of Tc::

    E = exp(-omega Tc);  d_k = E d_{k-1} + (1 - E) [(v_k - v_{k-1})/Tc - f_{k-1} - u_applied/m]

This form is stable for any omega; explicit Euler needs omega Tc < 2. The estimate is the force m d. ``u_applied`` is
the mean force over the sample after delay, lag and limit, from the values measured at both ends. omega = 1000 of the
paper is a difference quotient and fails with 0.01 m/s of speed noise; 20 suffices. The estimate contains all forces
that are not in f. One of them is the model error delta that the network of ``rbf_smc`` learns.

Scope of the force balance:

* ``vehicle``: the balance of every unit's own vehicle, with the measured forces of its couplers. ``smc`` requires it.
  f_hat is f/(1 + model_error), the model of the law, so that the estimate contains the error of f beside the
  disturbance.
* ``train``: the whole train as one rigid mass, the estimate split over the units, for laws with a feed-forward.
  On a long train the estimate contains the waves in the couplers: omega at most about .03 1/s with lag and delay.
* ``auto``: ``vehicle`` if the forces of all couplers beside units are available (a sensor, or a linear spring between
  two units), otherwise ``train``.

With an air brake the predicted shoe force is part of the model.

Needs: measured speed and force. ``scope: vehicle`` also needs the force of every coupler beside a power unit, and its
error message names the missing couplers. ``auto`` then uses the whole train.
"""

import math
from dataclasses import dataclass
from typing import ClassVar

from plant_sim.compiled import compiled
from plant_sim.record import quantity
from train_ato.control.contract import parameter
from train_ato.control.observers.force_balance import BalanceConstants, ForceBalance, scope
from train_ato.control.observers.record_observer import Body, ObserverForm, RecordObserver
from train_ato.control.train_model import TrainModel


@dataclass(frozen=True)
class NdoParameters:
    """Parameters of :class:`Ndo`."""

    omega: float = parameter(20.0, "1/s", 0.0, 1e6, "bandwidth; 1000 in the paper is a difference quotient")
    scope: str = scope()
    model_error: float = parameter(0.01, "1", -0.5, 10.0, "f_hat = f/(1 + model_error), vehicle scope only")


@dataclass(frozen=True)
class NdoConstants(NdoParameters, BalanceConstants):
    """Constants of :func:`ndo`: its parameters, the balance and the values computed from them."""

    decay: float = quantity("1", "factor on the estimate in a sample")


@compiled
def ndo(p: NdoConstants, own: Body, position: float, speed: float, driven: float, resistance: float) -> float:
    """Return the filtered acceleration that the model does not explain [m/s²]."""
    if not own.known:
        return own.unexplained
    found = (speed - own.speed) / p.period - driven + own.resistance
    return p.decay * own.unexplained + (1.0 - p.decay) * found


class Ndo(RecordObserver):
    """Nonlinear disturbance observer (paper 000), sampled exactly for any bandwidth."""

    Parameters: ClassVar[type] = NdoParameters
    form = ObserverForm(ndo, NdoConstants, Body)

    def __init__(self, parameters: NdoParameters, model: TrainModel, period: float) -> None:
        balance = ForceBalance(model, parameters.scope, parameters.model_error, period)
        super().__init__(parameters, model, period, balance, decay=math.exp(-parameters.omega * period))
