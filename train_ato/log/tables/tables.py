"""Table of one topic with a unit in the name of every column.

pandas is imported with the first table: a run is recorded without it, and starts earlier.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from train_ato.log.tables.columns import TIME, column, has_column
from train_ato.log.tables.portions import LayoutRecords, TopicMessages
from train_ato.loop.series import seconds
from train_ato.messages.codec.byte_layout import Layout, Leaf
from train_ato.messages.codec.cdr import nanoseconds
from train_ato.messages.topics import EPOCH_NS

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["LONGEST_ARRAY", "STAMPS", "check_foreign", "check_known", "foreign_table", "known_table"]

STAMPS = ("header.stamp", "clock")
"""Paths of the stamp in messages of the topic table."""
LONGEST_ARRAY = 1000
"""Maximum length of an array in columns; longer ones, for example images, are refused."""


def check_known(topic: str, layout: Layout) -> None:
    """Check that a message of a topic has one value per name.

    Raises
    ------
    ValueError
        If the numbers of names and values differ.
    """
    owners = _owners(layout)
    for leaf in _columns_of(topic, layout):
        if leaf.path not in STAMPS and not leaf.is_time:
            _names(topic, leaf, owners)


def _columns_of(topic: str, layout: Layout) -> list[Leaf]:
    """Return the numbers and times of a message with columns in the table of its topic."""
    return [
        leaf for leaf in layout.leaves if leaf.dtype is not None and leaf.count != 0 and has_column(topic, leaf.path)
    ]


def check_foreign(layout: Layout) -> None:
    """Check that the arrays of a message can be columns.

    Raises
    ------
    ValueError
        For arrays longer than :data:`LONGEST_ARRAY`.
    """
    for leaf in layout.leaves:
        if leaf.count is not None and leaf.count > LONGEST_ARRAY:
            raise ValueError(f"{leaf.path} is an array of {leaf.count} numbers, at most {LONGEST_ARRAY} make columns")


def known_table(topic: str, messages: TopicMessages) -> pd.DataFrame:
    """Return the table of a topic of the topic table: float64 columns over simulated time.

    Raises
    ------
    ValueError
        If two columns have the same name.
    """
    parts = [(np.concatenate(group.numbers), _part(topic, group)) for group in messages.groups]
    return in_order(_joined(parts))


def _part(topic: str, group: LayoutRecords) -> pd.DataFrame:
    """Return the table of the messages of one layout, with contiguous columns."""
    import pandas as pd

    owners, leaves = _owners(group.layout), _columns_of(topic, group.layout)
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
    titles = _unique([name for columns in names for name in columns])
    return pd.DataFrame(block.T, index=index, columns=titles, copy=False)


def _owners(layout: Layout) -> list[str]:
    """Return the names of the entries of a JointState."""
    return [leaf.text for leaf in layout.leaves if leaf.dtype is None and leaf.path.startswith("name[")]


def _names(topic: str, leaf: Leaf, owners: list[str]) -> list[str]:
    """Return the names of the columns of a part."""
    if not owners and leaf.count in (None, 1):
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

    Nested fields are joined by ``_``; entries of arrays are numbered, those of a JointState have their names; stamps
    are integers [ns].  Columns have no units, because the message types do not define them.

    Parameters
    ----------
    messages
        Messages of the topic.
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
