"""Step functions: constant values between rising bounds, for decelerations over speed and grades over position."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise


@dataclass(frozen=True, slots=True)
class StepFunction:
    """Step function: ``values[i]`` from ``bounds[i - 1]`` (excluded) to ``bounds[i]``; the last value is open-ended.

    Parameters
    ----------
    bounds : tuple of float, length n
        Upper bounds of the first n values, rising.
    values : tuple of float, length n + 1
        Values.

    Raises
    ------
    ValueError
        If the lengths do not fit or the bounds do not rise.
    """

    bounds: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.values) != len(self.bounds) + 1:
            raise ValueError(f"{len(self.bounds)} bounds need {len(self.bounds) + 1} values, not {len(self.values)}")
        if any(b <= a for a, b in pairwise(self.bounds)):
            raise ValueError("bounds of a step function must rise; sort them")

    @classmethod
    def constant(cls, value: float) -> StepFunction:
        """Return a function with one value."""
        return cls((), (value,))

    @classmethod
    def from_starts(cls, steps: Sequence[tuple[float, float]]) -> StepFunction:
        """Return the function of (start, value) pairs by rising start; the first value also holds before its start."""
        return cls(tuple(start for start, _ in steps[1:]), tuple(value for _, value in steps))

    def at(self, place: float) -> float:
        """Return the value at a place; at a bound that below it."""
        return self.values[bisect_left(self.bounds, place)]

    def above(self, place: float) -> tuple[float, float | None]:
        """Return the value just above a place, and the bound at which it ends; None for the last value."""
        index = bisect_right(self.bounds, place)
        return self.values[index], self.bounds[index] if index < len(self.bounds) else None

    def below(self, place: float) -> tuple[float, float | None]:
        """Return the value just below a place, and the bound at which it begins; None for the first value."""
        index = bisect_left(self.bounds, place)
        return self.values[index], self.bounds[index - 1] if index else None

    def combine(self, other: StepFunction, operation: Callable[[float, float], float]) -> StepFunction:
        """Return the step function of an operation on both values."""
        bounds = tuple(sorted({*self.bounds, *other.bounds}))
        return StepFunction(
            bounds,
            (
                *(operation(self.at(bound), other.at(bound)) for bound in bounds),
                operation(self.values[-1], other.values[-1]),
            ),
        )

    def largest_up_to(self, place: float) -> float:
        """Return the largest value from the first one up to a place."""
        return max(self.values[: bisect_left(self.bounds, place) + 1])
