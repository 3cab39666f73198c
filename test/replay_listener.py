"""A replay in a thread, and a real node that listens to it and gives it orders."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from train_ato.replay.options import ReplayOptions
from train_ato.replay.player import NODE
from train_ato.replay.publishing import Replayed, replay

LIMIT_S = 120.0
"""After so long a condition counts as not coming."""


class Listener:
    """A node with its own executor; it keeps the bytes of some topics, every message of them."""

    def __init__(self, context, executor, topics):
        from rclpy.node import Node

        self.executor = executor
        self.node = Node("listener", context=context, enable_rosout=False)
        self.heard = {}
        self.came_at = {}
        for name, source in topics.items():
            self.listen(name, source)
        executor.add_node(self.node)
        self._clients = {}

    def listen(self, name, source):
        """Subscribe to a topic that is published like one of the topic table."""
        from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

        from train_ato.nodes.shell import message_class
        from train_ato.topics import BY_NAME

        topic = BY_NAME[source]
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_ALL,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
        )

        self.heard[name], self.came_at[name] = [], []

        def receive(data):
            self.heard[name].append(data)
            self.came_at[name].append(time.monotonic())

        self.node.create_subscription(message_class(topic.type), name, receive, qos, raw=True)

    def until(self, condition, what):
        """Turn until a condition holds."""
        last = time.monotonic() + LIMIT_S
        while not condition():
            assert time.monotonic() < last, f"{what} did not come in {LIMIT_S} s"
            self.executor.spin_once(timeout_sec=0.01)

    def hear(self, name, count):
        """Turn until so many messages of a topic have come, and return all of it."""
        self.until(lambda: len(self.heard[name]) >= count, f"message {count} of {name}")
        return self.heard[name]

    def stay(self, seconds=0.3):
        """Turn for a while, so that what is on its way arrives."""
        last = time.monotonic() + seconds
        while time.monotonic() < last:
            self.executor.spin_once(timeout_sec=0.01)

    def answer(self, kind, service, request):
        """Call a service and return its response."""
        client = self._clients.setdefault(service, self.node.create_client(kind, service))
        self.until(client.service_is_ready, f"service {service}")
        future = client.call_async(request)
        self.until(future.done, f"an answer of {service}")
        return future.result()

    def call(self, service):
        """Call one of the services without a request."""
        from std_srvs.srv import Trigger

        return self.answer(Trigger, f"/{NODE}/{service}", Trigger.Request())

    def set(self, name, value):
        """Set a parameter of the replay; return the reason of a refusal."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        (result,) = self.answer(SetParameters, f"/{NODE}/set_parameters", request).results
        return None if result.successful else result.reason


class Replaying:
    """A replay in a thread of its own; at the end of the block it is stopped and its outcome looked at."""

    def __init__(self, run: Path, options: ReplayOptions, domain: int, listener: Listener) -> None:
        self._thread = threading.Thread(target=self._run, args=(run, options, domain), daemon=True)
        self._listener = listener
        self.states = []
        self.outcome: Replayed | None = None
        self.error: Exception | None = None

    def _run(self, run, options, domain):
        try:
            self.outcome = replay(run, options, domain=domain, progress=self.states.append)
        except Exception as error:
            self.error = error

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, kind, value, trace):
        if kind is not None and self._thread.is_alive():
            self._listener.call("stop")
        self.wait()
        if kind is None and self.error is not None:
            raise self.error

    def wait(self):
        """Turn until the replay is over."""
        self._listener.until(lambda: not self._thread.is_alive(), "the end of the replay")
        self._thread.join()
