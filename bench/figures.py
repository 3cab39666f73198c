"""A figure of a benchmark beside its floor or peer, its goal, and the file that collects the figures of a script.

``python -m bench`` names the file in the environment variable :data:`FILE`; a script that is started alone has none.
Times on a shared machine are upper bounds: a goal missed by less than the margin is reported and passes; a goal missed
by more gives exit status 1.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

FILE = "TRAIN_ATO_BENCH_FIGURES"
MARGIN = 1.5
"""Factor by which the value of a widely missed goal is worse than its bound."""


@dataclass(frozen=True)
class Figure:
    """Measured value with the value of its floor or peer in the same run, and its goal.

    Attributes
    ----------
    what : str
        Name, the same in every run of the script.
    value : float
        Measured value.
    unit : str
        Its unit; empty for a ratio.
    beside : str
        Name of the floor (work that no program can save) or of the peer (another library).
    beside_value : float or None
        Value of the floor or peer in the same unit.
    bound : float or None
        Goal; None: none.
    at_least : bool
        True if the goal is a lower bound.
    """

    what: str
    value: float
    unit: str = ""
    beside: str = ""
    beside_value: float | None = None
    bound: float | None = None
    at_least: bool = False

    @property
    def ratio(self) -> float | None:
        """Value over that of the floor or peer, None without one."""
        return self.value / self.beside_value if self.beside_value else None

    @property
    def excess(self) -> float:
        """Factor by which the value is worse than the bound; the goal is met up to 1."""
        if self.bound is None:
            return 0.0
        over, under = (self.bound, self.value) if self.at_least else (self.value, self.bound)
        return over / under if under else math.inf if over > 0 else 0.0

    @property
    def verdict(self) -> str:
        """``met``, ``missed`` or ``missed widely``; empty without a goal."""
        if self.bound is None:
            return ""
        return "met" if self.excess <= 1 else "missed" if self.excess <= MARGIN else "missed widely"

    def as_data(self) -> dict[str, Any]:
        """Return the figure as JSON values."""
        return {**asdict(self), "ratio": self.ratio, "verdict": self.verdict}


def Goal(  # noqa: N802  (a figure with a bound)
    what: str,
    value: float,
    bound: float,
    unit: str = "",
    *,
    at_least: bool = False,
    beside: str = "",
    beside_value: float | None = None,
) -> Figure:
    """Return a figure with an upper or lower bound."""
    return Figure(what, value, unit, beside, beside_value, bound, at_least)


def publish(*figures: Figure) -> None:
    """Append figures to the file of ``python -m bench``; nothing without it."""
    if name := os.environ.get(FILE):
        with Path(name).open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(figure.as_data()) + "\n" for figure in figures)


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


def published(path: Path) -> list[dict[str, Any]]:
    """Return the figures in a file; empty if no script wrote it."""
    lines: Iterable[str] = path.read_text(encoding="utf-8").splitlines() if path.is_file() else ()
    return [json.loads(line) for line in lines]
