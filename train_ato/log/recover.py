"""Recovery of a damaged log, or of the log of a killed run.

Only data with a correct checksum are used. Chunks are found by their pattern at any place and verified. Schemas and
channels come from such chunks, or from a summary with a correct checksum. So every recovered message was recorded.
Messages outside of chunks, as ``fastwrite`` of ``ros2 bag`` writes them, have no checksum of their own. If such a file
breaks off, all its whole records are used.

``ros2 bag`` and ``rosbags`` open a bag by its ``metadata.yaml``. They refuse a log if this file is missing or belongs
to another log. Therefore it is checked and repaired beside an undamaged log.
"""

import mmap
import shutil
import struct
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Attachment

from plant_sim.data_text import parse_yaml
from train_ato.log import mcap_records as records
from train_ato.log.bag_layout import LOG, METADATA, NEVER, PARTIAL, ChannelCount, bag_information, metadata_yaml
from train_ato.log.foreign_bag import BAG, PACKED, ROS_1, SQLITE, bag_files, head_of, of_damaged_sqlite, unpack
from train_ato.log.log_writer import LogFile
from train_ato.log.mcap_writer import MAGIC
from train_ato.log.reading import WALL_TIME, WallTime, being_written, log_file
from train_ato.log.whole_file import write_whole


def rewritten(log: Path) -> Path | None:
    """Write ``metadata.yaml`` of an undamaged log if it is missing or belongs to another log.

    Returns
    -------
    Path or None
        New name of the replaced file, or the new file if there was none; None if no repair was necessary.
    """
    information = _information(log)
    file = log.parent / METADATA
    if information is None or _read(file) == ([log.name], _counts(information)):
        return None
    kept = file
    if file.exists():
        kept = file.with_name(f"{METADATA}.broken")
        if kept.exists():
            raise ValueError(f"{kept}: exists already; move it away first")
        file.rename(kept)
    write_whole(file, metadata_yaml(information))
    return kept


def _information(log: Path) -> dict[str, Any] | None:
    """Return the bag information of a log from its summary; None without a summary."""
    with log.open("rb") as file:
        summary = records.summary_of(file, log.stat().st_size)
    if summary is None or summary.statistics is None:
        return None
    statistics, channels = summary.statistics, []
    for number in sorted(summary.known.channels):
        channel, schema = summary.known.kind(number)
        found, count = channel.metadata, statistics.channel_message_counts.get(number, 0)
        offered = (found.get("topic_type_hash", ""), found.get("offered_qos_profiles", "[]"))
        channels.append(ChannelCount(channel.topic, schema.name, channel.message_encoding, *offered, count))
    some = statistics.message_count > 0
    span = (statistics.message_start_time, statistics.message_end_time) if some else (NEVER, NEVER)
    return bag_information(log.name, channels, *span)


def belongs(file: Path, log: str) -> bool:
    """Return True if a ``metadata.yaml`` belongs to one log alone and not to a bag of several files.

    Parameters
    ----------
    file
        ``metadata.yaml``; it may be missing or unreadable.
    log
        Name of the log beside it.
    """
    if not file.exists():
        return log == LOG
    found = _read(file)
    return log == LOG if found is None else found[0] == [log]


def _read(file: Path) -> tuple[list[str], dict[str, int]] | None:
    """Return files and message counts of ``metadata.yaml``; None if it is unreadable."""
    try:
        information = parse_yaml(file.read_text(encoding="utf-8"))[BAG]
        return information["relative_file_paths"], _counts(information)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _counts(information: dict[str, Any]) -> dict[str, int]:
    topics = information["topics_with_message_count"]
    return {entry["topic_metadata"]["name"]: entry["message_count"] for entry in topics}


RECORDS = frozenset(map(int, Opcode)) | frozenset(range(0x80, 0x100))
"""Codes of records, the last ones of other programs."""


@dataclass(frozen=True)
class Recovered:
    """Result of a recovery.

    Attributes
    ----------
    path : Path
        New log, or the undamaged one.
    kept : Path or None
        Damaged file under its new name, None for a missing file.
    messages, lost_chunks : int
        Messages in the log; damaged chunks.
    metadata_only : bool
        True if the log was undamaged and only its ``metadata.yaml`` was written.
    """

    path: Path
    kept: Path | None
    messages: int
    lost_chunks: int
    metadata_only: bool = False


def recover(file: Path, progress: records.Progress | None = None) -> Recovered:
    """Write the undamaged part of a log and its ``metadata.yaml``; for an undamaged log only ``metadata.yaml``.

    Parameters
    ----------
    file
        ``run.mcap.partial`` of a killed run, a damaged ``.mcap``, or a run folder with one of them.
    progress
        Receiver of the fraction of the file that is read.

    Raises
    ------
    ValueError
        If there is nothing to recover, or the run still goes on.
    """
    source, target = _names(file)
    if source == target and (count := _whole(source)) is not None:
        return _metadata_again(source, count)
    converted = source != target and source.suffix != ".partial"
    kept = source if converted else target.with_name(f"{target.name}.broken")
    if not converted and kept.exists():
        raise ValueError(f"{kept}: exists already; move it away first")
    with _written(source.parent), tempfile.TemporaryDirectory(dir=source.parent, prefix=".recover-") as scratch:
        messages, lost = _rewrite(source, Path(scratch), target.name, progress)
        bag = belongs(target.parent / METADATA, target.name)
        if not converted:
            source.rename(kept)
        (Path(scratch) / target.name).rename(target)
        if bag:
            shutil.move(Path(scratch) / METADATA, target.parent / METADATA)
    return Recovered(target, kept, messages, lost)


@contextmanager
def _written(folder: Path) -> Iterator[None]:
    """Give the errors of the block, which writes into a folder, the name of the folder and a remedy."""
    try:
        yield
    except OSError as error:
        reason = getattr(error, "reason", None) or error.strerror or error
        remedy = "make room there, or recover a copy in another folder"
        raise OSError(f"{folder}: cannot be written ({reason}); {remedy}") from None


def _names(file: Path) -> tuple[Path, Path]:
    """Return the damaged file and the name of the new one.

    Raises
    ------
    ValueError
        If there is no such file, or it cannot be recovered, or need not.
    """
    source = file
    if file.is_dir():
        source = file / (PARTIAL if (file / PARTIAL).is_file() else LOG)
        if not source.is_file() and (files := bag_files(file)):
            source = next((part for part in files if _whole(part) is None), files[0])
    if not source.is_file():
        raise ValueError(f"{source}: no such file; name the run.mcap.partial of a killed run, or a damaged log")
    if source.suffix == ".partial":
        target = source.with_suffix("")
        if target.exists():
            raise ValueError(f"{target}: exists already; move it away first")
        if being_written(source):
            raise ValueError(f"{source}: is being written by a run that goes on; end it with Ctrl-C")
        return source, target
    if head_of(source) not in (PACKED, SQLITE):
        return source, source
    if _whole(source) is not None:
        raise ValueError(f"{source}: is undamaged; there is nothing to recover")
    target = source.with_name(f"{source.name.partition('.')[0]}.mcap")
    if target.exists():
        raise ValueError(f"{target}: exists already; move it away first")
    return source, target


def _whole(path: Path) -> int | None:
    """Return the number of messages in a log, None if it is damaged."""
    try:
        return sum(1 for _ in records.stream(log_file(path)))
    except ValueError:
        return None


def _metadata_again(log: Path, messages: int) -> Recovered:
    """Write a missing or damaged ``metadata.yaml`` of an undamaged log."""
    file = log.parent / METADATA
    there = file.exists()
    with _written(log.parent):
        kept = rewritten(log) if belongs(file, log.name) else None
    if kept is None:
        raise ValueError(f"{log}: is undamaged; there is nothing to recover")
    return Recovered(log, kept if there else None, messages, 0, metadata_only=True)


def _rewrite(source: Path, scratch: Path, name: str, progress: records.Progress | None) -> tuple[int, int]:
    """Write the undamaged messages of a file into a folder; return the numbers of messages and of lost chunks."""
    log: LogFile | None = None
    numbers: dict[int, int] = {}
    count = 0
    with _readable_part(source, scratch, progress) as (damaged, messages):
        for message in messages:
            if log is None:
                attached = {} if damaged is None else {entry.name: entry.data for entry in damaged.attachments()}
                log = LogFile(scratch, attached, name, wall_time=None if damaged is None else damaged.wall_time())
            number = message.channel.id
            if number not in numbers:
                numbers[number] = log.copy(message.channel, message.schema)
            log.write(numbers[number], message.publish_ns, message.log_ns, message.data)
            count += 1
    if log is None:
        raise ValueError(f"{source}: holds no undamaged message of a log; nothing can be recovered")
    log.close()
    return count, 0 if damaged is None else damaged.lost


@contextmanager
def _readable_part(
    source: Path, scratch: Path, progress: records.Progress | None
) -> "Iterator[tuple[DamagedLog | None, Iterator[records.RawMessage]]]":
    """Yield the readable messages of a file, and the log of an MCAP file."""
    if source.stat().st_size == 0:
        raise ValueError(f"{source}: is empty; nothing can be recovered")
    kind = head_of(source)
    if kind == PACKED:
        unpacked = scratch / "unpacked"
        unpack(source, unpacked)
        with _readable_part(unpacked, scratch, progress) as found:
            yield found
    elif kind == SQLITE:
        yield None, of_damaged_sqlite(source, scratch)
    elif kind == ROS_1:
        log_file(source)  # the reason and its remedy
    else:
        with source.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            damaged = DamagedLog(data, progress)
            yield damaged, damaged.messages()


class DamagedLog:
    """Reader of a file with wrong or missing bytes.

    Parameters
    ----------
    data
        Content of the file.
    progress
        Receiver of the fraction of the file that is read.
    """

    def __init__(self, data: mmap.mmap, progress: records.Progress | None = None) -> None:
        self._data = data
        self._progress = progress
        self.lost = 0

    def messages(self) -> Iterator[records.RawMessage]:
        """Yield the messages of every undamaged chunk, in the order of the file."""
        known = records.Definitions()
        chunks = list(self._chunks())
        if not chunks:
            yield from self._outside(known)
        summed = any(crc for _, crc in chunks)
        for begin, crc in chunks:
            # If other chunks have a checksum, a missing one is damage.
            if crc or not summed:
                yield from self._inside(self._content(begin), known)
            else:
                self.lost += 1
            self._data.madvise(mmap.MADV_DONTNEED, 0, begin - begin % mmap.PAGESIZE)  # else the memory has the file
            if self._progress is not None:
                self._progress(begin / len(self._data))

    def _outside(self, known: records.Definitions) -> Iterator[records.RawMessage]:
        """Yield the messages of a file without chunks that breaks off, up to the first record that is not whole."""
        end = next((place for code, place, _ in self._records() if code == Opcode.DATA_END), None)
        if end is not None and (self._data[-len(MAGIC) :] == MAGIC or not self._is_checked(end)):
            return  # the file does not break off: a bit is wrong somewhere
        with suppress(records.Damage):
            for code, begin, end in self._records():
                if code in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
                    yield from known.messages(self._data[begin:end])

    def _is_checked(self, end: int) -> bool:
        """Return True if the data before the record of their end agree with its checksum; without one they do."""
        (crc,) = struct.unpack_from("<I", self._data, end + records.HEAD.size)
        with memoryview(self._data) as data:
            return crc in (0, zlib.crc32(data[:end]))

    def _records(self) -> Iterator[tuple[int, int, int]]:
        """Yield code, begin and end of the records up to the first one that is not whole."""
        place = len(MAGIC)
        while (content := self._content(place)) is not None and self._data[place] in RECORDS:
            yield self._data[place], place, place + records.HEAD.size + len(content)
            place += records.HEAD.size + len(content)

    def _inside(self, content: bytes | None, known: records.Definitions) -> list[records.RawMessage]:
        """Return the messages of a chunk, none of a damaged one."""
        try:
            data = records.chunk_content(content or b"")
            try:
                return list(known.messages(data))
            except records.Damage:
                self._take_summary(known)
                return list(known.messages(data))
        except records.Damage:
            self.lost += 1
            return []

    def _chunks(self) -> Iterator[tuple[int, int]]:
        """Yield place and checksum of every candidate for a chunk."""
        place = 0
        while (found := records.CHUNK.search(self._data, place)) is not None:
            begin = found.start()
            place = begin + 1
            content = self._content(begin)
            try:
                crc = records.chunk_head(content or b"").crc
            except records.Damage:
                self.lost += not found[0].endswith(bytes(4))
                continue
            yield begin, crc
            place = begin + records.HEAD.size + len(content or b"")
            self._data.madvise(mmap.MADV_DONTNEED, 0, begin - begin % mmap.PAGESIZE)

    def _content(self, begin: int) -> bytes | None:
        """Return the content of the record at a place, None if it extends beyond the end."""
        if begin + records.HEAD.size > len(self._data):
            return None
        _, length = records.HEAD.unpack_from(self._data, begin)
        start = begin + records.HEAD.size
        return self._data[start : start + length] if length <= len(self._data) - start else None

    def attachments(self) -> Iterator[Attachment]:
        """Yield the attachments before the first damage with a correct checksum."""
        for content in self._undamaged(Opcode.ATTACHMENT):
            with suppress(records.Damage):
                yield records.attachment_of(content)

    def wall_time(self) -> WallTime | None:
        """Return the begin of the recording in wall time; None without a consistent record before the damage."""
        for content in self._undamaged(Opcode.METADATA):
            with suppress(records.Damage):
                record = records.metadata_of(content)
                found = WallTime.of(record.metadata) if record.name == WALL_TIME else None
                if found is not None:
                    return WallTime(found.begin_ns)  # metadata has no checksum; only the begin is there twice
        return None

    def _undamaged(self, code: Opcode) -> Iterator[bytes]:
        """Yield the content of the records of a kind before the first damage of a length."""
        for found, begin, end in self._records():
            if found == code:
                yield self._data[begin + records.HEAD.size : end]

    def _take_summary(self, known: records.Definitions) -> None:
        """Add schemas and channels of the summary, if it has a correct checksum."""
        with suppress(records.Damage):
            summary = records.summary_of(self._data, len(self._data))
            if summary is not None and summary.checked:
                known.schemas |= summary.known.schemas
                known.channels |= summary.known.channels
