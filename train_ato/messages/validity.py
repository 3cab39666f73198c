"""Validity of the values of a message: finite, physically possible, permitted."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from train_ato.messages.topic import Topic
from train_ato.messages.types import BrakeRelease

MAX_POSITION = 1e8
"""Largest valid position [m]."""
MAX_SPEED = 1e3
"""Largest valid speed [m/s], acceleration [m/s²] and jerk [m/s³]."""
MAX_FORCE = 1e10
"""Largest valid force [N]."""
MAX_PRESSURE = 1e7
"""Largest valid pressure [Pa]."""
MAX_MAGNITUDES = {"m": MAX_POSITION, "m/s": MAX_SPEED, "m/s²": MAX_SPEED, "N": MAX_FORCE, "Pa": MAX_PRESSURE}
"""Largest valid magnitude by unit."""


class AliveCheck:
    """Check of the alive counter of the brake releases: EN 50159, 7.3.2, against a sender that repeats its content."""

    def __init__(self) -> None:
        self._last = -1.0

    def problem(self, message: BrakeRelease) -> str:
        """Return the problem of a message as text, "" with a counter above that of the last valid message."""
        counters = message.alive.tolist()
        alive = counters[0]
        if not alive >= 0.0 or counters.count(alive) < len(counters):
            return f"alive counter {alive:g} not possible"
        if alive <= self._last:
            return f"alive counter {alive:g} repeated"
        self._last = alive
        return ""


@lru_cache(maxsize=64)
def validity_check(topic: Topic) -> Callable[[Any], str]:
    """Return a function that returns the problem of a message of a topic as text, "" for a valid message.

    A value is valid if it is one of the permitted values of its field, or within :data:`MAX_MAGNITUDES` of its unit. In
    a topic with ``finite=False`` a value without permitted ones may be NaN. All readers of a topic share one function.
    It checks a message once for consecutive readers, which do not change it.
    """
    fields = []
    for place in topic.places:
        description = topic.description(place)
        if description.permitted or description.unit in MAX_MAGNITUDES:
            fields.append((place.field, description.permitted, MAX_MAGNITUDES.get(description.unit, 0.0)))
    finite = topic.finite
    last: tuple[Any, str] = None, ""

    def problem(message: Any) -> str:
        nonlocal last
        known, text = last  # one read: runs in other threads use the same function
        if message is known:
            return text
        for name, permitted, bound in fields:
            value = getattr(message, name)
            for entry in (value,) if type(value) is float else value.tolist():
                if entry in permitted if permitted else -bound <= entry <= bound:
                    continue
                if permitted or finite or entry == entry:
                    text = f"{name} {entry:g}"
                    last = message, text
                    return text
        last = message, ""
        return ""

    return problem
