"""Messages of a run as a tree: the states of one environment share the messages before them."""

from __future__ import annotations

from typing import Any

from train_ato.loop.stage_messages import Published


class Past:
    """Messages of some ticks, and those before them.

    Attributes
    ----------
    before : Past or None
        Messages of the ticks before; None: none.
    ticks : list of tuple
        Stamp [ns] and messages of every part of a tick.
    """

    __slots__ = ("before", "ticks")

    def __init__(self, ticks: list[tuple[int, Published]], before: Past | None = None) -> None:
        self.ticks, self.before = ticks, before

    def all(self) -> list[tuple[int, Published]]:
        """Return stamp and messages of all ticks, oldest first."""
        parts, past = [], self.before
        parts.append(self.ticks)
        while past is not None:
            parts.append(past.ticks)
            past = past.before
        return [tick for part in reversed(parts) for tick in part]

    def __reduce__(self) -> Any:
        """Pickle without the tree."""
        return Past, (self.all(),)


class History:
    """Messages of a run up to now; made by :class:`train_ato.apps.env.stepped_loop.SteppedLoop`.

    Parameters
    ----------
    past
        Messages so far.
    """

    def __init__(self, past: Past | None = None) -> None:
        self._past, self._ticks = past, list[tuple[int, Published]]()

    def add(self, stamp: int, messages: Published) -> None:
        """Add the messages of a stage at a stamp [ns]."""
        self._ticks.append((stamp, messages))

    @property
    def newest(self) -> dict[str, Any]:
        """Messages of the last stage by topic."""
        return dict(self._ticks[-1][1])

    def mark(self) -> Past:
        """Return the messages up to now; later ones do not change it."""
        self._past, self._ticks = Past(self._ticks, self._past), []
        return self._past
