"""Writer of the log of a run.

The file is written as ``run.mcap.partial`` and renamed when it is closed, also after a failure or Ctrl-C.  Only a
killed process leaves the partial file, for ``recover``.
"""

import fcntl
import io
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from mcap.records import Channel, Schema

from train_ato.log import bag_layout as bag
from train_ato.log.chunk_thread import ChunkThread
from train_ato.log.compression import DEFAULT
from train_ato.log.definitions import definition
from train_ato.log.mcap_writer import McapWriter
from train_ato.log.reading import WALL_TIME, WallTime
from train_ato.log.whole_file import write_whole
from train_ato.messages.topics import EPOCH_NS, TOPICS, Topic
from train_ato.program.errors import refused_unwritten

CHUNK = 512 * 1024
"""Size at which a chunk is closed [bytes]; a killed run loses at most two chunks, 1 MiB."""
YAML = "application/yaml"


class LogFile(ChunkThread):
    """An MCAP file under construction, in the layout of ``ros2 bag``.

    The file is locked while it is open; the lock distinguishes it from the file of a killed run.

    Parameters
    ----------
    folder
        Existing folder of the run.
    attachments
        Texts to attach, by file name, before the first message.
    name
        Name of the closed file.
    chunk_size
        Size at which a chunk is closed [bytes].
    compression
        ``none``, ``fast`` or ``small``.
    wall_time
        Wall time of the recording, for the metadata record.
    remedy
        Remedy of a failed write; that of a copy does not name its incomplete file, which is removed.

    Raises
    ------
    ValueError
        If the folder already has a log or cannot be written, or has no room for the begin of the log.
    """

    def __init__(
        self,
        folder: Path,
        attachments: Mapping[str, bytes] | None = None,
        name: str = bag.LOG,
        *,
        chunk_size: int = CHUNK,
        compression: str = DEFAULT,
        wall_time: WallTime | None = None,
        remedy: str = "make room there",
    ) -> None:
        self.path = folder / name
        self.wall_time = wall_time
        self._partial = folder / f"{name}.partial"
        for taken in (self.path, self._partial):
            if taken.exists():
                raise ValueError(f"{taken}: exists already; name another output folder")
        with refused_unwritten(self._partial, "name a writable folder"):
            raw = self._partial.open("xb", buffering=0)
        with suppress(OSError):  # a file system without locks
            fcntl.flock(raw, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._stream = io.BufferedWriter(raw, 1 << 16)
        writer = McapWriter(self._stream, "ros2", "train_ato", compression)
        super().__init__(writer, raw, str(self._partial), chunk_size, remedy)
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: list[tuple[str, str, str, str, str]] = []
        self.closed = False
        with refused_unwritten(self._partial, "make room there, or name another folder", left=self._partial):
            self._begin(attachments or {})
        self.start()

    def _begin(self, attachments: Mapping[str, bytes]) -> None:
        self._writer.metadata(
            "rosbag2", bag.metadata_record(bag.bag_information(self.path.name, [], bag.NEVER, bag.NEVER))
        )
        self._write_wall_time()
        for name, data in attachments.items():
            self._writer.attachment(name, YAML, data, EPOCH_NS)
        self._stream.flush()

    def _write_wall_time(self) -> None:
        if self.wall_time is not None:
            self._writer.metadata(WALL_TIME, self.wall_time.record())

    def channel(self, name: str, type_name: str, text: str, type_hash: str, qos: str) -> int:
        """Add a topic; return its number for :meth:`write`."""
        metadata = {"offered_qos_profiles": qos, "topic_type_hash": type_hash}
        return self._declare(
            name, "cdr", Schema(id=1, data=text.encode(), encoding="ros2msg", name=type_name), metadata
        )

    def copy(self, channel: Channel, schema: Schema) -> int:
        """Add a topic of another log with its encoding; return its number."""
        offered = channel.metadata.get("offered_qos_profiles", "")
        metadata = {**channel.metadata, "offered_qos_profiles": offered if bag.offered_qos(offered) else "[]"}
        return self._declare(channel.topic, channel.message_encoding, schema, metadata)

    def _declare(self, name: str, encoding: str, schema: Schema, metadata: dict[str, str]) -> int:
        with self.lock:
            key = (schema.name, schema.encoding, schema.data)
            if schema.id and key not in self._schemas:
                self._schemas[key] = self._writer.schema(*key)
            number = self._writer.channel(name, encoding, self._schemas[key] if schema.id else 0, metadata)
            hash_and_qos = (metadata.get("topic_type_hash", ""), metadata["offered_qos_profiles"])
            self._channels.append((name, schema.name, encoding, *hash_and_qos))
        return number

    def write(self, channel: int, publish_ns: int, log_ns: int, data: bytes) -> None:
        """Add a message with publish and log time [ns since 1970].

        Raises
        ------
        OSError
            If the disk is full or gone; nothing is written after it.
        """
        self.extend(((channel, publish_ns, log_ns, data),))

    def close(self) -> None:
        """Finish and rename the file and write ``metadata.yaml``; after a failed write only close it.

        Raises
        ------
        OSError
            If the disk is full or gone; the partial file is kept for ``recover``.
        """
        if self.closed:
            return
        self.closed = True
        self.stop()
        if self.failure is None:
            self.guard(self._finish)

    def _finish(self) -> None:
        self._partial.stat()  # not there: it was removed, and a bag without it has no metadata
        pairs = zip(self._channels, self._writer.counts, strict=True)
        channels = [bag.ChannelCount(*channel, count) for channel, count in pairs]
        span = self._writer.span if any(self._writer.counts) else (bag.NEVER, bag.NEVER)
        information = bag.bag_information(self.path.name, channels, *span)
        self._write_wall_time()
        self._writer.metadata("rosbag2", bag.metadata_record(information))
        self._writer.finish()
        write_whole(self.path.parent / bag.METADATA, bag.metadata_yaml(information))
        self._partial.rename(self.path)
        self._stream.close()


class RunLog(LogFile):
    """Log of one run: the recorded topics of the table.

    Parameters
    ----------
    folder
        Existing folder of the run.
    topics
        Topics of the run; only recorded ones are added.
    resolved
        Returns the name of a topic in the graph, with its namespace and remaps.
    attachments
        Texts to attach, by file name, for the reproduction of the run.
    compression
        ``none``, ``fast`` or ``small``.
    timed
        Write the wall time of the recording; False for a log that is converted from another file.
    """

    def __init__(
        self,
        folder: Path,
        topics: Collection[Topic] = TOPICS,
        resolved: Callable[[str], str] = lambda name: f"/{name.lstrip('/')}",
        *,
        attachments: Mapping[str, bytes] | None = None,
        compression: str = DEFAULT,
        timed: bool = True,
    ) -> None:
        wall_time = WallTime.now() if timed else None
        remedy = "`train-ato recover` reads the rest" if timed else "make room there"
        super().__init__(folder, attachments, compression=compression, wall_time=wall_time, remedy=remedy)
        self.numbers: dict[str, int] = {}
        for topic in topics:
            if topic.recorded:
                known = definition(topic.type)
                self.numbers[topic.name] = self.channel(
                    bag.log_name(topic, resolved(topic.name)),
                    topic.type,
                    known.text,
                    known.hash,
                    bag.qos_text(bag.qos_profiles(topic)),
                )

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages per topic."""
        with self.lock:
            return dict(zip(self.numbers, self._writer.counts, strict=True))

    def add(self, topic: str, publish_ns: int, log_ns: int, data: bytes) -> None:
        """Record a message of a topic of the table with publish and log time [ns since 1970].

        Raises
        ------
        OSError
            If the disk is full or gone.
        """
        self.write(self.numbers[topic], publish_ns, log_ns, data)

    def close(self) -> None:
        """Finish the log and rename it to ``run.mcap``."""
        if self.wall_time is not None and not self.closed:
            self.wall_time = self.wall_time.ended()
        super().close()

    def __enter__(self) -> "RunLog":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
