"""Writer of MCAP files with indexed, compressed chunks, attachments and checksums over every byte.

The ``mcap`` package encodes rare records. All other messages are encoded here for speed. A message of a train of 106
vehicles takes 2.5 µs of processor time without compression (6.5 µs in the package's writer) and 3.3 µs with the default
compression (12 µs there), by ``python studies_done/recorder.py``. Another thread can write the full chunks.

The messages of consecutive ticks are encoded at once. A message of every tick has a fixed length, so that all ticks
have the same bytes except for times and numbers. These are written into the records of the messages; the other messages
are put between them.
"""

import struct
import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, pairwise
from typing import BinaryIO

import numpy as np
from mcap import records as mcap_records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from numpy.typing import NDArray

from train_ato.log.compression import DEFAULT, packer
from train_ato.messages.codec import Wire
from train_ato.messages.topics import EPOCH_NS, TickBlock

MESSAGE = struct.Struct("<BQHIQQ")
"""Head of a message: record type, length, channel, sequence number, log time and publish time [ns since 1970]."""
MESSAGE_TYPE, BEFORE_DATA, BEFORE_TIMES = 5, 22, 15
"""Type of the record; length of the record without its data; place of the times in the head [bytes]."""
Index = dict[int, list[int]]
"""Log time and place of every message by channel, one after the other."""


def message_head(channel: int, publish_ns: int, log_ns: int, length: int) -> bytes:
    """Return the head of a message with a length of its data [bytes]; the sequence number is 0, as in Jazzy."""
    return MESSAGE.pack(MESSAGE_TYPE, BEFORE_DATA + length, channel, 0, log_ns, publish_ns)


class TickRecords:
    """Records of a block of ticks, with publish time = log time = stamp.

    Attributes
    ----------
    sizes : Array of int, shape (ticks,)
        Length of the records of every tick [bytes].
    """

    def __init__(self, block: TickBlock, wire: Wire, channels: Mapping[str, int]) -> None:
        self._times: NDArray[np.int64] = block.stamps + EPOCH_NS
        self._channels = [channels[topic] for topic, _ in block.rows]
        records = [wire.records[topic] for topic, _ in block.rows]
        blank: list[bytes] = [
            message_head(channel, 0, 0, len(record.blank)) + record.blank
            for channel, record in zip(self._channels, records, strict=True)
        ]
        self._starts = [0, *accumulate(map(len, blank))]
        self._length = self._starts[-1]
        ticks = np.tile(np.frombuffer(b"".join(blank), np.uint8), (self._times.size, 1))
        for record, (_, values), (start, end) in zip(records, block.rows, pairwise(self._starts), strict=True):
            begin = start + MESSAGE.size
            ticks[:, start + BEFORE_TIMES : begin].view("<u8")[:] = self._times[:, None]
            record.fill(ticks[:, begin:end].view(record.dtype)[:, 0], block.stamps, values)
        self._ticks = memoryview(ticks.ravel())  # type: ignore[arg-type]
        self._between: dict[int, list[tuple[int, int, bytes]]] = {}
        self.sizes = np.full(self._times.size, self._length, dtype=np.int64)
        for tick, messages in block.between.items():
            time, added = int(self._times[tick]), []
            for before, topic, message in messages:
                content = wire.encode(topic, message)
                whole = message_head(channels[topic], time, time, len(content)) + content
                added.append((before, channels[topic], whole))
                self.sizes[tick] += len(whole)
            self._between[tick] = added

    def part(self, first: int, end: int, place: int) -> tuple[bytes, Index]:
        """Return the records of some ticks and their index, for a place in the chunk [bytes]."""
        begins = place + np.concatenate(([0], np.cumsum(self.sizes[first : end - 1])))
        places = begins[:, None] + np.array(self._starts[:-1])
        parts: list[bytes | memoryview] = []
        others: Index = {}
        for tick in range(first, end):
            row = self._ticks[tick * self._length : (tick + 1) * self._length]
            if tick not in self._between:
                parts.append(row)
                continue
            time, done, added = int(self._times[tick]), 0, 0
            for before, channel, record in self._between[tick]:
                cut = self._starts[before]
                parts += [row[done:cut], record]
                others.setdefault(channel, []).extend((time, int(begins[tick - first]) + cut + added))
                done, added = cut, added + len(record)
                places[tick - first, before:] += len(record)
            parts.append(row[done:])
        times, index = self._times[first:end], others
        for channel, column in zip(self._channels, places.T, strict=True):
            index[channel] = np.column_stack((times, column)).ravel().tolist()
        return b"".join(parts), index


MAGIC = b"\x89MCAP0\r\n"
_INDEX = struct.Struct("<BQHI")


def _bytes(record: mcap_records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


@dataclass
class OpenChunk:
    """Chunk under construction.

    Attributes
    ----------
    data : bytearray
        Encoded records.
    index : list of list of int
        Log times [ns] and offsets of the messages in alternation, per channel.
    opened : float or None
        Steady-clock time of the first message [s], None before it.
    """

    data: bytearray = field(default_factory=bytearray)
    index: list[list[int]] = field(default_factory=list)
    opened: float | None = None


class McapWriter:
    """Writer of one MCAP file.

    Parameters
    ----------
    stream
        Open binary file; the caller closes it.
    profile, library
        Texts of the header.
    compression
        One of :data:`train_ato.log.compression.COMPRESSIONS`.
    """

    def __init__(self, stream: BinaryIO, profile: str, library: str, compression: str = DEFAULT) -> None:
        self._stream = stream
        self._compression, self._pack = packer(compression)
        self._place = 0
        self._sum = 0
        self._schemas: list[mcap_records.Schema] = []
        self._channels: list[mcap_records.Channel] = []
        self._chunks: list[mcap_records.ChunkIndex] = []
        self._metadata: list[mcap_records.MetadataIndex] = []
        self._attachments: list[mcap_records.AttachmentIndex] = []
        self._taken: list[int] = []
        self._chunk = OpenChunk()
        self.span = (0, 0)
        self._write(MAGIC)
        self._write(_bytes(mcap_records.Header(profile, library)))

    def _write(self, data: bytes) -> None:
        self._stream.write(data)
        self._place += len(data)
        self._sum = zlib.crc32(data, self._sum)

    @property
    def counts(self) -> list[int]:
        """Number of messages per channel, in the order of the channels."""
        return [taken + len(entries) // 2 for taken, entries in zip(self._taken, self._chunk.index, strict=True)]

    @property
    def size(self) -> int:
        """Size of the open chunk [bytes]."""
        return len(self._chunk.data)

    @property
    def opened(self) -> float | None:
        """Steady-clock time of the first message in the open chunk [s], None for an empty chunk."""
        return self._chunk.opened

    def schema(self, name: str, encoding: str, text: bytes) -> int:
        """Add a schema and return its number."""
        self._schemas.append(mcap_records.Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=text))
        self._chunk.data += _bytes(self._schemas[-1])
        return len(self._schemas)

    def channel(self, topic: str, encoding: str, schema: int, metadata: dict[str, str]) -> int:
        """Add a channel and return its number."""
        number = len(self._channels) + 1
        channel = mcap_records.Channel(
            id=number, topic=topic, message_encoding=encoding, schema_id=schema, metadata=metadata
        )
        self._channels.append(channel)
        self._taken.append(0)
        self._chunk.index.append([])
        self._chunk.data += _bytes(channel)
        return number

    def add(self, channel: int, publish_ns: int, log_ns: int, data: bytes) -> int:
        """Add a message and return the size of the open chunk [bytes].

        The sequence number is 0, as in the bags of Jazzy.
        """
        chunk = self._chunk
        records = chunk.data
        if chunk.opened is None:
            chunk.opened = time.monotonic()
        chunk.index[channel - 1] += (log_ns, len(records))
        records += message_head(channel, publish_ns, log_ns, len(data))
        records += data
        return len(records)

    def add_ticks(self, records: TickRecords, first: int, end: int) -> int:
        """Add the messages of some ticks of a block and return the size of the open chunk [bytes]."""
        chunk = self._chunk
        if chunk.opened is None:
            chunk.opened = time.monotonic()
        data, index = records.part(first, end, len(chunk.data))
        chunk.data += data
        for channel, entries in index.items():
            chunk.index[channel - 1] += entries
        return len(chunk.data)

    def take_chunk(self) -> OpenChunk | None:
        """Return the open chunk for :meth:`write_chunk` and begin a new one; None for an empty chunk."""
        chunk = self._chunk
        if chunk.opened is None:
            return None
        self._taken = self.counts
        self._chunk = OpenChunk(index=[[] for _ in chunk.index])
        return chunk

    def write_chunk(self, chunk: OpenChunk) -> None:
        """Write a chunk with its indexes and flush the stream."""
        packed = self._pack(chunk.data)
        begin = self._place
        first = min(min(entries[::2]) for entries in chunk.index if entries)
        last = max(max(entries[::2]) for entries in chunk.index if entries)
        self._write(
            _bytes(
                mcap_records.Chunk(
                    compression=self._compression,
                    data=packed,
                    message_start_time=first,
                    message_end_time=last,
                    uncompressed_crc=zlib.crc32(chunk.data),
                    uncompressed_size=len(chunk.data),
                )
            )
        )
        length, offsets = self._place - begin, {}
        index_begin = self._place
        for number, entries in enumerate(chunk.index, 1):
            if entries:
                offsets[number] = self._place
                size = 8 * len(entries)
                self._write(_INDEX.pack(7, 6 + size, number, size) + struct.pack(f"<{len(entries)}Q", *entries))
        span = (first, last) if not self._chunks else (min(self.span[0], first), max(self.span[1], last))
        self._chunks.append(
            mcap_records.ChunkIndex(
                chunk_length=length,
                chunk_start_offset=begin,
                compression=self._compression,
                compressed_size=len(packed),
                message_end_time=last,
                message_index_length=self._place - index_begin,
                message_index_offsets=offsets,
                message_start_time=first,
                uncompressed_size=len(chunk.data),
            )
        )
        self.span = span
        self._stream.flush()

    def attachment(self, name: str, media_type: str, data: bytes, moment_ns: int) -> None:
        """Add an attachment with the time ``moment_ns`` [ns since 1970]."""
        record = _bytes(mcap_records.Attachment(moment_ns, moment_ns, name, media_type, data))
        self._attachments.append(
            mcap_records.AttachmentIndex(self._place, len(record), moment_ns, moment_ns, len(data), name, media_type)
        )
        self._write(record)

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Add a metadata record."""
        data = _bytes(mcap_records.Metadata(name=name, metadata=values))
        self._metadata.append(mcap_records.MetadataIndex(offset=self._place, length=len(data), name=name))
        self._write(data)

    def finish(self) -> None:
        """Write the summary and the footer, after the last chunk."""
        self._write(_bytes(mcap_records.DataEnd(self._sum)))
        start = self._place
        groups: tuple[tuple[Opcode, Sequence[mcap_records.McapRecord]], ...] = (
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        )
        summary, offsets = bytearray(), bytearray()
        for code, records in groups:
            begin = len(summary)
            for record in records:
                summary += _bytes(record)
            if records:
                offsets += _bytes(mcap_records.SummaryOffset(code, start + begin, len(summary) - begin))
        offset_start = start + len(summary)
        summary += offsets
        head = struct.pack("<BQQQ", Opcode.FOOTER, 8 + 8 + 4, start, offset_start)
        self._write(bytes(summary))
        self._write(_bytes(mcap_records.Footer(start, offset_start, zlib.crc32(head, zlib.crc32(summary)))))
        self._write(MAGIC)
        self._stream.flush()

    def _statistics(self) -> mcap_records.Statistics:
        return mcap_records.Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts={at + 1: count for at, count in enumerate(self._taken) if count},
            chunk_count=len(self._chunks),
            message_count=sum(self._taken),
            message_end_time=self.span[1],
            message_start_time=self.span[0],
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
