"""Sampled cascade of paper 002 for one vehicle: speed offset d1, its derivative, and disturbance d2.

Plant, with d1 unmatched (m/s) and d2 matched (m/s²)::

    x' = v + d1,   v' = a + d2                                                           (6)

The paper (7), (11): xh' = vh + phi1, phi1 = k1 sign(x - xh); vh' = a + phi2, phi2 = k2 sign(v - vh);
d1h' = k3 (phi1 - d1h) - k4 sign(d1h - d1), d2h = LPF(phi2). Its e3 = d1h - d1 contains the unknown d1, which is
replaced by the filtered phi1 here. The explicit form needs a very short step (10 % error after 0.02 s at 10 µs, useless
at 50 ms), and is :class:`ExplicitCascade`. Two better sampled forms:

* :class:`ImplicitCascade`: the sign is the projection that brings the error to 0 within one sample, if k is sufficient;
* :class:`LevantCascade`: robust exact differentiators of the same signals (d1 and d1' from x - int v, d2 from
  v - int a), best up to 1 ms.
"""

from __future__ import annotations

import math

from train_ato.control.algorithms.sliding import saturation


class Cascade:
    """State of one vehicle's cascade; a subclass adds ``step()``.

    Attributes
    ----------
    d1, d1_rate, d2 : float
        Speed offset [m/s], its rate and the disturbance [m/s²].
    position, velocity : float
        Estimated position [m] and speed [m/s], after the first ``step()``.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self.reset()

    def reset(self) -> None:
        """Restart at the next sample with estimates of 0."""
        self._x: float | None = None
        self._v = 0.0
        self.d1, self.d1_rate, self.d2 = 0.0, 0.0, 0.0

    def restart(self) -> None:
        """Restart at the next sample with the present estimates."""
        self._x = None

    @property
    def position(self) -> float:
        """Estimated position [m]; 0 before the first sample."""
        return self._x or 0.0

    @property
    def velocity(self) -> float:
        """Estimated speed [m/s]."""
        return self._v

    def step(self, x: float, v: float, acceleration: float) -> None:
        """Update the estimates by position [m], speed [m/s] and mean modelled acceleration of the sample [m/s²]."""
        raise TypeError(f"{type(self).__name__} has no step()")


class ExplicitCascade(Cascade):
    """Observer (7), (11) as printed: explicit steps and sign functions.

    Parameters
    ----------
    period
        Sampling period [s].
    k1, k2, k3, k4
        Gains of the paper [m/s, m/s², 1/s, m/s²].
    filter_time
        Time constant of the low-pass filters [s].
    """

    def __init__(self, period: float, k1: float, k2: float, k3: float, k4: float, filter_time: float) -> None:
        super().__init__(period)
        self._k1, self._k2, self._k3, self._k4 = k1, k2, k3, k4
        self._decay = math.exp(-period / filter_time) if filter_time > 0.0 else 0.0

    def reset(self) -> None:
        """Restart at the next sample with estimates of 0."""
        super().reset()
        self._offset = 0.0

    def step(self, x: float, v: float, acceleration: float) -> None:
        """Update the estimates by position [m], speed [m/s] and mean modelled acceleration of the sample [m/s²]."""
        if self._x is None:
            self._x, self._v = x, v
            return
        h, decay = self._period, self._decay
        phi1, phi2 = self._k1 * saturation(x - self._x, 0.0), self._k2 * saturation(v - self._v, 0.0)
        self._x += h * (self._v + phi1)
        self._v += h * (acceleration + phi2)
        self._offset = decay * self._offset + (1.0 - decay) * phi1
        self.d2 = decay * self.d2 + (1.0 - decay) * phi2
        rate = self._k3 * (phi1 - self.d1) - self._k4 * saturation(self.d1 - self._offset, 0.0)
        self.d1 += h * rate
        self.d1_rate = decay * self.d1_rate + (1.0 - decay) * rate


class ImplicitCascade(ExplicitCascade):
    """Observer (7), (11) with implicit signs; parameters as for :class:`ExplicitCascade`."""

    def step(self, x: float, v: float, acceleration: float) -> None:
        """Update the estimates by position [m], speed [m/s] and mean modelled acceleration of the sample [m/s²]."""
        if self._x is None:
            self._x, self._v = x, v
            return
        h, decay = self._period, self._decay
        phi2 = min(max((v - self._v) / h - acceleration, -self._k2), self._k2)
        mean = self._v + 0.5 * h * (acceleration + phi2)
        phi1 = min(max((x - self._x) / h - mean, -self._k1), self._k1)
        self._x += h * (mean + phi1)
        self._v += h * (acceleration + phi2)
        self._offset = decay * self._offset + (1.0 - decay) * phi1
        self.d2 = decay * self.d2 + (1.0 - decay) * phi2
        free = self.d1 + h * self._k3 * (phi1 - self.d1)
        off = free - self._offset
        found = self._offset + max(0.0, abs(off) - h * self._k4) * saturation(off, 0.0)
        rate = (found - self.d1) / h
        self.d1 = found
        self.d1_rate = decay * self.d1_rate + (1.0 - decay) * rate


class LevantCascade(Cascade):
    """Robust exact differentiators of second and first order for the same quantities.

    Parameters
    ----------
    period
        Sampling period [s].
    jerk_offset
        Bound of |d1''| [m/s³].
    jerk
        Bound of |d2'| [m/s³].
    """

    def __init__(self, period: float, jerk_offset: float, jerk: float) -> None:
        super().__init__(period)
        self._l1, self._l2 = jerk_offset, jerk

    def step(self, x: float, v: float, acceleration: float) -> None:
        """Update the estimates by position [m], speed [m/s] and mean modelled acceleration of the sample [m/s²]."""
        if self._x is None:
            self._x, self._v, self._measured = x, v, v
            return
        h = self._period
        mean = 0.5 * (v + self._measured)
        self._measured = v
        self._x += h * (mean + self.d1 + 0.5 * h * self.d1_rate)
        self.d1 += h * self.d1_rate
        miss = x - self._x
        size, scale = abs(miss), self._l1 ** (1.0 / 3.0)
        direction = saturation(miss, self._l1 * h**3)
        self._x += h * 2.0 * scale * size ** (2.0 / 3.0) * direction
        self.d1 += h * 2.12 * scale**2 * size ** (1.0 / 3.0) * direction
        self.d1_rate += h * 1.1 * self._l1 * direction
        self._v += h * (acceleration + self.d2)
        miss = v - self._v
        direction = saturation(miss, self._l2 * h * h)
        self._v += h * 1.5 * math.sqrt(self._l2 * abs(miss)) * direction
        self.d2 += h * 1.1 * self._l2 * direction
