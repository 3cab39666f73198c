"""What a role hands out, and when a report is due."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    pass


Outgoing = list[tuple[str, Any]]
"""Messages to publish: topic name and dataclass, in the order in which they are sent."""
SECOND_NS = 1_000_000_000


def stamped(message: Any, stamp: int) -> Any:
    """Return a message that came late under the stamp at which it is used."""
    return message if message.stamp == stamp else replace(message, stamp=stamp)


def due(stamp: int, tick_ns: int) -> bool:
    """Tell whether the diagnostics of a second fall on this stamp."""
    return stamp % SECOND_NS < tick_ns
