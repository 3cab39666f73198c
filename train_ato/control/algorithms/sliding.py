"""Sliding surfaces, reaching terms and smooth signs, shared by the sliding-mode laws."""

from __future__ import annotations

import math


def sign(value: float) -> float:
    """Return -1, 0 or 1."""
    return float((value > 0) - (value < 0))


def saturation(value: float, width: float) -> float:
    """Return the sign, linear within a boundary layer of ``width``; the sign itself for a width of 0."""
    if width <= 0.0:
        return sign(value)
    return min(max(value / width, -1.0), 1.0)


def sig(value: float, power: float) -> float:
    """Return ``|value|^power sign(value)``, written sig^p in paper 002."""
    if value == 0.0:
        return 0.0
    return math.copysign(math.pow(abs(value), power), value)


def adaptive_gain(error: float, kappa: float) -> float:
    """Return zeta = kappa tanh(|e|/2), the factor of the switching term in paper 000, eq. (21)."""
    return kappa * math.tanh(abs(error) / 2.0)


class IntegralSurface:
    """Surface S = e' + l1 e + l2 int e of one unit: paper 000, eq. (19).

    Parameters
    ----------
    l1, l2
        Weights [1/s, 1/s²].
    period
        Sampling period [s]; the integral is a trapezoidal sum.
    limit
        Largest magnitude of the integral [m s].
    """

    def __init__(self, l1: float, l2: float, period: float, limit: float) -> None:
        self.l1, self.l2 = l1, l2
        self._period, self._limit = period, limit
        self._integral = 0.0
        self._before: float | None = None

    def reset(self) -> None:
        """Set the integral to 0."""
        self._integral = 0.0
        self._before = None

    def on_missed_sample(self) -> None:
        """Handle a missed sample: the integral does not bridge the gap."""
        self._before = None

    def step(self, error: float, rate: float, hold: bool) -> float:
        """Return S [m/s] for an error [m] and its rate [m/s]; ``hold`` freezes the integral."""
        if not hold and self._before is not None:
            total = self._integral + 0.5 * (error + self._before) * self._period
            self._integral = min(max(total, -self._limit), self._limit)
        self._before = error
        return rate + self.l1 * error + self.l2 * self._integral
