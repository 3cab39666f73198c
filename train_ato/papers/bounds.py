"""Bounds of the judges: fixed before a run, each with its source, and compared so that NaN never meets one.

A stated figure of a paper is its own bound. The words of a paper are bounds by the fixed meanings below, the same in
all papers; no bound is taken from a result.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

BETTER = 0.9
""""Better", "more accurate": an error of at most nine tenths of the other one."""
MUCH_BETTER = 0.5
""""Significantly", "effective": at most half of the other one."""
REMOVED = 0.1
""""None", "removed", "accurate": at most a tenth of the other one, or of the quantity itself."""
UNCHANGED = 0.1
""""Unchanged": at most a tenth more or less."""
ROBUST = 2.0
""""Robust", "performance kept": at most twice the error of the nominal train."""
ABOUT = 0.2
""""About" a figure: within a fifth of it."""
TENTH = 0.1
"""A figure of an independent implementation or a printed one without "about": within a tenth of it."""
CLOSE = 0.03
"""Distance of a measured figure from its bound, as a fraction, from which the bound needs a note."""


@dataclass(frozen=True)
class Bound:
    """Limit of a measured quantity.

    Parameters
    ----------
    quantity
        Name of the quantity.
    limit
        Largest permitted value; the smallest with ``least``.
    unit
        Unit of value and limit, empty for ratios.
    source
        Origin of the limit: the paper's figure or words, a closed form, a goal, a convention.
    least
        The limit is the smallest permitted value.
    note
        Reason for a measured figure within 3 % of the limit.
    """

    quantity: str
    limit: float
    unit: str
    source: str
    least: bool = False
    note: str = ""

    def check(self, value: float) -> Check:
        """Return the comparison with a measured value."""
        return Check(self, float(value))


@dataclass(frozen=True)
class Check:
    """Bound and the measured value."""

    bound: Bound
    value: float

    @property
    def holds(self) -> bool:
        """True if the value is finite and within the bound."""
        inside = self.value >= self.bound.limit if self.bound.least else self.value <= self.bound.limit
        return bool(np.isfinite(self.value)) and inside

    @property
    def close(self) -> bool:
        """True if the value is within 3 % of the limit."""
        return abs(self.value - self.bound.limit) <= CLOSE * abs(self.bound.limit)

    def __str__(self) -> str:
        """Return bound, source and measured value as text."""
        bound = self.bound
        sign = ">=" if bound.least else "<="
        text = f"{bound.quantity} {sign} {bound.limit:.4g} {bound.unit}".strip()
        note = f", within 3 %: {bound.note or 'no reason given'}" if self.close else ""
        return f"{text} ({bound.source}): {self.value:.3g}{note}"


def about(quantity: str, stated: float, unit: str, source: str, part: float = ABOUT) -> tuple[Bound, Bound]:
    """Return lower and upper bound around a stated figure, by a fraction of it."""
    return (
        Bound(quantity, (1.0 - part) * stated, unit, source, least=True),
        Bound(quantity, (1.0 + part) * stated, unit, source),
    )


def ratio(quantity: str, limit: float, words: str, note: str = "") -> Bound:
    """Return the bound of a ratio for the words of a claim."""
    return Bound(quantity, limit, "", words, note=note)


def worst(values: Iterable[float]) -> float:
    """Return the largest value; NaN if any value is NaN."""
    return float(np.max(list(values)))


def least(values: Iterable[float]) -> float:
    """Return the smallest value; NaN if any value is NaN."""
    return float(np.min(list(values)))
