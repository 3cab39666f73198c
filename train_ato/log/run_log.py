"""Writing the log of a run.

The file is written as ``run.mcap.partial`` and gets its name when it is closed, also after a failure or Ctrl-C: only
a killed process leaves the partial file, and ``recover`` reads that.
"""

from __future__ import annotations

import fcntl
import io
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType

import yaml
from mcap.records import Channel, Schema

from train_ato.record.chunk_clock import ChunkClock
from train_ato.record.definitions import definition
from train_ato.record.layout import (
    LOG,
    METADATA,
    NEVER,
    ChannelCount,
    bag_information,
    log_name,
    metadata_record,
    metadata_yaml,
    qos_profiles,
    qos_text,
)
from train_ato.record.mcap_writer import McapWriter
from train_ato.topics import EPOCH_NS, TOPICS, Topic

CHUNK = 1024 * 1024
"""Size at which a chunk is closed [bytes]; a killed run loses what is in the open one."""
CLOSE_AFTER_S = 0.8
"""Age at which the open chunk is closed whatever its size [s]; with the time that takes it is less than a second."""
YAML = "application/yaml"


class LogFile:
    """An MCAP file under construction, in the layout of ``ros2 bag``.

    While it is written, the file is locked, so that nobody takes it for that of a killed run.

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

    Raises
    ------
    ValueError
        If there is a log in the folder already or it cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        attachments: Mapping[str, bytes] | None = None,
        name: str = LOG,
        chunk_size: int = CHUNK,
    ) -> None:
        self.path = folder / name
        self._partial = folder / f"{name}.partial"
        for taken in (self.path, self._partial):
            if taken.exists():
                raise ValueError(f"{taken}: exists already; name another output folder")
        try:
            self._raw = self._partial.open("xb", buffering=0)
        except OSError as error:
            raise ValueError(f"{self._partial}: cannot be written ({error.strerror}); name a writable folder") from None
        with suppress(OSError):  # a file system without locks
            fcntl.flock(self._raw, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._stream = io.BufferedWriter(self._raw, 1 << 16)
        self._lock = threading.Lock()
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: list[tuple[str, str, str, str, str]] = []
        self._told = False
        self.failure: str | None = None
        self.closed = False
        self._writer = McapWriter(self._stream, "ros2", "train_ato", chunk_size)
        self._guard(lambda: self._begin(attachments or {}))
        self._clock = ChunkClock(self._close_in_time, CLOSE_AFTER_S)

    def _begin(self, attachments: Mapping[str, bytes]) -> None:
        self._writer.metadata("rosbag2", metadata_record(bag_information(self.path.name, [], NEVER, NEVER)))
        for name, data in attachments.items():
            self._writer.attachment(name, YAML, data, EPOCH_NS)
        self._stream.flush()

    def channel(self, name: str, type_name: str, text: str, type_hash: str, qos: str) -> int:
        """Add a topic and return its number for :meth:`write`."""
        metadata = {"offered_qos_profiles": qos, "topic_type_hash": type_hash}
        return self._declare(
            name, "cdr", Schema(id=1, data=text.encode(), encoding="ros2msg", name=type_name), metadata
        )

    def copy(self, channel: Channel, schema: Schema) -> int:
        """Add a topic of another log as it stands there, whatever it is encoded in; return its number."""
        metadata = {**channel.metadata, "offered_qos_profiles": _readable_qos(channel.metadata)}
        return self._declare(channel.topic, channel.message_encoding, schema, metadata)

    def _declare(self, name: str, encoding: str, schema: Schema, metadata: dict[str, str]) -> int:
        with self._lock:
            key = (schema.name, schema.encoding, schema.data)
            if schema.id and key not in self._schemas:
                self._schemas[key] = self._writer.schema(*key)
            number = self._writer.channel(name, encoding, self._schemas[key] if schema.id else 0, metadata)
            told = (metadata.get("topic_type_hash", ""), metadata["offered_qos_profiles"])
            self._channels.append((name, schema.name, encoding, *told))
        return number

    def write(self, channel: int, publish_ns: int, log_ns: int, data: bytes) -> None:
        """Add a message; times are in ns since 1970.

        Raises
        ------
        OSError
            If the disk is full or gone. Nothing is written to that file afterwards.
        """
        with self._lock:
            if self.failure is not None:
                self._tell()
            try:
                self._writer.add(channel, publish_ns, log_ns, data)
            except OSError as error:
                self._give_up(error)
                self._tell()

    def flush(self) -> None:
        """Write the open chunk to the file."""
        with self._lock:
            self._guard(self._writer.close_chunk)

    def close(self) -> None:
        """Finish the file, give it its name and write ``metadata.yaml``; after a failed write only let go of it.

        Raises
        ------
        OSError
            If the disk is full or gone; the partial file stays, ``recover`` reads it.
        """
        if self.closed:
            return
        self.closed = True
        self._clock.stop()
        if self.failure is None:
            self._guard(self._finish)
        elif not self._told:
            self._tell()

    def _finish(self) -> None:
        self._writer.close_chunk()
        pairs = zip(self._channels, self._writer.counts, strict=True)
        channels = [ChannelCount(*channel, count) for channel, count in pairs]
        span = self._writer.span if any(self._writer.counts) else (NEVER, NEVER)
        information = bag_information(self.path.name, channels, *span)
        self._writer.metadata("rosbag2", metadata_record(information))
        self._writer.finish()
        (self.path.parent / METADATA).write_text(metadata_yaml(information), encoding="utf-8")
        self._partial.rename(self.path)
        self._stream.close()

    def _close_in_time(self) -> float:
        """Close the open chunk when it is old enough; return after how long to look again [s]."""
        with self._lock:
            opened = self._writer.opened
            if self.failure is not None or self.closed or opened is None:
                return CLOSE_AFTER_S
            left = opened + CLOSE_AFTER_S - time.monotonic()
            if left > 0:
                return left
            try:
                self._writer.close_chunk()
            except OSError as error:
                self._give_up(error)
        return CLOSE_AFTER_S

    def _guard(self, action: Callable[[], object]) -> None:
        if self.failure is not None:
            self._tell()
        try:
            action()
        except OSError as error:
            self._give_up(error)
            self._tell()

    def _give_up(self, error: OSError) -> None:
        """Remember the failure and release the file without another write to it."""
        self.failure = (
            f"{self._partial}: writing failed ({error.strerror or error}); `train-ato recover` reads the rest"
        )
        self._raw.close()

    def _tell(self) -> None:
        self._told = True
        raise OSError(self.failure)


def _readable_qos(metadata: Mapping[str, str]) -> str:
    """Return the quality of service of a channel; that of another program may be no YAML, and then none is told."""
    text = metadata.get("offered_qos_profiles", "")
    try:
        return text if isinstance(yaml.safe_load(text), list) else "[]"
    except yaml.YAMLError:
        return "[]"


class RunLog:
    """Log of one run: the recorded topics of the table.

    Parameters
    ----------
    folder
        Existing folder of the run.
    topics
        Topics of the run; those that are not recorded are left out.
    namespace
        Namespace of the graph.
    attachments
        Texts to attach, by file name: what made the run and with what it can be made again.
    """

    def __init__(
        self,
        folder: Path,
        topics: Sequence[Topic] = TOPICS,
        namespace: str = "",
        attachments: Mapping[str, bytes] | None = None,
    ) -> None:
        self._file = LogFile(folder, attachments)
        self._numbers: dict[str, int] = {}
        self.counts: dict[str, int] = {}
        for topic in topics:
            if topic.recorded:
                known = definition(topic.type)
                self._numbers[topic.name] = self._file.channel(
                    log_name(topic, namespace), topic.type, known.text, known.hash, qos_text(qos_profiles(topic))
                )
                self.counts[topic.name] = 0

    @property
    def path(self) -> Path:
        """Name of the log once it is closed."""
        return self._file.path

    @property
    def failure(self) -> str | None:
        """Reason why nothing can be written any more."""
        return self._file.failure

    def add(self, topic: str, publish_ns: int, log_ns: int, data: bytes) -> None:
        """Record a message of a topic of the table; times in ns since 1970.

        Raises
        ------
        OSError
            If the disk is full or gone.
        """
        self._file.write(self._numbers[topic], publish_ns, log_ns, data)
        self.counts[topic] += 1

    def close(self) -> None:
        """Finish the log and rename it to ``run.mcap``."""
        self._file.close()

    def __enter__(self) -> RunLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
