"""A log as a replay needs it: any moment of it at once, by its index.

Messages are ordered and timed by their publish times, which are the simulated ones; the index of an MCAP file goes by
log times, which are those of the wall clock where a graph was recorded.  A moment is therefore found by halving: of
the chunks that are looked at only the publish times are read, and a file of an hour is entered after some ten of its
chunks.  A file without an index is read from its beginning instead.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import BinaryIO

import yaml
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, ChunkIndex

from train_ato.record.mcap_writer import MAGIC
from train_ato.record.reading import Definitions, RawMessage, log_file, stream
from train_ato.record.records import Damage, chunk_content

DISORDER_NS = 1_000_000_000
"""Messages of several nodes stand in a log a little out of the order of their stamps, but never by more than this."""
_RECORD = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI")
_FOOTER_CONTENT = 20
_UNREADABLE = (Damage, McapError, struct.error, KeyError, EOFError, IndexError, UnicodeDecodeError, MemoryError)


@dataclass(frozen=True)
class LogTopic:
    """One topic of a log, and how it is published.

    Attributes
    ----------
    name, published_as
        Name in the log and in the graph.
    type, encoding
        Message type and encoding, ``cdr`` for ROS 2.
    latched
        Late joiners get the last ``depth`` messages.
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


def message_time(message: RawMessage) -> int:
    """Return when a message counts as sent [ns since 1970]: its publish time, its log time where it has none."""
    return message.publish_ns or message.log_ns


class ReplayLog:
    """An open log.

    Parameters
    ----------
    run
        Run folder or MCAP file.

    Attributes
    ----------
    topics : dict
        Topics that have messages, by name.
    begin_ns, end_ns : int
        Publish times of the first and the last message [ns since 1970].

    Raises
    ------
    ValueError
        If there is no log, it is damaged, or it holds no message.
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
        with self._readable():
            self._chunks = self._indexed_chunks()
        self._spans: dict[int, tuple[int, int]] = {}
        self.begin_ns, self.end_ns = self._span_of_all()
        if not self.topics:
            raise ValueError(f"{self.path}: holds no message; nothing can be replayed")

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> ReplayLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def length(self) -> float:
        """Time from the first message to the last [s]."""
        return (self.end_ns - self.begin_ns) * 1e-9

    def check_place(self, what: str, place: float) -> None:
        """Refuse a time [s from the first message] that is not one of the run, with the run's length.

        Raises
        ------
        ValueError
            One line that begins with ``what``.
        """
        if not 0 <= place <= self.length:
            raise ValueError(f"{what} {place:g}: the run has {self.length:g} s; give 0 to {self.length:g}")

    @contextmanager
    def _readable(self) -> Iterator[None]:
        """Turn what the MCAP reader raises on a damaged file into one line."""
        try:
            yield
        except _UNREADABLE as error:
            reason = str(error) or type(error).__name__
            raise ValueError(
                f"{self.path}: damaged or no log: {reason}; `train-ato recover {self.path}` saves what is whole"
            ) from None
        except OSError as error:
            raise ValueError(f"{self.path}: cannot be read ({error.strerror or error})") from None

    def _indexed_chunks(self) -> list[ChunkIndex]:
        """Return the chunks in the order of the file; none where the index is missing or not that of all messages."""
        self._known = Definitions()
        self._counts: Mapping[int, int] = {}
        self._check_summary()
        self._file.seek(0)
        summary = SeekingReader(self._file).get_summary()
        if summary is None or summary.statistics is None:
            return []
        if summary.statistics.chunk_count != len(summary.chunk_indexes):
            return []
        self._known = Definitions(summary.schemas, summary.channels)
        self._counts = summary.statistics.channel_message_counts
        return sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)

    def _check_summary(self) -> None:
        """Compare the checksum of the summary, where it has one: the reader of ``mcap`` believes its index blindly."""
        self._size = size = self.path.stat().st_size
        if size < 2 * len(MAGIC) + _FOOTER.size:
            raise Damage("it is too short")
        self._file.seek(size - len(MAGIC) - _FOOTER.size)
        code, length, begin, _, stored = _FOOTER.unpack(self._file.read(_FOOTER.size))
        if self._file.read() != MAGIC or code != Opcode.FOOTER or length != _FOOTER_CONTENT:
            raise Damage("it does not end like an MCAP file")
        if begin and stored:
            self._file.seek(begin)
            if zlib.crc32(self._file.read(size - len(MAGIC) - 4 - begin)) != stored:
                raise Damage("the checksum of its summary differs")

    @cached_property
    def topics(self) -> dict[str, LogTopic]:
        """Topics that have messages, by name."""
        counts: dict[str, int] = {}
        kinds: dict[str, tuple[Channel, str]] = {}
        if self._chunks:
            for number, count in self._counts.items():
                channel = self._known.channels[number]
                schema = self._known.schemas.get(channel.schema_id)
                kinds.setdefault(channel.topic, (channel, schema.name if schema else ""))
                counts[channel.topic] = counts.get(channel.topic, 0) + count
        else:
            for message in stream(self.path):
                topic = message.channel.topic
                kinds.setdefault(topic, (message.channel, message.schema.name))
                counts[topic] = counts.get(topic, 0) + 1
        return {name: _described(*kinds[name], count) for name, count in counts.items() if count}

    def _span_of_all(self) -> tuple[int, int]:
        if self._chunks:
            last = range(max(0, len(self._chunks) - 2), len(self._chunks))
            return self._span(0)[0], max(self._span(place)[1] for place in last)
        times = [message_time(message) for message in stream(self.path)]
        return (min(times), max(times)) if times else (0, 0)

    def _span(self, place: int) -> tuple[int, int]:
        """Return the first and the last publish time in a chunk."""
        if place not in self._spans:
            times = [message_time(message) for message in self._messages_in(place)]
            self._spans[place] = (min(times), max(times)) if times else (0, 0)
        return self._spans[place]

    def _messages_in(self, place: int) -> Iterator[RawMessage]:
        """Read the messages of a chunk in their order; its checksum is looked at first."""
        with self._readable():
            self._file.seek(self._chunks[place].chunk_start_offset)
            code, length = _RECORD.unpack(self._file.read(_RECORD.size))
            if code != Opcode.CHUNK or length > self._size:
                raise Damage("there is no chunk where the index says")
            data = chunk_content(self._file.read(length))
        with self._readable():
            yield from self._known.messages(data)

    def _chunk_of(self, moment_ns: int) -> int:
        """Return the chunk from which a moment is read on."""
        low, high = 0, len(self._chunks) - 1
        while low < high:
            middle = (low + high) // 2
            if self._span(middle)[1] < moment_ns:
                low = middle + 1
            else:
                high = middle
        while low > 0 and self._span(low - 1)[1] >= moment_ns - DISORDER_NS:
            low -= 1
        return low

    def _holding(self, topics: Collection[str]) -> Iterator[int]:
        """Return the chunks that may hold messages of some topics."""
        numbers = {number for number, channel in self._known.channels.items() if channel.topic in topics}
        for place, chunk in enumerate(self._chunks):
            if not chunk.message_index_offsets or numbers & chunk.message_index_offsets.keys():
                yield place

    def messages(self, topics: Collection[str], from_ns: int) -> Iterator[RawMessage]:
        """Read the messages of some topics from a publish time on, in the order of the log.

        Raises
        ------
        ValueError
            If a damaged part is met.
        """
        for message in self._from(topics, from_ns):
            if message.channel.topic in topics and message_time(message) >= from_ns:
                yield message

    def _from(self, topics: Collection[str], from_ns: int) -> Iterator[RawMessage]:
        if not self._chunks:
            yield from stream(self.path)
            return
        first = self._chunk_of(from_ns)
        for place in self._holding(topics):
            if place >= first:
                yield from self._messages_in(place)

    def standing(self, depths: Mapping[str, int], until_ns: int) -> list[RawMessage]:
        """Return what a late joiner would have been given at a moment, in the order of the log.

        Parameters
        ----------
        depths
            Latched topics, and how many of their messages are kept.
        until_ns
            Publish time up to which they were sent, itself included.
        """
        kept: dict[str, list[tuple[int, RawMessage]]] = {name: [] for name in depths}
        for number, message in enumerate(self._until(depths, until_ns)):
            name = message.channel.topic
            if name in kept and message_time(message) <= until_ns:
                kept[name].append((number, message))
                del kept[name][: -depths[name]]
        return [message for _, message in sorted((e for es in kept.values() for e in es), key=lambda entry: entry[0])]

    def _until(self, topics: Collection[str], until_ns: int) -> Iterator[RawMessage]:
        if not topics:
            return
        if not self._chunks:
            yield from stream(self.path)
            return
        for place in self._holding(topics):
            if self._span(place)[0] > until_ns + DISORDER_NS:
                return
            yield from self._messages_in(place)


def _described(channel: Channel, type_name: str, count: int) -> LogTopic:
    """Return a topic with the quality of service that stands in its channel."""
    try:
        profiles = yaml.safe_load(channel.metadata.get("offered_qos_profiles", ""))
    except yaml.YAMLError:
        profiles = None
    offered = profiles[0] if isinstance(profiles, list) and profiles and isinstance(profiles[0], dict) else {}
    depth = offered.get("depth")
    return LogTopic(
        channel.topic,
        channel.topic,
        type_name,
        # rosbag2 writes the words, its versions before Iron the numbers of the rmw
        offered.get("durability") in ("transient_local", 1),
        depth if isinstance(depth, int) and depth > 0 else 10,
        channel.message_encoding,
        count,
    )
