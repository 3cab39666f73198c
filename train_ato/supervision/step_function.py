"""Step functions: constant values between rising bounds, for decelerations over speed and grades over position."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from plant_sim.units import KMH
from train_ato.supervision.settings import STANDARD_GRAVITY, FixedValues


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
        values = [operation(self.at(bound), other.at(bound)) for bound in bounds]
        return StepFunction(bounds, (*values, operation(self.values[-1], other.values[-1])))

    def largest_up_to(self, place: float) -> float:
        """Return the largest value from the first one up to a place."""
        return max(self.values[: bisect_left(self.bounds, place) + 1])


def lowest_under_train(grades: Sequence[tuple[float, float]], length: float) -> StepFunction:
    """Return the lowest grade between front and rear over the position of the front: 3.13.4.2.

    Parameters
    ----------
    grades
        Pairs of start [m] and grade [‰, > 0 uphill] by rising start; the last one is open-ended. The grade before the
        first start is 0 (3.13.4.1.3).
    length
        Length of the train [m].
    """
    if not grades:
        return StepFunction.constant(0.0)
    local = StepFunction(tuple(start for start, _ in grades), (0.0, *(value for _, value in grades)))
    bounds = sorted({*local.bounds, *(bound + length for bound in local.bounds)})
    middles = [bounds[0] - 1.0, *((a + b) / 2 for a, b in pairwise(bounds)), bounds[-1] + 1.0]
    lowest = []
    first = last = 0  # pieces under rear and front; both only move forward
    for front in middles:
        while last < len(local.bounds) and local.bounds[last] < front:
            last += 1
        while first < len(local.bounds) and local.bounds[first] <= front - length:
            first += 1
        lowest.append(min(local.values[first : last + 1]))
    kept = [i for i in range(len(bounds)) if lowest[i] != lowest[i + 1]]
    return StepFunction(tuple(bounds[i] for i in kept), (lowest[0], *(lowest[i + 1] for i in kept)))


def gradient_acceleration(
    grades: Sequence[tuple[float, float]], length: float, m_rotating_nom: float | None, fixed: FixedValues
) -> StepFunction:
    """Return the deceleration by the gradient [m/s²] over the position of the front [m]: 3.13.4.3.2.

    Parameters
    ----------
    grades
        As in :func:`lowest_under_train`.
    length
        Length of the train [m].
    m_rotating_nom
        Nominal rotating mass [% of the mass]; None: the fixed values for uphill and downhill.
    fixed
        Fixed values.
    """
    lowest = lowest_under_train(grades, length)

    def acceleration(grade: float) -> float:
        rotating = m_rotating_nom
        if rotating is None:
            rotating = fixed.m_rotating_max if grade > 0 else fixed.m_rotating_min
        return STANDARD_GRAVITY * grade / (1000.0 + 10.0 * rotating)

    return StepFunction(lowest.bounds, tuple(acceleration(grade) for grade in lowest.values))


@dataclass(frozen=True, slots=True)
class CeilingMargin:
    """Margin above a speed limit: constant, then linear between two limits, then constant [km/h]."""

    margin_min: float
    margin_max: float
    speed_min: float
    speed_max: float

    def above(self, limit: float) -> float:
        """Return the margin [m/s] above a limit [m/s]: 3.13.9.2.3."""
        slope = (self.margin_max - self.margin_min) / (self.speed_max - self.speed_min)
        linear = self.margin_min + slope * max(limit * KMH - self.speed_min, 0.0)
        return min(linear, self.margin_max) / KMH


WARNING_MARGIN = CeilingMargin(4.0, 5.0, 110.0, 140.0)
SERVICE_MARGIN = CeilingMargin(5.5, 10.0, 110.0, 210.0)
EMERGENCY_MARGIN = CeilingMargin(7.5, 15.0, 110.0, 210.0)


class SupervisionSpeeds(NamedTuple):
    """Speeds of the supervision at one position [m/s].

    Attributes
    ----------
    permitted, warning, service, emergency : float
        Permitted speed, and the speeds of warning, service-brake and emergency-brake intervention.
    """

    permitted: float
    warning: float
    service: float
    emergency: float


def ceiling_speeds(limit: float) -> SupervisionSpeeds:
    """Return the ceiling speeds [m/s] for a speed limit [m/s]."""
    return SupervisionSpeeds(
        limit,
        limit + WARNING_MARGIN.above(limit),
        limit + SERVICE_MARGIN.above(limit),
        limit + EMERGENCY_MARGIN.above(limit),
    )
