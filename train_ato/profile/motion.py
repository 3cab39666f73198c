"""Motion in pieces of constant jerk, sampled to the knots of a profile.

A change of speed within a speed-dependent acceleration limit is solved in the plane of speed and ``y = a²/2``: since
dy/dv = da/dt, a jerk limit is a limit on the slope of y.  The fastest change is the largest curve below ``a_max(v)²/2``
with that slope; one pass in each direction finds it.  Between two grid points y is linear in v, so every cell is a
piece of constant jerk and is integrated exactly.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from train_ato.messages.types import Array
from train_ato.profile.knots import knot_count
from train_ato.profile.profile import Profile

CELLS = 1000
"""Number of speed cells of a change of speed."""
SAMPLED_AT_ONCE = 65536
"""Number of knots that are sampled at once: a day has 1.7 million."""
MIN_SPEED_CHANGE = 1e-9
"""Changes of speed below this are ignored [m/s]."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Duration [s], initial acceleration [m/s²] and constant jerk [m/s³] of one piece."""

    duration: float
    acceleration: float
    jerk: float


def _advance(x: float, v: float, t: float, a: float, j: float) -> tuple[float, float]:
    return x + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2)


@dataclass
class Motion:
    """A motion built from pieces of constant jerk.

    Attributes
    ----------
    time, position, velocity, acceleration : float
        State at its present end: s, m, m/s, m/s².
    pieces : array of float
        Duration [s], initial acceleration [m/s²] and jerk [m/s³] of every piece so far, one after the other.
    """

    time: float
    position: float
    velocity: float = 0.0
    acceleration: float = 0.0
    pieces: array[float] = field(default_factory=lambda: array("d"))

    def __post_init__(self) -> None:
        self.begin = (self.time, self.position, self.velocity)

    def add(self, pieces: list[Piece]) -> None:
        """Append pieces."""
        for piece in pieces:
            numbers = piece.duration, piece.acceleration, piece.jerk
            self.position, self.velocity = _advance(self.position, self.velocity, *numbers)
            self.time += piece.duration
            self.acceleration = piece.acceleration + piece.jerk * piece.duration
            self.pieces.extend(numbers)

    def hold(self, duration: float) -> None:
        """Append constant speed for a duration [s]."""
        if duration > 0:
            self.add([Piece(duration, 0.0, 0.0)])
            self.acceleration = 0.0

    def settle(self, jerk: float | None) -> None:
        """Append a piece that reduces the acceleration to 0 within the jerk limit [m/s³]."""
        if self.acceleration and jerk:
            duration = abs(self.acceleration) / jerk
            self.add([Piece(duration, self.acceleration, -math.copysign(jerk, self.acceleration))])
        self.acceleration = 0.0

    def sampled(self, period: float) -> Profile:
        """Return the profile of the motion with knots every ``period`` seconds; the last knot may be after its end."""
        time, x, v = self.begin
        pieces = len(self.pieces) // 3
        states = np.empty((pieces + 1, 5))
        for row, (duration, a, j) in zip(states, zip(*[iter(self.pieces)] * 3, strict=True), strict=False):
            row[:] = time, x, v, a, j
            x, v = _advance(x, v, duration, a, j)
            v = 0.0 if abs(v) < MIN_SPEED_CHANGE else v
            time += duration
        states[-1] = time, x, v, self.acceleration, 0.0
        count = knot_count(max(2.0, float(np.ceil((time - self.begin[0]) / period - 1e-9)) + 1))
        found = np.empty((3, count))
        for first in range(0, count, SAMPLED_AT_ONCE):
            part = found[:, first : first + SAMPLED_AT_ONCE]
            knots = self.begin[0] + period * np.arange(first, first + part.shape[1])
            index = np.clip(np.searchsorted(states[:, 0], knots + 1e-12, side="right") - 1, 0, pieces)
            t0, x0, v0, a0, j0 = states[index].T
            s = np.maximum(knots - t0, 0.0)
            part[0] = x0 + s * (v0 + s * (a0 / 2 + s * j0 / 6))
            part[1] = v0 + s * (a0 + s * j0 / 2)
            part[2] = a0 + s * j0
            if abs(v) < MIN_SPEED_CHANGE:
                part[:, index == pieces] = [[x], [0.0], [0.0]]
        return Profile.uniform(self.begin[0], period, *found)


def change_of_speed(start: float, target: float, limit: Callable[[Array], Array], jerk: float | None) -> list[Piece]:
    """Return the fastest change from one speed to another, with zero acceleration at both ends.

    Parameters
    ----------
    start, target
        Speeds [m/s] of one sign (0 counts as either).
    limit
        Function of the speed magnitude [m/s] that returns the acceleration limit [m/s²].
    jerk
        Jerk limit [m/s³]; None: the acceleration may step.

    Raises
    ------
    ValueError
        If the limit is zero at a speed between them.
    """
    if abs(target - start) < MIN_SPEED_CHANGE:
        return []
    speed = np.linspace(abs(start), abs(target), CELLS + 1)
    largest = np.asarray(limit(speed), dtype=np.float64)
    none_left = np.flatnonzero(largest <= 0)
    if none_left.size:
        raise ValueError(
            f"{3.6 * abs(target):.1f} km/h cannot be reached: no acceleration available at "
            f"{3.6 * speed[none_left[0]]:.1f} km/h; choose a speed below it"
        )
    y = _under_slope(largest**2 / 2, abs(target - start) / CELLS, jerk)
    a = np.sqrt(2 * y) * math.copysign(1.0, target - start)
    with np.errstate(divide="ignore"):  # an acceleration that is 0 in floating point: endless, refused by knot_count
        duration = 2 * abs(target - start) / CELLS / np.abs(a[:-1] + a[1:])
    slope = (a[1:] - a[:-1]) / duration
    return [Piece(*row) for row in zip(duration.tolist(), a[:-1].tolist(), slope.tolist(), strict=True)]


def _under_slope(y: Array, step: float, jerk: float | None) -> Array:
    """Return the largest curve below ``y`` with a slope within the jerk limit, 0 at both ends."""
    if jerk is None:
        return y
    y = y.copy()
    y[0] = y[-1] = 0.0
    rise = min(jerk * step, float(y.max()))  # a steeper ramp limits nothing else and would cancel y by rounding
    ramp = rise * np.arange(y.size)
    y = np.minimum.accumulate(y - ramp) + ramp
    y = (np.minimum.accumulate(y[::-1] - ramp) + ramp)[::-1]
    return np.maximum(y, 0.0)
