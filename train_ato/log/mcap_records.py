"""Reader of the records of an MCAP file with a check of every length and checksum.

The reader of the ``mcap`` package does not check lengths and skips unknown records: with a single wrong bit it can
read gigabytes or lose a chunk without an error.  Here every inconsistency is a :class:`Damage`.
"""

import mmap
import re
import shlex
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, ChunkIndex, Metadata, Schema, Statistics

from train_ato.log.mcap_writer import MAGIC

HEAD = struct.Struct("<BQ")
"""Code and length of a record."""
_MESSAGE = struct.Struct("<BQHIQQ")
_FOOTER = struct.Struct("<BQQQI")
_WORD = struct.Struct("<I")
MAX_TIME_NS = 2**63 - 1
"""Largest time of a message [ns since 1970], that of ROS 2."""
_MESSAGE_CODE = int(Opcode.MESSAGE)
_KNOWN = frozenset(int(code) for code in Opcode)
_PRIVATE = 0x80
_SKIPPED = frozenset((int(Opcode.MESSAGE_INDEX), int(Opcode.CHUNK_INDEX), int(Opcode.SUMMARY_OFFSET)))

NO_SCHEMA = Schema(id=0, name="", encoding="", data=b"")
"""Schema 0 of a channel without a schema, for example with JSON messages."""


class Damage(Exception):
    """Damage of a file, with its description."""


def records(file: BinaryIO, size: int) -> Iterator[tuple[int, bytes]]:
    """Yield code and content of the records of a file from its begin to its footer, without index records.

    Parameters
    ----------
    file
        File, open at its begin.
    size
        Length of the file [bytes].

    Raises
    ------
    Damage
        If a record is not valid, the file is incomplete, or the checksum of a section differs.
    """
    if file.read(len(MAGIC)) != MAGIC:
        raise Damage("it has no MCAP signature")
    place, total = len(MAGIC), zlib.crc32(MAGIC)
    while True:
        head = file.read(HEAD.size)
        if len(head) < HEAD.size:
            raise Damage(f"it breaks off at byte {size}")
        code, length = HEAD.unpack(head)
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
            yield code, content
        if code == Opcode.FOOTER:
            if file.read(len(MAGIC) + 1) != MAGIC:
                raise Damage("it does not end like an MCAP file")
            return


def _check(stored: bytes, found: int, what: str) -> None:
    """Compare a checksum with the stored one; a stored 0 means no checksum."""
    if len(stored) != _WORD.size:
        raise Damage(f"the checksum of the {what} is missing")
    (wanted,) = _WORD.unpack(stored)
    if wanted not in (0, found):
        raise Damage(f"the checksum of the {what} differs")


def _parsed(kind: type[Any], content: bytes, what: str) -> Any:
    """Return a record of the ``mcap`` package; raise :class:`Damage` if the bytes are not such a record."""
    try:
        return kind.read(ReadDataStream(BytesIO(content)))
    except Exception as error:
        raise Damage(f"{what} cannot be read ({type(error).__name__})") from None


def attachment_of(content: bytes) -> Attachment:
    """Return an attachment; raise :class:`Damage` if the record is none, or its checksum differs."""
    if len(content) < _WORD.size:
        raise Damage("an attachment cannot be read")
    _check(content[-_WORD.size :], zlib.crc32(content[: -_WORD.size]), "attachment")
    found: Attachment = _parsed(Attachment, content, "an attachment")
    return found


def metadata_of(content: bytes) -> Metadata:
    """Return a metadata record; raise :class:`Damage` if the record is none."""
    found: Metadata = _parsed(Metadata, content, "a metadata record")
    return found


class RawMessage(NamedTuple):
    """Message of a log with channel, schema, times [ns since 1970] and CDR bytes."""

    channel: Channel
    schema: Schema
    publish_ns: int
    log_ns: int
    data: bytes


@dataclass
class Definitions:
    """Schemas and channels by number, as read so far."""

    schemas: dict[int, Schema] = field(default_factory=lambda: {0: NO_SCHEMA})
    channels: dict[int, Channel] = field(default_factory=dict)

    def take(self, code: int, content: bytes) -> None:
        """Add a record if it is a schema or a channel."""
        if code == Opcode.SCHEMA:
            schema: Schema = _parsed(Schema, content, "a schema")
            if schema.encoding.startswith("ros2") and schema.name.count("/") == 1:  # as some writers call it
                schema.name = schema.name.replace("/", "/msg/")
            self.schemas[schema.id] = schema
        elif code == Opcode.CHANNEL:
            channel: Channel = _parsed(Channel, content, "a channel")
            self.channels[channel.id] = channel

    def kind(self, number: int) -> tuple[Channel, Schema]:
        """Return a channel and the schema of its messages; raise :class:`Damage` if one of them is unknown."""
        try:
            channel = self.channels[number]
            return channel, self.schemas[channel.schema_id]
        except KeyError as error:
            raise Damage(f"a message belongs to an unknown channel or schema ({error})") from None

    def walk(self, data: bytes) -> Iterator[tuple[int, int, int, int, int]]:
        """Yield the places of the messages of a chunk and add its definitions.

        A general reader needs ten times as long.

        Yields
        ------
        tuple of int
            Channel number, log time and publish time [ns since 1970], begin and end of the payload in ``data``.  A
            publish time of 0 in the file, of a recorder without one, is replaced by the log time.

        Raises
        ------
        Damage
            If a record extends beyond the chunk, or a time is not one of ROS 2.
        """
        place, end, unpack = 0, len(data), _MESSAGE.unpack_from
        try:
            while place < end:
                if data[place] == _MESSAGE_CODE:
                    _, length, number, _, log_ns, publish_ns = unpack(data, place)
                    stop = place + HEAD.size + length
                    if stop > end or length < _MESSAGE.size - HEAD.size:
                        raise Damage("a message reaches beyond its chunk")
                    if log_ns > MAX_TIME_NS or publish_ns > MAX_TIME_NS:
                        raise Damage("a message has a time after the year 2262")
                    yield number, log_ns, publish_ns or log_ns, place + _MESSAGE.size, stop
                else:
                    code, length = HEAD.unpack_from(data, place)
                    stop = place + HEAD.size + length
                    if stop > end:
                        raise Damage("a record reaches beyond its chunk")
                    self.take(code, data[place + HEAD.size : stop])
                place = stop
        except struct.error as error:
            raise Damage(f"a chunk holds an impossible record ({error})") from None

    def messages(self, data: bytes) -> Iterator[RawMessage]:
        """Yield the messages of a chunk in their order; raise :class:`Damage` as :meth:`walk` does."""
        kinds: dict[int, tuple[Channel, Schema]] = {}
        for number, log_ns, publish_ns, begin, end in self.walk(data):
            if number not in kinds:
                kinds[number] = self.kind(number)
            yield RawMessage(*kinds[number], publish_ns, log_ns, data[begin:end])


@dataclass
class Summary:
    """Summary section of a file: definitions, statistics, index of the chunks in the order of the file.

    ``checked`` is False without a checksum.
    """

    checked: bool
    known: Definitions = field(default_factory=Definitions)
    statistics: Statistics | None = None
    chunks: list[ChunkIndex] = field(default_factory=list)


def summary_of(file: BinaryIO | mmap.mmap, size: int) -> Summary | None:
    """Return the summary section of an open file of length ``size`` [bytes]; None without a summary.

    Raises
    ------
    Damage
        If the end of the file is not that of an MCAP file, or the section is damaged.
    """
    if size < 2 * len(MAGIC) + _FOOTER.size:
        raise Damage("it is too short")
    end = size - len(MAGIC) - _FOOTER.size
    file.seek(end)
    code, length, begin, _, stored = _FOOTER.unpack(file.read(_FOOTER.size))
    if file.read(len(MAGIC)) != MAGIC or code != Opcode.FOOTER or length != _FOOTER.size - HEAD.size:
        raise Damage("it does not end like an MCAP file")
    if not begin:
        return None
    if not len(MAGIC) <= begin <= end:
        raise Damage("there is no summary at its place")
    file.seek(begin)
    data = file.read(size - len(MAGIC) - _WORD.size - begin)
    if stored and zlib.crc32(data) != stored:
        raise Damage("the checksum of its summary differs")
    found = Summary(bool(stored))
    place = 0
    while place < end - begin:
        code, length = HEAD.unpack_from(data, place)
        content = data[place + HEAD.size : place + HEAD.size + length]
        if code == Opcode.STATISTICS:
            found.statistics = _parsed(Statistics, content, "the statistics")
        elif code == Opcode.CHUNK_INDEX:
            found.chunks.append(_parsed(ChunkIndex, content, "the index"))
        else:
            found.known.take(code, content)
        place += HEAD.size + length
    found.chunks.sort(key=lambda chunk: chunk.chunk_start_offset)
    return found


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
    """Return the head of a chunk; raise :class:`Damage` if its lengths are inconsistent."""
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
    """Return the uncompressed records of a chunk; Damage if the chunk cannot be unpacked or its checksum differs."""
    head = chunk_head(content)
    data = _unpacked(content[head.begin :], head)
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


CHUNK = re.compile(rb"\x06.{8}.{24}.{4}(?:\x04\x00\x00\x00zstd|\x03\x00\x00\x00lz4|\x00\x00\x00\x00)", re.DOTALL)
"""Begin of a chunk: code, length, three numbers, checksum, name of the compression."""
Progress = Callable[[float], None]
"""Receiver of the completed fraction of a task, 0 to 1."""


def _is_text(path: Path) -> bool:
    """Return True if a file begins with text; the head of a log has zeros."""
    with path.open("rb") as file:
        begin = file.read(512)
    return bool(begin) and begin[0] != MAGIC[0] and not set(begin) & set(range(9))


@contextmanager
def readable(path: Path, *, broken: bool = False) -> Iterator[None]:
    """Convert damage of a file and disk errors into a one-line ValueError; with ``broken``, stop at the damage."""
    try:
        yield
    except Damage as damage:
        if not broken and _is_text(path):
            raise ValueError(f"{path}: no log: a text; name the log or the folder of a run") from None
        if not broken:
            raise ValueError(f"{path}: damaged or no log: {damage}; {_remedy(path)}") from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror or error})") from None


def _remedy(path: Path) -> str:
    """Return the remedy for a damaged file: ``recover``, unless it has neither a whole chunk nor a readable message."""
    some = any(True for _ in stream(path, broken=True))
    if not some and path.stat().st_size:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            heads = [found.start() for found in CHUNK.finditer(data)]
            some = any(HEAD.unpack_from(data, at)[1] <= len(data) - at - HEAD.size for at in heads)
    saved = f"`train-ato recover {shlex.quote(str(path))}` saves what is undamaged, if anything is"
    return saved if some else "no message in it is readable"


def blocks(path: Path, progress: Progress | None = None) -> Iterator[bytes]:
    """Read a log in blocks of records: the content of a chunk, or one record outside of chunks.

    Every chunk is verified before it is returned, the whole file at its end.

    Raises
    ------
    Damage
        If the file is not a log or damaged.
    """
    with path.open("rb") as file:
        size, done = max(1, path.stat().st_size), 0
        for code, content in records(file, size):
            done += len(content)
            if code == Opcode.CHUNK:
                yield chunk_content(content)
                if progress is not None:
                    progress(done / size)
            elif code in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                yield HEAD.pack(code, len(content)) + content


def stream(path: Path, *, broken: bool = False, progress: Progress | None = None) -> Iterator[RawMessage]:
    """Read the messages of a log in the order of writing.

    Parameters
    ----------
    path
        MCAP file.
    broken
        Stop at the first damage without an error, for example at the end of a partial file.
    progress
        Receiver of the fraction of the file that is read.
    """
    known = Definitions()
    with readable(path, broken=broken):
        for block in blocks(path, progress):
            yield from known.messages(block)
