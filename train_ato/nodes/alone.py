"""A node started by hand or by a launch file: no runner, the nodes find each other and end together.

When the plant has left, the others leave; the recorder stays until nobody publishes any more.
"""

from __future__ import annotations

import sys
import time
from typing import Any

from plant_sim.node import silent_node
from train_ato.graph.run_end import STOPPING_S
from train_ato.nodes.meeting import Meeting, answer_ready
from train_ato.nodes.piped import RECORD_S, TURN_S
from train_ato.nodes.shell import Shell
from train_ato.topics import Role

TELL_AFTER_S = 3.0
"""Wall time after which the plant says what it waits for, and says it again."""


class AloneNode:
    """Turns the executor of one node until the run is over or Ctrl-C.

    Parameters
    ----------
    role, node, shell, executor
        The node.
    stopped
        ``asked`` becomes true on Ctrl-C and SIGTERM.
    recorded
        Of the plant: do not begin without a recorder.

    Attributes
    ----------
    first_heard, last_heard : float
        Monotonic wall time of the recorder's first and last message [s].
    """

    def __init__(
        self, role: Role, node: Any, shell: Shell, executor: Any, stopped: dict[str, bool], recorded: bool = False
    ) -> None:
        self.role = role
        self.node = node
        self.shell = shell
        self._executor = executor
        self._stopped = stopped
        self._met = False
        self.first_heard = self.last_heard = 0.0
        self._meeting = Meeting(shell, recorded) if role is Role.PLANT else None
        if role not in (Role.PLANT, Role.RECORDER):
            answer_ready(shell)

    def run(self) -> int:
        """Turn; return the exit status."""
        {Role.PLANT: self._drive, Role.RECORDER: self._record}.get(self.role, self._follow)()
        self.shell.deliver(STOPPING_S)
        if self.shell.watch.failure is not None:
            sys.stderr.write(f"{self.shell.watch.failure}\n")
            return 1
        return 0

    @property
    def _ends(self) -> bool:
        return self._stopped["asked"] or self.shell.watch.failure is not None

    def _follow(self) -> None:
        """Answer measurements until the plant has left."""
        if self.role is Role.PROFILE:
            self.shell.guard(self.node.begin)
        while not self._ends and not self._left("train/measurement"):
            self._executor.spin_once(timeout_sec=TURN_S)

    def _record(self) -> None:
        """Write what comes until nobody publishes any more, and close the log."""
        while not self._ends and not self._left(*self.shell.subscribed):
            self.shell.guard(self._poll)
            time.sleep(RECORD_S)
        self.shell.guard(lambda: self.node.close(None))

    def _poll(self) -> None:
        if self.node.poll():
            self.last_heard = time.monotonic()
            self.first_heard = self.first_heard or self.last_heard

    def _left(self, *topics: str) -> bool:
        """Tell whether those who published were there and are gone."""
        senders = sum(self.shell.senders(topic) for topic in topics)
        self._met = self._met or senders > 0
        return self._met and not senders

    def _drive(self) -> None:
        """Wait for the others, then let the messages drive everything until the last tick or Ctrl-C."""
        if not self._everybody_met():
            return
        self.node.follow_recorder()
        self.shell.guard(self.node.begin)
        look = 0.0
        while not self._ends and not self.node.finished:
            self._executor.spin_once(timeout_sec=TURN_S)
            if time.monotonic() >= look:
                look = time.monotonic() + TURN_S
                self._check_answers()
        if self._stopped["asked"] and not self.node.finished:
            self._stop()

    def _everybody_met(self) -> bool:
        """Let the nodes find each other; False when stopped before."""
        assert self._meeting is not None
        tell = time.monotonic() + TELL_AFTER_S
        while not self._ends:
            if self._meeting.complete():
                return True
            if time.monotonic() > tell:
                tell = time.monotonic() + TELL_AFTER_S
                self.shell.node.get_logger().info(f"not begun: {self._meeting.lack()}")
            self._executor.spin_once(timeout_sec=0.02)
        return False

    def _stop(self) -> None:
        """End the run after the tick under way, if its command comes."""
        self.node.request_stop()
        last = time.monotonic() + STOPPING_S
        while not self.node.finished and self.shell.watch.failure is None and time.monotonic() < last:
            self._executor.spin_once(timeout_sec=TURN_S)

    def _check_answers(self) -> None:
        """End the run when an answer has been due for too long; from here only the plant's own view is known."""
        if self.node.overdue:
            due = "the recorder" if silent_node({}, 0, self.node.blocked) is Role.RECORDER else "the command"
            self.shell.watch.fail(
                self.role.value, f"{due} for {self.node.stamp * 1e-9:.3f} s did not come within {self.node.timeout:g} s"
            )
