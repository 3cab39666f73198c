"""Node of a replay: publishers with the recorded quality of service, and waits for their readers."""

import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from train_ato.log.mcap_records import RawMessage
from train_ato.playback.log import CLOCK, LogTopic

NODE = "rosbag2_player"
"""Name of the node, that of ``ros2 bag play``, so that scripts find the same services."""
_QUEUE = 1000
"""Least depth of the queue of a topic that is not latched; unconfirmed messages stay in it."""
_MOST_BYTES = 16 * 2**20
"""Number of bytes on a topic after which the confirmation of the readers is awaited."""
_SLICE_S = 0.02
_STALL_S = 30.0
"""Longest wait for the confirmation of a reader; a killed reader is removed earlier."""
_QUIET_S = 0.5
"""Time without a new reader after which all existing readers count as matched."""
_DISCOVERY_PORT, _PORTS_OF_DOMAIN = 7410, 250
"""Discovery port of the first participant of domain 0, every other one 2 higher; ports per domain (RTPS 2.5, 9.6.2)."""
REPLAY_PROFILE = "fastdds_replay.xml"
"""Profile of Fast DDS with frequent requests for the confirmation of the readers.

The default period is 3 s, for which a replay at full speed would wait.
"""


class Sender:
    """Publisher with the count of its unconfirmed messages."""

    def __init__(self, topic: LogTopic, publisher: Any, depth: int) -> None:
        self.topic = topic
        self.publisher = publisher
        self.send: Callable[[bytes], None] = publisher.handle.publish_raw
        self.window = max(1, depth // 2)
        self.count = self.messages = self.bytes = 0
        self.waited_for = True

    def full(self) -> bool:
        """Return True if the readers must confirm before the next message."""
        return self.waited_for and (self.messages >= self.window or self.bytes >= _MOST_BYTES)

    def acknowledged(self, seconds: float) -> bool:
        """Return True if the readers confirm all messages within a time [s]."""
        from rclpy.duration import Duration

        if self.publisher.wait_for_all_acked(Duration(nanoseconds=max(0, round(seconds * 1e9)))):
            self.messages = self.bytes = 0
            return True
        return False


class Player:
    """Publishers of a replay.

    Parameters
    ----------
    executor, context
        Executor and context of the process.
    topics
        Published topics, by their name in the log.
    clock_hz
        Rate of the generated ``/clock`` [1/s of wall time]; None: no generated clock.

    Raises
    ------
    ValueError
        If a message type is not installed or not of ROS 2, or a topic name is invalid.
    """

    def __init__(self, executor: Any, context: Any, topics: Mapping[str, LogTopic], clock_hz: float | None) -> None:
        from rclpy.node import Node

        self.node = Node(NODE, context=context, enable_rosout=False)
        executor.add_node(self.node)
        self._executor = executor
        self._senders = {name: self._sender(topic) for name, topic in topics.items()}
        self._full: Sender | None = None
        self._full_since = 0.0
        self._period = 1 / clock_hz if clock_hz is not None else None
        self._clock = self._sender(_clock_topic()) if clock_hz is not None else None
        self._next_clock = time.monotonic()

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages sent, by the name in the log."""
        return {name: sender.count for name, sender in self._senders.items()}

    def _sender(self, topic: LogTopic) -> Sender:
        from rclpy.exceptions import NameValidationException
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        durability = DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE
        depth = topic.depth if topic.latched else max(topic.depth, _QUEUE)
        qos = QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
        try:
            return Sender(topic, self.node.create_publisher(_class_of(topic), topic.published_as, qos), depth)
        except NameValidationException as error:
            reason = str(error).splitlines()[0]
            raise ValueError(
                f"--remap {topic.name}:={topic.published_as}: invalid topic name ({reason}); give another name"
            ) from None

    def publish(self, message: RawMessage) -> None:
        """Send the bytes of a recorded message."""
        sender = self._senders[message.channel.topic]
        sender.send(bytes(message.data))
        sender.count += 1
        sender.messages += 1
        sender.bytes += len(message.data)
        if sender.full():
            self._full, self._full_since = sender, time.monotonic()

    def ready(self) -> bool:
        """Return True if the queues have space for another message, after a short wait for the readers."""
        if self._full is None or self._full.acknowledged(_SLICE_S):
            self._full = None
            return True
        if time.monotonic() - self._full_since < _STALL_S:
            return False
        self._full.waited_for = False
        name, self._full = self._full.topic.published_as, None
        sys.stderr.write(
            f"train-ato: {name}: no confirmation by a reader within {_STALL_S:g} s; the replay continues without it\n"
        )
        return True

    def turn(self, seconds: float, moment_ns: int) -> None:
        """Process service calls for a time [s] at most; publish ``/clock`` when it is due."""
        if self._clock is not None and self._period is not None:
            now = time.monotonic()
            if now >= self._next_clock:
                self._next_clock = max(self._next_clock + self._period, now)
                self._clock.publisher.publish(_clock_message(moment_ns))
            seconds = min(seconds, max(0.0, self._next_clock - now))
        self._executor.spin_once(timeout_sec=seconds)

    def wait_for_readers(self, most_s: float, interrupted: Callable[[], bool]) -> bool:
        """Wait until the existing readers are matched; they would lose all earlier messages.

        On a loaded machine a participant of the same machine is discovered late: it has a socket before.

        Returns
        -------
        bool
            False if a participant of this machine was not discovered, or a compatible reader not matched in time.
        """
        last = time.monotonic() + most_s
        seen, quiet = None, time.monotonic()
        while not interrupted():
            self._executor.spin_once(timeout_sec=_SLICE_S)
            now = time.monotonic()
            found = self._met()
            if found != seen:
                seen, quiet = found, now
            missing = any(matched < there for there, matched in found[0]) or 0 < self._participants() < self._sockets()
            if not missing and now - quiet >= min(_QUIET_S, most_s):
                return True
            if now >= last:
                return not missing
        return True

    def _met(self) -> tuple[tuple[tuple[int, int], ...], int]:
        """Return the numbers of compatible and of matched readers of every publisher, and the number of nodes."""
        senders = [*self._senders.values(), *([self._clock] if self._clock is not None else [])]
        pairs = tuple((self._fitting(sender), sender.publisher.get_subscription_count()) for sender in senders)
        return pairs, len(self.node.get_node_names_and_namespaces())

    def _participants(self) -> int:
        """Return the number of discovered DDS participants, this one included; 0 for a middleware without the topic."""
        return len(self.node.get_publishers_info_by_topic("ros_discovery_info", no_mangle=True))

    def _sockets(self) -> int:
        """Return the number of DDS participants with a discovery socket in this network namespace."""
        first = _DISCOVERY_PORT + _PORTS_OF_DOMAIN * int(self.node.context.get_domain_id())
        ports = set()
        for table in ("/proc/self/net/udp", "/proc/self/net/udp6"):
            with suppress(OSError):
                for line in Path(table).read_text(encoding="ascii").splitlines()[1:]:
                    ports.add(int(line.split()[1].rpartition(":")[2], 16))
        return sum(first <= port < first + _PORTS_OF_DOMAIN - 10 and (port - first) % 2 == 0 for port in ports)

    def _fitting(self, sender: Sender) -> int:
        """Return the number of readers compatible with a publisher."""
        from rclpy.qos import QoSCompatibility, qos_check_compatible

        publisher = sender.publisher
        return sum(
            reader.topic_type == sender.topic.type
            and qos_check_compatible(publisher.qos_profile, reader.qos_profile)[0] != QoSCompatibility.ERROR
            for reader in self.node.get_subscriptions_info_by_topic(publisher.topic_name)
        )

    def others(self) -> dict[str, list[str]]:
        """Return the other publishers of the same topics, by the name of the topic in the graph."""
        from train_ato.ros.nodes.publishers import wait_for_names

        found: dict[str, list[str]] = {}
        for sender in self._senders.values():
            name = sender.publisher.topic_name
            found[name] = wait_for_names(partial(self._publishing, name))
        for sender in self._senders.values():
            found[sender.publisher.topic_name].remove(NODE)
        return {name: nodes for name, nodes in found.items() if nodes}

    def _publishing(self, name: str) -> list[str]:
        return [info.node_name for info in self.node.get_publishers_info_by_topic(name)]

    def wait_for_confirmation(self, most_s: float, interrupted: Callable[[], bool]) -> bool:
        """Wait until the readers confirm all messages; return False if they do not in time."""
        last = time.monotonic() + most_s
        for sender in self._senders.values():
            while not sender.acknowledged(min(_SLICE_S, last - time.monotonic())):
                if interrupted() or time.monotonic() >= last:
                    return False
        return True


def _class_of(topic: LogTopic) -> Any:
    """Return the message class of a topic."""
    from train_ato.ros.nodes.endpoints import message_class

    if topic.encoding != "cdr" or topic.type.count("/") != 2:
        raise ValueError(
            f"{topic.name}: messages of type '{topic.type}' in '{topic.encoding}' are not ROS 2 messages; exclude the "
            "topic with --exclude-topics"
        )
    try:
        return message_class(topic.type)
    except (ImportError, AttributeError):
        raise ValueError(
            f"{topic.name}: messages of type {topic.type} are not installed; install them, or exclude the topic "
            "with --exclude-topics"
        ) from None


def _clock_topic() -> LogTopic:
    return LogTopic(CLOCK, CLOCK, "rosgraph_msgs/msg/Clock", False, _QUEUE)


def _clock_message(moment_ns: int) -> Any:
    from rosgraph_msgs.msg import Clock

    message = Clock()
    message.clock.sec, message.clock.nanosec = divmod(moment_ns, 1_000_000_000)
    return message
