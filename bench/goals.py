"""Goals of a benchmark, their verdicts and the exit status.

Times on a shared machine are upper bounds: a goal missed by less than the margin is reported and passes; a goal missed
by more gives exit status 1.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

MARGIN = 1.5
"""Factor by which the value of a widely missed goal is worse than its bound."""


@dataclass(frozen=True)
class Goal:
    """Measured value and its upper or lower bound."""

    what: str
    value: float
    bound: float
    unit: str = ""
    at_least: bool = False

    @property
    def excess(self) -> float:
        """Factor by which the value is worse than the bound; the goal is met up to 1."""
        return self.bound / self.value if self.at_least else self.value / self.bound

    @property
    def verdict(self) -> str:
        """``met``, ``missed`` or ``missed widely``."""
        return "met" if self.excess <= 1 else "missed" if self.excess <= MARGIN else "missed widely"

    def as_data(self) -> dict[str, Any]:
        """Return the goal for ``--json``."""
        return {**asdict(self), "verdict": self.verdict}


def judge(goals: Iterable[Goal], *, quiet: bool = False) -> int:
    """Print a line for each goal; return the exit status, 1 if one is missed widely."""
    status = 0
    for goal in goals:
        status = max(status, int(goal.verdict == "missed widely"))
        if not quiet:
            bound = f"{'at least' if goal.at_least else 'at most'} {goal.bound:g} {goal.unit}".rstrip()
            sys.stdout.write(f"goal: {goal.what}: {bound}: {goal.value:.3g}, {goal.verdict}\n")
    return status
