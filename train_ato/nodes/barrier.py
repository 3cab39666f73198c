"""Waiting until all messages of one stamp are there, free of ROS."""

from __future__ import annotations

from typing import Any


class Barrier:
    """Collects one message of every kind per stamp and lets each stamp through once, in order.

    Parameters
    ----------
    kinds
        Names of what has to be there.

    Attributes
    ----------
    ignored : int
        Messages that came twice or for a stamp that is over.
    """

    def __init__(self, *kinds: str) -> None:
        self._kinds = kinds
        self._waiting: dict[int, dict[str, Any]] = {}
        self._last = -1
        self.ignored = 0

    def put(self, kind: str, message: Any) -> tuple[Any, ...] | None:
        """Take a message; return those of its stamp in the order of the kinds once they are complete.

        Stamps that were overtaken by a complete later one are given up.
        """
        stamp = message.stamp
        if stamp <= self._last:
            self.ignored += 1
            return None
        row = self._waiting.get(stamp)
        if row is None:
            row = self._waiting[stamp] = {}
        if kind in row:
            self.ignored += 1
            return None
        row[kind] = message
        if len(row) < len(self._kinds):
            return None
        self._last = stamp
        if len(self._waiting) > 1:
            self._waiting = {later: rest for later, rest in self._waiting.items() if later > stamp}
        else:
            self._waiting.clear()
        return tuple(row[name] for name in self._kinds)
