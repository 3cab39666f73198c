"""Replay in a thread, and a real node that receives its messages and calls its services."""

import threading
import time
from pathlib import Path

from waiting import wait_for

from train_ato.playback.log import ReplayOptions
from train_ato.playback.publishing import NODE, Replayed, publish_run


class Listener:
    """Node with its own executor that stores the bytes of all messages of some topics."""

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

        from train_ato.messages.topics import BY_NAME
        from train_ato.ros.nodes.endpoints import message_class

        topic = BY_NAME[source]
        kept = DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE
        qos = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE, durability=kept)
        self.heard[name], self.came_at[name] = [], []

        def receive(data):
            self.heard[name].append(data)
            self.came_at[name].append(time.monotonic())

        self.node.create_subscription(message_class(topic.type), name, receive, qos, raw=True)

    def until(self, condition, what):
        """Run callbacks until a condition holds."""
        wait_for(condition, what, lambda: self.executor.spin_once(timeout_sec=0.01))

    def hear(self, name, count):
        """Run callbacks until a number of messages of a topic has arrived; return all of them."""
        self.until(lambda: len(self.heard[name]) >= count, f"message {count} of {name}")
        return self.heard[name]

    def stay(self, seconds=0.3):
        """Run callbacks for a time [s], so that messages in flight arrive."""
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
        """Call a service without a request."""
        from std_srvs.srv import Trigger

        return self.answer(Trigger, f"/{NODE}/{service}", Trigger.Request())

    def set(self, name, value):
        """Set a parameter of the replay; return the reason of a rejection."""
        from rcl_interfaces.srv import SetParameters
        from rclpy.parameter import Parameter

        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        (result,) = self.answer(SetParameters, f"/{NODE}/set_parameters", request).results
        return None if result.successful else result.reason


class Replaying:
    """Replay in a separate thread; at the end of the block it is stopped and its result is checked."""

    def __init__(self, run: Path, options: ReplayOptions, domain: int, listener: Listener) -> None:
        self._thread = threading.Thread(target=self._run, args=(run, options, domain), daemon=True)
        self._listener = listener
        self.states = []
        self.outcome: Replayed | None = None
        self.error: Exception | None = None

    def _run(self, run, options, domain):
        try:
            self.outcome = publish_run(run, options, domain=domain, progress=self.states.append)
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
        """Run callbacks until the end of the replay."""
        self._listener.until(lambda: not self._thread.is_alive(), "the end of the replay")
        self._thread.join()
