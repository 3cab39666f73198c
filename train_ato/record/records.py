"""Records of an MCAP file, one after the other, with every length and every checksum looked at.

The reader of the ``mcap`` package believes lengths and skips what it does not know: a single wrong bit can make it
read gigabytes or lose a chunk without a word.  Here whatever does not fit is a :class:`Damage`.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Schema

from train_ato.record.mcap_writer import MAGIC

_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_LONG = struct.Struct("<Q")
_WORD = struct.Struct("<I")
_KNOWN = frozenset(int(code) for code in Opcode)
_PRIVATE = 0x80
_LARGEST_CHUNK = 1 << 30
"""Uncompressed size beyond which a chunk is taken for damaged [bytes]."""
_SKIPPED = frozenset((int(Opcode.MESSAGE_INDEX), int(Opcode.CHUNK_INDEX), int(Opcode.SUMMARY_OFFSET)))


class Damage(Exception):
    """Something in a file that cannot be; the text says what."""


@dataclass(frozen=True)
class Record:
    """One record: its code and its content."""

    code: int
    content: bytes


def records(file: BinaryIO, size: int) -> Iterator[Record]:
    """Read the records of a file from its beginning to its footer; those that only serve as an index are left out.

    Parameters
    ----------
    file
        Open at its beginning.
    size
        Its length [bytes].

    Raises
    ------
    Damage
        If a record cannot be one, the file breaks off, or a checksum over a section differs.
    """
    if file.read(len(MAGIC)) != MAGIC:
        raise Damage("it does not begin like an MCAP file")
    place, total = len(MAGIC), zlib.crc32(MAGIC)
    while True:
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise Damage(f"it breaks off at byte {size}")
        code, length = _HEAD.unpack(head)
        if not (code in _KNOWN or code >= _PRIVATE):
            raise Damage(f"there is no record of kind {code} (byte {place})")
        if length > size - place - len(head):
            raise Damage(f"it breaks off inside the record at byte {place}")
        content = file.read(length)
        if code == Opcode.DATA_END:
            _check(content, total, "data section")
            total = 0
        elif code == Opcode.FOOTER:
            total = zlib.crc32(content[:16], zlib.crc32(head, total))
            _check(content[16:], total, "summary")
        else:
            total = zlib.crc32(content, zlib.crc32(head, total))
        place += len(head) + length
        if code not in _SKIPPED:
            yield Record(code, content)
        if code == Opcode.FOOTER:
            if file.read(len(MAGIC) + 1) != MAGIC:
                raise Damage("it does not end like an MCAP file")
            return


def _check(stored: bytes, found: int, what: str) -> None:
    """Compare a checksum with the one that stands in the file; 0 means that the writer made none."""
    if len(stored) != _WORD.size:
        raise Damage(f"the checksum of the {what} is missing")
    (wanted,) = _WORD.unpack(stored)
    if wanted not in (0, found):
        raise Damage(f"the checksum of the {what} differs")


@dataclass(frozen=True)
class ChunkHead:
    """What stands before the compressed part of a chunk; ``begin`` is where that starts in the record's content."""

    uncompressed: int
    crc: int
    compression: str
    begin: int


def chunk_head(content: bytes) -> ChunkHead:
    """Return the head of a chunk whose lengths fit together.

    Raises
    ------
    Damage
        If they do not.
    """
    try:
        _, _, uncompressed, crc, letters = _CHUNK.unpack_from(content)
        begin = _CHUNK.size + letters + _LONG.size
        (length,) = _LONG.unpack_from(content, _CHUNK.size + letters)
        compression = content[_CHUNK.size : _CHUNK.size + letters].decode("ascii")
    except (struct.error, UnicodeDecodeError):
        raise Damage("a chunk without a readable head") from None
    if begin + length != len(content) or uncompressed > _LARGEST_CHUNK:
        raise Damage("the lengths of a chunk do not fit")
    return ChunkHead(uncompressed, crc, compression, begin)


def chunk_content(content: bytes) -> bytes:
    """Return the records inside a chunk, one after the other.

    Raises
    ------
    Damage
        If the chunk cannot be unpacked or its checksum differs.
    """
    head = chunk_head(content)
    packed = content[head.begin :]
    data = _unpacked(packed, head)
    if len(data) != head.uncompressed:
        raise Damage("a chunk has another length than it says")
    if head.crc and zlib.crc32(data) != head.crc:
        raise Damage("the checksum of a chunk differs")
    return data


def _unpacked(packed: bytes, head: ChunkHead) -> bytes:
    if head.compression == "":
        return packed
    try:
        if head.compression == "zstd":
            told = zstandard.get_frame_parameters(packed).content_size
            if told not in (head.uncompressed, zstandard.CONTENTSIZE_UNKNOWN):
                raise Damage("a chunk has another length than it says")
            return zstandard.ZstdDecompressor().decompress(packed, max_output_size=head.uncompressed)
        if head.compression == "lz4":
            import lz4.frame

            return bytes(lz4.frame.decompress(packed))
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
        raise Damage(f"a chunk cannot be unpacked ({' '.join(str(error).split())})") from None
    raise Damage(f"a chunk is packed with '{head.compression[:16]}'")


def schema_of(content: bytes) -> Schema:
    """Return a schema.

    Raises
    ------
    Damage
        If the record is none.
    """
    try:
        found: Schema = Schema.read(ReadDataStream(BytesIO(content)))
    except Exception as error:
        raise Damage(f"a schema cannot be read ({type(error).__name__})") from None
    return found


def channel_of(content: bytes) -> Channel:
    """Return a channel.

    Raises
    ------
    Damage
        If the record is none.
    """
    try:
        found: Channel = Channel.read(ReadDataStream(BytesIO(content)))
    except Exception as error:
        raise Damage(f"a channel cannot be read ({type(error).__name__})") from None
    return found


def attachment_of(content: bytes) -> Attachment:
    """Return an attachment whose checksum is right.

    Raises
    ------
    Damage
        If the record is none, or was changed.
    """
    if len(content) < _WORD.size:
        raise Damage("an attachment cannot be read")
    _check(content[-_WORD.size :], zlib.crc32(content[: -_WORD.size]), "attachment")
    try:
        found: Attachment = Attachment.read(ReadDataStream(BytesIO(content)))
    except Exception as error:
        raise Damage(f"an attachment cannot be read ({type(error).__name__})") from None
    return found
