"""Discrete observer of a quantity and of the unknown part of its rate, both poles at exp(-omega Tc).

With y measured, r the known part of its rate and d the unknown part::

    y- = y_k-1 + Tc (r + d_k-1),   e = y_k - y-
    y_k = y- + (1 - b²) e,   d_k = d_k-1 + (1 - b)²/Tc e,   b = exp(-omega Tc)

A constant d is found without offset; the error falls like (1 + k (1 - b)) b^k for any omega Tc.
"""

import math
from dataclasses import dataclass

from plant_sim.compiled import compiled
from plant_sim.record import quantity, zeros


@dataclass
class Tracked:
    """State of an observer of one quantity."""

    value: float = quantity("any", "estimate of the quantity")
    unknown_rate: float = quantity("any/s", "estimate of d")
    known: bool = quantity("", "there is a sample before")


def luenberger_gains(omega: float, period: float) -> tuple[float, float]:
    """Return the gains on the quantity [1] and on its unknown rate [1/s] for a bandwidth [1/s] and a period [s]."""
    pole = math.exp(-omega * period)
    return 1.0 - pole * pole, (1.0 - pole) ** 2 / period


@compiled
def unknown_rate(own: Tracked, period: float, gain: float, rate_gain: float, measured: float, rate: float) -> float:
    """Return the estimate of d for a sample and the known mean rate since the previous one."""
    if not own.known:
        own.known, own.value = True, measured
        return own.unknown_rate
    predicted = own.value + period * (rate + own.unknown_rate)
    miss = measured - predicted
    own.value = predicted + gain * miss
    own.unknown_rate += rate_gain * miss
    return own.unknown_rate


class LuenbergerObserver:
    """Observer of one quantity, called from Python.

    Parameters
    ----------
    omega
        Bandwidth [1/s].
    period
        Sampling period [s].
    """

    def __init__(self, omega: float, period: float) -> None:
        self._gains, self._state = (period, *luenberger_gains(omega, period)), zeros(Tracked, 1)

    def restart(self) -> None:
        """Restart at the next sample with the present unknown rate."""
        self._state["known"] = False

    def step(self, measured: float, known: float) -> float:
        """Return the unknown rate for a sample and the known mean rate since the previous sample."""
        return float(unknown_rate(self._state[0], *self._gains, measured, known))
