"""A node under the runner: it reports over its pipe and does what it is told there."""

from __future__ import annotations

import gc
import threading
import time
from typing import Any

from train_ato.graph.pipe import ChildPipe
from train_ato.nodes.shell import Shell
from train_ato.topics import Role

TURN_S = 0.1
RECORD_S = 0.02
"""Time between two looks of the recorder at its queues; at 10 000 ticks a second they fill by 200 of 1000."""


class PipedNode:
    """Turns the executor of one node and talks to the runner.

    Parameters
    ----------
    role, node, shell, executor
        The node.
    stopped
        ``asked`` becomes true on SIGTERM.
    """

    def __init__(self, role: Role, node: Any, shell: Shell, executor: Any, stopped: dict[str, bool]) -> None:
        self.role = role
        self.node = node
        self.shell = shell
        self._executor = executor
        self._stopped = stopped
        self._called = threading.Event()
        self._pipe = ChildPipe(self._called.set if role is Role.RECORDER else executor.wake)
        self._ready = self._finished = self._failed = self._leaving = self._silent = False
        self._expected: dict[str, int] | None = None
        self._drain_until = 0.0

    def run(self) -> int:
        """Turn until told to exit; return the exit status."""
        gc.freeze()
        inbox = self._pipe.inbox
        look = 0.0
        while not self._leaving:
            self._turn()
            while inbox:
                self._obey(inbox.popleft())
            now = time.monotonic()
            if now >= look or self.shell.watch.failure is not None or getattr(self.node, "finished", False):
                look = now + TURN_S
                self._look()
            if self._drain_until:
                self._drain(now)
        if self.role is Role.RECORDER:
            self._close(None)
        return 1 if self._failed else 0

    def _turn(self) -> None:
        """Run one callback, or let the recorder write what has come."""
        if self.role is not Role.RECORDER:
            self._executor.spin_once(timeout_sec=TURN_S if self._ready else 0.01)
        elif not self.node.closed:
            self.shell.guard(self.node.poll)
            self._called.wait(RECORD_S)
            self._called.clear()

    def _look(self) -> None:
        """Tell the runner what changed."""
        if self._stopped["asked"]:
            self._leaving = True
        failure = self.shell.watch.failure
        if failure is not None and not self._failed:
            self._failed = True
            self._pipe.send("failed", reason=failure)
        if not self._ready:
            absent = self.shell.missing()
            self._ready = not absent
            if self._ready:
                self._pipe.send("ready")
            else:
                self._pipe.send("waiting", absent=absent[0])
        if self.role is Role.PLANT and self._ready and not self._failed:
            self._look_at_plant()

    def _look_at_plant(self) -> None:
        plant = self.node
        if plant.finished and not self._finished:
            self._finished = True
            self._pipe.send("finished", tick=plant.role.tick, asked=plant.asked, late=plant.late, held=plant.held)
        elif not plant.finished:
            self._pipe.send("progress", tick=plant.role.tick)
            if plant.overdue and not self._silent:
                self._silent = True
                self._pipe.send("silent", stamp=plant.stamp, blocked=plant.blocked, timeout=plant.timeout)

    def _obey(self, order: dict[str, Any]) -> None:
        action = order["do"]
        if action == "begin":
            self.shell.guard(self.node.begin)
        elif action == "stop":
            self.node.request_stop()
        elif action == "report":
            times = self.node.role.step_times.nanoseconds if self.role is Role.CONTROLLER else []
            self._pipe.send(
                "report",
                last_stamp=self.shell.last_stamp,
                published=self.shell.published,
                step_ns=times if order.get("whole") else [],
            )
        elif action == "drain":
            self._expected = order["published"]
            self._drain_until = time.monotonic() + order["limit"]
        elif action == "close":
            self._close(None)
        elif action == "exit":
            self._leaving = True

    def _drain(self, now: float) -> None:
        """Close the log once everything has come, or the limit has passed."""
        assert self._expected is not None
        if self.node.complete(self._expected) or now > self._drain_until:
            self._drain_until = 0.0
            self._close(self._expected)

    def _close(self, published: dict[str, int] | None) -> None:
        if self.node.closed:
            return
        self.shell.guard(lambda: self.node.close(published))
        self._pipe.send("closed", recorded=self.node.log.counts, failure=self.shell.watch.failure)
