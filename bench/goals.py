"""What a benchmark has to reach, the verdict beside it, and the exit status that follows.

Times on a shared machine are upper bounds: a goal missed by less than the margin is said and passes, one missed by
more ends the benchmark with exit status 1.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

MARGIN = 1.5
"""A goal is missed widely when the value is worse by this factor."""


@dataclass(frozen=True)
class Goal:
    """One measured value beside its bound: at most it, or at least it."""

    what: str
    value: float
    bound: float
    unit: str = ""
    at_least: bool = False

    @property
    def excess(self) -> float:
        """Factor by which the value is worse than the bound; up to 1 the goal is met."""
        return self.bound / self.value if self.at_least else self.value / self.bound

    @property
    def verdict(self) -> str:
        """``met``, ``missed`` or ``missed widely``."""
        return "met" if self.excess <= 1 else "missed" if self.excess <= MARGIN else "missed widely"

    def as_data(self) -> dict[str, Any]:
        """Return everything for ``--json``."""
        return {**asdict(self), "verdict": self.verdict}


def judge(goals: Iterable[Goal], *, quiet: bool = False) -> int:
    """Print a line for each goal and return the exit status: 1 when one is missed widely."""
    status = 0
    for goal in goals:
        status = max(status, int(goal.verdict == "missed widely"))
        if not quiet:
            bound = f"{'at least' if goal.at_least else 'at most'} {goal.bound:g} {goal.unit}".rstrip()
            sys.stdout.write(f"goal: {goal.what}: {bound}: {goal.value:.3g}, {goal.verdict}\n")
    return status
