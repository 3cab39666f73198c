"""Models of the disturbance d of a train [m/s²] for a bank of Kalman filters, and d at a later time.

Trains with couplers: d is a random walk of PSD q = (share omega_o)⁴ sigma² Tc, with the shares 1, 1/4, 1/16 of the
bandwidth omega_o. A constant d needs a slow filter, and a sudden one a fast filter.

A train without couplers shows its disturbance without their waves. Two filters, after Singer (1970, IEEE Transactions on
Aerospace and Electronic Systems 6), who has a target in place of the train::

    d' = r + white noise of PSD q,   r' = -r/T_r + white noise of PSD q_r,   q_r = (omega_o/4)⁶ sigma² Tc

A grade or a curve under a train of length L changes d at a rate r for L/v: ``RAMP_TIME`` is the time constant T_r. The
first filter is that of a gust, which begins at once (q > 0), and is right for ``GUST_TIME``. The second one has q = 0
and is right for ``CALM_TIME``. The change comes from the innovations: it is quick at the begin of a gust, and the
command is calm between gusts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from train_ato.messages.types import Array

SHARES = (1.0, 0.25, 0.0625)
"""Bandwidths of the random walks over omega_o."""
RATE_SHARE = 0.2
"""Bandwidth of the rate of the disturbance over omega_o."""
STAY_TIME = 20.0
"""Mean time for which one of the random walks is right [s]."""
GUST_TIME, CALM_TIME = 1.0, 20.0
"""Mean times for which the filter of a gust and that of a steady rate are right [s]."""
RAMP_TIME = 3.0
"""Time constant of the rate of the disturbance [s]: 118 m of a metro train at 20 m/s are 6 s."""
COUPLED_RATIO, FREE_RATIO = 0.5, 0.05
"""Smallest standard deviation of the position over that of the speed, up to that of ``SPEED_FLOOR`` [s]. Waves in the
couplers move a unit by millimetres; without couplers the smallest one is 1 mm. More noise of the position is measured.
"""
COUPLED_PRIOR, FREE_PRIOR = 0.05, 0.0025
"""Standard deviation of the position at the start [m]; a larger one is measured within seconds. The smaller one has the
ratio to that of the speed that it has later: else a quick filter takes an error of the speed of 2 mm/s for motion.
"""


@dataclass(frozen=True)
class DisturbanceFilters:
    """Filters of the disturbance.

    Attributes
    ----------
    walks : Array, shape (filters,)
        Squares of the bandwidths of the random walks [rad²/s²]; 0: the disturbance changes by its rate only.
    rates : Array, shape (filters,)
        Sixth powers of the bandwidths of the rates [rad⁶/s⁶]; 0: no rate.
    chain : Array, shape (filters, filters)
        Probability of a change in a period, from filter to filter.
    position_ratio
        Smallest standard deviation of the position over that of the speed [s].
    position_prior
        Standard deviation of the position at the start [m].
    """

    walks: Array
    rates: Array
    chain: Array
    position_ratio: float
    position_prior: float

    @classmethod
    def coupled(cls, period: float, bandwidth: float) -> DisturbanceFilters:
        """Return random walks for a period [s] and a bandwidth omega_o [rad/s]."""
        count = len(SHARES)
        leave = min(0.5, period / STAY_TIME) / (count - 1)
        chain = np.full((count, count), leave)
        chain[np.arange(count), np.arange(count)] = 1.0 - leave * (count - 1)
        return cls((bandwidth * np.array(SHARES)) ** 2, np.zeros(count), chain, COUPLED_RATIO, COUPLED_PRIOR)

    @classmethod
    def free(cls, period: float, bandwidth: float) -> DisturbanceFilters:
        """Return the filters of a gust and of a steady rate for a period [s] and a bandwidth omega_o [rad/s]."""
        ends, begins = (min(0.5, period / time) for time in (GUST_TIME, CALM_TIME))
        chain = np.array([[1.0 - ends, ends], [begins, 1.0 - begins]])
        rates = np.full(2, (RATE_SHARE * bandwidth) ** 6)
        return cls(np.array([bandwidth**2, 0.0]), rates, chain, FREE_RATIO, FREE_PRIOR)


def disturbance_ahead(rate: float, later: float, lag: float) -> tuple[float, float, float]:
    """Return the change of position [m], speed [m/s] and disturbance [m/s²] by its rate after a time.

    Parameters
    ----------
    rate
        r, rate of the disturbance now [m/s³].
    later
        Time [s].
    lag
        Lag Ta of the actuators [s]: the third result is d + Ta d' - d(0), which a command must give.
    """
    faded = math.exp(-later / RAMP_TIME)
    speed = RAMP_TIME * rate * (later - RAMP_TIME * (1.0 - faded))
    position = RAMP_TIME * rate * (0.5 * later * later - RAMP_TIME * later + RAMP_TIME**2 * (1.0 - faded))
    return position, speed, rate * (RAMP_TIME * (1.0 - faded) + lag * faded)
