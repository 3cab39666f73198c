"""Operational speed profile: the reference over time, evaluated at any stamp.

Knots of a profile at a constant period: validation and interpolation.

Between two knots the position is the cubic Hermite polynomial of positions and speeds. The speed is the cubic Hermite
polynomial of speeds and accelerations, and the acceleration is its derivative. The jerk is the mean over the interval,
so that a limit that holds at the knots also holds between them. Position, speed and acceleration are exact at every
knot and continuous everywhere. A profile with constant jerk between the knots is reproduced exactly. At a step of the
speed between two knots, the state of the knot before continues at constant acceleration up to the step.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from plant_sim.compiled import also_compiled, compiled
from plant_sim.line import Line
from plant_sim.units import number_text
from train_ato.messages.types import Array, Trajectory

STEP_ACCELERATION = 20.0
"""Mean acceleration between two knots above which the change of speed is a step [m/s²]."""
MAX_KNOTS = 2_000_000
"""Maximum number of knots of a profile, 27 h at 20 Hz; a profile is one message of up to 112 MB, which every node
decodes whole."""
MAX_TIME = 1e8
"""Maximum time of a knot [s]."""


@also_compiled
def hermite(y0, d0, y1, d1, s, period):  # type: ignore[no-untyped-def]
    """Return value and derivative of the cubic Hermite polynomial at ``s`` within an interval."""
    slope = (y1 - y0) / period
    c2 = (3.0 * slope - 2.0 * d0 - d1) / period
    c3 = (d0 + d1 - 2.0 * slope) / (period * period)
    value = y0 + s * (d0 + s * (c2 + s * c3))
    return value, d0 + s * (2.0 * c2 + 3.0 * s * c3)


@compiled
def reading(knots, count, after, period_ns):  # type: ignore[no-untyped-def]
    """Return position [m], speed [m/s], acceleration [m/s²] and jerk [m/s³] at a time after the first knot [ns].

    ``knots`` has these in its rows.  Before the first and after the last of the ``count`` knots the profile is at rest.
    """
    last, index = count - 1, after // period_ns
    rest, period = after - index * period_ns, period_ns * 1e-9
    if index < 0 or index > last or (index == last and rest != 0):
        return float(knots[0, 0 if index < 0 else last]), 0.0, 0.0, 0.0
    x0, v0, a0, j = knots[0, index], knots[1, index], knots[2, index], knots[3, index]
    if rest == 0:
        return x0, v0, a0, j
    s, x1, v1, a1 = rest * 1e-9, knots[0, index + 1], knots[1, index + 1], knots[2, index + 1]
    if abs(v1 - v0) > STEP_ACCELERATION * period:
        return x0 + (v0 + 0.5 * a0 * s) * s, v0 + a0 * s, a0, j
    v, a = hermite(v0, a0, v1, a1, s, period)
    return hermite(x0, v0, x1, v1, s, period)[0], v, a, j


@compiled
def _readings(knots, count, after, period_ns):  # type: ignore[no-untyped-def]
    """Return :func:`reading` at many times, shape (4, times)."""
    found = np.empty((4, after.size))
    for i in range(after.size):
        found[0, i], found[1, i], found[2, i], found[3, i] = reading(knots, count, after[i], period_ns)
    return found


def mean_jerk(velocity: Array, acceleration: Array, period: float) -> Array:
    """Return the mean jerk from every knot to the next [m/s³], shape (n,); 0 at the last and before a step."""
    v0, v1, a0, a1 = velocity[:-1], velocity[1:], acceleration[:-1], acceleration[1:]
    jerk = np.zeros(velocity.size)
    smooth = np.abs(v1 - v0) <= STEP_ACCELERATION * period
    jerk[:-1] = np.where(smooth, (a1 - a0) / period, 0.0)
    return jerk


def knot_count(count: float) -> int:
    """Return a number of knots as an integer after a check.

    Raises
    ------
    ValueError
        Above :data:`MAX_KNOTS`.
    """
    if not count <= MAX_KNOTS:
        raise ValueError(
            f"a profile of {number_text(count, 3)} knots, at most {MAX_KNOTS}; shorten it, or increase tick or period"
        )
    return int(count)


def stamps_to_seconds(stamps: NDArray[np.int64]) -> Array:
    """Return times [s] of stamps [ns]."""
    return np.asarray(stamps * 1e-9, dtype=np.float64)


def check_columns(columns: Mapping[str, Array]) -> None:
    """Check that the columns of a profile are finite and of equal length.

    Raises
    ------
    ValueError
        With the column, the knot and the value.
    """
    if any(column.ndim != 1 or column.size != columns["time"].size for column in columns.values()):
        sizes = ", ".join(f"{name} {column.size}" for name, column in columns.items())
        raise ValueError(f"columns of a profile differ in length ({sizes}); make them one length")
    if columns["time"].size < 2:
        raise ValueError(f"a profile of {columns['time'].size} knots; give at least two")
    for name, column in columns.items():
        wrong = np.flatnonzero(~np.isfinite(column))
        if wrong.size:
            raise ValueError(f"{name} of knot {wrong[0]} is {column[wrong[0]]}; give a finite number")


def even_grid(time: Array) -> tuple[int, int]:
    """Return start and period [ns] of evenly spaced times.

    Raises
    ------
    ValueError
        If they are not evenly spaced or exceed :data:`MAX_TIME`.
    """
    if np.abs(time).max() > MAX_TIME:
        raise ValueError(
            f"a profile up to {number_text(np.abs(time).max(), 3)} s; give at most {number_text(MAX_TIME)} s"
        )
    stamps = np.rint(time * 1e9)
    period = round((float(stamps[-1]) - float(stamps[0])) / (time.size - 1))
    uneven = np.flatnonzero(np.abs(stamps - (stamps[0] + period * np.arange(time.size))) > max(2.0, 1e-6 * period))
    if period < 1 or uneven.size:
        place = int(uneven[0]) if uneven.size else 0
        raise ValueError(f"knot {place} at {time[place]} s: the knots are not evenly spaced in time; resample them")
    return int(stamps[0]), period


def padded(columns: Iterable[Array], tail: int) -> Array:
    """Return positions, speeds, accelerations and jerks in rows, followed by ``tail`` knots at rest, read-only."""
    x, v, a, j = columns
    pad = np.zeros((4, x.size + tail))
    pad[0], pad[:, : x.size] = x[-1], (x, v, a, j)
    pad.flags.writeable = False
    return pad


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
        "_count", "_knots", "acceleration", "period_ns", "position", "start_ns", "time", "velocity",
    )  # fmt: skip

    def __init__(self, time: Array, position: Array, velocity: Array, acceleration: Array) -> None:
        columns = [np.asarray(column, dtype=np.float64) for column in (time, position, velocity, acceleration)]
        check_columns(dict(zip(("time", "position", "velocity", "acceleration"), columns, strict=True)))
        self.start_ns, self.period_ns = even_grid(columns[0])
        self._count = count = columns[0].size
        self.time = stamps_to_seconds(self.start_ns + self.period_ns * np.arange(count))
        self.time.flags.writeable = False
        self._pad((*columns[1:], mean_jerk(columns[2], columns[3], self.period)), TAIL)

    def _pad(self, columns: Iterable[Array], tail: int) -> None:
        """Keep the knots, followed by ``tail`` knots at rest."""
        self._knots = padded(columns, tail)
        self.position, self.velocity, self.acceleration, _ = self._knots[:, : self._count]

    @classmethod
    def uniform(cls, start: float, period: float, position: Array, velocity: Array, acceleration: Array) -> Profile:
        """Return the profile with knots every ``period`` seconds from ``start`` on."""
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
        """Return position [m], speed [m/s], acceleration [m/s²] and jerk [m/s³] at a time [s].

        The time is rounded to the nanosecond; at a knot the values are those of the knot bit for bit.
        """
        after = round(t * 1e9) - self.start_ns
        x, v, a, j = reading(self._knots, self._count, after, self.period_ns)
        return float(x), float(v), float(a), float(j)  # without the compiler they are numbers of numpy

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
            return self.at_stamps(stamps)[:3]
        if (count - 1) * step + 1 > self._knots.shape[1] - self._count:
            self._pad(self._knots[:, : self._count], (count - 1) * step + 1)
        first = min(first, self._count)
        part = slice(first, first + (count - 1) * step + 1, step)
        return self._knots[0, part], self._knots[1, part], self._knots[2, part]

    def at_times(self, t: Array) -> tuple[Array, Array, Array]:
        """Return positions [m], speeds [m/s] and accelerations [m/s²] at many times [s], each of the shape of ``t``."""
        return self.at_stamps(np.rint(t * 1e9).astype(np.int64))[:3]

    def at_stamps(self, stamps: NDArray[np.int64]) -> tuple[Array, Array, Array, Array]:
        """Return what :meth:`at` returns at many stamps [ns], each of their shape."""
        after = np.ravel(stamps) - self.start_ns
        x, v, a, j = _readings(self._knots, self._count, after, self.period_ns)
        shape = np.shape(stamps)
        return x.reshape(shape), v.reshape(shape), a.reshape(shape), j.reshape(shape)

    def resampled(self, period: float) -> Profile:
        """Return the profile with knots at another period [s]; the last one is at or just after the end.

        Raises
        ------
        ValueError
            If the period is not a positive number of whole nanoseconds.
        """
        period_ns = round(period * 1e9) if math.isfinite(period) else 0
        if period_ns < 1:
            raise ValueError(f"the period of a profile is {period} s; give at least 1 ns")
        if period_ns == self.period_ns:
            return self
        last_ns = self.start_ns + self.period_ns * (self._count - 1)
        count = knot_count(max(2, -((self.start_ns - last_ns) // period_ns) + 1))
        stamps = self.start_ns + period_ns * np.arange(count)
        x, v, a, _ = self.at_stamps(stamps)
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

    def since(self, t: float) -> Profile:
        """Return the part from the knot at or just before a time [s] on, with that knot as the new begin.

        Raises
        ------
        ValueError
            If fewer than two knots remain.
        """
        first = (round(t * 1e9) - self.start_ns) // self.period_ns
        if not 0 <= first < self._count - 1:
            raise ValueError(
                f"profile.since = {t:g} s: the profile has times from {self.start:g} to {self.end:g} s; correct it"
            )
        rest = slice(first, None)
        time = self.time[: self._count - first]
        return Profile(time, self.position[rest], self.velocity[rest], self.acceleration[rest])

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
        before = padded(self._knots[:, : self._count], max(0, ahead - self._count))[:3, :ahead]
        parts = np.concatenate((before, (other.position, other.velocity, other.acceleration)), axis=1)
        return Profile(stamps_to_seconds(self.start_ns + self.period_ns * np.arange(parts.shape[1])), *parts)

    def jerk(self) -> Array:
        """Return the mean jerk from every knot to the next [m/s³], shape (n,); 0 at the last and before a step."""
        return self._knots[3, : self._count].copy()

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


def trajectory_of(profile: Profile, planned: int = 0) -> Trajectory:
    """Return the message of a profile; ``planned`` is the stamp of its planning [ns]."""
    time_ns = np.rint(profile.time * 1e9).astype(np.int64)
    return Trajectory(planned, "train", time_ns, profile.position, profile.velocity, profile.acceleration)


def profile_of(trajectory: Trajectory) -> Profile:
    """Return the profile of a message, bit-identical to the sent one."""
    time = stamps_to_seconds(trajectory.time)
    return Profile(time, trajectory.position, trajectory.velocity, trajectory.acceleration)


def limits_of(line: Line) -> Trajectory:
    """Return the message of the speed limits of a line, steps over the place."""
    limits = [(limit.at, limit.speed) for limit in line.restricted_limits]
    place, speed = np.array(limits, dtype=np.float64).reshape(-1, 2).T.copy()
    return Trajectory(0, "limit", np.zeros(place.size, dtype=np.int64), place, speed, np.zeros(0))
