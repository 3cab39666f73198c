"""Making a damaged log, or that of a killed run, readable again.

Nothing in a damaged file is believed but what a checksum vouches for: chunks are found by their pattern, wherever they
stand, and taken when theirs is right.  Schemas and channels come from such chunks, or from a summary whose checksum is
right.  So every message that is recovered is one that was recorded.
"""

from __future__ import annotations

import mmap
import re
import shutil
import struct
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Attachment

from train_ato.record.bag_metadata import belongs, rewritten
from train_ato.record.layout import LOG, METADATA, PARTIAL
from train_ato.record.mcap_writer import MAGIC
from train_ato.record.reading import Definitions, Progress, RawMessage, being_written, stream
from train_ato.record.records import Damage, attachment_of, chunk_content, chunk_head
from train_ato.record.run_log import LogFile

_HEAD = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI")
_CHUNK = re.compile(rb"\x06.{8}.{24}.{4}(?:\x04\x00\x00\x00zstd|\x03\x00\x00\x00lz4|\x00\x00\x00\x00)", re.DOTALL)
"""A chunk up to the name of its compression: code, length, three numbers, checksum."""


@dataclass(frozen=True)
class Recovered:
    """What was saved of a log.

    Attributes
    ----------
    path : Path
        The new log, or the one that is whole.
    kept : Path or None
        The damaged file under its new name, None where one was missing.
    messages, lost_chunks : int
        Messages in the log; chunks that were found and are damaged.
    metadata_only : bool
        Whether the log is whole and only ``metadata.yaml`` beside it was written again.
    """

    path: Path
    kept: Path | None
    messages: int
    lost_chunks: int
    metadata_only: bool = False


def recover(file: Path, progress: Progress | None = None) -> Recovered:
    """Write what is whole of a damaged log as a proper one with its ``metadata.yaml``; of a whole log only the latter.

    Parameters
    ----------
    file
        ``run.mcap.partial`` of a killed run, a damaged ``.mcap``, or the folder of a run that holds one.
    progress
        Takes the share of the file that is read.

    Raises
    ------
    ValueError
        If there is nothing to recover, or the run still goes on.
    """
    source, target = _names(file)
    if source == target and (count := _whole(source)) is not None:
        return _metadata_again(source, count)
    kept = target.with_name(f"{target.name}.broken")
    if kept.exists():
        raise ValueError(f"{kept}: exists already; move it away first")
    try:
        with tempfile.TemporaryDirectory(dir=source.parent, prefix=".recover-") as scratch:
            messages, lost = _rewrite(source, Path(scratch), target.name, progress)
            bag = belongs(target.parent / METADATA, target.name)
            source.rename(kept)
            (Path(scratch) / target.name).rename(target)
            if bag:
                shutil.move(Path(scratch) / METADATA, target.parent / METADATA)
    except OSError as error:
        raise OSError(f"{source.parent}: cannot be written ({error.strerror or error})") from None
    return Recovered(target, kept, messages, lost)


def _names(file: Path) -> tuple[Path, Path]:
    """Return the damaged file and the name of the new one."""
    source = file
    if file.is_dir():
        source = file / (PARTIAL if (file / PARTIAL).is_file() else LOG)
    if not source.is_file():
        raise ValueError(f"{source}: no such file; name the run.mcap.partial of a killed run, or a damaged log")
    if source.suffix == ".partial":
        target = source.with_suffix("")
        if target.exists():
            raise ValueError(f"{target}: exists already; move it away first")
        if being_written(source):
            raise ValueError(f"{source}: is being written by a run that goes on; end it with Ctrl-C")
        return source, target
    return source, source


def _whole(path: Path) -> int | None:
    """Return the number of messages in a log, None where it is damaged."""
    try:
        return sum(1 for _ in stream(path))
    except ValueError:
        return None


def _metadata_again(log: Path, messages: int) -> Recovered:
    """Write the ``metadata.yaml`` of a run whose log is whole, where that is what is damaged or missing."""
    file = log.parent / METADATA
    there = file.exists()
    try:
        kept = rewritten(log) if belongs(file, log.name) else None
    except OSError as error:
        raise OSError(f"{log.parent}: cannot be written ({error.strerror or error})") from None
    if kept is None:
        raise ValueError(f"{log}: is whole; there is nothing to recover")
    return Recovered(log, kept if there else None, messages, 0, metadata_only=True)


def _rewrite(source: Path, scratch: Path, name: str, progress: Progress | None) -> tuple[int, int]:
    """Write the whole chunks of a file into a folder; return the number of messages and of lost chunks."""
    log: LogFile | None = None
    numbers: dict[int, int] = {}
    count = 0
    with source.open("rb") as file:
        if source.stat().st_size == 0:
            raise ValueError(f"{source}: is empty; nothing can be recovered")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            wreck = Wreck(data, progress)
            for message in wreck.messages():
                if log is None:
                    log = LogFile(scratch, {entry.name: entry.data for entry in wreck.attachments()}, name)
                number = message.channel.id
                if number not in numbers:
                    numbers[number] = log.copy(message.channel, message.schema)
                log.write(numbers[number], message.publish_ns, message.log_ns, message.data)
                count += 1
    if log is None:
        raise ValueError(f"{source}: holds no whole chunk of a log; nothing can be recovered")
    log.close()
    return count, wreck.lost


class Wreck:
    """A file of which some bytes may be wrong or missing.

    Parameters
    ----------
    data
        All of it.
    progress
        Takes the share of it that is read.

    Attributes
    ----------
    lost : int
        Chunks that were found by their pattern and are damaged.
    """

    def __init__(self, data: mmap.mmap, progress: Progress | None = None) -> None:
        self._data = data
        self._progress = progress
        self.lost = 0

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages of every whole chunk, in the order of the file."""
        known = Definitions()
        chunks = list(self._chunks())
        summed = any(crc for _, crc in chunks)
        for begin, crc in chunks:
            # Where others carry a checksum, one that is missing was lost.
            if crc or not summed:
                yield from self._inside(self._content(begin), known)
            else:
                self.lost += 1
            if self._progress is not None:
                self._progress(begin / len(self._data))

    def _inside(self, content: bytes | None, known: Definitions) -> list[RawMessage]:
        """Return the messages of a chunk, none of one that cannot be understood."""
        try:
            data = chunk_content(content or b"")
            try:
                return list(known.messages(data))
            except Damage:
                self._take_summary(known)
                return list(known.messages(data))
        except Damage:
            self.lost += 1
            return []

    def _chunks(self) -> Iterator[tuple[int, int]]:
        """Yield where something like a chunk stands, and its checksum."""
        place = 0
        while (found := _CHUNK.search(self._data, place)) is not None:
            begin = found.start()
            place = begin + 1
            content = self._content(begin)
            try:
                crc = chunk_head(content or b"").crc
            except Damage:
                self.lost += not found[0].endswith(bytes(4))
                continue
            yield begin, crc
            place = begin + _HEAD.size + len(content or b"")

    def _content(self, begin: int) -> bytes | None:
        """Return the content of the record at a place, None if it reaches beyond the end."""
        if begin + _HEAD.size > len(self._data):
            return None
        _, length = _HEAD.unpack_from(self._data, begin)
        start = begin + _HEAD.size
        return self._data[start : start + length] if length <= len(self._data) - start else None

    def attachments(self) -> Iterator[Attachment]:
        """Yield the attachments with a right checksum that stand before the first damage."""
        place = len(MAGIC)
        while (content := self._content(place)) is not None:
            if self._data[place] == Opcode.ATTACHMENT:
                with suppress(Damage):
                    yield attachment_of(content)
            place += _HEAD.size + len(content)

    def _take_summary(self, known: Definitions) -> None:
        """Take schemas and channels from the summary, if its checksum is there and right."""
        end = len(self._data) - len(MAGIC)
        if end < _FOOTER.size + len(MAGIC) or self._data[end:] != MAGIC:
            return
        foot = self._data[end - _FOOTER.size : end]
        code, _, start, _, crc = _FOOTER.unpack(foot)
        if code != Opcode.FOOTER or not len(MAGIC) <= start < end or zlib.crc32(self._data[start : end - 4]) != crc:
            return
        place = start
        while place < end - _FOOTER.size and (content := self._content(place)) is not None:
            known.take(self._data[place], content)
            place += _HEAD.size + len(content)
