"""Table of one topic with a unit in the name of every column.

pandas is imported with the first table: a run is recorded without it, and starts earlier.

Messages of a log in portions: hundreds of payloads of one channel at once, as records of one layout.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from train_ato.judge.series import seconds
from train_ato.log.mcap_records import NO_SCHEMA, Definitions, Progress, blocks, readable
from train_ato.log.table_columns import TIME, column
from train_ato.messages.cdr import Layout, Leaf, Typestore, layout_of, nanoseconds, rows_of
from train_ato.messages.topics import EPOCH_NS, Topic, topic_with

if TYPE_CHECKING:
    import pandas as pd


PORTION = 2**20
"""Size of a portion [bytes]: large enough for a low cost per message, small enough for a cache."""
MAX_KEPT = 2**30
"""Maximum size of the messages of variable length of one log [bytes]."""
MAX_LAYOUTS = 64
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
        """Add messages of a topic; ValueError if all kept messages are larger than :data:`MAX_KEPT`."""
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
        """Add a portion of the log; ValueError for bytes that are not a message of the type, and from ``check``."""
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
            if len(known) < MAX_LAYOUTS:
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


STAMPS = ("header.stamp", "clock")
"""Paths of the stamp in messages of the topic table."""
MAX_ARRAY = 1000
"""Maximum length of an array in columns; longer ones, for example images, are refused."""


def check_known(topic: Topic, layout: Layout) -> None:
    """Check that a message of a topic has one value per name; ValueError if the numbers of names and values differ."""
    topic, owners = _entry(topic, layout)
    for leaf in _columns_of(topic, layout):
        if leaf.path not in STAMPS and not leaf.is_time:
            _names(topic, leaf, owners)


def _columns_of(topic: Topic, layout: Layout) -> list[Leaf]:
    """Return the numbers and times of a message with columns in the table of its topic."""
    known = {place.path for place in topic.places}
    return [leaf for leaf in layout.leaves if leaf.dtype is not None and leaf.count != 0 and leaf.path in known]


def check_foreign(layout: Layout) -> None:
    """Check that the arrays of a message can be columns; ValueError for arrays longer than :data:`MAX_ARRAY`."""
    for leaf in layout.leaves:
        if leaf.count is not None and leaf.count > MAX_ARRAY:
            raise ValueError(f"{leaf.path} is an array of {leaf.count} numbers, at most {MAX_ARRAY} make columns")


def known_table(topic: Topic, messages: TopicMessages) -> pd.DataFrame:
    """Return the table of a topic of the topic table: float64 columns over simulated time.

    Raises
    ------
    ValueError
        If two columns have the same name.
    """
    parts = [(np.concatenate(group.numbers), _part(topic, group)) for group in messages.groups]
    return in_order(_joined(parts))


def _part(topic: Topic, group: LayoutRecords) -> pd.DataFrame:
    """Return the table of the messages of one layout, with contiguous columns."""
    import pandas as pd

    topic, owners = _entry(topic, group.layout)
    leaves = _columns_of(topic, group.layout)
    stamps = next(nanoseconds(group.values(path)) for path in STAMPS if path in group.layout.names) - EPOCH_NS
    names = [_names(topic, leaf, owners) for leaf in leaves]
    block = np.empty((sum(map(len, names)), group.size))
    row = 0
    for leaf, columns in zip(leaves, names, strict=True):
        out = block[row : row + len(columns)]
        if leaf.path in STAMPS:
            out[0] = seconds(stamps)
        elif leaf.is_time:
            out[0] = seconds(nanoseconds(group.values(leaf.path)) + stamps)
        else:
            group.fill(leaf.path, out.T if leaf.count is not None else out[0])
        row += len(columns)
    index = pd.Index(seconds(stamps), name=TIME)
    titles = [name for columns in names for name in columns]
    if "" in titles:
        block = block[[number for number, title in enumerate(titles) if title]]
    return pd.DataFrame(block.T, index=index, columns=_unique(list(filter(None, titles))), copy=False)


def _entry(topic: Topic, layout: Layout) -> tuple[Topic, list[str]]:
    """Return the entry of a topic for a message, present or former, and the names of the owners of its values."""
    owners = _owners(layout, topic.names_path) if topic.owners else []
    return topic_with(topic, owners), owners


def _owners(layout: Layout, path: str = "name") -> list[str]:
    """Return the names of the entries of a JointState, or those in another field."""
    return [leaf.text for leaf in layout.leaves if leaf.dtype is None and leaf.path.startswith(f"{path}[")]


def _names(topic: Topic, leaf: Leaf, owners: list[str]) -> list[str]:
    """Return the names of the columns of a part."""
    if leaf.count is None or (not owners and leaf.count == 1):
        return [column(topic, leaf.path)]
    if leaf.count != len(owners):
        raise ValueError(f"{leaf.path} has {leaf.count} values for {len(owners)} names")
    return [column(topic, leaf.path, owner) for owner in owners]


def _unique(names: list[str]) -> list[str]:
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise ValueError(f"two columns would be called '{twice[0]}'")
    return names


def _joined(parts: list[tuple[NDArray[np.int64], pd.DataFrame]]) -> pd.DataFrame:
    """Join the parts of a topic in the order of the log."""
    if len(parts) == 1:
        return parts[0][1]
    import pandas as pd

    order = np.argsort(np.concatenate([numbers for numbers, _ in parts]), kind="stable")
    return pd.concat([part for _, part in parts]).iloc[order]


def in_order(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows in the order of time."""
    return table if table.index.is_monotonic_increasing else table.sort_index(kind="stable")


def foreign_table(messages: TopicMessages) -> pd.DataFrame:
    """Return the table of a topic that is not in the topic table, over publish time [ns since 1970].

    Nested fields are joined by ``_``. Entries of arrays are numbered, and entries of a JointState have their names.
    Stamps are integers [ns]. Columns have no units, because the message types do not define them.
    """
    import pandas as pd

    publish = np.array(messages.publish_ns, dtype=np.int64)
    found: dict[str, NDArray[Any]] = {}
    for group in messages.groups:
        numbers = np.concatenate(group.numbers)
        for name, values in _foreign_columns(group):
            if numbers.size == publish.size:
                found[name] = values
            else:
                _scatter(found, name, numbers, values, publish.size)
    return in_order(pd.DataFrame(found, index=pd.Index(publish, name=TIME), copy=False))


def _foreign_columns(group: LayoutRecords) -> Iterator[tuple[str, NDArray[Any]]]:
    owners = _owners(group.layout)
    for leaf in group.layout.leaves:
        name = _plain(leaf.path)
        if leaf.dtype is None:
            if not (owners and leaf.path.startswith("name[")):
                yield name, np.full(group.size, leaf.text, dtype=object)
        elif leaf.is_time:
            yield f"{name}_ns", nanoseconds(group.values(leaf.path))
        elif leaf.count is None:
            yield name, group.values(leaf.path)
        else:
            named = len(owners) == leaf.count and "." not in leaf.path
            for index, row in enumerate(np.ascontiguousarray(group.values(leaf.path).T)):
                yield f"{owners[index]}_{name}" if named else f"{name}_{index}", row


def _scatter(
    found: dict[str, NDArray[Any]], name: str, numbers: NDArray[np.int64], values: NDArray[Any], size: int
) -> None:
    """Write the values of some messages into a column; the other rows are missing values."""
    text = values.dtype == object
    if name not in found:
        found[name] = np.full(size, None if text else np.nan, dtype=object if text else np.float64)
    column_ = found[name]
    if column_.dtype != object and text:
        column_ = found[name] = column_.astype(object)
    column_[numbers] = values


def _plain(path: str) -> str:
    """Return a path as name of a column: ``pose.position.x`` becomes ``pose_position_x``."""
    return path.replace("].", "_").replace("[", "_").replace("]", "").replace(".", "_")
