"""A ROS parameter as a page offers it: a slider over a sensible part of its range, a list of words, a switch."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

WIDE = 50.0
"""A range that is so many times wider than the value is not shown whole."""
REACH = 4.0
"""The slider then ends at so many times the value."""
STEPS = 200


@dataclass(frozen=True)
class Tunable:
    """One parameter of a running node, as the node describes it.

    Attributes
    ----------
    name
        Full name, for example ``pid.kp``.
    value
        As it is now.
    meaning
        Of the descriptor, the unit in brackets at its end.
    low, high
        Range; infinite where the descriptor has none.
    choices
        Allowed words; empty for numbers and switches.
    """

    name: str
    value: Any
    meaning: str = ""
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    read_only: bool = False

    @property
    def title(self) -> str:
        """Name without the law, with the unit; a pure number has none."""
        _, bracket, unit = self.meaning.rpartition("[")
        told = bracket and unit.endswith("]") and unit != "1]"
        return f"{self.name.rpartition('.')[2]}{f' in {unit[:-1]}' if told else ''}"

    @property
    def whole(self) -> bool:
        """Whether it takes whole numbers only."""
        return isinstance(self.value, int) and not isinstance(self.value, bool)


@dataclass(frozen=True)
class Scale:
    """Ends and step of a slider."""

    low: float
    high: float
    step: float


def slider_scale(tunable: Tunable) -> Scale:
    """Return the part of a parameter's range that its slider covers: all of it, or that around the value.

    Examples
    --------
    >>> slider_scale(Tunable("pid.kp", 0.05, low=0.0, high=1e9))
    Scale(low=0.0, high=0.2, step=0.001)
    >>> slider_scale(Tunable("smc.c", 0.4, low=0.0, high=1.0))
    Scale(low=0.0, high=1.0, step=0.005)
    """
    size = abs(float(tunable.value))
    low, high = tunable.low, tunable.high
    reach = REACH * size if size > 0 else 1.0
    if high - low > WIDE * max(size, 1e-12):
        high = min(high, reach)
        low = max(low, 0.0 if tunable.value >= 0 else -reach)
    if not low < high:
        low, high = min(low, float(tunable.value)), max(low, float(tunable.value)) + 1.0
    step = _nice((high - low) / STEPS)
    if tunable.whole:
        step = max(1.0, round(step))
    return Scale(low, high, step)


def _nice(step: float) -> float:
    """Round a step down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(step))
    mantissa = next(m for m in (5.0, 2.0, 1.0) if step / power >= m * (1 - 1e-9))
    return float(f"{mantissa * power:.3g}")


def from_descriptor(descriptor: Any, value: Any) -> Tunable:
    """Return a parameter from its rcl_interfaces descriptor and its value."""
    low, high = -math.inf, math.inf
    for found in (*descriptor.floating_point_range, *descriptor.integer_range):
        low, high = float(found.from_value), float(found.to_value)
    _, one_of, words = descriptor.additional_constraints.partition("one of: ")
    choices = tuple(word.strip() for word in words.split(",")) if one_of else ()
    return Tunable(descriptor.name, value, descriptor.description, low, high, choices, descriptor.read_only)


def coerced(tunable: Tunable, value: Any) -> Any:
    """Return a value of a widget as the type that the parameter has."""
    if isinstance(tunable.value, bool):
        return bool(value)
    if tunable.whole:
        return round(value)
    return float(value) if isinstance(tunable.value, float) else value
