"""Steps of the control stack that only repeat the last command, and when there have been too many of them."""

from __future__ import annotations

from train_ato.failure import RunFailed

LEAST = 3
"""Consecutive steps that are forgiven in any case, however long the law's period is."""


class HeldSteps:
    """Counts the steps in which the last command was repeated for want of a usable one.

    Parameters
    ----------
    limit
        Longest time for which that may go on [s].
    period
        Of the law [s].

    Attributes
    ----------
    total, in_a_row : int
        Steps of the whole run, and of the gap that is still open.
    """

    def __init__(self, limit: float, period: float) -> None:
        self._most = max(LEAST, round(limit / period))
        self._period = period
        self._reason = ""
        self.total = 0
        self.in_a_row = 0

    def count(self, reason: str) -> None:
        """Take note of one step and why it found no command."""
        self.total += 1
        self.in_a_row += 1
        self._reason = reason

    def over(self) -> None:
        """Take note that a usable command was found."""
        self.in_a_row = 0

    def check(self) -> None:
        """Fail the run where the limit was reached.

        Raises
        ------
        RunFailed
            One line with the last reason and the number of steps.
        """
        if self.in_a_row >= self._most:
            seconds = self.in_a_row * self._period
            raise RunFailed(f"{self._reason} in {self.in_a_row} consecutive steps ({seconds:g} s, hold_limit)")
