"""Pacing on the wall clock."""

from __future__ import annotations

import time


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
