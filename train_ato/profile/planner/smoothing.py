"""Jerk limit by a moving average over time.

The unsmoothed solution has constant acceleration in every cell.  Its average over a window T has the jerk
(a(t + T/2) - a(t - T/2))/T, the same distance and the same end; no speed or acceleration exceeds the largest in the
window.  Averages are differences of the integrals and therefore exact.
"""

from __future__ import annotations

import numpy as np

from plant_sim.compiled import compiled
from train_ato.messages.types import Array


@compiled
def time_history(
    energy: Array, places: Array, lead: float, lead_acceleration: float, tail: float, margin: float
) -> Array:
    """Return the unsmoothed solution over time: rows time, integral of place, place, speed, acceleration.

    Parameters
    ----------
    energy : Array, shape (n + 1,)
        v²/2 at every place of the front.
    places : Array, shape (n + 1,)
        m.
    lead, lead_acceleration
        Duration and acceleration of the state before the first place [s, m/s²].
    tail
        Duration of the speed at the last place [s].
    margin
        Further time before and after [s].
    """
    n, begin = energy.size - 1, places[0]
    run = np.zeros((5, n + 3))
    v0 = np.sqrt(2.0 * energy[0])
    time, v = -lead - margin, v0 - lead_acceleration * (lead + margin)
    run[0, 0], run[3, 0], run[4, 0] = time, v, lead_acceleration
    run[2, 0] = begin - v0 * (lead + margin) + 0.5 * lead_acceleration * (lead + margin) ** 2
    time, v = 0.0, v0
    run[0, 1], run[2, 1], run[3, 1] = 0.0, begin, v0
    for k in range(n):
        u = np.sqrt(2.0 * energy[k + 1])
        dt = 2.0 * (places[k + 1] - places[k]) / (v + u)
        run[4, k + 1] = (u - v) / dt
        time, v = time + dt, u
        run[0, k + 2], run[2, k + 2], run[3, k + 2] = time, places[k + 1], u
    run[0, n + 2], run[2, n + 2], run[3, n + 2] = time + tail + margin, places[n] + v * (tail + margin), v
    origin = run[2, 1]
    for k in range(n + 2):
        dt = run[0, k + 1] - run[0, k]
        run[1, k + 1] = run[1, k] + dt * (run[2, k] - origin + dt * (run[3, k] / 2.0 + dt * run[4, k] / 6.0))
    return run


@compiled
def _integrals_at(run: Array, piece: int, time: float, origin: float) -> tuple[float, float, float, float]:
    s = time - run[0, piece]
    x, v, a = run[2, piece] - origin, run[3, piece], run[4, piece]
    return (
        run[1, piece] + s * (x + s * (v / 2.0 + s * a / 6.0)),
        x + s * (v + s * a / 2.0),
        v + s * a,
        a,
    )


@compiled
def moving_average(run: Array, times: Array, window: float) -> tuple[Array, Array, Array]:
    """Return place [m], speed [m/s] and acceleration [m/s²], averaged over a window [s] around increasing times [s]."""
    n = times.size
    place, speed, acceleration = np.empty(n), np.empty(n), np.empty(n)
    origin = run[2, 1]
    early, late, last = 0, 0, run.shape[1] - 2
    for k in range(n):
        t0, t1 = times[k] - window / 2.0, times[k] + window / 2.0
        while early < last and run[0, early + 1] <= t0:
            early += 1
        while late < last and run[0, late + 1] <= t1:
            late += 1
        y0, x0, v0, a0 = _integrals_at(run, early, t0, origin)
        if window <= 0.0:
            place[k], speed[k], acceleration[k] = origin + x0, v0, a0
        else:
            y1, x1, v1, _ = _integrals_at(run, late, t1, origin)
            place[k] = origin + (y1 - y0) / window
            speed[k] = (x1 - x0) / window
            acceleration[k] = (v1 - v0) / window
    return place, speed, acceleration


@compiled
def largest_acceleration_change(run: Array, window: float) -> float:
    """Return the largest change of acceleration within a window [m/s²]; divided by the window it is the jerk."""
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
