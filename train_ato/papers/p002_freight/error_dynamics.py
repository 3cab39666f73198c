"""Nominal error dynamics of paper 002: (18), (22), (26) in continuous time, without a train.

With all forces cancelled and no limit, S' = -a2 sig^p2(S) - b2 sig^g2(S) and E' = S - S_au(E), which depends on the
gain and on E(0) only.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from train_ato.control.algorithms.sliding import sig
from train_ato.control.laws.fixed_time_smc import LARGE, SMALL, alternating

FRACTION = 0.01
"""Integration step as a fraction of the fastest time constant."""
REST = 1e-9
"""A surface below this is 0 [m/s]."""
LONGEST = 60.0
"""End of the integration [s]."""


def fixed_time_bound(gain: float) -> tuple[float, float]:
    """Return the paper's bounds of the time to the surface (23) and on it (34) [s], eps = 1, all gains equal."""
    reaching = 1.0 / (2.0 * gain * (1.0 - (SMALL + 1.0) / 2.0)) + 1.0 / (2.0 * gain * ((LARGE + 1.0) / 2.0 - 1.0))
    sliding = math.log(2.0) / gain * (1.0 / (LARGE - 1.0) + 1.0 / (1.0 - SMALL))
    return reaching, sliding


def _reaching(surface: float, gain: float) -> float:
    return float(-gain * (sig(surface, SMALL) + sig(surface, LARGE)))


def nominal_settling(
    gain: float, error: float, rate: float, band: float = 0.01
) -> tuple[dict[str, float], dict[str, Any]]:
    """Integrate the nominal error dynamics.

    Parameters
    ----------
    gain
        alpha1 = beta1 = alpha2 = beta2 [1/s].
    error, rate
        E(0) [m] and E'(0) [m/s].
    band
        Largest error of the settled state [m].

    Returns
    -------
    figures
        ``settling`` (|E| stays within the band) and ``bound``, the sum of (23) and (34) [s]; ``acceleration``, the
        largest |E''| [m/s²].
    series
        ``time``, ``error``, ``acceleration``.
    """
    surface = rate + alternating(error, gain)[0]
    t, settled, largest = 0.0, 0.0, 0.0
    rows = []
    while t < LONGEST and (abs(error) > 1e-6 or abs(surface) > REST):
        auxiliary, slope = alternating(error, gain)
        pull = _reaching(surface, gain)
        acceleration = pull - slope * (surface - auxiliary)
        largest = max(largest, abs(acceleration))
        rows.append((t, error, acceleration))
        if abs(error) > band:
            settled = t
        fast = slope + (abs(pull / surface) * LARGE if abs(surface) > REST else 0.0)
        h = FRACTION / fast
        error, surface = _step(error, surface, gain, h)
        t += h
    time, errors, accelerations = np.array(rows).T
    figures = {"settling": settled, "bound": sum(fixed_time_bound(gain)), "acceleration": largest}
    return figures, {"time": time, "error": errors, "acceleration": accelerations}


def _step(error: float, surface: float, gain: float, h: float) -> tuple[float, float]:
    """Return E and S after one step of the midpoint rule; S does not cross 0."""
    half = surface + 0.5 * h * _reaching(surface, gain) if abs(surface) > REST else 0.0
    ahead = surface + h * _reaching(half, gain)
    if abs(surface) <= REST or ahead * surface < 0.0:
        ahead = 0.0
    middle = error + 0.5 * h * (surface - alternating(error, gain)[0])
    return error + h * (half - alternating(middle, gain)[0]), ahead
