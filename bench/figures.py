"""A figure of a benchmark beside its floor or peer, and its goal.

A script gives its figures to :func:`publish` or :func:`judge`, which print a line for each; ``python -m bench --json``
names a file in the environment variable :data:`FILE` that gets them as well.  Times on a shared machine are upper
bounds: a goal missed by less than the margin is reported and passes; a goal missed by more gives exit status 1.
"""

import json
import math
import os
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
    what, value, unit
        Name, the same in every run of the script; measured value and its unit, empty for a ratio.
    beside, beside_value
        Floor (work that no program can save) or peer (another library), and its value in the same unit.
    bound, at_least
        Goal, an upper bound or a lower one; None: none.
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
    def verdict(self) -> str:
        """``met``, ``missed`` or ``missed widely``; empty without a goal."""
        if self.bound is None:
            return ""
        over, under = (self.bound, self.value) if self.at_least else (self.value, self.bound)
        excess = over / under if under else math.inf if over > 0 else 0.0
        return "met" if excess <= 1 else "missed" if excess <= MARGIN else "missed widely"

    @property
    def line(self) -> str:
        """Figure as a line of text."""
        parts = [f"{self.what}: {self.value:.4g} {self.unit}".rstrip()]
        if self.ratio is not None:
            parts.append(f"{self.ratio:.4g} times {self.beside} ({self.beside_value:.4g})")
        if self.bound is not None:
            parts.append(f"goal at {'least' if self.at_least else 'most'} {self.bound:g}: {self.verdict}")
        return ", ".join(parts)


def Goal(what: str, value: float, bound: float, unit: str = "", **more: Any) -> Figure:  # noqa: N802
    """Return a figure with an upper bound, or a lower one with ``at_least``."""
    return Figure(what, value, unit, bound=bound, **more)


def publish(*figures: Figure, quiet: bool = False) -> None:
    """Print figures, and append them to the file of ``python -m bench --json`` if it is named."""
    for figure in figures:
        if not quiet:
            print(figure.line, flush=True)
        if name := os.environ.get(FILE):
            data = {**asdict(figure), "ratio": figure.ratio, "verdict": figure.verdict}
            with Path(name).open("a", encoding="utf-8") as file:
                file.write(json.dumps(data) + "\n")


def judge(figures: Iterable[Figure], *, quiet: bool = False) -> int:
    """Publish figures; return the exit status, 1 if a goal is missed widely."""
    found = list(figures)
    publish(*found, quiet=quiet)
    return int(any(figure.verdict == "missed widely" for figure in found))
