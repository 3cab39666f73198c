"""Replay of a recorded run with its names, types, quality of service and pace, by a node with services.

Without these types every service is a ``std_srvs/srv/Trigger`` of the same name; the arguments of the requests of
rosbag2 are parameters of the node.
"""

import math
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from plant_sim.formats.fields import print_assumption
from plant_sim.units import number_text
from train_ato.log.mcap_records import RawMessage
from train_ato.log.reading import MAX_RUN_NS
from train_ato.messages.topics import BY_NAME
from train_ato.playback.log import CLOCK, LogTopic, ReplayLog, ReplayOptions, absolute, chosen_topics
from train_ato.playback.playback import Playback, ReplayState
from train_ato.program.errors import FirstFailure
from train_ato.program.interrupt import interruptible
from train_ato.ros import require_ros

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

        from train_ato.ros.nodes.parameter_services import ParameterServices

        self.node = Node(NODE, context=context, enable_rosout=False, start_parameter_services=False)
        ParameterServices(self.node, FirstFailure())  # they take 1 for 1.0
        executor.add_node(self.node)
        self._executor = executor
        self._senders = {name: self._sender(topic) for name, topic in topics.items()}
        self._full: Sender | None = None
        self._full_since = 0.0
        self._period = 1 / clock_hz if clock_hz is not None else None
        clock = LogTopic(CLOCK, CLOCK, "rosgraph_msgs/msg/Clock", False, _QUEUE)
        self._clock = self._sender(clock) if clock_hz is not None else None
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
            from rosgraph_msgs.msg import Clock

            now = time.monotonic()
            if now >= self._next_clock:
                self._next_clock = max(self._next_clock + self._period, now)
                message = Clock()
                message.clock.sec, message.clock.nanosec = divmod(moment_ns, 1_000_000_000)
                self._clock.publisher.publish(message)
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
            # discovered DDS participants, this one included; 0 for a middleware without the topic
            participants = len(self.node.get_publishers_info_by_topic("ros_discovery_info", no_mangle=True))
            missing = any(matched < there for there, matched in found[0]) or 0 < participants < self._sockets()
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


SERVICES = (
    "pause", "resume", "toggle_paused", "is_paused", "get_rate", "set_rate", "play_next", "burst", "seek", "play",
    "stop",
)  # fmt: skip
RESULTS = {"is_paused": "paused", "get_rate": "rate", "burst": "actually_burst"}
"""Fields of the answers of rosbag2 with a result."""


def rosbag2_types() -> Any | None:
    """Return the service types of rosbag2, None if they are not installed."""
    try:
        types = import_module("rosbag2_interfaces.srv")
    except ImportError:
        return None
    return types if all(hasattr(types, type_name(service)) for service in SERVICES) else None


def type_name(service: str) -> str:
    """Return the type name of a service: PlayNext for ``play_next``."""
    return "".join(part.capitalize() for part in service.split("_"))


def offer_services(node: Any, playback: Playback) -> None:
    """Create the services of a replay on its node, after the wait for existing readers."""
    from std_srvs.srv import Trigger

    types = rosbag2_types()
    for service in SERVICES:
        kind, answer = (Trigger, _trigger) if types is None else (getattr(types, type_name(service)), _rosbag2)
        node.create_service(kind, f"~/{service}", partial(answer, node, playback, service))


def _carry_out(playback: Playback, service: str, argument: Callable[[str], Any]) -> Any:
    """Carry out an order, except a change of the rate; return its result.

    Parameters
    ----------
    playback
        Replay to control.
    service
        Name of the service.
    argument
        Returns an argument by the name of its parameter.
    """
    if service == "is_paused":
        return playback.state.paused
    if service == "get_rate":
        return float(playback.state.rate)
    if service == "burst":
        return playback.burst(int(argument("burst")))
    if service == "seek":
        return playback.seek(argument("seek"))
    if service == "play":
        return playback.play(argument("start_offset"), argument("playback_duration") or None)
    return None if service == "set_rate" else getattr(playback, service)()


def _trigger(node: Any, playback: Playback, service: str, request: Any, response: Any) -> Any:
    """Answer a Trigger with the result of the order, the place if it has none, or the reason of a refusal."""

    def place() -> str:
        state = playback.state
        return f"{'paused' if state.paused else 'plays'} at {state.moment:.3f} of {state.length:.3f} s"

    before = place()
    try:
        result = _carry_out(playback, service, lambda name: node.get_parameter(name).value)
    except ValueError as error:
        response.success, response.message = False, str(error)
        return response
    response.success = result if service == "is_paused" else True
    response.message = {
        "get_rate": f"{playback.state.rate:g}",
        "set_rate": f"rate {playback.state.rate:g}, from the parameter",
        "burst": f"{result} messages sent; {place()}",
        "stop": f"stopped, {before}",
    }.get(service, place())
    return response


def _rosbag2(node: Any, playback: Playback, service: str, request: Any, response: Any) -> Any:
    """Answer a request of rosbag2; its time of ``seek`` is an absolute time of the log."""
    from rclpy.parameter import Parameter

    arguments: dict[str, Callable[[], Any]] = {
        "burst": lambda: request.num_messages,
        "seek": lambda: playback.place_of(_nanoseconds(request.time)),
        "start_offset": lambda: _nanoseconds(request.start_offset) * 1e-9,
        "playback_duration": lambda: max(0.0, _nanoseconds(request.playback_duration) * 1e-9),
    }
    done = True
    try:
        result = _carry_out(playback, service, lambda name: arguments[name]())
    except ValueError:
        done = False
    if service == "set_rate":
        change = Parameter("rate", Parameter.Type.DOUBLE, float(request.rate))
        done = bool(node.set_parameters([change])[0].successful)
    if service in ("set_rate", "play_next", "seek", "play"):
        response.success = done
    elif service in RESULTS and done:
        setattr(response, RESULTS[service], result)
    return response


def _nanoseconds(time: Any) -> int:
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


@dataclass(frozen=True)
class Replayed:
    """Result of a replay.

    Attributes
    ----------
    counts : dict
        Number of sent messages by topic of the log.
    moment : float
        Last time of the log [s].
    end : str
        ``end``, ``stopped`` by the service, or ``interrupted`` by Ctrl-C.
    acknowledged : bool
        The readers have confirmed all messages.
    """

    counts: dict[str, int]
    moment: float
    end: str
    acknowledged: bool


Keys = Callable[[Playback], None]
"""Callback that processes the keys."""


def note_far_stamp(run: Path, length: float, options: ReplayOptions) -> None:
    """Note a log longer than a day [s], because the replay waits until its last message: its stamp may be wrong."""
    if length > MAX_RUN_NS / 1e9 and options.duration is None and math.isfinite(options.rate):
        print_assumption(
            f"{run}: {number_text(length)} s from the first message to the last, more than a run has: one of them may "
            "have a wrong stamp, and the replay waits until the last one; end it with --playback-duration"
        )


def refuse_topics_of_runs(domain: int | None, names: Iterable[str]) -> None:
    """Refuse published names that are topics of a run in the domain: a second publisher would end the run."""
    from train_ato.ros.graph.domain_lock import TRAINS, locked_runs
    from train_ato.ros.graph.environment import domain_of_environment

    of_environment = domain_of_environment()
    option = "--domain" if domain is not None else "ROS domain" if of_environment is None else "ROS_DOMAIN_ID"
    number = domain if domain is not None else of_environment or 0
    spaces = {space for held, space in locked_runs() if held == number}
    for space in spaces - ({"", TRAINS} if TRAINS in spaces else set()):  # the program of several trains has no nodes
        own = {f"{space}/{name.removeprefix('/')}" for name, topic in BY_NAME.items() if len(topic.publishers) == 1}
        if taken := sorted(own.intersection(names)):
            raise ValueError(
                f"{option} {number}: a run in progress publishes {taken[0]} there, and would end; give another "
                "--domain, or --remap or --exclude-topics for its topics"
            )


def publish_run(
    run: Path,
    options: ReplayOptions,
    *,
    domain: int | None = None,
    progress: Callable[[ReplayState], None] | None = None,
    keys: Keys | None = None,
) -> Replayed:
    """Publish a recorded run until its end, the service ``stop``, or Ctrl-C.

    The recorded bytes are sent in the order of the log at their publish times.  The first message is sent after the
    existing readers are matched; latched messages from before the start are sent first.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    options
        Rate, selection and names.
    domain
        ROS domain; default: as in the environment.
    progress
        Callback for the state, about ten times a second.
    keys
        Callback for the keys, at the same rate.

    Returns
    -------
    Replayed
        Sent messages and end of the replay.

    Raises
    ------
    ValueError
        For invalid options, topics not in the log or of a run in the domain, missing message types, or a damaged log.
    """
    from train_ato.ros.graph.environment import check_domain

    options.check()
    check_domain(domain)
    require_ros()
    with ReplayLog(run) as log, interruptible() as interrupt:
        topics = chosen_topics(log.topics, options)
        log.check_place("--start-offset", options.start_offset)
        names = [absolute(topic.published_as) for topic in topics.values()]
        refuse_topics_of_runs(domain, [*names, CLOCK] if options.clock_hz is not None else names)
        note_far_stamp(run, log.length, options)
        from train_ato.ros.graph.assembly import executor_of

        def interrupted() -> bool:
            return interrupt.asked

        def report(state: ReplayState) -> None:
            if progress is not None:
                progress(state)
            if keys is not None:
                keys(playback)

        # an empty list: without arguments rclpy would apply the remappings of the command line a second time
        with executor_of(domain, []) as (context, executor):
            player = Player(executor, context, topics, options.clock_hz)
            playback = Playback(log, topics, options, player, interrupted=interrupted, progress=report)
            declare_parameters(player.node, playback)
            player.wait_for_readers(options.meet_s, interrupted)
            others = player.others()
            _warn_of_others(others)
            offer_services(player.node, playback)
            playback.run()
            acknowledged = player.wait_for_confirmation(options.acknowledged_s, interrupted)
            _warn_of_others({topic: nodes for topic, nodes in player.others().items() if topic not in others})
        end = "stopped" if playback.stopped else "interrupted" if interrupt.asked else "end"
        return Replayed(player.counts, playback.state.moment, end, acknowledged)


def _warn_of_others(others: Mapping[str, Sequence[str]]) -> None:
    for topic, nodes in others.items():
        sys.stderr.write(
            f"train-ato: {topic}: also published on this domain by {', '.join(nodes)}, readers receive both; give "
            "--domain, --remap or --exclude-topics\n"
        )


PARAMETERS: tuple[tuple[str, float | int, str], ...] = (
    ("rate", 1.0, "simulated seconds per second, .inf for as fast as possible; takes effect at once"),
    ("seek", 0.0, "time of the service seek [s from the first message]"),
    ("burst", 1, "number of messages of the service burst; 0: all"),
    ("start_offset", 0.0, "start of the service play [s from the first message]"),
    ("playback_duration", 0.0, "duration of the service play [s]; 0: to the end"),
)


def declare_parameters(node: Any, playback: Playback) -> None:
    """Declare the parameters of the node: the rate, and the arguments of services without a request."""
    from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult

    def refuse(parameters: list[Any]) -> Any:
        for name, value in ((parameter.name, parameter.value) for parameter in parameters):
            if name == "rate" and not value > 0:
                return SetParametersResult(successful=False, reason=f"rate {value:g}: give a number above 0")
            if name in ("seek", "burst", "start_offset", "playback_duration") and not 0 <= value < math.inf:
                return SetParametersResult(successful=False, reason=f"{name} {value:g}: give 0 or more")
        return SetParametersResult(successful=True)

    def take_over(parameters: list[Any]) -> None:
        for parameter in parameters:
            if parameter.name == "rate":
                playback.set_rate(parameter.value)

    for name, value, text in PARAMETERS:
        start = playback.state.rate if name == "rate" else value
        node.declare_parameter(name, start, ParameterDescriptor(description=text))
    node.add_on_set_parameters_callback(refuse)
    node.add_post_set_parameters_callback(take_over)
