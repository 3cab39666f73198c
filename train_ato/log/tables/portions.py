"""Messages of a log in portions: hundreds of payloads of one channel at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.records import Channel, Schema

from train_ato.log.mcap_records import NO_SCHEMA, Definitions
from train_ato.log.reading import Progress, blocks, readable

__all__ = ["KeptMessages", "Portion", "Reader"]

PORTION = 2**20
"""Size of a portion [bytes]: large enough for a low cost per message, small enough for a cache."""
MAX_KEPT = 2**30
"""Maximum size of the messages of variable length of one log [bytes]."""


@dataclass
class Portion:
    """Messages of one channel in the order of the file.

    Attributes
    ----------
    payloads : list of memoryview
        CDR bytes of every message.
    publish_ns : list of int
        Publish times [ns since 1970].
    """

    channel: Channel
    schema: Schema
    payloads: list[memoryview] = field(default_factory=list)
    publish_ns: list[int] = field(default_factory=list)


class KeptMessages(dict[str, list[bytes]]):
    """Messages of variable length by topic, up to :data:`MAX_KEPT` bytes."""

    def __init__(self) -> None:
        super().__init__()
        self._size = 0

    def take(self, topic: str) -> list[bytes]:
        """Return the messages of a topic and remove them."""
        self._size -= sum(map(len, self[topic]))
        return self.pop(topic)

    def keep(self, topic: str, payloads: Iterable[bytes | memoryview]) -> None:
        """Add messages of a topic.

        Raises
        ------
        ValueError
            If all kept messages are larger than :data:`MAX_KEPT`.
        """
        kept = self.setdefault(topic, [])
        for payload in payloads:
            self._size += len(payload)
            if self._size > MAX_KEPT:
                raise ValueError(
                    f"more than {MAX_KEPT >> 20} MiB of profiles, limits and diagnostics; name another log"
                )
            kept.append(bytes(payload))


class Reader:
    """Reader of the messages of selected channels, per channel in the order of the file.

    Parameters
    ----------
    path
        MCAP file, with or without chunks.
    wanted
        Selection of channels, called once per channel.
    progress
        Receiver of the fraction of the file that is read, 0 to 1.

    Attributes
    ----------
    first_ns : int or None
        Publish time of the first message of the file [ns since 1970].
    """

    def __init__(self, path: Path, wanted: Callable[[Channel, Schema], bool], progress: Progress | None = None) -> None:
        self.first_ns: int | None = None
        self._path, self._wanted, self._progress = path, wanted, progress
        self._known = Definitions()
        self._open: dict[int, Portion | None] = {}

    @property
    def channels(self) -> list[tuple[Channel, Schema]]:
        """All channels read so far, selected or not."""
        schemas = self._known.schemas
        return [(channel, schemas.get(channel.schema_id, NO_SCHEMA)) for channel in self._known.channels.values()]

    def portions(self) -> Iterator[Portion]:
        """Yield the portions of the file.

        Raises
        ------
        ValueError
            If the file is not a log, incomplete or damaged: one line with its name.
        """
        size = 0
        with readable(self._path):
            for block in blocks(self._path, self._progress):
                self._take(block)
                size += len(block)
                if size > PORTION:
                    yield from self._closed()
                    size = 0
        yield from self._closed()

    def _closed(self) -> Iterator[Portion]:
        """Yield and clear the collected portions."""
        for number, portion in self._open.items():
            if portion is not None and portion.payloads:
                self._open[number] = Portion(portion.channel, portion.schema)
                yield portion

    def _take(self, block: bytes) -> None:
        """Collect the messages of a block."""
        view, portions = memoryview(block), self._open
        for number, _, publish_ns, begin, end in self._known.walk(block):
            if number not in portions:
                kind = self._known.kind(number)
                portions[number] = Portion(*kind) if self._wanted(*kind) else None
                self.first_ns = publish_ns if self.first_ns is None else self.first_ns
            portion = portions[number]
            if portion is not None:
                portion.payloads.append(view[begin:end])
                portion.publish_ns.append(publish_ns)
