"""Reading the log of a run."""

from __future__ import annotations

import fcntl
import struct
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from train_ato.record.layout import LOG, PARTIAL, table_name
from train_ato.record.records import Damage, attachment_of, channel_of, chunk_content, records, schema_of
from train_ato.topics import EPOCH_NS

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_MESSAGE_CODE = 5
NO_SCHEMA = Schema(id=0, name="", encoding="", data=b"")
"""What number 0 of a channel means: its messages, JSON for one, need no schema."""


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
        If there is none, or only that of a run which was killed or still goes on.
    """
    path = run / LOG if run.is_dir() else run
    partial = partial_of(run)
    if partial is not None:
        raise ValueError(f"{partial}: {state_of(partial)}")
    if not path.is_file():
        raise ValueError(f"{path}: no such log; name a run folder or an MCAP file")
    return path


def partial_of(run: Path) -> Path | None:
    """Return the log that was never closed, where a run has no other."""
    partial = run / PARTIAL if run.is_dir() else run
    if partial.suffix != ".partial" or not partial.is_file() or (run.is_dir() and (run / LOG).is_file()):
        return None
    return partial


def state_of(partial: Path) -> str:
    """Say what became of the run whose log was not closed, and what to do."""
    if being_written(partial):
        return "the run still goes on; wait for its end, or end it with Ctrl-C"
    return f"the run was killed; `train-ato recover {partial}` makes its log readable"


def being_written(path: Path) -> bool:
    """Tell whether a process has a log open for writing: it holds a lock on the file."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


@dataclass
class Definitions:
    """Schemas and channels met so far, by their numbers."""

    schemas: dict[int, Schema] = field(default_factory=lambda: {0: NO_SCHEMA})
    channels: dict[int, Channel] = field(default_factory=dict)

    def take(self, code: int, content: bytes) -> None:
        """Take a record if it is a schema or a channel."""
        if code == Opcode.SCHEMA:
            schema = schema_of(content)
            self.schemas[schema.id] = schema
        elif code == Opcode.CHANNEL:
            channel = channel_of(content)
            self.channels[channel.id] = channel

    def messages(self, data: bytes) -> Iterator[RawMessage]:
        """Walk the records inside a chunk; messages are taken apart here, a general reader is ten times slower.

        Raises
        ------
        Damage
            If a record reaches beyond the chunk, or a message belongs to no known channel.
        """
        channels, schemas = self.channels, self.schemas
        place, end = 0, len(data)
        try:
            while place < end:
                code, length = _RECORD.unpack_from(data, place)
                begin = place + 9
                place = begin + length
                if place > end:
                    raise Damage("a record reaches beyond its chunk")
                if code == _MESSAGE_CODE:
                    number, _, log_ns, publish_ns = _MESSAGE.unpack_from(data, begin)
                    channel = channels[number]
                    schema = schemas[channel.schema_id]
                    yield RawMessage(channel, schema, publish_ns, log_ns, data[begin + 22 : place])
                else:
                    self.take(code, data[begin:place])
        except (struct.error, KeyError) as error:
            raise Damage(f"a chunk holds what it cannot ({type(error).__name__}: {error})") from None


Progress = Callable[[float], None]
"""Takes the share of a work that is done, 0 to 1."""


def stream(path: Path, *, broken: bool = False, progress: Progress | None = None) -> Iterator[RawMessage]:
    """Read a log from its beginning, message by message, in the order in which it was written.

    Every chunk is checked before its first message is handed out, the file as a whole at its end.

    Parameters
    ----------
    path
        MCAP file.
    broken
        End quietly at the first damage, also where the file breaks off, as a killed run leaves it.
    progress
        Takes the share of the file that is read, chunk by chunk.

    Raises
    ------
    ValueError
        If the file is no log or damaged.
    """
    known = Definitions()
    try:
        with path.open("rb") as file:
            size, done = max(1, path.stat().st_size), 0
            for record in records(file, size):
                done += len(record.content)
                if record.code == Opcode.CHUNK:
                    yield from known.messages(chunk_content(record.content))
                    if progress is not None:
                        progress(done / size)
                elif record.code == Opcode.MESSAGE:
                    yield from known.messages(_RECORD.pack(record.code, len(record.content)) + record.content)
                else:
                    known.take(record.code, record.content)
    except Damage as damage:
        if not broken:
            raise ValueError(_complaint(path, damage)) from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None


def _complaint(path: Path, damage: Damage) -> str:
    return f"{path}: damaged or no log: {damage}; `train-ato recover {path}` saves what is whole"


def attachments(path: Path, *, broken: bool = False) -> dict[str, bytes]:
    """Return the files that are attached to a log, by their names.

    Parameters
    ----------
    path
        MCAP file.
    broken
        End quietly at the first damage.

    Raises
    ------
    ValueError
        If the file is no log or damaged.
    """
    found = {}
    try:
        with path.open("rb") as file:
            for record in records(file, path.stat().st_size):
                if record.code == Opcode.ATTACHMENT:
                    entry = attachment_of(record.content)
                    found[entry.name] = entry.data
    except Damage as damage:
        if not broken:
            raise ValueError(_complaint(path, damage)) from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None
    return found


def iter_raw(
    run: Path, topics: Collection[str] | None = None, progress: Progress | None = None
) -> Iterator[tuple[str, int, bytes]]:
    """Read the messages of a run as (topic of the table, publish stamp, CDR bytes), in the order of the log.

    Parameters
    ----------
    run
        Run folder or MCAP file.
    topics
        Names in the table; default: all.
    progress
        Takes the share of the file that is read.
    """
    known: dict[str, str | None] = {}
    for message in stream(log_file(run), progress=progress):
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
