"""Simulated time of a replay on the wall clock."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

AS_FAST_AS_POSSIBLE = math.inf
"""Rate of a replay that waits for nothing but its readers."""


class ReplayClock:
    """Time of the log, that flows with the wall clock times a rate, stands in a pause, and can be set.

    Parameters
    ----------
    rate
        Simulated seconds per second of wall time; infinite: time follows the messages.
    paused
        Begin with a pause.
    steady
        The wall clock [s].
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
        """Time stands still."""
        return self._paused

    @property
    def now(self) -> float:
        """Time of the log [s]."""
        if self._paused or math.isinf(self._rate):
            return self._place
        return self._place + max(0.0, self._steady() - self._since) * self._rate

    def jump(self, place: float, delay: float = 0.0) -> None:
        """Set the time of the log [s]; it begins to flow after a delay in seconds of wall time."""
        self._place = place
        self._since = self._steady() + delay

    def reached(self, place: float) -> None:
        """Tell that the message of a time has gone out; where the wall clock does not lead, time follows it."""
        if self._paused or math.isinf(self._rate):
            self._place = place

    def set_rate(self, rate: float) -> None:
        """Change the rate from now on.

        Raises
        ------
        ValueError
            If it is not above 0.
        """
        if not rate > 0:
            raise ValueError(f"rate {rate:g}: give a number above 0, 1 for real time")
        self._settle()
        self._rate = rate

    def set_paused(self, paused: bool) -> None:
        """Let time stand still or flow again."""
        self._settle()
        self._paused = paused

    def _settle(self) -> None:
        """Make now the point from which time is counted; a delay under way goes on."""
        self._place, self._since = self.now, max(self._since, self._steady())

    def until(self, place: float) -> float:
        """Return the wall time until a time of the log has come [s]; infinite in a pause."""
        if self._paused:
            return math.inf
        delay = max(0.0, self._since - self._steady())
        if math.isinf(self._rate):
            return delay
        return delay + max(0.0, (place - self.now) / self._rate)
