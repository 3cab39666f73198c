"""Chunks of an MCAP file: check of lengths and checksum, and decompression."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import zstandard

from train_ato.log.mcap_records import Damage

__all__ = ["ChunkHead", "chunk_content", "chunk_head"]

_CHUNK = struct.Struct("<QQQII")
_LONG = struct.Struct("<Q")
_LARGEST_CHUNK = 1 << 29
"""Maximum uncompressed size of a valid chunk [bytes]."""


@dataclass(frozen=True)
class ChunkHead:
    """Head of a chunk; ``begin`` is the offset of the compressed part in the content of the record."""

    uncompressed: int
    crc: int
    compression: str
    begin: int


def chunk_head(content: bytes) -> ChunkHead:
    """Return the head of a chunk.

    Raises
    ------
    Damage
        If its lengths are inconsistent.
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
    """Return the uncompressed records of a chunk.

    Raises
    ------
    Damage
        If the chunk cannot be unpacked or its checksum differs.
    """
    head = chunk_head(content)
    packed = content[head.begin :]
    data = _unpacked(packed, head)
    if len(data) != head.uncompressed:
        raise Damage("the length of a chunk differs from its head")
    if head.crc and zlib.crc32(data) != head.crc:
        raise Damage("the checksum of a chunk differs")
    return data


def _unpacked(packed: bytes, head: ChunkHead) -> bytes:
    if head.compression == "":
        return packed
    try:
        if head.compression == "zstd":
            size = zstandard.get_frame_parameters(packed).content_size
            if size not in (head.uncompressed, zstandard.CONTENTSIZE_UNKNOWN):
                raise Damage("the length of a chunk differs from its head")
            return zstandard.ZstdDecompressor().decompress(packed, max_output_size=head.uncompressed)
        if head.compression == "lz4":
            import lz4.frame

            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=head.uncompressed))
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
        raise Damage(f"a chunk cannot be unpacked ({' '.join(str(error).split())})") from None
    raise Damage(f"a chunk is packed with '{head.compression[:16]}'")
