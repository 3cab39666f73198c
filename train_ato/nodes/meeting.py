"""How nodes without a runner find each other: every node answers whether it has met all others, the plant asks."""

from __future__ import annotations

import time
from typing import Any

from std_srvs.srv import SetBool

from train_ato.nodes.shell import Shell
from train_ato.topics import Role

ASK_AGAIN_S = 0.3
OTHERS = (Role.PROFILE, Role.OBSERVER, Role.CONTROLLER)


def answer_ready(shell: Shell) -> None:
    """Offer the service ``~/ready``: true when the node has met every other, with ``data`` the recorder too."""

    def answer(request: Any, response: Any) -> Any:
        absent = shell.missing((Role.RECORDER,) if request.data else ())
        response.success = not absent
        response.message = f"waits for {absent[0]}" if absent else "has met every node it talks to"
        return response

    shell.node.create_service(SetBool, "~/ready", answer)


class Meeting:
    """The plant's side: asks the others until all of them are ready.

    Parameters
    ----------
    shell
        Of the plant.
    recorded
        Wait for a recorder; otherwise only one that is there before all others are ready is waited for.

    Attributes
    ----------
    recorded : bool
        A recorder is part of the run.
    """

    def __init__(self, shell: Shell, recorded: bool) -> None:
        self.recorded = recorded
        self._shell = shell
        self._clients = {role: shell.node.create_client(SetBool, f"{role.value}/ready") for role in OTHERS}
        self._asked: dict[Role, tuple[Any, float]] = {}
        self._lacks = dict.fromkeys(OTHERS, "is not there")

    def complete(self) -> bool:
        """Look at the answers that came, ask again; tell whether the run can begin."""
        if not self.recorded and self._shell.senders("record/acknowledged"):
            self.recorded = True
            self._asked.clear()
            self._lacks = dict.fromkeys(OTHERS, "has not said whether it has met the recorder")
        for role in self._lacks:
            self._ask(role)
        self._lacks = {role: lack for role, lack in self._lacks.items() if lack}
        return not self._lacks and not self._own_lack()

    def lack(self) -> str:
        """Say what the plant waits for."""
        return next((f"{role.value} {lack}" for role, lack in self._lacks.items()), self._own_lack())

    def _own_lack(self) -> str:
        absent = self._shell.missing((Role.RECORDER,) if self.recorded else ())
        return f"plant waits for {absent[0]}" if absent else ""

    def _ask(self, role: Role) -> None:
        """Take a node's answer; ask where none is under way."""
        future, since = self._asked.get(role, (None, 0.0))
        if future is not None and future.done():
            del self._asked[role]
            if future.result() is not None:
                self._lacks[role] = "" if future.result().success else future.result().message
        elif self._clients[role].service_is_ready() and time.monotonic() - since > ASK_AGAIN_S:
            # An answer to a client that the server has not met yet is lost, so a call is not trusted for long.
            request = SetBool.Request(data=self.recorded)
            self._asked[role] = (self._clients[role].call_async(request), time.monotonic())
