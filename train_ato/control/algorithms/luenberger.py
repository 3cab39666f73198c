"""A quantity and the constant that its known rate misses, observed in discrete time with both poles at exp(-omega Tc).

With r the rate that is known and d the one that is not, y measured::

    y- = y_k-1 + Tc (r + d_k-1),   e = y_k - y-
    y_k = y- + (1 - b²) e,   d_k = d_k-1 + (1 - b)²/Tc e,   b = exp(-omega Tc)

A constant d is found without offset, and what is left of it falls like (1 + k (1 - b)) b^k whatever omega Tc is.
"""

from __future__ import annotations

import math


class TwoPoles:
    """Observer of one quantity.

    Parameters
    ----------
    omega
        Bandwidth [1/s].
    period
        Sampling period [s].

    Attributes
    ----------
    missing : float
        Estimate of d, in the unit of the quantity per second.
    """

    def __init__(self, omega: float, period: float) -> None:
        pole = math.exp(-omega * period)
        self._period = period
        self._gain, self._missing_gain = 1.0 - pole * pole, (1.0 - pole) ** 2 / period
        self.reset()

    def reset(self) -> None:
        """Begin with the next sample, with nothing missing."""
        self.missing = 0.0
        self.restart()

    def restart(self) -> None:
        """Begin with the next sample, keeping what was found missing."""
        self._value: float | None = None

    def step(self, measured: float, known: float) -> float:
        """Take a sample and the known mean rate over the time since the last one; return :attr:`missing`."""
        if self._value is None:
            self._value = measured
            return self.missing
        predicted = self._value + self._period * (known + self.missing)
        miss = measured - predicted
        self._value = predicted + self._gain * miss
        self.missing += self._missing_gain * miss
        return self.missing
