"""A node started by hand or by a launch file: no runner, the nodes find each other.

Every node offers the service ``~/ready``; the plant begins when all the others answer that they have met everybody.
"""

from __future__ import annotations

import sys
import time
from typing import Any

from std_srvs.srv import Trigger

from plant_sim.node import silent_node
from train_ato.nodes.piped import RECORD_S, TURN_S
from train_ato.nodes.shell import Shell
from train_ato.topics import Role

ASK_AGAIN_S = 0.3
OTHERS = (Role.PROFILE, Role.OBSERVER, Role.CONTROLLER)


class AloneNode:
    """Turns the executor of one node until the run is over or Ctrl-C.

    Parameters are those of :class:`train_ato.nodes.piped.PipedNode`.
    """

    def __init__(self, role: Role, node: Any, shell: Shell, executor: Any, stopped: dict[str, bool]) -> None:
        self.role = role
        self.node = node
        self.shell = shell
        self._executor = executor
        self._stopped = stopped
        if role is not Role.RECORDER:
            shell.node.create_service(Trigger, "~/ready", self._answer)
        self._clients = (
            {other: shell.node.create_client(Trigger, f"{other.value}/ready") for other in OTHERS}
            if role is Role.PLANT
            else {}
        )

    def run(self) -> int:
        """Turn; return the exit status."""
        if self.role is Role.PROFILE:
            self.shell.guard(self.node.begin)
        if self.role is Role.PLANT and self._everybody_ready():
            self.node.follow_recorder()
            self.node.begin()
        look = 0.0
        while not self._stopped["asked"] and self.shell.watch.failure is None:
            if self.role is Role.RECORDER:
                self.shell.guard(self.node.poll)
                time.sleep(RECORD_S)
            else:
                self._executor.spin_once(timeout_sec=TURN_S)
            if self.role is Role.PLANT and time.monotonic() >= look:
                look = time.monotonic() + TURN_S
                if self.node.finished:
                    break
                self._check_answers()
        if self.role is Role.RECORDER:
            self.shell.guard(lambda: self.node.close(None))
        if self.shell.watch.failure is not None:
            sys.stderr.write(f"{self.shell.watch.failure}\n")
            return 1
        return 0

    def _answer(self, request: Any, response: Any) -> Any:
        absent = self.shell.missing()
        response.success = not absent
        response.message = f"waits for {absent[0]}" if absent else "has met every node it talks to"
        return response

    def _everybody_ready(self) -> bool:
        """Ask the other nodes until all of them are ready; False when stopped before."""
        waiting = dict(self._clients)
        asked: dict[Role, tuple[Any, float]] = {}
        while not self._stopped["asked"]:
            for role, client in list(waiting.items()):
                future, since = asked.get(role, (None, 0.0))
                if future is not None and future.done():
                    if future.result() is not None and future.result().success:
                        del waiting[role]
                    asked.pop(role)
                elif client.service_is_ready() and time.monotonic() - since > ASK_AGAIN_S:
                    # An answer to a client that the server has not met yet is lost, so a call is not trusted for long.
                    asked[role] = (client.call_async(Trigger.Request()), time.monotonic())
            if not waiting and not self.shell.missing():
                return True
            self._executor.spin_once(timeout_sec=0.02)
        return False

    def _check_answers(self) -> None:
        """End the run when an answer has been due for too long; from here only the plant's own view is known."""
        if self.node.overdue:
            due = "the recorder" if silent_node({}, 0, self.node.blocked) is Role.RECORDER else "the command"
            self.shell.watch.fail(
                self.role.value, f"{due} for {self.node.stamp * 1e-9:.3f} s did not come within {self.node.timeout:g} s"
            )
