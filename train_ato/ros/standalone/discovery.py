"""Discovery of nodes without a runner: the plant polls the service ``~/ready`` of the other nodes.

The answers contain the fingerprint of the node's scenario; a difference from that of the plant fails the run.
"""

import json
import sys
import time
from collections.abc import Callable
from typing import Any

from std_srvs.srv import SetBool

from plant_sim.data_text import parse_json
from train_ato.messages.topics import Role
from train_ato.ros.nodes.endpoints import NodeEndpoints, roles_of

REQUEST_EVERY_S = 0.3
_STAMP = "; stamp "
"""Separator before the stamp of the last message of the node [ns], -1 before the first."""
_RECORDED = "; a recorder is there"
"""Part of the answer of a node that has found a recorder; the run would begin without it if the plant has not."""
_AWAITS = "; awaits "
"""Separator before the topic for which the node waits."""
_SCENARIO = "; scenario "
"""Separator before the fingerprint in an answer; the fingerprint is a JSON object with one hash per key."""
ANSWER_S = 2.0
"""Wall time for the answers of running nodes [s]."""


def answer_ready(endpoints: NodeEndpoints, fingerprint: dict[str, str]) -> None:
    """Offer the service ``~/ready``: true if all endpoints are connected, with ``data`` those of the recorder too."""

    def answer(request: Any, response: Any) -> Any:
        absent = endpoints.missing((Role.RECORDER,) if request.data else ())
        response.success = not absent
        text = f"waits for {', '.join(absent)}" if absent else "all endpoints are connected"
        text += _RECORDED if endpoints.node.count_publishers("recorder/progress") else ""
        awaits = f"{_AWAITS}{topic}" if (topic := endpoints.awaited()) else ""
        response.message = f"{text}{awaits}{_STAMP}{endpoints.last_stamp}{_SCENARIO}{json.dumps(fingerprint)}"
        return response

    endpoints.serve(SetBool, "~/ready", answer)


class Discovery:
    """Polls the other nodes for the plant until all of them are ready.

    Parameters
    ----------
    endpoints
        Endpoints of the plant.
    fingerprint
        Fingerprint of the plant's scenario.
    recorded
        True: require a recorder. False: include a recorder only if it starts before all others are ready.
    recorder_connected
        Returns True after a recent message of a recorder that receives every publisher.

    Attributes
    ----------
    recorded : bool
        True if a recorder is part of the run.
    others : list of Role
        Nodes of the run that offer ``~/ready``: all besides plant, recorder and the external one.
    outside : set of Role
        Programs outside of this project: the external one, and those whose answer has no fingerprint.
    """

    def __init__(
        self,
        endpoints: NodeEndpoints,
        fingerprint: dict[str, str],
        recorded: bool,
        recorder_connected: Callable[[], bool],
    ) -> None:
        self._recorder_connected = recorder_connected
        self.recorded = recorded
        self._fingerprint = fingerprint
        self._endpoints = endpoints
        besides = (Role.PLANT, Role.RECORDER, endpoints.external)
        self.outside = set() if endpoints.external is None else {endpoints.external}
        self.others = [role for role in roles_of(endpoints.wire.layout) if role not in besides]
        self._clients = {role: endpoints.node.create_client(SetBool, f"{role.value}/ready") for role in self.others}
        self._asked: dict[Role, tuple[list[Any], float]] = {}
        self._missing = dict.fromkeys(self.others, "is not there")

    def complete(self) -> bool:
        """Read the answers and repeat the requests; return True if the run can begin."""
        if not self.recorded and self._endpoints.senders("recorder/progress"):
            self.recorded = True
            self._asked.clear()
            self._missing = dict.fromkeys(self.others, "has not answered yet about the recorder")
        for role in self.others:  # also after its answer: a second publisher may come and end before the start
            self._poll(role)
        return not any(self._missing.values()) and not self._missing_for_plant()

    def missing_peers(self) -> str:
        """Return every missing node and connection as text."""
        lacking = [f"{role.value} {reason}" for role, reason in self._missing.items() if reason]
        return "; ".join([*lacking, *filter(None, [self._missing_for_plant()])])

    def departed(self) -> list[Role]:
        """Return the nodes of the run that have left, the recorder included, in the order of dependence."""
        gone = [role for role in self.others if not self._clients[role].service_is_ready()]
        if self._endpoints.external is not None and self._endpoints.external_left:
            gone.append(self._endpoints.external)
        if self.recorded and not self._endpoints.senders("recorder/progress"):
            gone.append(Role.RECORDER)
        return gone

    def progress(self, turn: Callable[[], None]) -> tuple[dict[Role, int], dict[Role, str]]:
        """Return the stamps of the last messages of the nodes that answer [ns], and the topics for which they wait.

        ``turn`` runs the executor once.  A program without an answer, or without a stamp in it, counts as up to date.
        """
        futures = {role: client.call_async(SetBool.Request()) for role, client in self._clients.items()}
        last = time.monotonic() + ANSWER_S
        while not all(future.done() for future in futures.values()) and time.monotonic() < last:
            turn()
        external = self._endpoints.external
        stamps, awaited = {} if external is None else {external: sys.maxsize}, {}
        for role, future in futures.items():
            if future.done() and future.result() is not None:
                text, separator, stamp = future.result().message.partition(_SCENARIO)[0].rpartition(_STAMP)
                stamps[role] = int(stamp) if separator else sys.maxsize
                awaited[role] = text.partition(_AWAITS)[2]
        return stamps, awaited

    def _missing_for_plant(self) -> str:
        absent = self._endpoints.missing((Role.RECORDER,) if self.recorded else ())
        if self.recorded and not absent and not self._recorder_connected():
            absent = ["the recorder, which does not receive every publisher yet"]
        return f"plant waits for {', '.join(absent)}" if absent else ""

    def _compare(self, role: Role, theirs: str) -> None:
        """Fail the run if the scenario of a node differs; a program without a fingerprint is not checked."""
        try:
            found = parse_json(theirs) if theirs else self._fingerprint
        except ValueError:
            found = None
        if found == self._fingerprint:
            return
        known = found if isinstance(found, dict) else {}
        keys = [key for key in {**self._fingerprint, **known} if self._fingerprint.get(key) != known.get(key)]
        self._endpoints.watch.fail(
            role.value,
            f"it was started with another scenario than the plant: {', '.join(keys)} differ; "
            "give every node the same --scenario and --set",
        )

    def _poll(self, role: Role) -> None:
        """Read the answer of a node; send a request if none is open."""
        open_, since = self._asked.get(role, ([], 0.0))
        answered = next((future for future in open_ if future.done()), None)
        if answered is not None:
            del self._asked[role]
            if answered.result() is not None:
                text, _, theirs = answered.result().message.partition(_SCENARIO)
                if not theirs:
                    self.outside.add(role)
                self._missing[role] = "" if answered.result().success else text.partition(_STAMP)[0]
                if _RECORDED in text and not self.recorded:
                    self._missing[role] = "has found a recorder, and the plant has not yet"
                self._compare(role, theirs)
        elif self._clients[role].service_is_ready() and time.monotonic() - since > REQUEST_EVERY_S:
            # A server that has not discovered the client yet loses its answer, so requests are repeated.  An answer to
            # an earlier one counts too: that of a slow node comes after the next request, every time.
            request = SetBool.Request(data=self.recorded)
            self._asked[role] = ([*open_, self._clients[role].call_async(request)], time.monotonic())
