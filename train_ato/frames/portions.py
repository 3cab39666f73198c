"""The messages of a log in portions: hundreds of payloads of one channel at once, never one at a time."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from train_ato.record.reading import NO_SCHEMA
from train_ato.record.records import Damage, channel_of, chunk_content, records, schema_of

__all__ = ["Portion", "Reader"]

PORTION = 2**20
"""Bytes of messages that are taken apart together: enough to spread the cost of a step, little enough for a cache."""
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_RECORD = struct.Struct("<BQHIQQ")
_CODE = int(Opcode.MESSAGE)


@dataclass
class Portion:
    """Some messages of one channel, in the order of the file.

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


class Reader:
    """Reads the messages of the wanted channels; those of one channel come in the order of the file.

    Parameters
    ----------
    path
        MCAP file, chunked or not.
    wanted
        Asked once for every channel.
    progress
        Takes the share of the file that is read, 0 to 1.

    Attributes
    ----------
    channels : list of (Channel, Schema)
        Every channel met so far, wanted or not.
    first_ns : int or None
        Publish time of the first message of the file [ns since 1970].
    """

    def __init__(
        self,
        path: Path,
        wanted: Callable[[Channel, Schema], bool],
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self._progress = progress
        self.channels: list[tuple[Channel, Schema]] = []
        self.first_ns: int | None = None
        self._path = path
        self._wanted = wanted
        self._schemas: dict[int, Schema] = {}
        self._open: dict[int, Portion | None] = {}
        self._size = 0

    def portions(self) -> Iterator[Portion]:
        """Read the file from its beginning to its end.

        Raises
        ------
        ValueError
            If the file is no log, cut off or damaged: one line that names it.
        """
        try:
            with self._path.open("rb") as file:
                size, done = max(1, self._path.stat().st_size), 0
                for record in records(file, size):
                    done += len(record.content)
                    if record.code == Opcode.CHUNK:
                        content = chunk_content(record.content)
                        self._walk(content)
                        self._size += len(content)
                    elif record.code in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                        self._walk(_HEAD.pack(record.code, len(record.content)) + record.content)
                        self._size += len(record.content)
                    if self._size > PORTION:
                        yield from self._closed()
                        if self._progress is not None:
                            self._progress(done / size)
        except Damage as damage:
            text = f"{self._path}: damaged or no log: {damage}; `train-ato recover {self._path}` saves what is whole"
            raise ValueError(text) from None
        except OSError as error:
            raise ValueError(f"{self._path}: cannot be read ({error.strerror})") from None
        yield from self._closed()

    def _closed(self) -> Iterator[Portion]:
        """Hand over what was collected."""
        for number, portion in self._open.items():
            if portion is not None and portion.payloads:
                self._open[number] = Portion(portion.channel, portion.schema)
                yield portion
        self._size = 0

    def _walk(self, data: bytes) -> None:
        """Take the records of a chunk."""
        view, channels, unpack = memoryview(data), self._open, _RECORD.unpack_from
        place, end = 0, len(data)
        try:
            while place < end:
                if data[place] == _CODE:
                    _, length, number, _, _, publish_ns = unpack(data, place)
                    stop = place + 9 + length
                    if stop > end or length < _MESSAGE.size:
                        raise Damage("a message reaches beyond its chunk")
                    portion = channels[number]
                    if portion is not None:
                        portion.payloads.append(view[place + 31 : stop])
                        portion.publish_ns.append(publish_ns)
                    if self.first_ns is None:
                        self.first_ns = publish_ns
                else:
                    code, length = _HEAD.unpack_from(data, place)
                    stop = place + _HEAD.size + length
                    if stop > end:
                        raise Damage("a record reaches beyond its chunk")
                    self._declare(code, data[place + _HEAD.size : stop])
                place = stop
        except (struct.error, KeyError) as error:
            raise Damage(f"a chunk holds what it cannot ({type(error).__name__}: {error})") from None

    def _declare(self, code: int, content: bytes) -> None:
        """Take a schema or a channel; they are said again behind the messages."""
        if code == Opcode.SCHEMA:
            schema = schema_of(content)
            self._schemas.setdefault(schema.id, schema)
        elif code == Opcode.CHANNEL:
            channel = channel_of(content)
            if channel.id not in self._open:
                schema = self._schemas.get(channel.schema_id) or NO_SCHEMA
                self.channels.append((channel, schema))
                self._open[channel.id] = Portion(channel, schema) if self._wanted(channel, schema) else None
