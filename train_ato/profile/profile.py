"""Operational speed profile: the reference over time, evaluated at any stamp (interpolation in ``knots.py``)."""

from __future__ import annotations

import hashlib
from array import array

import numpy as np
from numpy.typing import NDArray

from train_ato.messages.types import Array
from train_ato.profile.knots import (
    STEP_ACCELERATION,
    check_columns,
    even_grid,
    hermite,
    knot_count,
    mean_jerk,
    padded,
    read_between,
    read_only,
    stamps_to_seconds,
    whole_nanoseconds,
)

__all__ = ["Profile"]

TAIL = 1024
"""Number of knots at rest stored after the end, so that a preview beyond the end is a slice."""


class Profile:
    """Reference of vehicle 0's centre over time.

    Before its start the profile is at rest at the first position, after its end at rest at the last one.

    Parameters
    ----------
    time : array_like, shape (n,)
        Times of the knots from the start of the run [s], evenly spaced, n >= 2; rounded to the nanosecond.
    position, velocity, acceleration : array_like, shape (n,)
        m, m/s, m/s².

    Raises
    ------
    ValueError
        If lengths differ, a value is not finite or the knots are not evenly spaced.
    """

    __slots__ = (
        "_a", "_count", "_j", "_pads", "_v", "_x", "acceleration", "period_ns", "position", "start_ns", "time",
        "velocity",
    )  # fmt: skip

    def __init__(self, time: Array, position: Array, velocity: Array, acceleration: Array) -> None:
        columns = [np.asarray(column, dtype=np.float64) for column in (time, position, velocity, acceleration)]
        check_columns(columns)
        self.start_ns, self.period_ns = even_grid(columns[0])
        self._count = count = columns[0].size
        self.time = stamps_to_seconds(self.start_ns + self.period_ns * np.arange(count))
        self.time.flags.writeable = False
        self._pad(columns[1], columns[2], columns[3], TAIL)
        self._j = array("d", mean_jerk(self.velocity, self.acceleration, self.period).tobytes())

    def _pad(self, position: Array, velocity: Array, acceleration: Array, tail: int) -> None:
        """Keep the knots, followed by ``tail`` knots at rest: once, as numbers of Python and as read-only arrays."""
        self._x, self._v, self._a = numbers = padded(position, velocity, acceleration, tail)
        self._pads = tuple(map(read_only, numbers))
        self.position, self.velocity, self.acceleration = (pad[: self._count] for pad in self._pads)

    @classmethod
    def uniform(cls, start: float, period: float, position: Array, velocity: Array, acceleration: Array) -> Profile:
        """Return the profile with knots every ``period`` stamps_to_seconds from ``start`` on."""
        count = np.asarray(position).size
        time = stamps_to_seconds(round(start * 1e9) + round(period * 1e9) * np.arange(count))
        return cls(time, position, velocity, acceleration)

    @property
    def start(self) -> float:
        """Time of the first knot [s]."""
        return self.start_ns * 1e-9

    @property
    def period(self) -> float:
        """Time between knots [s]."""
        return self.period_ns * 1e-9

    @property
    def end(self) -> float:
        """Time of the last knot [s]."""
        return float(self.time[-1])

    @property
    def ends_rolling(self) -> bool:
        """True if the last knot is faster than 1 mm/s: the reference then steps to rest after it."""
        return bool(abs(self.velocity[-1]) > 1e-3)

    def at(self, t: float) -> tuple[float, float, float, float]:
        """Return position [m], speed [m/s], acceleration [m/s²] and jerk [m/s³] at a time [s]."""
        return self.at_stamp(round(t * 1e9))

    def at_stamp(self, stamp: int) -> tuple[float, float, float, float]:
        """Return the same at an integer stamp [ns]; at a knot equal to the knot bit for bit."""
        index, rest = divmod(stamp - self.start_ns, self.period_ns)
        last = self._count - 1
        if index < 0:
            return self._x[0], 0.0, 0.0, 0.0
        if index >= last:
            if index == last and rest == 0:
                return self._x[last], self._v[last], self._a[last], 0.0
            return self._x[last], 0.0, 0.0, 0.0
        if rest == 0:
            return self._x[index], self._v[index], self._a[index], self._j[index]
        return self._between(index, rest * 1e-9)

    def _between(self, index: int, s: float) -> tuple[float, float, float, float]:
        period = self.period_ns * 1e-9
        x0, v0, a0 = self._x[index], self._v[index], self._a[index]
        x1, v1, a1 = self._x[index + 1], self._v[index + 1], self._a[index + 1]
        if abs(v1 - v0) > STEP_ACCELERATION * period:
            return x0 + (v0 + 0.5 * a0 * s) * s, v0 + a0 * s, a0, 0.0
        x, _ = hermite(x0, v0, x1, v1, s, period)
        v, a = hermite(v0, a0, v1, a1, s, period)
        return x, v, a, self._j[index]

    def window(self, t: float, count: int, period: float) -> tuple[Array, Array, Array]:
        """Return positions, speeds and accelerations at ``t + k period``, k = 0 ... count - 1.

        If ``t`` is a knot and ``period`` a multiple of the knots' period, the arrays are read-only views.

        Returns
        -------
        position, velocity, acceleration : Array, shape (count,)
            m, m/s, m/s²; equal bit for bit to :meth:`at`.
        """
        stamp, period_ns = round(t * 1e9), round(period * 1e9)
        first, rest = divmod(stamp - self.start_ns, self.period_ns)
        step, uneven = divmod(period_ns, self.period_ns)
        if rest or uneven or first < 0 or step < 1:
            stamps = stamp + period_ns * np.arange(count)
            return self._evaluate(stamps)
        if (count - 1) * step + 1 > self._pads[0].size - self._count:
            self._pad(self.position, self.velocity, self.acceleration, (count - 1) * step + 1)
        first = min(first, self._count)
        part = slice(first, first + (count - 1) * step + 1, step)
        return self._pads[0][part], self._pads[1][part], self._pads[2][part]

    def at_times(self, t: Array) -> tuple[Array, Array, Array]:
        """Return positions [m], speeds [m/s] and accelerations [m/s²] at many times [s], each of the shape of ``t``."""
        return self._evaluate(np.rint(t * 1e9).astype(np.int64))

    def jerks_at(self, stamps: NDArray[np.int64]) -> Array:
        """Return the jerk at many stamps [ns] in m/s³, that of :meth:`at_stamp` bit for bit."""
        index = (stamps - self.start_ns) // self.period_ns
        inside = (index >= 0) & (index < len(self._j))  # the jerk is 0 at the last knot and before a step
        return np.asarray(np.where(inside, np.frombuffer(self._j)[np.clip(index, 0, len(self._j) - 1)], 0.0))

    def _evaluate(self, stamps: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Return position, speed and acceleration at many stamps [ns]."""
        knots = (self.position, self.velocity, self.acceleration)
        return read_between(knots, stamps - self.start_ns, self.period_ns)

    def resampled(self, period: float) -> Profile:
        """Return the profile with knots at another period [s]; the last one is at or just after the end.

        Raises
        ------
        ValueError
            If the period is not a positive number of whole nanoseconds.
        """
        period_ns = whole_nanoseconds(period, "the period of a profile")
        if period_ns == self.period_ns:
            return self
        last_ns = self.start_ns + self.period_ns * (self._count - 1)
        count = knot_count(max(2, -((self.start_ns - last_ns) // period_ns) + 1))
        stamps = self.start_ns + period_ns * np.arange(count)
        x, v, a = self._evaluate(stamps)
        if stamps[-1] > last_ns and self.ends_rolling:
            stamps, x, v, a = stamps[:-1], x[:-1], v[:-1], a[:-1]
        return Profile(stamps_to_seconds(stamps), x, v, a)

    def shifted(self, distance: float) -> Profile:
        """Return the profile moved along the line by a distance [m]."""
        return Profile(self.time, self.position + distance, self.velocity, self.acceleration)

    def until(self, t: float) -> Profile:
        """Return the part up to a time [s], at least two knots."""
        count = max(2, min(self._count, (round(t * 1e9) - self.start_ns) // self.period_ns + 1))
        return Profile(self.time[:count], self.position[:count], self.velocity[:count], self.acceleration[:count])

    def followed_by(self, other: Profile) -> Profile:
        """Return this profile up to the start of another one, followed by the other one.

        Raises
        ------
        ValueError
            If the knots of both do not coincide.
        """
        ahead, rest = divmod(other.start_ns - self.start_ns, self.period_ns)
        if other.period_ns != self.period_ns or rest or ahead < 0:
            raise ValueError(
                "the knots of two profiles do not coincide; resample one of them to the period of the other"
            )
        pads = padded(self.position, self.velocity, self.acceleration, max(0, ahead - self._count) + 1)
        parts = [
            np.concatenate((read_only(before)[:ahead], after))
            for before, after in zip(pads, (other.position, other.velocity, other.acceleration), strict=True)
        ]
        time = stamps_to_seconds(self.start_ns + self.period_ns * np.arange(parts[0].size))
        return Profile(time, *parts)

    def jerk(self) -> Array:
        """Return the mean jerk from every knot to the next [m/s³], shape (n,); 0 at the last and before a step."""
        return np.array(self._j)

    def fingerprint(self) -> str:
        """Return the SHA-256 of the knots' bits; equal for equal profiles only."""
        digest = hashlib.sha256(f"{self.start_ns} {self.period_ns}".encode())
        for column in (self.position, self.velocity, self.acceleration):
            digest.update(column.astype("<f8").tobytes())
        return digest.hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Profile) and self.fingerprint() == other.fingerprint()

    def __hash__(self) -> int:
        return hash(self.fingerprint())

    def __len__(self) -> int:
        return self._count

    def __repr__(self) -> str:
        length = self.position[-1] - self.position[0]
        return f"Profile({len(self)} knots every {self.period:g} s, {self.end - self.start:g} s, {length:g} m)"
