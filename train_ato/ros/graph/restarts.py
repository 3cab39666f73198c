"""Restart of the nodes whose process has ended: a bounded number of new processes for each node.

The new process starts at once, but joins the graph only after every other node has lost the publishers of the old one.
So no topic ever has two publishers, and the new one is identified as at the start of the run.
"""

import time
from collections import Counter
from collections.abc import Callable

from train_ato.messages.topics import Role
from train_ato.ros.graph.node_process import LEAVING_S, NodeProcess
from train_ato.ros.standalone.notices import Notice, NoticeKind

RETURN_S = 180.0
"""Maximum wall time from the end of a process to the return of its node [s]."""
RESTARTED = (Role.CONTROLLER, Role.OBSERVER, Role.PROFILE, Role.SUPERVISOR)
"""Nodes that are started again; the train and the log exist only in the processes of plant and recorder."""


class Restarts:
    """Restarts of the nodes of one run.

    Parameters
    ----------
    nodes
        Processes of the nodes; that of a restarted node is replaced.
    start
        Starts the new process of a node, for its role and the number of the restart.
    limit
        Maximum number of restarts of each node.
    """

    def __init__(self, nodes: dict[Role, NodeProcess], start: Callable[[Role, int], NodeProcess], limit: int) -> None:
        self.begun: Counter[Role] = Counter()
        self._nodes = nodes
        self._start = start
        self._limit = limit
        self._joining: dict[Role, float] = {}
        self._met: dict[Role, list[NodeProcess]] = {}

    @property
    def returned(self) -> dict[str, int]:
        """Number of restarts after which the node has answered again, by node."""
        plant = self._nodes[Role.PLANT].counts
        counts = {role.value: plant.get(f"returned {role.value}", [0])[0] for role in self.begun}
        return {name: count for name, count in counts.items() if count}

    def step(self) -> None:
        """Replace ended processes, and let new ones join after the old ones have left; not after a lost node."""
        if not self._limit or any(node.lost for node in self._nodes.values()):
            return
        for role in RESTARTED:
            if role in self._nodes and self._nodes[role].crashed:
                self._replace(role)
        for role, last in list(self._joining.items()):
            if self.returned.get(role.value, 0) >= self.begun[role]:
                del self._joining[role]
            elif time.monotonic() > last:
                del self._joining[role]
                self._nodes[role].remark = f"; it did not return within {RETURN_S:g} s after a restart"
                self._nodes[role].process.kill()
            else:
                self._let_join(role)

    def end(self) -> None:
        """Let the processes end that have not returned."""
        for role in self._joining:
            self._nodes[role].release()

    def _replace(self, role: Role) -> None:
        """Start a new process in place of an ended one, unless the limit is reached."""
        old = self._nodes[role]
        assert old.failure is not None
        self._joining.pop(role, None)
        if old.remark:
            return
        if self.begun[role] >= self._limit:
            count = self._limit
            old.remark = f"; it was restarted {'once' if count == 1 else f'{count} times'} before"
            return
        self.begun[role] += 1
        reason = old.failure.partition(" failed: ")[2]
        notice = Notice(NoticeKind.AWAY, role, f"{self.begun[role]} {reason}")
        new = [node for node in self._nodes.values() if node.role in self._joining and not node.joined]
        self._met[role] = [other for other in self._nodes.values() if other is not old and other not in new]
        for other in self._met[role]:
            other.send(notice)
        old.release()
        old.end(LEAVING_S)
        self._nodes[role] = self._start(role, self.begun[role])
        self._joining[role] = time.monotonic() + RETURN_S

    def _let_join(self, role: Role) -> None:
        """Send the notice to join after every node that has met the old process has lost its publishers."""
        node = self._nodes[role]
        if node.joined:
            return
        key = f"without {role.value}"
        left = [other for other in self._met[role] if self._nodes[other.role] is other]
        if all(other.counts.get(key, [0])[0] >= self.begun[role] for other in left):
            node.joined = True
            node.send(Notice(NoticeKind.BEGIN, role, str(self._nodes[Role.PLANT].counts[key][1])))
