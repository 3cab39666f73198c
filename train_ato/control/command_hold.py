"""Count of the steps that repeat the last command, and its limit."""

from __future__ import annotations

from train_ato.control.component_fault import ComponentFailed
from train_ato.errors import RunFailed

MIN_HELD_STEPS = 3
"""Consecutive steps that are allowed for any period of the law."""


class CommandHold:
    """Counter of the steps that repeat the last command because no valid new one exists.

    Parameters
    ----------
    limit
        Maximum time of consecutive repeated steps [s].
    period
        Period of the law [s].

    Attributes
    ----------
    total, in_a_row : int
        Repeated steps of the run, and of the present gap.
    """

    def __init__(self, limit: float, period: float) -> None:
        self._max_steps = max(MIN_HELD_STEPS, round(limit / period))
        self._period = period
        self._reason, self._by_component = "", False
        self.total = 0
        self.in_a_row = 0

    def hold(self, reason: str, *, by_component: bool = False) -> None:
        """Count one repeated step with its reason; ``by_component`` for a fault of a law or a compensation."""
        self.total += 1
        self.in_a_row += 1
        self._reason, self._by_component = reason, by_component

    def resume(self) -> None:
        """End the gap after a valid command."""
        self.in_a_row = 0

    def check_limit(self) -> None:
        """Fail the run at the limit.

        Raises
        ------
        RunFailed
            One line with the last reason and the number of steps; :class:`ComponentFailed` for a fault of a component.
        """
        if self.in_a_row >= self._max_steps:
            seconds = self.in_a_row * self._period
            steps = f"in {self.in_a_row} consecutive steps ({seconds:g} s, hold_limit)"
            if self._by_component:
                raise ComponentFailed(f"{self._reason}; the last command was repeated {steps}")
            raise RunFailed(f"{self._reason} {steps}")
