"""Arrays from the messages of one topic, thousands at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train_ato.log.tables.portions import Portion
from train_ato.messages.codec.byte_layout import Layout, Leaf, Typestore, layout_of, rows_of

__all__ = ["Group", "TopicColumns"]

MOST_LAYOUTS = 64
"""Maximum number of layouts of messages with one length; further messages, for example with texts, are read singly."""


@dataclass
class Group:
    """Messages of one layout.

    Attributes
    ----------
    leaves
        Selected parts.
    """

    layout: Layout
    leaves: tuple[Leaf, ...]
    _numbers: list[NDArray[np.int64]] = field(default_factory=list)
    _messages: list[NDArray[np.uint8]] = field(default_factory=list)

    def add(self, numbers: NDArray[np.int64], messages: NDArray[np.uint8]) -> None:
        """Add messages of this layout, shape (n, length), and their places in the topic."""
        self._numbers.append(numbers)
        self._messages.append(messages)

    @property
    def size(self) -> int:
        """Number of messages."""
        return sum(len(messages) for messages in self._messages)

    def numbers(self) -> NDArray[np.int64]:
        """Return the places of the messages in the topic."""
        return np.concatenate(self._numbers)

    def fill(self, leaf: Leaf, out: NDArray[Any]) -> None:
        """Write a part of every message into an array of shape (n,), for an array (count, n)."""
        place = 0
        for messages in self._messages:
            out[..., place : place + len(messages)] = self.layout.read(messages, leaf)
            place += len(messages)

    def values(self, leaf: Leaf) -> NDArray[Any]:
        """Return a part of every message, shape (n,), for an array (count, n)."""
        assert leaf.dtype is not None
        shape = (self.size,) if leaf.count is None else (leaf.count, self.size)
        out = np.empty(shape, leaf.dtype.newbyteorder("="))
        self.fill(leaf, out)
        return out


class TopicColumns:
    """Messages of one topic.

    Parameters
    ----------
    types
        Type store with the type.
    type_name
        Type of the messages.
    choose
        Selection of parts.
    check
        Check of every new layout before its messages are kept; it raises ValueError.

    Attributes
    ----------
    groups : list of Group
        Messages by layout.
    """

    def __init__(
        self,
        types: Typestore,
        type_name: str,
        choose: Callable[[Leaf], bool] = lambda leaf: True,
        check: Callable[[Layout], None] = lambda layout: None,
    ) -> None:
        self._types = types
        self._type_name = type_name
        self._choose = choose
        self._check = check
        self._known: dict[int, list[Group]] = {}
        self._publish: list[int] = []
        self.groups: list[Group] = []

    @property
    def nbytes(self) -> int:
        """Size of the messages [bytes]."""
        return sum(group.layout.length * group.size for group in self.groups)

    @property
    def publish_ns(self) -> NDArray[np.int64]:
        """Publish times of all messages [ns since 1970]."""
        return np.array(self._publish, dtype=np.int64)

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
            self._sort(len(self._publish) + places, rows_of(payloads, length))
        self._publish += portion.publish_ns

    def _sort(self, numbers: NDArray[np.int64], messages: NDArray[np.uint8]) -> None:
        """Add messages of one length to the groups of their layouts."""
        known = self._known.setdefault(messages.shape[1], [])
        for group in known:
            if not numbers.size:
                return
            numbers, messages = _taken(group, numbers, messages)
        while numbers.size:
            layout = layout_of(self._types, self._type_name, messages[0].tobytes())
            self._check(layout)
            group = Group(layout, tuple(leaf for leaf in layout.leaves if self._choose(leaf)))
            self.groups.append(group)
            if len(known) < MOST_LAYOUTS:
                known.append(group)
                numbers, messages = _taken(group, numbers, messages)
            else:
                group.add(numbers[:1], messages[:1])
                numbers, messages = numbers[1:], messages[1:]


def _taken(
    group: Group, numbers: NDArray[np.int64], messages: NDArray[np.uint8]
) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Add the messages with the layout of a group to it; return the rest."""
    fits = group.layout.fits(messages)
    if fits.all():
        group.add(numbers, messages)
        return numbers[:0], messages[:0]
    if fits.any():
        group.add(numbers[fits], messages[fits])
    return numbers[~fits], messages[~fits]
