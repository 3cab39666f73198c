"""Pacing on the wall clock."""

from __future__ import annotations

import time

_CATCH_UP_S = 0.2


class Pace:
    """Waits so that simulated time does not run ahead of the wall clock.

    Parameters
    ----------
    factor
        Simulated seconds per second of wall time; None never waits.
    tick
        Simulated seconds of one tick.
    """

    def __init__(self, factor: float | None, tick: float) -> None:
        self._period = tick / factor if factor is not None else 0.0
        self._begin: float | None = None

    def deadline(self, ticks: int) -> float:
        """Return the steady-clock time at which so many ticks are over [s]."""
        if self._begin is None:
            self._begin = time.monotonic()
        return self._begin + ticks * self._period

    def wait(self, ticks: int) -> None:
        """Sleep until so many ticks are over; the clock starts with the first call."""
        if self._period <= 0:
            return
        remaining = self.deadline(ticks) - time.monotonic()
        if remaining > 0:
            time.sleep(remaining)


class SteadyPace:
    """Tells how long a tick has to wait, where the loop may not sleep; the factor may change while it runs.

    What cannot keep up is not caught up with: after a fifth of a second the count starts anew.

    Parameters
    ----------
    tick
        Simulated seconds of one tick.
    factor
        Simulated seconds per second of wall time at most; 0 never waits.
    """

    def __init__(self, tick: float, factor: float = 0.0) -> None:
        self._tick = tick
        self.factor = factor
        self._origin: tuple[float, int] | None = None

    def change(self, factor: float) -> None:
        """Take another factor, from the next tick on."""
        self.factor = factor
        self._origin = None

    def restart(self) -> None:
        """Count from the next tick on: after a pause nothing is to be caught up with."""
        self._origin = None

    def wait(self, ticks: int) -> float:
        """Return how long to wait before the next tick, when so many are over [s]."""
        if self.factor <= 0:
            return 0.0
        now = time.monotonic()
        if self._origin is None:
            self._origin = (now, ticks)
        begin, first = self._origin
        ahead = begin + (ticks - first) * self._tick / self.factor - now
        if ahead < -_CATCH_UP_S:
            self._origin = (now, ticks)
        return max(0.0, ahead)
