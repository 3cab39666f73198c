"""Messages of a log in portions: hundreds of payloads of one channel at once, as records of one layout."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from train_ato.log.mcap_records import NO_SCHEMA, Definitions
from train_ato.log.reading import Progress, blocks, readable
from train_ato.messages.codec.byte_layout import Layout, Typestore, layout_of, rows_of

__all__ = ["KeptMessages", "LayoutRecords", "Portion", "Reader", "TopicMessages"]

PORTION = 2**20
"""Size of a portion [bytes]: large enough for a low cost per message, small enough for a cache."""
MAX_KEPT = 2**30
"""Maximum size of the messages of variable length of one log [bytes]."""
MOST_LAYOUTS = 64
"""Maximum number of layouts of messages with one length; further messages, for example with texts, are read singly."""


@dataclass
class Portion:
    """Messages of one channel in the order of the file.

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


class KeptMessages(dict[str, list[bytes]]):
    """Messages of variable length by topic, up to :data:`MAX_KEPT` bytes."""

    def __init__(self) -> None:
        super().__init__()
        self._size = 0

    def take(self, topic: str) -> list[bytes]:
        """Return the messages of a topic and remove them."""
        self._size -= sum(map(len, self[topic]))
        return self.pop(topic)

    def keep(self, topic: str, payloads: Iterable[bytes | memoryview]) -> None:
        """Add messages of a topic.

        Raises
        ------
        ValueError
            If all kept messages are larger than :data:`MAX_KEPT`.
        """
        kept = self.setdefault(topic, [])
        for payload in payloads:
            self._size += len(payload)
            if self._size > MAX_KEPT:
                raise ValueError(
                    f"more than {MAX_KEPT >> 20} MiB of profiles, limits and diagnostics; name another log"
                )
            kept.append(bytes(payload))


class Reader:
    """Reader of the messages of selected channels, per channel in the order of the file.

    Parameters
    ----------
    path
        MCAP file, with or without chunks.
    wanted
        Selection of channels, called once per channel.
    progress
        Receiver of the fraction of the file that is read, 0 to 1.

    Attributes
    ----------
    first_ns : int or None
        Publish time of the first message of the file [ns since 1970].
    """

    def __init__(self, path: Path, wanted: Callable[[Channel, Schema], bool], progress: Progress | None = None) -> None:
        self.first_ns: int | None = None
        self._path, self._wanted, self._progress = path, wanted, progress
        self._known = Definitions()
        self._open: dict[int, Portion | None] = {}

    @property
    def channels(self) -> list[tuple[Channel, Schema]]:
        """All channels read so far, selected or not."""
        schemas = self._known.schemas
        return [(channel, schemas.get(channel.schema_id, NO_SCHEMA)) for channel in self._known.channels.values()]

    def portions(self) -> Iterator[Portion]:
        """Yield the portions of the file.

        Raises
        ------
        ValueError
            If the file is not a log, incomplete or damaged: one line with its name.
        """
        size = 0
        with readable(self._path):
            for block in blocks(self._path, self._progress):
                self._take(block)
                size += len(block)
                if size > PORTION:
                    yield from self._closed()
                    size = 0
        yield from self._closed()

    def _closed(self) -> Iterator[Portion]:
        """Yield and clear the collected portions."""
        for number, portion in self._open.items():
            if portion is not None and portion.payloads:
                self._open[number] = Portion(portion.channel, portion.schema)
                yield portion

    def _take(self, block: bytes) -> None:
        """Collect the messages of a block."""
        view, portions = memoryview(block), self._open
        for number, _, publish_ns, begin, end in self._known.walk(block):
            if number not in portions:
                kind = self._known.kind(number)
                portions[number] = Portion(*kind) if self._wanted(*kind) else None
                self.first_ns = publish_ns if self.first_ns is None else self.first_ns
            portion = portions[number]
            if portion is not None:
                portion.payloads.append(view[begin:end])
                portion.publish_ns.append(publish_ns)


@dataclass
class LayoutRecords:
    """Messages of one layout.

    Attributes
    ----------
    size : int
        Number of messages.
    numbers : list of Array of int
        Places of the messages in the topic, in parts.
    parts : list of Array
        Messages as records of the type of the layout, shape (n,) each.
    """

    layout: Layout
    size: int = 0
    numbers: list[NDArray[np.int64]] = field(default_factory=list)
    parts: list[NDArray[Any]] = field(default_factory=list)

    def add(self, numbers: NDArray[np.int64], rows: NDArray[np.uint8]) -> None:
        """Add messages of this layout, shape (n, bytes)."""
        self.numbers.append(numbers)
        self.parts.append(rows.view(self.layout.dtype)[:, 0])
        self.size += len(rows)

    def fill(self, path: str, out: NDArray[Any]) -> None:
        """Write the values of a field of all messages into an array, shape (n,), for arrays (n, count)."""
        end = 0
        for part in self.parts:
            begin, end = end, end + part.size
            out[begin:end] = part[path]

    def values(self, path: str) -> NDArray[Any]:
        """Return the values of a field of all messages, shape (n,), for arrays (n, count)."""
        kind = self.layout.dtype[path]
        out = np.empty((self.size, *kind.shape), kind.base.newbyteorder("="))
        self.fill(path, out)
        return out


class TopicMessages:
    """Messages of one topic.

    Parameters
    ----------
    types
        Type store with the type.
    type_name
        Type of the messages.
    check
        Check of every new layout before its messages are kept; it raises ValueError.

    Attributes
    ----------
    publish_ns : list of int
        Publish times of all messages [ns since 1970].
    groups : list of LayoutRecords
        Messages by layout.
    """

    def __init__(self, types: Typestore, type_name: str, check: Callable[[Layout], None]) -> None:
        self._types, self._type_name, self._check = types, type_name, check
        self._known: dict[int, list[LayoutRecords]] = {}
        self.publish_ns: list[int] = []
        self.groups: list[LayoutRecords] = []

    @property
    def nbytes(self) -> int:
        """Size of the messages [bytes]."""
        return sum(group.layout.length * group.size for group in self.groups)

    def add(self, portion: Portion) -> None:
        """Add a portion of the log.

        Raises
        ------
        ValueError
            For bytes that are not a message of the type, and from ``check``.
        """
        lengths = np.array([len(payload) for payload in portion.payloads])
        for length in np.unique(lengths).tolist():
            places = np.flatnonzero(lengths == length)
            whole = places.size == lengths.size
            payloads = portion.payloads if whole else [portion.payloads[place] for place in places.tolist()]
            self._sort(len(self.publish_ns) + places, rows_of(payloads, length))
        self.publish_ns += portion.publish_ns

    def _sort(self, numbers: NDArray[np.int64], rows: NDArray[np.uint8]) -> None:
        """Add messages of one length to the groups of their layouts."""
        known = self._known.setdefault(rows.shape[1], [])
        for group in known:
            if not numbers.size:
                return
            numbers, rows = _rest(group, numbers, rows, group.layout.fits(rows))
        while numbers.size:
            layout = layout_of(self._types, self._type_name, rows[0].tobytes())
            self._check(layout)
            group, fits = LayoutRecords(layout), np.arange(numbers.size) == 0
            self.groups.append(group)
            if len(known) < MOST_LAYOUTS:
                known.append(group)
                fits = layout.fits(rows)
            numbers, rows = _rest(group, numbers, rows, fits)


def _rest(
    group: LayoutRecords, numbers: NDArray[np.int64], rows: NDArray[np.uint8], fits: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Add the messages with the layout of a group to it and return the others."""
    if fits.all():
        group.add(numbers, rows)
        return numbers[:0], rows[:0]
    if fits.any():
        group.add(numbers[fits], rows[fits])
    return numbers[~fits], rows[~fits]
