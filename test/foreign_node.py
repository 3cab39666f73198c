"""ROS node outside of the run, on the domain of the run."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from typing import Any

from waiting import LIMIT_S

from train_ato.messages.topics import BY_NAME


class ForeignNode:
    """A plain rclpy node of a domain with a context of its own; its DDS settings are those of the environment."""

    def __init__(self, domain: int, name: str = "intruder") -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node

        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node(name, context=self.context, enable_rosout=False, start_parameter_services=False)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._publishers: dict[str, Any] = {}

    def close(self) -> None:
        """Leave the domain."""
        self._executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def __enter__(self) -> ForeignNode:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def until(self, condition: Callable[[], Any], limit: float = LIMIT_S) -> None:
        """Run callbacks until a condition holds."""
        last = time.monotonic() + limit
        while not condition():
            assert time.monotonic() < last, "did not happen in time"
            self._executor.spin_once(timeout_sec=0.02)

    def publisher(self, topic: str) -> Any:
        """Return a publisher of a topic of the table."""
        from train_ato.ros.nodes.endpoints import quality_of_service

        if topic not in self._publishers:
            package, _, kind = BY_NAME[topic].type.split("/")
            message = getattr(importlib.import_module(f"{package}.msg"), kind)
            self._publishers[topic] = self.node.create_publisher(message, topic, quality_of_service(BY_NAME[topic]))
        return self._publishers[topic]

    def publish(self, topic: str, message: Any) -> None:
        """Send a message, or bytes as they are, once a node of the run reads the topic."""
        publisher = self.publisher(topic)
        self.until(publisher.get_subscription_count)
        publisher.publish(message)

    def settle(self, seconds: float = 0.5) -> None:
        """Run callbacks for a time [s], so that messages in flight arrive."""
        last = time.monotonic() + seconds
        while time.monotonic() < last:
            self._executor.spin_once(timeout_sec=0.02)

    def call(self, kind: Any, service: str, request: Any, limit: float = LIMIT_S) -> Any:
        """Return the answer of a service."""
        client = self.node.create_client(kind, service)
        self.until(client.service_is_ready, limit)
        future = client.call_async(request)
        self.until(future.done, limit)
        return future.result()
