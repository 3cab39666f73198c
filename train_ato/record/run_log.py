"""Writing the log of a run.

The file is written as ``run.mcap.partial`` and gets its name when it is closed, also after a failure or Ctrl-C: only
a killed process leaves the partial file, and ``recover`` reads that.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType

from train_ato.record.definitions import definition
from train_ato.record.layout import (
    LOG,
    METADATA,
    PARTIAL,
    ChannelCount,
    log_name,
    metadata_yaml,
    qos_profiles,
    qos_text,
)
from train_ato.record.mcap_writer import McapWriter
from train_ato.topics import TOPICS, Topic

CHUNK = 256 * 1024
"""Size at which a chunk is closed [bytes]; a killed run loses what is in the open one."""
FLUSH_S = 1.0
"""Longest wall time for which messages stay in the open chunk [s]."""
_LOOK = 32


class LogFile:
    """An MCAP file under construction, in the layout of ``ros2 bag``.

    Parameters
    ----------
    folder
        Existing folder of the run.

    Raises
    ------
    ValueError
        If there is a log in the folder already or it cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / LOG
        self._partial = folder / PARTIAL
        for taken in (self.path, self._partial):
            if taken.exists():
                raise ValueError(f"{taken}: exists already; name another output folder")
        try:
            self._raw = self._partial.open("xb", buffering=0)
        except OSError as error:
            raise ValueError(f"{self._partial}: cannot be written ({error.strerror}); name a writable folder") from None
        self._stream = io.BufferedWriter(self._raw, 1 << 16)
        self._writer = McapWriter(self._stream, "ros2", "train_ato", CHUNK)
        self._schemas: dict[str, int] = {}
        self._channels: list[tuple[str, str, str, str]] = []
        self._flushed = time.monotonic()
        self._total = 0
        self.failure: str | None = None
        self.closed = False

    def channel(self, name: str, type_name: str, text: str, type_hash: str, qos: str) -> int:
        """Add a topic and return its number for :meth:`write`."""
        if type_name not in self._schemas:
            self._schemas[type_name] = self._writer.schema(type_name, "ros2msg", text.encode())
        metadata = {"offered_qos_profiles": qos, "topic_type_hash": type_hash}
        number = self._writer.channel(name, "cdr", self._schemas[type_name], metadata)
        self._channels.append((name, type_name, type_hash, qos))
        return number

    def write(self, channel: int, publish_ns: int, log_ns: int, data: bytes) -> None:
        """Add a message; times are in ns since 1970.

        Raises
        ------
        OSError
            If the disk is full or gone. Nothing is written to that file afterwards.
        """
        if self.failure is not None:
            raise OSError(self.failure)
        try:
            self._writer.add(channel, publish_ns, log_ns, data)
            self._total += 1
            if self._total % _LOOK == 0 and time.monotonic() - self._flushed > FLUSH_S:
                self._writer.flush()
                self._flushed = time.monotonic()
        except OSError as error:
            self._give_up(error)

    def flush(self) -> None:
        """Write the open chunk to the file."""
        self._guard(self._writer.flush)

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
        if self.failure is not None:
            return
        self._guard(self._finish)

    def _finish(self) -> None:
        self._writer.close_chunk()
        pairs = zip(self._channels, self._writer.counts, strict=True)
        text = metadata_yaml(LOG, [ChannelCount(*channel, count) for channel, count in pairs], *self._writer.span)
        self._writer.metadata("rosbag2", {"serialized_metadata": text})
        self._writer.finish()
        self._stream.close()
        self._partial.rename(self.path)
        (self.path.parent / METADATA).write_text(text, encoding="utf-8")

    def _guard(self, action: Callable[[], object]) -> None:
        if self.failure is not None:
            raise OSError(self.failure)
        try:
            action()
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        """Remember the failure and release the file without another write to it."""
        self.failure = (
            f"{self._partial}: writing failed ({error.strerror or error}); `train-ato recover` reads the rest"
        )
        self._raw.close()
        raise OSError(self.failure) from None


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
    """

    def __init__(self, folder: Path, topics: Sequence[Topic] = TOPICS, namespace: str = "") -> None:
        self._file = LogFile(folder)
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
