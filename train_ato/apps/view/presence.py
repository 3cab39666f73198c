"""Whether the run that a page shows is still there, and whether it says anything."""

from __future__ import annotations

from typing import Any

LOOK_S = 0.5
"""Wall time from one look at the graph to the next."""
SILENT_S = 2.0
"""Wall time without a new tick after which a run that is neither paused nor over counts as silent."""
PAUSES = 3.0
"""A slow run counts as silent after so many times its last pause between two ticks, if that is longer."""
TOPIC = "train/cars"


class Presence:
    """Knows the plant that was met by its publisher: another run on the same domain has another one.

    Parameters
    ----------
    node
        rclpy node that sees the graph.

    Attributes
    ----------
    gone : bool
        The plant that was met is no longer there, or another one is there beside it.
    """

    def __init__(self, node: Any) -> None:
        self._node = node
        self._met: frozenset[bytes] = frozenset()
        self._looked = self._news = float("-inf")
        self._pause = 0.0
        self.gone = False

    def look(self, now: float, *, news: bool) -> None:
        """Take note of a moment of wall time [s], and whether a new tick was seen at it."""
        if news:
            self._pause = now - self._news if self._news > float("-inf") else 0.0
            self._news = now
        if now - self._looked >= LOOK_S:
            self._looked = now
            found = frozenset(bytes(entry.endpoint_gid) for entry in self._node.get_publishers_info_by_topic(TOPIC))
            self._met = self._met or found
            self.gone = found != self._met

    def silent(self, now: float) -> bool:
        """Whether no tick came for longer than the run's pace explains."""
        return now - self._news > max(SILENT_S, PAUSES * self._pause) > 0.0
