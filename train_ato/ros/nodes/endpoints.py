"""What every node of the graph is made of: endpoints from the topic table, bytes in, bytes out, failures by name."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import Any

from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from train_ato.failure import Watch
from train_ato.topics import BY_NAME, Rate, Role, Topic, published_by
from train_ato.wire import Wire

ROLES = (Role.PLANT, Role.PROFILE, Role.OBSERVER, Role.CONTROLLER, Role.RECORDER)
COMMAND_DEPTH = 10
"""Queue of a reader of commands: more than a few can never be under way in lockstep."""


def quality_of_service(topic: Topic, depth: int | None = None) -> Any:
    """Return the quality of service of a topic, the same on both ends: reliable, latched topics transient local."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=topic.depth if depth is None else depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
    )


def message_class(type_name: str) -> Any:
    """Return the message class of ``package/msg/Type``."""
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def _never(data: bytes) -> None:
    raise AssertionError("a node that takes its messages itself was given to an executor")


class Shell:
    """One node: its publishers, its subscriptions, what it published.

    Parameters
    ----------
    role
        Which node it is; its name and its endpoints follow from it.
    wire
        Encoder and decoder of the run's messages.
    context
        rclpy context of the process.
    watch
        Takes failures of callbacks.
    roles
        Nodes of the graph; :meth:`missing` waits for them.

    Attributes
    ----------
    published : dict
        Number of messages sent per topic.
    last_stamp : int
        Latest stamp answered on a topic of every tick [ns], -1 before the first.
    """

    def __init__(
        self,
        role: Role,
        wire: Wire,
        context: Context,
        watch: Watch,
        roles: Collection[Role] = ROLES,
        arguments: list[str] | None = None,
    ) -> None:
        self.role = role
        self.name = role.value
        self.wire = wire
        self.watch = watch
        self.node = Node(self.name, context=context, cli_args=arguments, enable_rosout=False, use_global_arguments=True)
        self._roles = roles
        self.last_stamp = -1
        self.published: dict[str, int] = {}
        self._publishers: dict[str, Any] = {}
        self._senders: dict[str, Callable[[bytes], None]] = {}
        self._subscriptions: dict[str, Any] = {}
        self._ticking = {name for name, topic in BY_NAME.items() if topic.rate is Rate.TICK}
        for topic in published_by(role):
            if wire.shape.has(topic):
                self._publishers[topic.name] = self.node.create_publisher(
                    message_class(topic.type), topic.name, quality_of_service(topic)
                )
                self._senders[topic.name] = self._publishers[topic.name].handle.publish_raw
                self.published[topic.name] = 0

    def publish(self, topic: str, message: Any) -> None:
        """Encode a message and send it.

        Raises
        ------
        ValueError
            If the message holds what must not go out: a force that is not finite, a wrong number of values.
        """
        self._senders[topic](self.wire.encode(topic, message))
        self.published[topic] += 1
        if topic in self._ticking:
            self.last_stamp = message.stamp

    def publish_all(self, messages: list[tuple[str, Any]]) -> None:
        """Send messages in their order."""
        for topic, message in messages:
            self.publish(topic, message)

    def subscribe(self, handlers: Mapping[str, Callable[[Any], None]]) -> None:
        """Subscribe to topics; a handler gets the decoded message."""
        decode = self.wire.decode
        for name, handler in handlers.items():
            topic = BY_NAME[name]
            if self.wire.shape.has(topic):
                sender = "/".join(role.value for role in topic.publishers)

                def receive(
                    data: bytes, name: str = name, handler: Callable[[Any], None] = handler, sender: str = sender
                ) -> None:
                    try:
                        message = decode(name, data)
                    except ValueError as error:
                        raise ValueError(f"{error}; sent by {sender}") from error
                    handler(message)

                self.subscribe_raw(name, receive)

    def subscribe_raw(self, name: str, receive: Callable[[bytes], None]) -> None:
        """Subscribe to the bytes of a topic; an exception in the callback ends the run with the node's name."""
        watch, node = self.watch, self.name
        topic = BY_NAME[name]

        def guarded(data: bytes) -> None:
            if watch.failure is None:
                try:
                    receive(data)
                except Exception as error:
                    watch.fail(node, error)

        depth = COMMAND_DEPTH if name == "ato/command" and self.role is Role.PLANT else None
        self._subscriptions[name] = self.node.create_subscription(
            message_class(topic.type), name, guarded, quality_of_service(topic, depth), raw=True
        )

    def taker(self, name: str) -> Callable[[], Any]:
        """Subscribe to the bytes of a topic without callbacks.

        Returns
        -------
        callable
            Takes the next message out of the queue, as (bytes, dictionary of times), or returns None. The node must
            not be given to an executor.
        """
        topic = BY_NAME[name]
        kind = message_class(topic.type)
        subscription = self.node.create_subscription(kind, name, _never, quality_of_service(topic), raw=True)
        self._subscriptions[name] = subscription
        return partial(subscription.handle.take_message, kind, True)

    def guard(self, action: Callable[[], None]) -> None:
        """Run something outside a callback with the same treatment of failures."""
        try:
            action()
        except Exception as error:
            self.watch.fail(self.name, error)

    def missing(self, besides: Collection[Role] = ()) -> list[str]:
        """Name the endpoints of other nodes that this node has not met yet, those of further roles included."""
        roles = {*self._roles, *besides}
        absent = []
        for name, publisher in self._publishers.items():
            topic = BY_NAME[name]
            readers = [role for role in topic.readers if role in roles]
            if topic.recorded and Role.RECORDER in roles:
                readers.append(Role.RECORDER)
            if publisher.get_subscription_count() < len(readers):
                absent.append(f"a reader of {name} ({', '.join(role.value for role in readers)})")
        for name, subscription in self._subscriptions.items():
            senders = [role for role in BY_NAME[name].publishers if role in roles]
            if subscription.get_publisher_count() < len(senders):
                absent.append(f"a publisher of {name} ({', '.join(role.value for role in senders)})")
        return absent

    @property
    def subscribed(self) -> tuple[str, ...]:
        """Topics that this node reads."""
        return tuple(self._subscriptions)

    def deliver(self, limit: float) -> None:
        """Wait until every reader has what was published, at most so long [s]; then the node can leave."""
        last = time.monotonic() + limit
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, last - time.monotonic())))

    def senders(self, name: str) -> int:
        """Return how many publishers of a topic this node has met."""
        return int(self._subscriptions[name].get_publisher_count())

    def destroy(self) -> None:
        """Release the node."""
        self.node.destroy_node()
