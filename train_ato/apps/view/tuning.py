"""ROS parameters as widgets of the page: slider, list of choices, or switch."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

WIDE = 50.0
"""Ratio of range to value above which the slider covers a part of the range."""
REACH = 4.0
"""Ratio of the end of that part to the value."""
STEPS = 200


@dataclass(frozen=True)
class Tunable:
    """Parameter of a running node with its descriptor.

    Attributes
    ----------
    name
        Full name, for example ``pid.kp``.
    value
        Present value.
    meaning
        Description, with the unit in brackets at its end.
    low, high
        Range; infinite without one in the descriptor.
    choices
        Allowed values; empty for numbers and switches.
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
        """Name without the law, with the unit if it has one."""
        _, bracket, unit = self.meaning.rpartition("[")
        shown = bracket and unit.endswith("]") and unit != "1]"
        return f"{self.name.rpartition('.')[2]}{f' in {unit[:-1]}' if shown else ''}"

    @property
    def explanation(self) -> str:
        """Name, meaning and range, for a tooltip."""
        ends = [f"{end:.6g}" if math.isfinite(end) else "" for end in (self.low, self.high)]
        known = [f"from {ends[0]}" if ends[0] else "", f"to {ends[1]}" if ends[1] else ""]
        bounds = " ".join(word for word in known if word)
        shown = "" if self.choices or isinstance(self.value, bool) else bounds
        fixed = "fixed during the run" if self.read_only else ""
        return "; ".join(part for part in (f"{self.name}: {self.meaning}", shown, fixed) if part)

    @property
    def whole(self) -> bool:
        """Type is a whole number."""
        return isinstance(self.value, int) and not isinstance(self.value, bool)


@dataclass(frozen=True)
class Scale:
    """Ends and step of a slider."""

    low: float
    high: float
    step: float


def slider_scale(tunable: Tunable) -> Scale:
    """Return the part of a parameter's range for its slider: the whole range, or a part around the value.

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
    """Return a parameter from its rcl_interfaces descriptor and value."""
    low, high = -math.inf, math.inf
    for found in (*descriptor.floating_point_range, *descriptor.integer_range):
        low, high = float(found.from_value), float(found.to_value)
    _, one_of, words = descriptor.additional_constraints.partition("one of: ")
    choices = tuple(word.strip() for word in words.split(",")) if one_of else ()
    return Tunable(descriptor.name, value, descriptor.description, low, high, choices, descriptor.read_only)


def coerced(tunable: Tunable, value: Any) -> Any:
    """Return a value of a widget in the type of the parameter."""
    if isinstance(tunable.value, bool):
        return bool(value)
    if tunable.whole:
        return round(value)
    return float(value) if isinstance(tunable.value, float) else value
