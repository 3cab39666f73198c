"""The node of a replay: publishers as they were recorded, and readers that are waited for."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from train_ato.record.reading import RawMessage
from train_ato.replay.log import LogTopic
from train_ato.replay.options import CLOCK

NODE = "rosbag2_player"
"""Name of the node, that of ``ros2 bag play``: scripts that talk to it find the same services."""
_QUEUE = 1000
"""Least queue of a topic that is not latched; nothing that readers have not got falls out of it."""
_MOST_BYTES = 16 * 2**20
"""Readers are waited for after so many bytes on a topic, however few messages those are."""
_SLICE_S = 0.02
_STALL_S = 30.0
"""A reader that does not confirm for so long is not waited for any longer; one that was killed is forgotten before."""
_QUIET_S = 0.5
"""No reader has turned up for so long: all that were there are matched."""


def middleware_profile() -> Path:
    """Return the file that makes Fast DDS find readers quickly and ask them often what they have got.

    It is named by ``FASTRTPS_DEFAULT_PROFILES_FILE`` before the first node of a process; without it a reader is asked
    every 3 s, which a replay at full speed has to wait for.
    """
    return Path(str(files("train_ato"))) / "graph" / "fastdds_replay.xml"


class Sender:
    """A publisher and what went out on it since its readers had everything."""

    def __init__(self, topic: LogTopic, publisher: Any, depth: int) -> None:
        self.topic = topic
        self.publisher = publisher
        self.send: Callable[[bytes], None] = publisher.handle.publish_raw
        self.window = max(1, depth // 2)
        self.count = self.messages = self.bytes = 0
        self.waited_for = True

    def full(self) -> bool:
        """Tell whether the readers have to be asked before more is sent."""
        return self.waited_for and (self.messages >= self.window or self.bytes >= _MOST_BYTES)

    def acknowledged(self, seconds: float) -> bool:
        """Tell whether the readers have everything, waiting so long at most."""
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
        Of the process.
    topics
        What is published, by the name in the log.
    clock_hz
        Rate of a ``/clock`` of its own [1/s of wall time]; None: there is none.

    Raises
    ------
    ValueError
        If a message type is not installed, no ROS 2 message, or a name is no name of a topic.
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
            raise ValueError(f"--remap {topic.name}:={topic.published_as}: no name of a topic ({reason})") from None

    def publish(self, message: RawMessage) -> None:
        """Send one recorded message as it is."""
        sender = self._senders[message.channel.topic]
        sender.send(bytes(message.data))
        sender.count += 1
        sender.messages += 1
        sender.bytes += len(message.data)
        if sender.full():
            self._full, self._full_since = sender, time.monotonic()

    def ready(self) -> bool:
        """Tell whether the readers have got enough for another message to be sent; waits a little for them."""
        if self._full is None or self._full.acknowledged(_SLICE_S):
            self._full = None
            return True
        if time.monotonic() - self._full_since < _STALL_S:
            return False
        self._full.waited_for = False
        name, self._full = self._full.topic.published_as, None
        sys.stderr.write(
            f"train-ato: {name}: a reader does not confirm within {_STALL_S:g} s and is not waited for any longer\n"
        )
        return True

    def turn(self, seconds: float, moment_ns: int) -> None:
        """Let services be called for so long at most, and publish ``/clock`` when it is due."""
        if self._clock is not None and self._period is not None:
            now = time.monotonic()
            if now >= self._next_clock:
                self._next_clock = max(self._next_clock + self._period, now)
                self._clock.publisher.publish(_clock_message(moment_ns))
            seconds = min(seconds, max(0.0, self._next_clock - now))
        self._executor.spin_once(timeout_sec=seconds)

    def meet(self, most_s: float, asked: Callable[[], bool]) -> bool:
        """Wait until readers that are there already are matched: what is sent before is lost to them.

        Returns
        -------
        bool
            False when a reader that fits was not matched in time.
        """
        last = time.monotonic() + most_s
        seen, quiet = None, time.monotonic()
        while not asked():
            self._executor.spin_once(timeout_sec=_SLICE_S)
            now = time.monotonic()
            found = self._met()
            if found != seen:
                seen, quiet = found, now
            missing = any(matched < there for there, matched in found[0])
            if not missing and now - quiet >= min(_QUIET_S, most_s):
                return True
            if now >= last:
                return not missing
        return True

    def _met(self) -> tuple[tuple[tuple[int, int], ...], int]:
        """Return readers that fit and readers that are matched, for every publisher, and the number of nodes."""
        senders = [*self._senders.values(), *([self._clock] if self._clock is not None else [])]
        pairs = tuple((self._fitting(sender), sender.publisher.get_subscription_count()) for sender in senders)
        return pairs, len(self.node.get_node_names_and_namespaces())

    def _fitting(self, sender: Sender) -> int:
        """Count the readers of a topic that this publisher can serve."""
        from rclpy.qos import QoSCompatibility, qos_check_compatible

        publisher = sender.publisher
        return sum(
            reader.topic_type == sender.topic.type
            and qos_check_compatible(publisher.qos_profile, reader.qos_profile)[0] != QoSCompatibility.ERROR
            for reader in self.node.get_subscriptions_info_by_topic(publisher.topic_name)
        )

    def others(self) -> dict[str, list[str]]:
        """Return the nodes that publish the same topics, by the name of the topic in the graph."""
        found: dict[str, list[str]] = {}
        for sender in self._senders.values():
            name = sender.publisher.topic_name
            found[name] = [info.node_name for info in self.node.get_publishers_info_by_topic(name)]
        for sender in self._senders.values():
            found[sender.publisher.topic_name].remove(NODE)
        return {name: nodes for name, nodes in found.items() if nodes}

    def settle(self, most_s: float, asked: Callable[[], bool]) -> bool:
        """Wait until the readers have everything; False if they have not in time."""
        last = time.monotonic() + most_s
        for sender in self._senders.values():
            while not sender.acknowledged(min(_SLICE_S, last - time.monotonic())):
                if asked() or time.monotonic() >= last:
                    return False
        return True


def _class_of(topic: LogTopic) -> Any:
    """Return the class of a topic's messages."""
    from train_ato.nodes.shell import message_class

    if topic.encoding != "cdr" or topic.type.count("/") != 2:
        raise ValueError(
            f"{topic.name}: messages of type '{topic.type}' in '{topic.encoding}' are none of ROS 2; leave the topic "
            "out with --exclude-topics"
        )
    try:
        return message_class(topic.type)
    except (ImportError, AttributeError):
        raise ValueError(
            f"{topic.name}: messages of type {topic.type} are not installed; install them, or leave the topic out "
            "with --exclude-topics"
        ) from None


def _clock_topic() -> LogTopic:
    return LogTopic(CLOCK, CLOCK, "rosgraph_msgs/msg/Clock", False, _QUEUE)


def _clock_message(moment_ns: int) -> Any:
    from rosgraph_msgs.msg import Clock

    message = Clock()
    message.clock.sec, message.clock.nanosec = divmod(moment_ns, 1_000_000_000)
    return message
