"""Goals of a benchmark, their verdicts and the exit status.

Times on a shared machine are upper bounds: a goal missed by less than the margin is reported and passes; a goal missed
by more gives exit status 1.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable

from figures import Figure, publish


def Goal(  # noqa: N802  (a figure with a bound)
    what: str,
    value: float,
    bound: float,
    unit: str = "",
    at_least: bool = False,
    *,
    beside: str = "",
    beside_value: float | None = None,
) -> Figure:
    """Return a figure with an upper or lower bound."""
    return Figure(what, value, unit, beside, beside_value, bound, at_least)


def judge(goals: Iterable[Figure], *, quiet: bool = False) -> int:
    """Publish figures and print a line for each goal; return the exit status, 1 if one is missed widely."""
    status = 0
    for goal in goals:
        publish(goal)
        status = max(status, int(goal.verdict == "missed widely"))
        if goal.bound is not None and not quiet:
            bound = f"{'at least' if goal.at_least else 'at most'} {goal.bound:g} {goal.unit}".rstrip()
            sys.stdout.write(f"goal: {goal.what}: {bound}: {goal.value:.3g}, {goal.verdict}\n")
    return status
