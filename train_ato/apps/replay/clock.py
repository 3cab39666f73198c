"""Simulated time of a replay as a function of the wall time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable


class ReplayClock:
    """Clock of the log time with rate, pause and jump.

    Parameters
    ----------
    rate
        Simulated seconds per second of wall time; if infinite, the time follows the messages.
    paused
        Start paused.
    steady
        Monotonic wall clock [s].
    """

    def __init__(self, rate: float, paused: bool, steady: Callable[[], float] = time.monotonic) -> None:
        self._steady = steady
        self._rate = rate
        self._paused = paused
        self._place = 0.0
        self._since = steady()

    @property
    def rate(self) -> float:
        """Simulated seconds per second of wall time."""
        return self._rate

    @property
    def paused(self) -> bool:
        """Clock is paused."""
        return self._paused

    @property
    def now(self) -> float:
        """Time of the log [s]."""
        if self._paused or math.isinf(self._rate):
            return self._place
        return self._place + max(0.0, self._steady() - self._since) * self._rate

    def jump(self, place: float, delay: float = 0.0) -> None:
        """Set the time of the log [s]; it is constant for a delay [s of wall time]."""
        self._place = place
        self._since = self._steady() + delay

    def reached(self, place: float) -> None:
        """Set the time of the log to that of a sent message [s], in a pause or at an infinite rate."""
        if self._paused or math.isinf(self._rate):
            self._place = place

    def set_rate(self, rate: float) -> None:
        """Change the rate.

        Raises
        ------
        ValueError
            If the rate is not above 0.
        """
        if not rate > 0:
            raise ValueError(f"rate {rate:g}: give a number above 0, 1 for real time")
        self._settle()
        self._rate = rate

    def set_paused(self, paused: bool) -> None:
        """Pause or resume the clock."""
        self._settle()
        self._paused = paused

    def _settle(self) -> None:
        """Restart the time count at the present time; a running delay continues."""
        self._place, self._since = self.now, max(self._since, self._steady())

    def until(self, place: float) -> float:
        """Return the wall time until a time of the log [s]; infinite in a pause."""
        if self._paused:
            return math.inf
        delay = max(0.0, self._since - self._steady())
        if math.isinf(self._rate):
            return delay
        return delay + max(0.0, (place - self.now) / self._rate)
