"""Reading the log of a run."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from train_ato.record.layout import LOG, PARTIAL, table_name
from train_ato.topics import EPOCH_NS

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_MESSAGE_CODE = 5


@dataclass(frozen=True, slots=True)
class RawMessage:
    """One message of a log: name in the log, times in ns since 1970, CDR bytes."""

    channel: Channel
    schema: Schema
    publish_ns: int
    log_ns: int
    data: bytes


def log_file(run: Path) -> Path:
    """Return the log of a run: the file itself or ``run.mcap`` in its folder.

    Raises
    ------
    ValueError
        If there is none, or only that of a killed run.
    """
    path = run / LOG if run.is_dir() else run
    partial = run / PARTIAL if run.is_dir() else path
    if partial.suffix == ".partial" and partial.is_file() and not (run.is_dir() and path.is_file()):
        raise ValueError(f"{partial}: the run was killed; `train-ato recover {partial}` makes its log readable")
    if not path.is_file():
        raise ValueError(f"{path}: no such log; name a run folder or an MCAP file")
    return path


def stream(path: Path, *, broken: bool = False) -> Iterator[RawMessage]:
    """Read a log from its beginning, message by message, in the order in which it was written.

    Parameters
    ----------
    path
        MCAP file.
    broken
        End quietly where the file breaks off, as a killed run leaves it.

    Raises
    ------
    ValueError
        If the file is no log or damaged.
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    try:
        with path.open("rb") as file:
            for record in StreamReader(file, emit_chunks=True).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    channel = channels[record.channel_id]
                    schema = schemas[channel.schema_id]
                    yield RawMessage(channel, schema, record.publish_time, record.log_time, record.data)
                elif isinstance(record, Chunk):
                    yield from _chunk(record, schemas, channels)
    except (McapError, struct.error, zstandard.ZstdError, KeyError, EOFError, IndexError) as error:
        if not broken:
            raise ValueError(f"{path}: damaged or no MCAP file ({type(error).__name__}: {error})") from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None


def _chunk(chunk: Chunk, schemas: dict[int, Schema], channels: dict[int, Channel]) -> Iterator[RawMessage]:
    """Walk the records of a chunk; messages are taken apart here, the general reader is ten times slower."""
    if chunk.compression != "zstd":
        for record in breakup_chunk(chunk):
            if isinstance(record, Message):
                channel = channels[record.channel_id]
                yield RawMessage(channel, schemas[channel.schema_id], record.publish_time, record.log_time, record.data)
            elif isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
        return
    data = zstandard.decompress(chunk.data, chunk.uncompressed_size)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise McapError("checksum of a chunk differs")
    place, end = 0, len(data)
    others: list[tuple[int, int]] = []
    while place < end:
        code, length = _RECORD.unpack_from(data, place)
        place += 9
        if code == _MESSAGE_CODE:
            for begin, stop in others:
                _declare(data[begin:stop], schemas, channels)
            others.clear()
            number, _, log_ns, publish_ns = _MESSAGE.unpack_from(data, place)
            channel = channels[number]
            yield RawMessage(channel, schemas[channel.schema_id], publish_ns, log_ns, data[place + 22 : place + length])
        else:
            others.append((place - 9, place + length))
        place += length
    for begin, stop in others:
        _declare(data[begin:stop], schemas, channels)


def _declare(record: bytes, schemas: dict[int, Schema], channels: dict[int, Channel]) -> None:
    """Take a schema or channel record that stands inside a chunk."""
    plain = Chunk("", record, 0, 0, 0, len(record))
    for entry in breakup_chunk(plain):
        if isinstance(entry, Schema):
            schemas[entry.id] = entry
        elif isinstance(entry, Channel):
            channels[entry.id] = entry


def iter_raw(run: Path, topics: Collection[str] | None = None) -> Iterator[tuple[str, int, bytes]]:
    """Read the messages of a run as (topic of the table, publish stamp, CDR bytes), in the order of the log.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    topics
        Names in the table; default: all.
    """
    known: dict[str, str | None] = {}
    for message in stream(log_file(run)):
        name = message.channel.topic
        if name not in known:
            found = table_name(name)
            known[name] = found if topics is None or found in topics else None
        topic = known[name]
        if topic is not None:
            yield topic, message.publish_ns - EPOCH_NS, message.data


def read_log(
    run: Path, decode: Callable[[str, bytes], Any], topics: Collection[str] | None = None
) -> Iterator[tuple[str, int, Any]]:
    """Read the decoded messages of a run as (topic, stamp, dataclass); ``decode`` is that of its :class:`Wire`."""
    for topic, stamp, data in iter_raw(run, topics):
        yield topic, stamp, decode(topic, data)


def message_counts(run: Path) -> dict[str, int]:
    """Return the number of messages of every topic in a log."""
    counts: dict[str, int] = {}
    for message in stream(log_file(run)):
        counts[message.channel.topic] = counts.get(message.channel.topic, 0) + 1
    return counts
