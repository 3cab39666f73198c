"""Log of a replay: its messages from any time on, by the index; options, and selection of topics.

Messages have the order and the times of their publish times, which are simulated times.  The index of an MCAP file has
log times, which are wall times in a graph recorded by another recorder.  A time is therefore found by
bisection over the chunks: about ten chunks are read in the log of an hour.  A log without an index is read from its
beginning.
"""

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel

from plant_sim.input_error import close_match
from train_ato.log import mcap_records
from train_ato.log.bag_layout import offered_qos
from train_ato.log.foreign_bag import original
from train_ato.log.reading import log_file

DISORDER_NS = 1_000_000_000
"""Largest difference between the order of the messages in a log and the order of their stamps [ns]."""


@dataclass(frozen=True)
class LogTopic:
    """Topic of a log and its quality of service.

    Attributes
    ----------
    name, published_as
        Name in the log and in the graph.
    type, encoding
        Message type and encoding, ``cdr`` for ROS 2.
    latched
        A late subscriber receives the last ``depth`` messages.
    count
        Number of messages in the log.
    """

    name: str
    published_as: str
    type: str
    latched: bool
    depth: int
    encoding: str = "cdr"
    count: int = 0


class ReplayLog:
    """An open log.

    Attributes
    ----------
    topics : dict
        Topics with messages, by name.
    begin_ns, end_ns : int
        Publish times of the first and the last message [ns since 1970].

    Raises
    ------
    ValueError
        If there is no log, it is damaged, or it contains no message.
    """

    def __init__(self, run: Path) -> None:
        self.path = log_file(run)
        try:
            self._file: BinaryIO = self.path.open("rb")
        except OSError as error:
            raise ValueError(f"{self.path}: cannot be read ({error.strerror})") from None
        try:
            self._open()
        except BaseException:
            self._file.close()
            raise

    def _open(self) -> None:
        self._known, self._chunks = mcap_records.Definitions(), []
        self._counts: Mapping[int, int] = {}
        with mcap_records.readable(self.path):
            self._size = self.path.stat().st_size
            deque(
                mcap_records.records(self._file, self._size), maxlen=0
            )  # every checksum: a replay must not end half-way
            summary = mcap_records.summary_of(self._file, self._size)
        statistics = None if summary is None else summary.statistics
        if summary and statistics and statistics.chunk_count == len(summary.chunks):  # the index is complete
            self._known, self._chunks = summary.known, summary.chunks
            self._counts = statistics.channel_message_counts
        self._spans: dict[int, tuple[int, int]] = {}
        self.begin_ns, self.end_ns = self._span_of_all()
        if not self.topics:
            raise ValueError(f"{original(self.path)}: contains no message; nothing to replay")

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> "ReplayLog":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def length(self) -> float:
        """Time from the first message to the last [s]."""
        return (self.end_ns - self.begin_ns) * 1e-9

    def check_place(self, what: str, place: float) -> None:
        """Reject a time outside the run [s from the first message].

        Raises
        ------
        ValueError
            One line that begins with ``what`` and gives the length of the run.
        """
        if not 0 <= place <= self.length:
            raise ValueError(f"{what} {place:g}: the run has {self.length:g} s; give 0 to {self.length:g}")

    @cached_property
    def topics(self) -> dict[str, LogTopic]:
        """Topics with messages, by name."""
        counts: dict[str, int] = {}
        kinds: dict[str, tuple[Channel, str]] = {}
        if self._chunks:
            with mcap_records.readable(self.path):
                for number, count in self._counts.items():
                    channel, schema = self._known.kind(number)
                    kinds.setdefault(channel.topic, (channel, schema.name))
                    counts[channel.topic] = counts.get(channel.topic, 0) + count
        else:
            for message in mcap_records.stream(self.path):
                topic = message.channel.topic
                kinds.setdefault(topic, (message.channel, message.schema.name))
                counts[topic] = counts.get(topic, 0) + 1
        return {name: _described(*kinds[name], count) for name, count in counts.items() if count}

    def _span_of_all(self) -> tuple[int, int]:
        if self._chunks:
            last = range(max(0, len(self._chunks) - 2), len(self._chunks))
            return self._span(0)[0], max(self._span(place)[1] for place in last)
        times = [message.publish_ns for message in mcap_records.stream(self.path)]
        return (min(times), max(times)) if times else (0, 0)

    def _span(self, place: int) -> tuple[int, int]:
        """Return the first and the last publish time in a chunk."""
        if place not in self._spans:
            times = [message.publish_ns for message in self._messages_in(place)]
            self._spans[place] = (min(times), max(times)) if times else (0, 0)
        return self._spans[place]

    def _messages_in(self, place: int) -> Iterator[mcap_records.RawMessage]:
        """Read the messages of a chunk in their order, after a check of its checksum."""
        with mcap_records.readable(self.path):
            self._file.seek(self._chunks[place].chunk_start_offset)
            head = self._file.read(mcap_records.HEAD.size)
            code, length = mcap_records.HEAD.unpack(head) if len(head) == mcap_records.HEAD.size else (None, 0)
            if code != Opcode.CHUNK or length > self._size:
                raise mcap_records.Damage("no chunk at the position in the index")
            yield from self._known.messages(mcap_records.chunk_content(self._file.read(length)))

    def _holding(self, topics: Collection[str]) -> Iterator[int]:
        """Return the chunks that may contain messages of the topics."""
        numbers = {number for number, channel in self._known.channels.items() if channel.topic in topics}
        for place, chunk in enumerate(self._chunks):
            if not chunk.message_index_offsets or numbers & chunk.message_index_offsets.keys():
                yield place

    def messages(self, topics: Collection[str], from_ns: int) -> Iterator[mcap_records.RawMessage]:
        """Read the messages of the topics from a publish time on, in the order of the log."""
        for message in self._from(topics, from_ns):
            if message.channel.topic in topics and message.publish_ns >= from_ns:
                yield message

    def _from(self, topics: Collection[str], from_ns: int) -> Iterator[mcap_records.RawMessage]:
        if not self._chunks:
            yield from mcap_records.stream(self.path)
            return
        first = bisect_left(range(len(self._chunks) - 1), from_ns, key=lambda place: self._span(place)[1])
        while first > 0 and self._span(first - 1)[1] >= from_ns - DISORDER_NS:
            first -= 1
        for place in self._holding(topics):
            if place >= first:
                yield from self._messages_in(place)

    def standing(self, depths: Mapping[str, int], until_ns: int) -> list[mcap_records.RawMessage]:
        """Return the latched messages in force at a time, in the order of the log.

        Parameters
        ----------
        depths
            Number of kept messages by latched topic.
        until_ns
            Last publish time, included.
        """
        kept = {name: deque[tuple[int, mcap_records.RawMessage]](maxlen=depth) for name, depth in depths.items()}
        for number, message in enumerate(self._until(depths, until_ns)):
            name = message.channel.topic
            if name in kept and message.publish_ns <= until_ns:
                kept[name].append((number, message))
        return [message for _, message in sorted((e for es in kept.values() for e in es), key=lambda entry: entry[0])]

    def _until(self, topics: Collection[str], until_ns: int) -> Iterator[mcap_records.RawMessage]:
        if not topics:
            return
        if not self._chunks:
            yield from mcap_records.stream(self.path)
            return
        for place in self._holding(topics):
            if self._span(place)[0] > until_ns + DISORDER_NS:
                return
            yield from self._messages_in(place)


def _described(channel: Channel, type_name: str, count: int) -> LogTopic:
    """Return a topic with the quality of service of its channel."""
    profiles = offered_qos(channel.metadata.get("offered_qos_profiles", ""))
    offered = profiles[0] if profiles and isinstance(profiles[0], dict) else {}
    depth = offered.get("depth")
    return LogTopic(
        channel.topic,
        channel.topic,
        type_name,
        # rosbag2 writes names; versions before Iron write the numbers of the rmw
        offered.get("durability") in ("transient_local", 1),
        min(depth, MOST) if isinstance(depth, int) and depth > 0 else 10,
        channel.message_encoding,
        count,
    )


CLOCK = "/clock"
MOST = 2**31 - 1
"""Largest depth of a publisher of ROS 2."""


@dataclass(frozen=True)
class ReplayOptions:
    """Options of a replay.

    Attributes
    ----------
    rate : float
        Simulated seconds per second of wall time; infinite: as fast as the readers receive the messages.
    start_offset : float
        Start after the first message [s]; earlier latched messages are sent first.
    duration : float or None
        Published time of the log [s]; None: to its end.
    delay : float
        Wall time before the first message of every loop [s].
    loop, start_paused : bool
        Restart at the end; wait for the service ``resume``.
    clock_hz : float or None
        Rate of ``/clock`` [1/s of wall time], which replaces the recorded one.
    topics, exclude : tuple of str
        Names in the log, with or without the leading slash: published topics (empty: all) and excluded topics.
    remap : mapping of str to str
        Published name by the name in the log.
    meet_s : float
        Longest wall time to wait for existing readers [s].
    acknowledged_s : float
        Longest wall time to wait at the end for the confirmation of all messages by the readers [s].
    """

    rate: float = 1.0
    start_offset: float = 0.0
    duration: float | None = None
    delay: float = 0.0
    loop: bool = False
    start_paused: bool = False
    clock_hz: float | None = None
    topics: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    remap: Mapping[str, str] = field(default_factory=dict)
    meet_s: float = 5.0
    acknowledged_s: float = 5.0

    def check(self) -> None:
        """Reject invalid values.

        Raises
        ------
        ValueError
            One line that names the option, its value and the remedy.
        """
        if not self.rate > 0:
            raise ValueError(f"--rate {self.rate:g}: give a number above 0, 1 for real time, or max")
        if not (math.isfinite(self.start_offset) and self.start_offset >= 0):
            raise ValueError(f"--start-offset {self.start_offset:g}: give seconds from the run's start, 0 or more")
        if self.duration is not None and not (math.isfinite(self.duration) and self.duration > 0):
            raise ValueError(f"--playback-duration {self.duration:g}: give seconds of the run, more than 0")
        if not 0 <= self.delay <= 86_400:
            raise ValueError(f"--delay {self.delay:g}: give 0 to 86400 s")
        if self.clock_hz is not None and not 0 < self.clock_hz <= 10_000:
            raise ValueError(f"--clock {self.clock_hz:g}: give a rate above 0 and up to 10000 Hz")
        if not self.acknowledged_s >= 0:
            raise ValueError(f"--wait-for-all-acked {self.acknowledged_s * 1e3:g}: give milliseconds, 0 for no limit")


def parse_remap(entries: tuple[str, ...]) -> dict[str, str]:
    """Return the mapping of texts ``a:=b``; ValueError if a text has another form, or a topic has two new names."""
    mapping: dict[str, str] = {}
    for entry in entries:
        before, sign, after = entry.partition(":=")
        if not (sign and before and after):
            raise ValueError(f"--remap {entry}: write it as from:=to, for example --remap ato/command:=shadow/command")
        if absolute(before) in map(absolute, mapping):
            raise ValueError(f"--remap {entry}: {before} already has another new name; give one name")
        mapping[before] = after
    return mapping


def absolute(name: str) -> str:
    """Return the name of a topic with a leading slash."""
    return name if name.startswith("/") else f"/{name}"


def chosen_topics(found: Mapping[str, LogTopic], options: ReplayOptions) -> dict[str, LogTopic]:
    """Return the published topics of a log, by their name in the log.

    Raises
    ------
    ValueError
        If a topic is not in the log (with the nearest name), if no topic remains, or if two topics of different types
        have the same published name.
    """
    named = (("--topics", options.topics), ("--exclude-topics", options.exclude), ("--remap", tuple(options.remap)))
    for option, names in named:
        for name in names:
            if absolute(name) not in found:
                near, known = close_match(absolute(name), found), ", ".join(sorted(found))
                raise ValueError(f"{option} {name}: not in the log{near}; it has: {known}")
    wanted = {absolute(name) for name in options.topics} or set(found)
    wanted -= {absolute(name) for name in options.exclude}
    if options.clock_hz is not None:
        wanted.discard(CLOCK)
    if not wanted:
        raise ValueError("--topics, --exclude-topics and --clock leave no topic to publish; select at least one")
    renamed = {absolute(before): after for before, after in options.remap.items()}
    chosen = {
        name: replace(topic, published_as=renamed.get(name, topic.published_as))
        for name, topic in found.items()
        if name in wanted
    }
    _check_names(chosen)
    return chosen


def _check_names(chosen: Mapping[str, LogTopic]) -> None:
    kinds: dict[str, LogTopic] = {}
    for topic in chosen.values():
        other = kinds.setdefault(absolute(topic.published_as), topic)
        if other.type != topic.type:
            raise ValueError(
                f"{other.name} ({other.type}) and {topic.name} ({topic.type}) would both be published as "
                f"{topic.published_as}; change --remap"
            )
