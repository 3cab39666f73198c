"""Jerk limit by averaging: the raw run is averaged over a sliding window of time.

The raw run has constant acceleration in every cell.  Averaged over a window T its jerk is (a(t + T/2) - a(t - T/2))/T,
its distance and its end stay what they are, and an acceleration or speed is never above the largest in the window.
All is exact: averages are differences of the integrals.
"""

from __future__ import annotations

import numpy as np

from plant_sim.compiled import compiled
from train_ato.types import Array

__all__ = ["averaged", "largest_jump", "raw_run"]


@compiled
def raw_run(energy: Array, places: Array, lead: float, lead_rate: float, tail: float, forever: float) -> Array:
    """Return the raw run as rows time, integral of place, place, speed, acceleration at every change.

    Parameters
    ----------
    energy : Array, shape (n + 1,)
        v²/2 at every place of the front.
    places : Array, shape (n + 1,)
        m.
    lead, lead_rate
        The state before the first place has lasted so long, with this acceleration [s, m/s²].
    tail
        The speed at the last place lasts so long [s].
    forever
        After and before that it lasts so long [s].
    """
    n, begin = energy.size - 1, places[0]
    run = np.zeros((5, n + 3))
    v0 = np.sqrt(2.0 * energy[0])
    time, v = -lead - forever, v0 - lead_rate * (lead + forever)
    run[0, 0], run[3, 0], run[4, 0] = time, v, lead_rate
    run[2, 0] = begin - v0 * (lead + forever) + 0.5 * lead_rate * (lead + forever) ** 2
    time, v = 0.0, v0
    run[0, 1], run[2, 1], run[3, 1] = 0.0, begin, v0
    for k in range(n):
        u = np.sqrt(2.0 * energy[k + 1])
        dt = 2.0 * (places[k + 1] - places[k]) / (v + u)
        run[4, k + 1] = (u - v) / dt
        time, v = time + dt, u
        run[0, k + 2], run[2, k + 2], run[3, k + 2] = time, places[k + 1], u
    run[0, n + 2], run[2, n + 2], run[3, n + 2] = time + tail + forever, places[n] + v * (tail + forever), v
    origin = run[2, 1]
    for k in range(n + 2):
        dt = run[0, k + 1] - run[0, k]
        run[1, k + 1] = run[1, k] + dt * (run[2, k] - origin + dt * (run[3, k] / 2.0 + dt * run[4, k] / 6.0))
    return run


@compiled
def _state(run: Array, piece: int, time: float, origin: float) -> tuple[float, float, float, float]:
    s = time - run[0, piece]
    x, v, a = run[2, piece] - origin, run[3, piece], run[4, piece]
    return (
        run[1, piece] + s * (x + s * (v / 2.0 + s * a / 6.0)),
        x + s * (v + s * a / 2.0),
        v + s * a,
        a,
    )


@compiled
def averaged(run: Array, times: Array, window: float) -> tuple[Array, Array, Array]:
    """Return place, speed and acceleration averaged over a window around rising times."""
    n = times.size
    place, speed, rate = np.empty(n), np.empty(n), np.empty(n)
    origin = run[2, 1]
    early, late, last = 0, 0, run.shape[1] - 2
    for k in range(n):
        t0, t1 = times[k] - window / 2.0, times[k] + window / 2.0
        while early < last and run[0, early + 1] <= t0:
            early += 1
        while late < last and run[0, late + 1] <= t1:
            late += 1
        y0, x0, v0, a0 = _state(run, early, t0, origin)
        if window <= 0.0:
            place[k], speed[k], rate[k] = origin + x0, v0, a0
        else:
            y1, x1, v1, _ = _state(run, late, t1, origin)
            place[k] = origin + (y1 - y0) / window
            speed[k] = (x1 - x0) / window
            rate[k] = (v1 - v0) / window
    return place, speed, rate


@compiled
def largest_jump(run: Array, window: float) -> float:
    """Return the largest change of acceleration across a window [m/s²]; over the window it is the largest jerk."""
    last = run.shape[1] - 2
    largest, first = 0.0, 0
    for early in range(last + 1):
        while first < last and run[0, first + 1] <= run[0, early] + window:
            first += 1
        late = first
        while late <= last and run[0, late] < run[0, early + 1] + window:
            largest = max(largest, abs(run[4, late] - run[4, early]))
            late += 1
    return largest
