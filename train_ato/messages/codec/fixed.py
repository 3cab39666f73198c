"""Codec of messages of fixed length: all messages of every tick.

The messages of a topic differ only in the stamp and in the numbers.  A blank message is serialised once by the Jazzy
serialiser of ``rosbags``; its byte layout gives the offsets of the numbers, and encoding writes only these.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train_ato.messages.codec.byte_layout import Layout, layout_of, rows_of
from train_ato.messages.codec.cdr import (
    packed_stamp,
    packed_times,
    stamp_of,
    typestore,
)
from train_ato.messages.codec.slots import FLOAT64, STAMP_END, TimeSlot, sample_of, slots_of
from train_ato.messages.codec.small import MOST_BYTES, SmallMessage
from train_ato.messages.layout import TrainLayout
from train_ato.messages.tick_block import Values
from train_ato.messages.topic import Topic
from train_ato.messages.topics import EPOCH_NS


class FixedCodec:
    """Encoder and decoder of one topic with messages of fixed length.

    Names and lengths are encoded once and cost no time per message. ``train/vehicles`` of 106 vehicles is encoded 32
    times and decoded 15 times as fast as by ``rosbags``, 20 times together (``python bench/codec.py``).

    Parameters
    ----------
    topic
        Entry of the topic table.
    layout
        Sizes of the train.

    Raises
    ------
    ValueError
        If the places of the topic do not fit its dataclass or its ROS type.
    """

    def __init__(self, topic: Topic, layout: TrainLayout) -> None:
        self.topic = topic
        self._names = topic.names(layout)
        places = [place for place in topic.places if place.field != "stamp"]
        order = [entry.name for entry in dataclasses.fields(topic.message) if entry.name != "stamp"]
        if sorted(order) != sorted(place.field for place in places):
            raise ValueError(f"topic {topic.name}: every field of {topic.message.__name__} needs one place")
        sample = sample_of(topic, layout)
        self._slots = slots_of(topic, layout, sample)
        self._readers = [slot.read for slot in self._slots]
        edges = [STAMP_END]
        for slot in self._slots:
            edges += [slot.start, slot.start + 8 * slot.size]
        gaps = list(zip(edges[::2], [*edges[1::2], len(sample)], strict=True))
        self.length, self._sample = len(sample), sample
        self._fields = {slot.path: [place.field for place in places if place.path == slot.path] for slot in self._slots}
        self._constants = tuple((begin, end, sample[begin:end]) for begin, end in ((0, 4), *gaps) if begin < end)
        self._head, self._first = sample[:4], sample[STAMP_END : gaps[0][1]]
        self._writers: list[tuple[Callable[[Any], Any], bytes]] = []
        for slot, (begin, end) in zip(self._slots, gaps[1:], strict=True):
            *others, last = slot.writers
            self._writers += [*((write, b"") for write in others), (last, sample[begin:end])]
        by_place = [place.field for slot in self._slots for place in places if place.path == slot.path]
        self._values = _getter(by_place)
        self._order = [by_place.index(field) for field in order]
        durations = {slot.path for slot in self._slots if isinstance(slot, TimeSlot)}
        self._durations = [by_place.index(place.field) for place in places if place.path in durations]
        self._other: Layout | None = None
        self._shifted_fields = [self._order.index(place) for place in self._durations]
        self._small: SmallMessage | None = None
        if self.length <= MOST_BYTES:
            self._small = SmallMessage(sample, self._slots, self._order, topic.finite)

    def encode(self, message: Any) -> bytes:
        """Return the CDR bytes of a message.

        Raises
        ------
        ValueError
            For an array of the wrong type or length, or a number that is not finite.
        """
        parts: list[Any] = [self._head, packed_stamp(message.stamp), self._first]
        values = self._values(message)
        if self._durations:
            values = self._shifted(values, -message.stamp)
        try:
            for (write, constant), value in zip(self._writers, values, strict=True):
                parts.append(write(value))
                parts.append(constant)
        except ValueError as error:
            raise ValueError(f"{self.topic.name}: {error}") from None
        return b"".join(parts)

    def encode_each(self, stamps: NDArray[np.int64], values: Values) -> NDArray[np.uint8]:
        """Return the CDR bytes of several messages, shape (messages, length); errors as :meth:`encode`.

        Parameters
        ----------
        stamps : Array of int, shape (messages,)
            Stamps [ns].
        values
            Values by field, shape (messages, n) each; durations [ns] as integers.
        """
        data = np.tile(np.frombuffer(self._sample, dtype=np.uint8), (stamps.size, 1))
        data[:, 4:STAMP_END] = packed_times(EPOCH_NS + stamps)
        for slot in self._slots:
            columns = [values[field] for field in self._fields[slot.path]]
            count, start = sum(column.shape[1] for column in columns), slot.start
            if count != slot.size:
                raise ValueError(f"{self.topic.name}: {slot.path} has {count} values where {slot.size} are due")
            for column in columns:
                end = start + 8 * column.shape[1]
                if isinstance(slot, TimeSlot):
                    data[:, start:end] = packed_times(column[:, 0] - stamps)
                elif slot.finite and not np.isfinite(column).all():
                    wrong = column[~np.isfinite(column)][0]
                    raise ValueError(f"{self.topic.name}: {slot.path} is not finite: {wrong}")
                else:
                    data[:, start:end] = np.ascontiguousarray(column, FLOAT64).view(np.uint8)
                start = end
        return data

    def decode(self, data: bytes) -> Any:
        """Return the message of the bytes; arrays are copies.

        Raises
        ------
        ValueError
            For bytes of another type, other names or lengths, or numbers that are not finite.
        """
        if self._small is not None and (found := self._small.read(data)) is not None:
            stamp, values = found
            for field in self._shifted_fields:
                values[field] += stamp
            return self.topic.message(stamp, *values)
        try:
            if self._fits(data):
                values = []
                for read in self._readers:
                    values += read(data)
            else:
                values = self._read_any(data)
        except ValueError as error:
            raise ValueError(f"{self.topic.name}: {error}") from None
        if self._durations:
            values = self._shifted(values, stamp_of(data))
        return self.topic.message(stamp_of(data), *[values[place] for place in self._order])

    def _shifted(self, values: Sequence[Any], by: int) -> list[Any]:
        """Return the values with the durations shifted by a time [ns]."""
        shifted = list(values)
        for place in self._durations:
            shifted[place] += by
        return shifted

    def _fits(self, data: bytes) -> bool:
        """Return True if the constant bytes are those of the blank message."""
        if len(data) != self.length:
            return False
        for begin, end, constant in self._constants:  # noqa: SIM110 (a generator costs three times as much here)
            if data[begin:end] != constant:
                return False
        return True

    def _read_any(self, data: bytes) -> list[Any]:
        """Decode a message with any padding, byte order and frame; names and lengths are checked."""
        rows = rows_of([data], len(data))
        layout = self._other
        if layout is None or layout.length != len(data) or not layout.fits(rows).all():
            layout = layout_of(typestore(), self.topic.type, data)
            self._check_names([leaf.text for leaf in layout.leaves if leaf.path.startswith("name[")])
            self._other = layout
        leaves = {leaf.path: leaf for leaf in layout.leaves}
        values: list[Any] = []
        for slot in self._slots:
            leaf = leaves.get(slot.path)
            if leaf is None or ("[0]" in slot.path and slot.path.replace("[0]", "[1]") in leaves):
                raise ValueError(f"{slot.path.partition('[')[0]} does not hold one entry")
            values += slot.read_any(layout, rows, leaf)
        return values

    def _check_names(self, names: Sequence[str]) -> None:
        due = self._names
        if tuple(names) != due:
            raise ValueError(f"names {list(names[:3])}... where {list(due[:3])}... ({len(due)}) are due")


def _getter(fields: Sequence[str]) -> Callable[[Any], Sequence[Any]]:
    """Return a function from a message to the values of its fields."""
    if len(fields) > 1:
        return attrgetter(*fields)
    return lambda message: [getattr(message, field) for field in fields]
