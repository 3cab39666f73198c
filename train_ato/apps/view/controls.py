"""Parameters and services of the nodes of a running graph, without blocking: answers arrive as callbacks.

All ROS calls run in the thread of the executor; other threads queue their requests by :meth:`Controls.submit`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from std_srvs.srv import SetBool, Trigger

from train_ato.apps.view.tuning import Tunable, coerced, from_descriptor
from train_ato.scenario.ato_requests import REQUESTS

NODES = ("controller", "plant")
TRIGGERS = ("step", "stop", "gust", "delay_jump")
SWITCHES = ("pause", "emergency_brake")
"""Services of the plant without and with an argument; those of the controller are the requests to the ATO."""

Answer = Callable[[bool, str], None]
"""Callback for success and message of a node."""


class Controls:
    """Parameters and services of ``controller`` and ``plant``.

    Attributes
    ----------
    tunables : dict
        Parameters by node and name, updated by parameter events.
    number : int
        Number of changes so far.
    over : bool
        The run has ended; a later run on the domain receives no request.
    """

    def __init__(self, node: Any, wake: Callable[[], None]) -> None:
        self._node = node
        self._wake = wake
        self._requests: deque[Callable[[], None]] = deque()
        self._clients = {name: AsyncParameterClient(node, name) for name in NODES}
        self._services = {name: node.create_client(Trigger, f"plant/{name}") for name in TRIGGERS}
        self._services |= {name: node.create_client(SetBool, f"plant/{name}") for name in SWITCHES}
        self._services |= {name: node.create_client(Trigger, f"controller/{name}") for name in REQUESTS}
        self.tunables: dict[str, dict[str, Tunable]] = {name: {} for name in NODES}
        self.number = 0
        self.over = False
        node.create_subscription(ParameterEvent, "/parameter_events", self._changed, 100)

    @property
    def ready(self) -> bool:
        """Parameters of both nodes have arrived."""
        return all(self.tunables.values())

    @property
    def missing(self) -> str:
        """Awaited part of the graph, in words."""
        absent = [name for name in NODES if not self._clients[name].services_are_ready()]
        silent = [name for name in NODES if name not in absent and not self.tunables[name]]
        texts = [f"node {name} to start" for name in absent] + [f"node {name} to answer" for name in silent]
        return " and ".join(texts)

    def submit(self, request: Callable[[], None]) -> None:
        """Queue a request for the executor's thread."""
        self._requests.append(request)
        self._wake()

    def serve(self) -> None:
        """Run the queued requests; called by the executor's thread."""
        while self._requests:
            self._requests.popleft()()

    def learn(self) -> None:
        """Request the parameters of the discovered nodes."""
        for name, client in self._clients.items():
            if not self.tunables[name] and client.services_are_ready():
                client.list_parameters().add_done_callback(lambda future, name=name: self._listed(name, future))

    def _listed(self, node: str, future: Any) -> None:
        client = self._clients[node]
        names = list(future.result().result.names)
        descriptors = client.describe_parameters(names)

        def valued(values: Any) -> None:
            found = zip(descriptors.result().descriptors, values.result().values, strict=True)
            self.tunables[node] = {
                descriptor.name: from_descriptor(descriptor, parameter_value_to_python(value))
                for descriptor, value in found
            }
            self.number += 1

        descriptors.add_done_callback(lambda _: client.get_parameters(names).add_done_callback(valued))

    def _changed(self, event: Any) -> None:
        known = {} if self.over else self.tunables.get(event.node.rpartition("/")[2], {})
        for parameter in event.changed_parameters:
            if parameter.name in known:
                self._follow(event.node.rpartition("/")[2], parameter.name, parameter_value_to_python(parameter.value))

    def _follow(self, node: str, name: str, value: Any) -> None:
        """Take a new value of a parameter."""
        tunable = self.tunables[node][name]
        self.tunables[node][name] = replace(tunable, value=coerced(tunable, value))
        self.number += 1

    def set_parameter(self, node: str, name: str, value: Any, answer: Answer) -> None:
        """Set a parameter, from any thread; a rejection has its reason as the message."""

        def request() -> None:
            tunable = self.tunables[node].get(name)
            client = self._clients[node]
            if self.over or tunable is None or not client.services_are_ready():
                answer(False, self._reason(node))
                return
            change = client.set_parameters([Parameter(name, value=coerced(tunable, value))])
            change.add_done_callback(lambda future: done(future.result().results[0]))

        def done(result: Any) -> None:
            if result.successful:  # the event of the change may precede the subscription
                self._follow(node, name, value)
            done = [f"{name} = {value}"] if result.successful else []
            answer(bool(result.successful), "; ".join([*done, *filter(None, [str(result.reason)])]))

        self.submit(request)

    def call(self, service: str, answer: Answer, data: bool | None = None) -> None:
        """Call a service of the plant or of the controller, from any thread."""

        def request() -> None:
            client = self._services[service]
            if self.over or not client.service_is_ready():
                answer(False, self._reason("the controller" if service in REQUESTS else "the plant"))
                return
            message = Trigger.Request() if data is None else SetBool.Request(data=data)
            client.call_async(message).add_done_callback(lambda future: done(future.result()))

        def done(response: Any) -> None:
            answer(bool(response.success), str(response.message))

        self.submit(request)

    def _reason(self, name: str) -> str:
        return (
            "the run has ended; restart the view" if self.over else f"no response from {name}; the run may have ended"
        )

    def value(self, node: str, name: str, default: Any = None) -> Any:
        """Return the present value of a parameter."""
        found = self.tunables[node].get(name)
        return default if found is None else found.value
