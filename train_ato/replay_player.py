"""Publishers and pace of a replay."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from train_ato.record.reading import RawMessage
from train_ato.topics import EPOCH_NS

CLOCK = "/clock"
TURN_S = 0.1
_SETTLE_S = 2.0


@dataclass(frozen=True)
class ReplayOptions:
    """How a run is published again.

    Attributes
    ----------
    rate : float
        Simulated seconds per second of wall time.
    start_offset : float
        Time from the run's start before which only latched topics are sent [s].
    loop, start_paused : bool
        Begin again at the end; wait for the service ``/replay/start``.
    clock_hz : float or None
        Publish ``/clock`` so often per wall second instead of the recorded one.
    topics : tuple of str
        Names in the log (with or without the leading slash); empty: all.
    remap : mapping of str to str
        Name in the log to the name to publish under.
    """

    rate: float = 1.0
    start_offset: float = 0.0
    loop: bool = False
    start_paused: bool = False
    clock_hz: float | None = None
    topics: tuple[str, ...] = ()
    remap: Mapping[str, str] = field(default_factory=dict)

    def check(self) -> None:
        """Refuse what makes no sense.

        Raises
        ------
        ValueError
            One line that names the option, its value and the remedy.
        """
        if not (math.isfinite(self.rate) and self.rate > 0):
            raise ValueError(f"--rate {self.rate}: give a positive number, 1 for real time")
        if not (math.isfinite(self.start_offset) and self.start_offset >= 0):
            raise ValueError(f"--start-offset {self.start_offset}: give seconds from the run's start, 0 or more")
        if self.clock_hz is not None and not 0 < self.clock_hz <= 10_000:
            raise ValueError(f"--clock {self.clock_hz}: give a rate above 0 and up to 10000 Hz")


@dataclass(frozen=True)
class LogTopic:
    """One topic of a log as it will be published."""

    name: str
    published_as: str
    type: str
    latched: bool
    depth: int


class Player:
    """Publishers of a replay and its pace on the wall clock."""

    def __init__(self, executor: Any, context: Any, topics: Mapping[str, LogTopic], options: ReplayOptions) -> None:
        from rclpy.node import Node
        from std_srvs.srv import SetBool, Trigger

        self.node = Node("replay", context=context, enable_rosout=False)
        self._executor = executor
        self._options = options
        self._topics = topics
        self.paused = options.start_paused
        self.stopped = False
        self.counts = dict.fromkeys(topics, 0)
        self._publishers = {name: self._publisher(topic) for name, topic in topics.items()}
        self._clock = None
        if options.clock_hz is not None:
            self._clock = self._publisher(LogTopic(CLOCK, CLOCK, "rosgraph_msgs/msg/Clock", False, 1000))
        self.node.create_service(Trigger, "~/start", self._start)
        self.node.create_service(SetBool, "~/pause", self._pause)
        executor.add_node(self.node)
        self._wall = time.monotonic()
        self._simulated = 0.0
        self._next_clock = 0.0

    def _publisher(self, topic: LogTopic) -> Any:
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        from train_ato.nodes.shell import message_class

        try:
            kind = message_class(topic.type)
        except (ImportError, AttributeError):
            raise ValueError(
                f"{topic.name}: messages of type {topic.type} are not installed; leave the topic out with --topics"
            ) from None
        durability = DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE
        qos = QoSProfile(depth=topic.depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
        return self.node.create_publisher(kind, topic.published_as, qos)

    def _start(self, request: Any, response: Any) -> Any:
        self.paused = False
        response.success, response.message = True, "plays"
        return response

    def _pause(self, request: Any, response: Any) -> Any:
        self.paused = bool(request.data)
        response.success, response.message = True, "paused" if self.paused else "plays"
        return response

    def publish(self, message: RawMessage) -> None:
        """Send one recorded message as it is."""
        name = message.channel.topic
        self._publishers[name].publish(bytes(message.data))
        self.counts[name] += 1

    def begin_at(self, simulated: float) -> None:
        """Start the wall clock of the replay at a simulated time [s]."""
        self._wall, self._simulated = time.monotonic(), simulated

    def wait_for(self, simulated: float, asked: Callable[[], bool]) -> bool:
        """Turn until a simulated time has come on the wall clock; False when the replay was stopped."""
        while not (asked() or self.stopped):
            if self.paused:
                self._executor.spin_once(timeout_sec=TURN_S)
                self.begin_at(self._simulated)
                continue
            now = time.monotonic()
            self._simulated += (now - self._wall) * self._options.rate
            self._wall = now
            self._tick_clock(now)
            remaining = (simulated - self._simulated) / self._options.rate
            if remaining <= 0:
                return True
            until_clock = self._next_clock - now if self._clock is not None else TURN_S
            self._executor.spin_once(timeout_sec=max(0.0005, min(remaining, until_clock, TURN_S)))
        return False

    def _tick_clock(self, now: float) -> None:
        if self._clock is None or now < self._next_clock:
            return
        from rosgraph_msgs.msg import Clock

        assert self._options.clock_hz is not None
        self._next_clock = max(self._next_clock + 1 / self._options.clock_hz, now)
        moment = EPOCH_NS + round(self._simulated * 1e9)
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(moment, 1_000_000_000)
        self._clock.publish(message)

    def settle(self) -> None:
        """Wait until the readers have everything."""
        from rclpy.duration import Duration

        last = time.monotonic() + _SETTLE_S
        for publisher in self._publishers.values():
            left = max(0.0, last - time.monotonic())
            publisher.wait_for_all_acked(Duration(nanoseconds=round(left * 1e9)))
