"""The messages of an MCAP file in portions: thousands of payloads of one channel at once, never one at a time."""

from __future__ import annotations

import io
import mmap
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema

MAGIC = b"\x89MCAP0\r\n"
PORTION = 8 * 2**20
"""Bytes of messages that are taken apart together: enough to spread the cost of a step, little enough for a cache."""
LARGEST_CHUNK = 2**30
"""Chunks that claim to hold more bytes are damaged."""
_DAMAGE = (
    McapError, struct.error, zstandard.ZstdError, KeyError, EOFError, IndexError, RuntimeError, MemoryError,
    UnicodeDecodeError,
)  # fmt: skip
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_RECORD = struct.Struct("<BQHIQQ")


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
        MCAP file, chunked or not, compressed by zstd, lz4 or not at all.
    wanted
        Asked once for every channel.

    Attributes
    ----------
    channels : list of (Channel, Schema)
        Every channel met so far, wanted or not.
    first_ns : int or None
        Publish time of the first message of the file [ns since 1970].
    """

    def __init__(self, path: Path, wanted: Callable[[Channel, Schema], bool]) -> None:
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
            If the file is no MCAP file, cut off or damaged: one line that names it.
        """
        path = self._path
        try:
            with path.open("rb") as file:
                if path.stat().st_size < 2 * len(MAGIC):
                    raise McapError(f"it has {path.stat().st_size} bytes")
                with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                    yield from self._through(data)
        except _DAMAGE as error:
            reason = str(error).strip("'") or type(error).__name__
            raise ValueError(
                f"{path}: damaged or no MCAP file ({reason}); `train-ato recover` may save a part"
            ) from None
        except OSError as error:
            raise ValueError(f"{path}: cannot be read ({error.strerror})") from None

    def _through(self, data: mmap.mmap) -> Iterator[Portion]:
        if data[: len(MAGIC)] != MAGIC:
            raise McapError("it does not begin like one")
        place, last = len(MAGIC), len(data)
        while True:
            if place + _HEAD.size > last:
                raise McapError("it breaks off without an end")
            code, length = _HEAD.unpack_from(data, place)
            place += _HEAD.size
            if place + length > last:
                raise McapError("it breaks off inside a record")
            if code == Opcode.FOOTER:
                break
            if code == Opcode.CHUNK:
                chunk = Chunk.read(ReadDataStream(io.BytesIO(data[place : place + length])))
                self._records(_unpacked(chunk))
            elif code in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                self._records(data[place - _HEAD.size : place + length])
            place += length
            if self._size > PORTION:
                yield from self._closed()
        yield from self._closed()

    def _closed(self) -> Iterator[Portion]:
        """Hand over what was collected."""
        for number, portion in self._open.items():
            if portion is not None and portion.payloads:
                self._open[number] = Portion(portion.channel, portion.schema)
                yield portion
        self._size = 0

    def _records(self, data: bytes) -> None:
        """Take the records of a chunk."""
        view, channels = memoryview(data), self._open
        place, end = 0, len(data)
        while place < end:
            if data[place] == Opcode.MESSAGE:
                _, length, number, _, _, publish_ns = _RECORD.unpack_from(data, place)
                stop = place + _HEAD.size + length
                if stop > end or length < _MESSAGE.size:
                    raise McapError("a message reaches beyond its chunk")
                portion = channels[number]
                if self.first_ns is None:
                    self.first_ns = publish_ns
                if portion is not None:
                    portion.payloads.append(view[place + _RECORD.size : stop])
                    portion.publish_ns.append(publish_ns)
                    self._size += length
            else:
                code, length = _HEAD.unpack_from(data, place)
                stop = place + _HEAD.size + length
                if stop > end:
                    raise McapError("a record reaches beyond its chunk")
                self._declared(code, data[place + _HEAD.size : stop])
            place = stop

    def _declared(self, code: int, data: bytes) -> None:
        """Take a schema or a channel; they are said again behind the messages."""
        if code == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(io.BytesIO(data)))
            self._schemas.setdefault(schema.id, schema)
        elif code == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(io.BytesIO(data)))
            if channel.id not in self._open:
                schema = self._schemas.get(channel.schema_id) or Schema(id=0, data=b"", encoding="", name="")
                self.channels.append((channel, schema))
                self._open[channel.id] = Portion(channel, schema) if self._wanted(channel, schema) else None


def _unpacked(chunk: Chunk) -> bytes:
    """Return the records of a chunk."""
    if chunk.uncompressed_size > LARGEST_CHUNK:
        raise McapError(f"a chunk claims {chunk.uncompressed_size} bytes")
    if chunk.compression == "zstd":
        if zstandard.frame_content_size(chunk.data) not in (-1, chunk.uncompressed_size):
            raise McapError("the size of a chunk differs")
        data = zstandard.decompress(chunk.data, chunk.uncompressed_size)
    elif chunk.compression == "lz4":
        data = bytes(lz4.frame.decompress(chunk.data))
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise McapError(f"chunks are compressed by '{chunk.compression}', this reads zstd and lz4")
    if len(data) != chunk.uncompressed_size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise McapError("the checksum of a chunk differs")
    return data
