"""Last part of a trip profile: from the slow end of the simulated run to standstill at the stop."""

from __future__ import annotations

import math

import numpy as np

from train_ato.messages.types import Array

JERK = 0.002
"""Change of the deceleration at the begin of the last part [m/s³]: 21 kN/s for a train of 10 700 t."""
STRONGEST = 0.2
"""Largest deceleration of the last part [m/s²]."""


def braking_distance(speed: float, deceleration: float, final: float) -> float:
    """Return the distance to standstill [m] if the deceleration changes to a final one with :data:`JERK`.

    Parameters
    ----------
    speed, deceleration
        State at the begin [m/s, m/s²].
    final
        Deceleration after the change [m/s²].
    """
    duration, slope = _change(speed, deceleration, final)
    rest = speed - deceleration * duration - slope * duration**2 / 2
    way = speed * duration - deceleration * duration**2 / 2 - slope * duration**3 / 6
    return way + max(rest, 0.0) ** 2 / (2 * final)


def _change(speed: float, deceleration: float, final: float) -> tuple[float, float]:
    """Return duration [s] and slope [m/s³] of the change; it ends at standstill at the latest."""
    slope = math.copysign(JERK, final - deceleration)
    duration = (final - deceleration) / slope
    root = deceleration**2 + 2 * slope * speed
    if root >= 0.0:
        stop = 2 * speed / (deceleration + math.sqrt(root))
        duration = min(duration, stop)
    return duration, slope


def final_deceleration(speed: float, deceleration: float, distance: float) -> float:
    """Return the final deceleration that stops the train after a distance [m/s²].

    Raises
    ------
    ValueError
        If no deceleration up to :data:`STRONGEST` does.
    """
    low, high = 1e-4, STRONGEST
    if not braking_distance(speed, deceleration, high) <= distance <= braking_distance(speed, deceleration, low):
        raise ValueError(
            f"no stop after {distance:.1f} m from {3.6 * speed:.1f} km/h; permit a stronger brake, or increase "
            "final_deceleration"
        )
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if braking_distance(speed, deceleration, middle) > distance else (low, middle)
    return 0.5 * (low + high)


def stop_knots(
    position: float, speed: float, deceleration: float, stop: float, period: float
) -> tuple[Array, Array, Array]:
    """Return position, speed and acceleration of the knots after a state, up to rest at a stop [m].

    Parameters
    ----------
    position, speed, deceleration
        State of the last knot before [m, m/s, m/s²].
    stop
        Place of standstill [m].
    period
        Time between the knots [s].
    """
    final = final_deceleration(speed, deceleration, stop - position)
    change, slope = _change(speed, deceleration, final)
    middle = speed - deceleration * change - slope * change**2 / 2
    end = change + max(middle, 0.0) / final
    time = period * np.arange(1, math.ceil(end / period) + 1)
    first = np.minimum(time, change)
    second = np.clip(time - change, 0.0, end - change)
    a = np.where(time < change, -(deceleration + slope * time), -final)
    v = speed - deceleration * first - slope * first**2 / 2 - final * second
    x = speed * first - deceleration * first**2 / 2 - slope * first**3 / 6 + middle * second - final * second**2 / 2
    at_rest = time >= end - 1e-9
    return np.where(at_rest, stop, position + x), np.where(at_rest, 0.0, np.maximum(v, 0.0)), np.where(at_rest, 0.0, a)
