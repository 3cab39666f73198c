"""Extended-state observer in discrete time: speed and disturbance as states, both poles at exp(-omega Tc).

The observer predicts the next speed from the modelled forces and the estimated disturbance, and corrects both by the
prediction error. It is less noisy than `ndo` at the same bandwidth and preferable from 10 ms on. It is not from a
paper.

The scope of the balance (every unit's vehicle, or the whole train) and its forces are those of
:mod:`train_ato.control.observers.ndo`. a is the modelled acceleration, averaged over the sample::

    v- = v_k-1 + Tc (a + d_k-1),   r = v_measured - v-
    v_k = v- + (1 - b²) r,   d_k = d_k-1 + (1 - b)²/Tc r,   b = exp(-omega Tc)

A constant disturbance is found without offset; the error falls like (1 + k (1 - b)) b^k for any omega Tc. The
estimate is the force m d.

Needs: the same as `ndo`.
"""

from dataclasses import dataclass
from typing import ClassVar

from plant_sim.compiled import compiled
from plant_sim.record import quantity
from train_ato.control.algorithms.luenberger import Tracked, luenberger_gains, unknown_rate
from train_ato.control.contract import parameter
from train_ato.control.observers.force_balance import BalanceConstants, ForceBalance, scope
from train_ato.control.observers.record_observer import Body, ObserverForm, RecordObserver
from train_ato.control.train_model import TrainModel


@dataclass(frozen=True)
class EsoParameters:
    """Parameters of :class:`Eso`."""

    omega: float = parameter(2.0, "1/s", 0.0, 1e6, "bandwidth: both poles at exp(-omega Tc)")
    scope: str = scope()


@dataclass(frozen=True)
class EsoConstants(EsoParameters, BalanceConstants):
    """Constants of :func:`eso`: its parameters, the balance and the values computed from them."""

    gain: float = quantity("1", "gain on the error of the speed")
    rate_gain: float = quantity("1/s", "gain on the error of the disturbance")


@dataclass
class EsoBody(Tracked, Body):
    """State of :func:`eso`: estimates of speed and disturbance, and the balance."""


@compiled
def eso(p: EsoConstants, own: EsoBody, position: float, speed: float, driven: float, resistance: float) -> float:
    """Return the estimated disturbance [m/s²]."""
    rate = driven - 0.5 * (own.resistance + resistance)
    return float(unknown_rate(own, p.period, p.gain, p.rate_gain, speed, rate))


class Eso(RecordObserver):
    """Discrete extended-state observer: speed and disturbance, one bandwidth."""

    Parameters: ClassVar[type] = EsoParameters
    form = ObserverForm(eso, EsoConstants, EsoBody)

    def __init__(self, parameters: EsoParameters, model: TrainModel, period: float) -> None:
        balance = ForceBalance(model, parameters.scope, 0.0, period)
        gain, rate_gain = luenberger_gains(parameters.omega, period)
        super().__init__(parameters, model, period, balance, gain=gain, rate_gain=rate_gain)
