"""Outage of nodes whose process is started again, as seen by the plant."""

from __future__ import annotations

from collections import Counter

from train_ato.messages.topics import Role

OUTAGE_RATE = 1.0
"""Maximum simulated seconds per wall second during an outage: the train goes on while a process starts."""


class Outage:
    """Nodes that are away, from the notice of their restart until every answer is in order again.

    Parameters
    ----------
    ticks
        Number of consecutive ticks with all answers that end the outage.

    Attributes
    ----------
    away : dict
        Reason of the restart, by node.
    returned : Counter
        Number of restarts after which the node has answered again, by node.
    """

    def __init__(self, ticks: int) -> None:
        self.away: dict[Role, str] = {}
        self.returned: Counter[Role] = Counter()
        self._begun: Counter[Role] = Counter()
        self._ticks = ticks
        self._in_order = 0

    @property
    def text(self) -> str:
        """Nodes that are away, with the reasons; "" without one."""
        return "; ".join(f"node {role.value}: {reason}" for role, reason in self.away.items())

    def begin(self, role: Role, reason: str) -> None:
        """Add a node that is away."""
        self.away[role] = reason
        self._begun[role] += 1
        self._in_order = 0

    def step(self, in_order: bool) -> bool:
        """Count a tick with all answers in time, or begin to count again; return True at the end of the outage."""
        self._in_order = self._in_order + 1 if in_order else 0
        if self._in_order < self._ticks:
            return False
        for role in self.away:
            self.returned[role] = self._begun[role]
        self.away.clear()
        return True
