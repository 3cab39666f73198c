"""Detection of the end and of the silence of the run on a page."""

from __future__ import annotations

from typing import Any

from train_ato.ros.graph.domain_lock import DomainLock

LOOK_S = 0.5
"""Wall time between two checks of the graph."""
SILENT_S = 2.0
"""Wall time without a new tick after which a run that is not paused or finished counts as silent."""
PAUSES = 3.0
"""Multiple of the last time between two ticks after which a slow run counts as silent, if that is longer."""
TOPIC = "train/vehicles"


class Presence:
    """Monitor of the plant's publisher; another run on the same domain has a different publisher.

    The middleware reports the end of a killed publisher after 10 s and more; the lock of the domain is free at once.

    Parameters
    ----------
    node
        rclpy node in the graph.
    domain
        ROS domain of the run.

    Attributes
    ----------
    gone : bool
        The first publisher has disappeared, a second one exists, or the run has released its domain.
    replaced : bool
        Another publisher exists.
    """

    def __init__(self, node: Any, domain: int) -> None:
        self._node = node
        self._lock = DomainLock(domain)
        self._was_held = False
        self._met: frozenset[bytes] = frozenset()
        self._looked = self._news = float("-inf")
        self._pause = 0.0
        self.gone = self.replaced = False

    def look(self, now: float, *, news: bool) -> None:
        """Check the graph at a wall time [s]; ``news`` means a new tick at this time."""
        if news:
            self._pause = now - self._news if self._news > float("-inf") else 0.0
            self._news = now
        if now - self._looked >= LOOK_S:
            self._looked = now
            found = frozenset(bytes(entry.endpoint_gid) for entry in self._node.get_publishers_info_by_topic(TOPIC))
            self._met = self._met or found
            self.replaced = bool(found - self._met)
            held = self._lock.held
            self._was_held |= held
            self.gone = self.gone or found != self._met or (self._was_held and not held)

    def silent(self, now: float) -> bool:
        """Return True if no tick came for longer than the rate of the run explains."""
        return now - self._news > max(SILENT_S, PAUSES * self._pause) > 0.0
