"""Publishers and subscriptions of a node from the topic table, for CDR bytes; failures name the node."""

import importlib
import os
import sys
import time
import warnings
from collections.abc import Callable, Collection, Mapping
from functools import partial
from typing import Any

from rcl_interfaces.msg import Log as LogMessage
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from train_ato.messages.codec import Wire, stamp_of
from train_ato.messages.topic import TrainLayout
from train_ato.messages.topics import BY_NAME, END_TOPIC, EPOCH_NS, Rate, Role, Topic, published_by
from train_ato.messages.types import Diagnostic
from train_ato.program.errors import FirstFailure, NodeFault
from train_ato.ros.nodes.parameter_services import ParameterServices
from train_ato.ros.nodes.publishers import NamedSenders, OnePublisher

ROLES = (Role.PLANT, Role.SUPERVISOR, Role.PROFILE, Role.OBSERVER, Role.CONTROLLER, Role.RECORDER)
"""Nodes of a graph, a supervisor only in a supervised run (:func:`roles_of`)."""
ROSOUT = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Quality of service of the lines on ``/rosout``."""
SETTLING_S = 1.0
"""Wall time without a new connection before the start of a run with a program in place of a node [s].

The topics that the program reads are unknown. A reader that comes later gets the first message again; without lockstep
the run does not wait for it.
"""
REPEAT_S = 0.1
"""Wall time between two looks for readers that came after the first message [s]."""
COMMAND_DEPTH = 10
"""Queue length of the plant for commands; in lockstep only a few are in flight."""


def roles_of(layout: TrainLayout) -> tuple[Role, ...]:
    """Return the nodes of a run."""
    return tuple(role for role in ROLES if layout.supervised or role is not Role.SUPERVISOR)


def quality_of_service(topic: Topic, depth: int | None = None) -> Any:
    """Return the quality of service of a topic for both ends: reliable, transient local for latched topics."""
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


def placed(node: Any, name: str) -> str:
    """Return the name of a topic in the namespace of a node, also of an absolute one: each train has its own.

    Without a namespace ``/clock``, ``/diagnostics`` and ``/tf`` have the names that tools expect.
    """
    return name if node.get_namespace() == "/" else name.removeprefix("/")


def _never(data: bytes) -> None:
    raise AssertionError("a node that polls its messages was added to an executor")


def _of_ticks(handler: Callable[[Any], None], tick_ns: int) -> Callable[[Any], None]:
    """Return a handler of measurements that raises :class:`NodeFault` for a plant with another tick [ns]."""
    last = -1

    def receive(measurement: Any) -> None:
        nonlocal last
        stamp, due = measurement.stamp, last + tick_ns if last >= 0 else 0
        if stamp < 0 or stamp % tick_ns or (last == 0 and stamp > due):
            came = "stamped 0" if stamp == -EPOCH_NS else f"for {stamp * 1e-9:.3f} s"
            first = f", the first stamp {EPOCH_NS // 10**9} s (2026-01-01)" if stamp < 0 else ""
            reason = f"measurement {came} came, {due * 1e-9:.3f} s was due: the tick of the scenario is"
            raise NodeFault(Role.PLANT.value, f"{reason} {tick_ns * 1e-9:g} s{first}")
        last = stamp
        handler(measurement)

    return receive


class NodeEndpoints:
    """Node with its publishers, subscriptions and message counts.

    Parameters
    ----------
    role
        Role in the topic table; defines name and topics of the node.
    wire
        Encoder and decoder of the run's messages.
    context
        rclpy context of the process.
    watch
        Receiver of failures of callbacks.
    roles
        Nodes of the graph; :meth:`missing` waits for them.
    external
        Node of the graph in whose place another program runs. It needs only the publishers that others wait for.

    Attributes
    ----------
    published : dict
        Number of messages sent per topic.
    last_stamp : int
        Latest stamp answered on a topic of every tick [ns], -1 before the first.
    joining : bool
        True: the node joins a run in progress; it handles messages, but sends none.
    handled : int
        Number of messages handled while joining.
    on_second_publisher : callable
        Called with a topic and the reason after the appearance of a second publisher; False fails the run.
    awaited : callable
        Returns the topic for which the node waits, "" for none.
    ignored : callable
        Returns the number of messages that the node has read and not used; the first of each topic is named.
    lacking : callable
        Returns further missing conditions for the start.
    on_note : callable
        Receiver of the lines of :meth:`note`.
    """

    def __init__(
        self,
        role: Role,
        wire: Wire,
        context: Context,
        watch: FirstFailure,
        roles: Collection[Role] = ROLES,
        arguments: list[str] | None = None,
        external: Role | None = None,
    ) -> None:
        # rclpy warns of an answer to a client that is not discovered yet, or gone; the client repeats or names it.
        warnings.filterwarnings("ignore", "failed to send response", RuntimeWarning)
        self.role, self.name, self.external = role, role.value, external
        self.wire, self.watch = wire, watch
        self.node = Node(
            self.name,
            context=context,
            cli_args=arguments,
            enable_rosout=False,
            use_global_arguments=True,
            start_parameter_services=False,
        )
        # A refused parameter leaves the node in a reference cycle; without this it would publish into the next run.
        context.on_shutdown(self.node.destroy_node)
        self.parameter_services = ParameterServices(self.node, watch)
        self._roles = [role for role in roles if role in roles_of(wire.layout) and role is not external]
        self.last_stamp = -1
        self.on_second_publisher: Callable[[str, str], bool] = lambda topic, reason: False
        self.awaited: Callable[[], str] = lambda: ""
        self.ignored: Callable[[], int] = lambda: 0
        self.lacking: Callable[[], list[str]] = list
        self.on_note: Callable[[str], Any] = lambda text: sys.stderr.write(f"{text}\n")
        self._ignored, self._unused = 0, set[str]()
        self._planned_end: tuple[int, int] | None = None
        self._connected: tuple[tuple[int, ...], float] = (), 0.0
        self.published: dict[str, int] = {}
        self._publishers: dict[str, Any] = {}
        self._senders: dict[str, Callable[[bytes], None]] = {}
        self._subscriptions: dict[str, Any] = {}
        self._sources: dict[str, OnePublisher] = {}
        self._shared: NamedSenders | None = None
        self._ticking = {name for name, topic in BY_NAME.items() if topic.rate in (Rate.TICK, Rate.SUPERVISION)}
        self._first_sent: dict[str, tuple[bytes, int]] = {}
        self._first_read: dict[str, bytes] = {}
        self._repeatable = set(self._ticking)
        if external is None and role is Role.PLANT:
            self._repeatable.clear()
        if external is not None:
            self.node.create_timer(REPEAT_S, self._repeat_first, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._advertise()
        self._log = self.node.create_publisher(LogMessage, "/rosout", ROSOUT)
        self.joining, self.handled = False, 0
        self._end: Diagnostic | None = None
        self._take_end: Callable[[], Any] | None = None
        if role is Role.RECORDER:
            self._take_end, _ = self.taker(END_TOPIC)
        elif role in BY_NAME[END_TOPIC].readers:
            self.subscribe({END_TOPIC: self._on_end})

    def _advertise(self) -> None:
        """Create the publishers of the role."""
        for topic in published_by(self.role):
            if topic.exists(self.wire.layout):
                self._publishers[topic.name] = self.node.create_publisher(
                    message_class(topic.type), placed(self.node, topic.name), quality_of_service(topic)
                )
                self._senders[topic.name] = self._publishers[topic.name].handle.publish_raw
                self.published[topic.name] = 0

    def _on_end(self, notice: Diagnostic) -> None:
        self._end = notice

    @property
    def end(self) -> Diagnostic | None:
        """End notice of the plant, None before it; a plant that has left without it has failed."""
        if self._take_end is not None and (found := self._take_end()) is not None:
            self._end = self.wire.decode(END_TOPIC, found[0])
        return self._end

    @property
    def begun(self) -> bool:
        """True after the first message of a tick, sent or received."""
        ticking = (source.begun for name, source in self._sources.items() if name in self._ticking)
        return self.last_stamp >= 0 or any(ticking)

    @property
    def ended(self) -> bool:
        """True after the end notice, sent or received, or a failure."""
        return bool(self.watch.failure or self.published.get(END_TOPIC) or self.end is not None)

    def end_process_at(self, stamp: int, signal_number: int) -> None:
        """Send a signal to this process in place of the first message from a stamp [ns] on: a fault of the node."""
        self._planned_end = stamp, signal_number

    def publish(self, *messages: tuple[str, Any]) -> None:
        """Encode messages with their topics and send them in their order.

        Raises
        ------
        ValueError
            For a value that is not finite or a wrong number of values.
        """
        encoders, senders, ticking = self.wire.encoders, self._senders, self._ticking
        known, fixed = self.wire.known, self.wire.records
        for topic, message in messages:
            if self._planned_end is not None and message.stamp >= self._planned_end[0]:
                os.kill(os.getpid(), self._planned_end[1])
            if self.joining:
                return
            data = encoders[topic](message)
            if topic in fixed:
                known[topic] = data, message
            if self.external is not None and topic in ticking and message.stamp == 0:
                self._first_sent[topic] = data, self.readers(topic)
            senders[topic](data)
            self.published[topic] += 1
            if topic in ticking:
                self.last_stamp = message.stamp

    def repeat(self, topic: str, message: Any) -> None:
        """Send a message again, which the recorder does not record."""
        self._senders[topic](self.wire.encode(topic, message))

    def _repeat_first(self) -> None:
        """Send the message of stamp 0 again if a reader has come after it, as long as no later one is sent.

        A program in place of a node may make its readers in any order; it has not answered without the message.
        """
        for topic, (data, met) in self._first_sent.items() if self.last_stamp == 0 else ():
            if (found := self.readers(topic)) != met:
                self._first_sent[topic] = data, found
                if found > met:
                    self._senders[topic](data)

    def is_repeated(self, name: str, data: bytes) -> bool:
        """Return True for the first message of a topic of ticks that its node sends again, for another reader.

        A program in place of a node that reads such a message twice sends its answer to it twice.
        """
        if name not in self._repeatable:
            return False
        if name not in self._first_read and self.sent_outside(name) and stamp_of(data):
            self._repeatable.discard(name)  # a command without a stamp, or of a later tick
            return False
        first = self._first_read.setdefault(name, data)
        if first != data:
            self._repeatable.discard(name)  # it is sent again before the second message only
        return first is not data and first == data

    def subscribe(self, handlers: Mapping[str, Callable[[Any], None]], tick_ns: int = 0, at: str | None = None) -> None:
        """Subscribe to topics with a handler for decoded messages each.

        ``tick_ns`` is the tick of a measurement, ``at`` the name of the topic of another train.
        """
        for name, handler in handlers.items():
            if BY_NAME[name].exists(self.wire.layout):
                ticked = tick_ns and name == "train/measurement"
                handler = _of_ticks(handler, tick_ns) if ticked else handler
                self.subscribe_raw(name, handler, at, self.wire.decode_shared)

    def subscribe_raw(
        self,
        name: str,
        handler: Callable[[Any], None],
        at: str | None = None,
        decode: Callable[[str, bytes], Any] = lambda name, data: data,
    ) -> None:
        """Subscribe to a topic with one publisher, without ``decode`` to its bytes; ``at`` as in :meth:`subscribe`.

        An exception in the callback and a second publisher fail the run with the name of the node.
        """
        watch, node, topic = self.watch, self.name, BY_NAME[name]
        source = self._sources[name] = OnePublisher(self.node, topic)

        def guarded(data: bytes) -> None:
            if watch.failure is None:
                self.handled += self.joining
                try:
                    if not source.begun:
                        source.begin()
                    if name in self._repeatable and self.is_repeated(name, data):
                        return
                    try:
                        message = decode(name, data)
                    except ValueError as error:
                        source.check()
                        sender = source.name or "/".join(role.value for role in topic.publishers)
                        raise ValueError(f"{error}; sent by {sender}") from error
                    handler(message)
                    if (ignored := self.ignored()) != self._ignored:
                        self._ignored = ignored
                        self.name_unused(name, message.stamp)
                except (Exception, SystemExit) as error:
                    watch.fail(node, error)

        def matched(event: Any) -> None:
            try:
                source.changed(event)
            except ValueError as error:
                if not self.on_second_publisher(name, str(error)):
                    watch.fail(node, error)

        depth = COMMAND_DEPTH if name == "ato/command" and self.role is Role.PLANT else None
        self._subscriptions[name] = self.node.create_subscription(
            message_class(topic.type),
            at or placed(self.node, name),
            guarded,
            quality_of_service(topic, depth),
            event_callbacks=SubscriptionEventCallbacks(matched=matched),
            raw=True,
        )
        source.attach(self._subscriptions[name])

    def name_unused(self, name: str, stamp: int) -> None:
        """Name the first message of a topic that the node does not use, with the remedy."""
        if name not in self._unused:
            self._unused.add(name)
            said = f"{name} stamped {stamp * 1e-9:.3f} s came twice, or its step is over or not due"
            self.note(f"node {self.name}: {said}; send it once for each step, with the stamp of the step")

    def serve(self, kind: Any, name: str, answer: Callable[[Any, Any], Any]) -> Any:
        """Offer a service and return it; an exception in ``answer`` fails the run with the name of the node."""

        def guarded(request: Any, response: Any) -> Any:
            try:
                return answer(request, response)
            except (Exception, SystemExit) as error:
                self.watch.fail(self.name, error)
                return response

        return self.node.create_service(kind, name, guarded)

    def taker(self, name: str) -> tuple[Callable[[], Any], OnePublisher]:
        """Subscribe to the bytes of a topic with one publisher for polling, without callbacks.

        Returns
        -------
        take : callable
            Returns the next message of the queue as (bytes, dictionary of times), or None. The node must not be added
            to an executor.
        source : OnePublisher
            Publisher of the topic.
        """
        take = self._polled(name)
        source = self._sources[name] = OnePublisher(self.node, BY_NAME[name])
        source.attach(self._subscriptions[name])
        return take, source

    def shared_taker(self, name: str) -> tuple[Callable[[], Any], NamedSenders]:
        """Subscribe as :meth:`taker` to a topic of several nodes; return the publishers in place of one."""
        take = self._polled(name)
        self._shared = NamedSenders(self.node, BY_NAME[name], self._subscriptions[name])
        return take, self._shared

    def _polled(self, name: str) -> Callable[[], Any]:
        topic = BY_NAME[name]
        kind = message_class(topic.type)
        subscription = self.node.create_subscription(
            kind, placed(self.node, name), _never, quality_of_service(topic), raw=True
        )
        self._subscriptions[name] = subscription
        return partial(subscription.handle.take_message, kind, True)

    def answer_requests(self) -> None:
        """Answer the waiting requests of every service of a node that is in no executor."""
        for service in self.node.services:
            with service.handle:
                request, header = service.handle.service_take_request(service.srv_type.Request)
            if header is not None:
                service.send_response(service.callback(request, service.srv_type.Response()), header)

    def guard(self, action: Callable[[], None]) -> None:
        """Run an action outside of callbacks; an exception fails the run as in callbacks."""
        try:
            action()
        except (Exception, SystemExit) as error:
            self.watch.fail(self.name, error)

    def missing(self, besides: Collection[Role] = ()) -> list[str]:
        """Return the missing conditions for the start: endpoints of other nodes; requests to stop a second publisher.

        Parameters
        ----------
        besides
            Roles with required endpoints, added to those of the graph.
        """
        roles = {*self._roles, *besides}
        lacking: list[tuple[str, list[Role]]] = []
        for name, publisher in self._publishers.items():
            topic = BY_NAME[name]
            if not topic.awaited:
                continue
            readers = [role for role in topic.readers if role in roles]
            if topic.recorded and Role.RECORDER in roles:
                readers.append(Role.RECORDER)
            if publisher.get_subscription_count() < len(readers):
                lacking.append((f"a reader of {name}", readers))
        for name, subscription in self._subscriptions.items():
            topic = BY_NAME[name]
            needed = roles if topic.optional or self.external is None else {*roles, self.external}
            senders = [role for role in topic.publishers if role in needed and topic.awaited]
            if len(BY_NAME[name].publishers) > 1:  # a program in place of a node may send no diagnostics
                continue
            if subscription.get_publisher_count() < len(senders):
                lacking.append((f"a publisher of {name}", senders))
        own, space = self.node.get_name(), self.node.get_namespace()
        names = [name for name, other in self.node.get_node_names_and_namespaces() if other == space]
        named = {role for _, peers in lacking for role in peers} - {self.external}  # a program may have any name
        away = [role for role in Role if role in named and role.value not in names]
        absent = [f"node {role.value}" for role in away]
        for what, peers in lacking:  # the topics of a node that is not there say no more than its name
            if not set(peers) & set(away):
                absent.append(f"{what} ({', '.join(role.value for role in peers)})")
        absent += filter(None, (source.second() for source in self._sources.values()))
        absent += self.lacking()
        if names.count(own) > 1:
            absent.append(f"the end of a second node {self.name}")
        if not absent and self.external is not None and self._settling():
            absent.append(f"{SETTLING_S:g} s without a new reader in node {self.external.value}")
        if not absent:
            for source in self._sources.values():
                source.pin()
        return absent

    def _settling(self) -> bool:
        """Return True if the numbers of connections have changed in the last :data:`SETTLING_S`."""
        connected = self.connections()
        if connected != self._connected[0]:
            self._connected = connected, time.monotonic()
        return time.monotonic() - self._connected[1] < SETTLING_S

    def left(self, role: Role) -> bool:
        """Return True if no publisher of a node is left on the topics that only this node sends."""
        return not any(self.senders(name) for name in self._sources if BY_NAME[name].publishers == (role,))

    @property
    def publisher_names(self) -> dict[str, str]:
        """Names of the nodes that publish, by node of the graph."""
        return {BY_NAME[name].publishers[0].value: source.name for name, source in self._sources.items() if source.name}

    @property
    def external_name(self) -> str:
        """Name of the program in place of a node; the name of the node until it is known; "" without a program."""
        return "" if self.external is None else self.publisher_names.get(self.external.value, self.external.value)

    @property
    def external_left(self) -> bool:
        """True if the external node has sent messages to this node, and has left."""
        begun = [name for name, source in self._sources.items() if self.sent_outside(name) and source.begun]
        return bool(begun) and not any(map(self.senders, begun))

    def renew(self, role: Role) -> None:
        """Accept a new publisher on every topic of a node, after the old one has left."""
        for name, source in self._sources.items():
            if BY_NAME[name].publishers == (role,):
                source.renew()
        if self._shared is not None:
            self._shared.renew(role)

    @property
    def subscribed(self) -> tuple[str, ...]:
        """Names of the subscribed topics."""
        return tuple(self._subscriptions)

    def log(self, text: str, level: int = LogMessage.ERROR) -> None:
        """Publish a line of standard error on ``/rosout``, which other hosts read."""
        stamp = self.node.get_clock().now().to_msg()
        self._log.publish(LogMessage(stamp=stamp, level=level, name=self.name, msg=text))

    def note(self, text: str) -> None:
        """Write a line for the user during the run: on standard error, or as :attr:`on_note`, and on ``/rosout``."""
        self.log(text, LogMessage.WARN)
        self.on_note(text)

    def deliver(self, limit: float) -> None:
        """Wait until every reader has received the published messages, at most ``limit`` [s]."""
        last = time.monotonic() + limit
        for publisher in (*self._publishers.values(), self._log):
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, last - time.monotonic())))

    def connections(self) -> tuple[int, ...]:
        """Return the number of readers of every publisher, and of publishers of every subscription."""
        readers = (publisher.get_subscription_count() for publisher in self._publishers.values())
        return (*readers, *(subscription.get_publisher_count() for subscription in self._subscriptions.values()))

    def sent_outside(self, name: str) -> bool:
        """Return True if a program in place of a node publishes a topic, alone or among others."""
        return self.external in BY_NAME[name].publishers

    def left_out(self, name: str) -> bool:
        """Return True if the program in place of its node does not publish an optional topic."""
        return self.sent_outside(name) and BY_NAME[name].optional and not self.senders(name)

    def readers(self, name: str) -> int:
        """Return the number of discovered readers of an own topic."""
        return int(self._publishers[name].get_subscription_count())

    def senders(self, name: str) -> int:
        """Return the number of discovered publishers of a topic."""
        return int(self._subscriptions[name].get_publisher_count())

    def destroy(self) -> None:
        """Release the node."""
        self.node.destroy_node()
