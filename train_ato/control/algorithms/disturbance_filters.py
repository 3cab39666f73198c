"""Models of the disturbance of a train for a bank of Kalman filters; `msgs_docs/mpc_derivation.md`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from train_ato.messages.types import Array

SHARES = (1.0, 0.25, 0.0625)
"""Bandwidths of the random walks over omega_o."""
STAY_TIME = 20.0
"""Mean time for which one of the random walks is right [s]."""
RATE_SHARE = 0.2
"""Bandwidth of the rate of the disturbance over omega_o."""
RAMP_TIME = 3.0
"""T_r, time constant of the rate of the disturbance [s]; 118 m of a metro train have 6 s at 20 m/s."""
GUST_TIME, CALM_TIME = 1.0, 20.0
"""Mean times for which the filter of a gust and that of a steady rate are right [s]."""
COUPLED_FLOOR, FREE_FLOOR = 0.5, 0.05
"""Smallest standard deviation of the position over that of the speed, up to that of ``SPEED_FLOOR`` [s]: 5 mm with
couplers, which move a unit in its train, and .5 mm without. More noise of the position is measured."""
COUPLED_PRIOR, FREE_PRIOR = 0.05, 0.0025
"""Standard deviation of the position at the start [m]; a larger one is measured within seconds. ``FREE_PRIOR`` has the
later ratio to that of the speed: with .05 m a fast filter takes an error of the speed of 2 mm/s for motion."""


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
    position_floor
        Smallest standard deviation of the position over that of the speed [s].
    position_prior
        Standard deviation of the position at the start [m].
    """

    walks: Array
    rates: Array
    chain: Array
    position_floor: float
    position_prior: float

    @classmethod
    def coupled(cls, period: float, bandwidth: float) -> DisturbanceFilters:
        """Return random walks for a period [s] and a bandwidth omega_o [rad/s]."""
        count = len(SHARES)
        leave = min(0.5, period / STAY_TIME) / (count - 1)
        chain = np.full((count, count), leave)
        chain[np.arange(count), np.arange(count)] = 1.0 - leave * (count - 1)
        return cls((bandwidth * np.array(SHARES)) ** 2, np.zeros(count), chain, COUPLED_FLOOR, COUPLED_PRIOR)

    @classmethod
    def free(cls, period: float, bandwidth: float) -> DisturbanceFilters:
        """Return the filters of a gust and of a steady rate for a period [s] and a bandwidth omega_o [rad/s]."""
        ends, begins = (min(0.5, period / time) for time in (GUST_TIME, CALM_TIME))
        chain = np.array([[1.0 - ends, ends], [begins, 1.0 - begins]])
        rates = np.full(2, (RATE_SHARE * bandwidth) ** 6)
        return cls(np.array([bandwidth**2, 0.0]), rates, chain, FREE_FLOOR, FREE_PRIOR)


def motion_by_rate(rate: float, later: float) -> tuple[float, float, float, float]:
    """Return position [m], speed [m/s], disturbance [m/s²] and rate [m/s³] after a time by the rate now alone.

    Parameters
    ----------
    rate
        r, rate of the disturbance now [m/s³].
    later
        Time [s].
    """
    fade = math.exp(-later / RAMP_TIME)
    risen = RAMP_TIME * (1.0 - fade)
    speed = RAMP_TIME * (later - risen)
    position = RAMP_TIME * (0.5 * later * later - speed)
    return rate * position, rate * speed, rate * risen, rate * fade
