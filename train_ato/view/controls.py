"""Parameters and services of the nodes of a running graph, without blocking: answers arrive as callbacks.

All ROS calls run in the thread of the executor; other threads queue their requests by :meth:`Controls.submit`.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from std_srvs.srv import SetBool, Trigger

from train_ato.ros.nodes.publishers import in_place_of
from train_ato.scenario.interventions import REQUESTS

WIDE = 50.0
"""Ratio of range to value above which the slider covers a part of the range."""
REACH = 4.0
"""Ratio of the end of that part to the value."""
STEPS = 200


@dataclass(frozen=True)
class Tunable:
    """Parameter of a running node with its descriptor.

    Attributes
    ----------
    name
        Full name, for example ``pid.kp``.
    value
        Present value.
    meaning
        Description, with the unit in brackets at its end.
    low, high
        Range; infinite without one in the descriptor.
    choices
        Allowed values; empty for numbers and switches.
    """

    name: str
    value: Any
    meaning: str = ""
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    read_only: bool = False

    @property
    def title(self) -> str:
        """Name without the law, with the unit if it has one."""
        _, bracket, unit = self.meaning.rpartition("[")
        shown = bracket and unit.endswith("]") and unit != "1]"
        return f"{self.name.rpartition('.')[2]}{f' in {unit[:-1]}' if shown else ''}"

    @property
    def explanation(self) -> str:
        """Name, meaning and range, for a tooltip."""
        ends = [f"{end:.6g}" if math.isfinite(end) else "" for end in (self.low, self.high)]
        known = [f"from {ends[0]}" if ends[0] else "", f"to {ends[1]}" if ends[1] else ""]
        bounds = " ".join(word for word in known if word)
        shown = "" if self.choices or isinstance(self.value, bool) else bounds
        fixed = "fixed during the run" if self.read_only else ""
        return "; ".join(part for part in (f"{self.name}: {self.meaning}", shown, fixed) if part)

    @property
    def whole(self) -> bool:
        """Type is a whole number."""
        return isinstance(self.value, int) and not isinstance(self.value, bool)


def slider_scale(tunable: Tunable) -> dict[str, float]:
    """Return ends and step of the slider of a parameter: the whole range, or a part around the value.

    Examples
    --------
    >>> slider_scale(Tunable("pid.kp", 0.05, low=0.0, high=1e9))
    {'start': 0.0, 'end': 0.2, 'step': 0.001}
    >>> slider_scale(Tunable("smc.c", 0.4, low=0.0, high=1.0))
    {'start': 0.0, 'end': 1.0, 'step': 0.005}
    """
    size = abs(float(tunable.value))
    low, high = tunable.low, tunable.high
    reach = REACH * size if size > 0 else 1.0
    if high - low > (WIDE * size or WIDE):
        high = min(high, reach)
        low = max(low, 0.0 if tunable.value > 0 else -reach)
    if not low < high:
        low, high = min(low, float(tunable.value)), max(low, float(tunable.value)) + 1.0
    step = _nice((high - low) / STEPS)
    if tunable.whole:
        step = max(1.0, round(step))
    return {"start": low, "end": high, "step": step}


def _nice(step: float) -> float:
    """Round a step down to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(step))
    mantissa = next(m for m in (5.0, 2.0, 1.0) if step / power >= m * (1 - 1e-9))
    return float(f"{mantissa * power:.3g}")


def from_descriptor(descriptor: Any, value: Any) -> Tunable:
    """Return a parameter from its rcl_interfaces descriptor and value."""
    low, high = -math.inf, math.inf
    for found in (*descriptor.floating_point_range, *descriptor.integer_range):
        low, high = float(found.from_value), float(found.to_value)
    _, one_of, words = descriptor.additional_constraints.partition("one of: ")
    choices = tuple(word.strip() for word in words.split(",")) if one_of else ()
    return Tunable(descriptor.name, value, descriptor.description, low, high, choices, descriptor.read_only)


def coerced(tunable: Tunable, value: Any) -> Any:
    """Return a value of a widget in the type of the parameter."""
    if isinstance(tunable.value, bool):
        return bool(value)
    if tunable.whole:
        return round(value)
    return float(value) if isinstance(tunable.value, float) else value


NODES = ("controller", "plant")
TRIGGERS = ("step", "stop", "gust", "delay_jump")
SWITCHES = ("pause", "emergency_brake")
"""Services of the plant without and with an argument; those of the controller are the requests to the ATO."""

Answer = Callable[[bool, str], None]
"""Callback for success and message of a node."""


class Controls:
    """Parameters and services of ``controller`` and ``plant`` in the namespace of a node.

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
        """Parameters of both nodes have arrived; a program in place of a node may have none."""
        return all(found or self.outside(name) for name, found in self.tunables.items())

    def outside(self, name: str) -> str:
        """Return the name of the program in place of a node, "" without one."""
        return in_place_of(self._node, name)

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
        space, _, name = event.node.rpartition("/")
        other = self.over or space != self._node.get_namespace().rstrip("/")
        known = {} if other else self.tunables.get(name, {})
        for parameter in event.changed_parameters:
            if parameter.name in known:
                self._follow(name, parameter.name, parameter_value_to_python(parameter.value))

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
                answer(False, self._reason("controller" if service in REQUESTS else "plant"))
                return
            message = Trigger.Request() if data is None else SetBool.Request(data=data)
            client.call_async(message).add_done_callback(lambda future: done(future.result()))

        def done(response: Any) -> None:
            answer(bool(response.success), str(response.message))

        self.submit(request)

    def _reason(self, name: str) -> str:
        if self.over:
            return "the run has ended; restart the view"
        if program := self.outside(name):
            return f"the {name} is the program {program}, which has no such service"
        return f"no response from the {name}; the run may have ended"

    def value(self, node: str, name: str, default: Any = None) -> Any:
        """Return the present value of a parameter."""
        found = self.tunables[node].get(name)
        return default if found is None else found.value
