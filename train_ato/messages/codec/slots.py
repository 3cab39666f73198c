"""Slots of a message of fixed length: places of its numbers in the bytes."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate
from typing import Any

import numpy as np

from train_ato.messages.codec.byte_layout import Layout, Leaf, layout_of
from train_ato.messages.codec.cdr import SECOND, TIME, blank, nanoseconds, resize, typestore
from train_ato.messages.layout import TrainLayout
from train_ato.messages.topic import Topic
from train_ato.messages.types import Array

__all__ = ["FLOAT64", "STAMP_END", "ArraySlot", "NumberSlot", "Slot", "TimeSlot", "sample_of", "slots_of"]

_SMALL = 16
"""Maximum size of a block for which a loop checks finite values faster than numpy."""
_FLOAT = struct.Struct("<d")
FLOAT64 = np.dtype("<f8")
"""Numbers in the bytes of a message."""
STAMP_END = 12
"""End of the stamp in the bytes of a message."""


class ArraySlot:
    """Consecutive arrays of float64: values of vehicles, power units or coupler sensors."""

    def __init__(self, path: str, start: int, sizes: Sequence[int], finite: bool) -> None:
        self.path, self.start, self.sizes, self.finite = path, start, sizes, finite
        self.size = sum(sizes)
        self._parts = [slice(end - size, end) for end, size in zip(accumulate(sizes), sizes, strict=True)]

    @property
    def writers(self) -> list[Callable[[Any], Any]]:
        """Functions from a value of every field to the bytes of the slot."""
        return [partial(self.write, size) for size in self.sizes]

    def write(self, size: int, value: Any) -> Any:
        """Return a checked array; its buffer has the bytes."""
        if value.dtype.char != "d":
            raise ValueError(f"{self.path} is {value.dtype}, not float64")
        if value.size != size:
            raise ValueError(f"{self.path} has {value.size} values where {size} are due")
        if self.finite:
            self.check(value)
        return value

    def read(self, data: bytes) -> list[Array]:
        """Return the values of the fields in the bytes of a message with the due layout."""
        return self.split(np.frombuffer(data, np.float64, self.size, self.start).copy())

    def read_any(self, layout: Layout, rows: Any, leaf: Leaf) -> list[Array]:
        """Return the values of the fields in the bytes of a message with another layout."""
        if leaf.count != self.size:
            raise ValueError(f"{self.path} has {leaf.count} values where {self.size} are due")
        return self.split(layout.read(rows, leaf)[:, 0].astype(np.float64))

    def split(self, values: Array) -> list[Array]:
        """Return the values of every field."""
        if self.finite:
            self.check(values)
        return [values[part] for part in self._parts] if len(self.sizes) > 1 else [values]

    def check(self, values: Array) -> None:
        """Check that the slot has finite values only."""
        small = values.size <= _SMALL
        if not (all(map(math.isfinite, values.tolist())) if small else np.isfinite(values).all()):
            raise ValueError(f"{self.path} is not finite: {values[~np.isfinite(values)][0]}")


@dataclass(frozen=True)
class NumberSlot:
    """Single float64."""

    path: str
    start: int
    finite: bool
    size: int = 1

    @property
    def writers(self) -> list[Callable[[float], bytes]]:
        """Functions from a value of every field to the bytes of the slot."""
        return [self.write]

    def write(self, value: float) -> bytes:
        """Return the bytes of a value."""
        self.check(value)
        return _FLOAT.pack(value)

    def read(self, data: bytes) -> list[float]:
        """Return the values of the fields in the bytes of a message with the due layout."""
        (value,) = _FLOAT.unpack_from(data, self.start)
        self.check(value)
        return [value]

    def read_any(self, layout: Layout, rows: Any, leaf: Leaf) -> list[float]:
        """Return the values of the fields in the bytes of a message with another layout."""
        if leaf.count not in (None, 1):
            raise ValueError(f"{self.path} has {leaf.count} values where 1 are due")
        value = float(layout.read(rows, leaf).item())
        self.check(value)
        return [value]

    def check(self, value: float) -> None:
        """Check that the slot has finite values only."""
        if self.finite and not math.isfinite(value):
            raise ValueError(f"{self.path} is not finite: {value}")


@dataclass(frozen=True)
class TimeSlot:
    """Duration from the stamp [ns]."""

    path: str
    start: int
    size: int = 1

    @property
    def writers(self) -> list[Callable[[int], bytes]]:
        """Functions from a value of every field to the bytes of the slot."""
        return [self.write]

    def write(self, value: int) -> bytes:
        """Return the bytes of a value."""
        return TIME.pack(*divmod(value, SECOND))

    def read(self, data: bytes) -> list[int]:
        """Return the values of the fields in the bytes of a message with the due layout."""
        seconds, nanoseconds = TIME.unpack_from(data, self.start)
        return [seconds * SECOND + nanoseconds]

    def read_any(self, layout: Layout, rows: Any, leaf: Leaf) -> list[int]:
        """Return the values of the fields in the bytes of a message with another layout."""
        return [int(nanoseconds(layout.read(rows, leaf))[0])]


Slot = ArraySlot | NumberSlot | TimeSlot


def _sizes(topic: Topic, layout: TrainLayout, path: str) -> tuple[int | None, ...]:
    """Return the numbers of values of the fields at a path, None for a single value."""
    owners = (place.owner for place in topic.places if place.path == path)
    return tuple(None if owner is None else len(layout.names(owner)) for owner in owners)


def sample_of(topic: Topic, layout: TrainLayout) -> bytes:
    """Return the bytes of a message with stamp and numbers 0."""
    message = blank(topic.type)
    if topic.owners:
        message.name = list(topic.names(layout))
    if frame := topic.frame_id(layout):
        message.header.frame_id = frame
    for path, texts in topic.texts:
        setattr(message, path, list(texts))
    for path in dict.fromkeys(place.path for place in topic.places):
        resize(topic.type, message, path, sum(1 if size is None else size for size in _sizes(topic, layout, path)))
    return bytes(typestore().serialize_cdr(message, topic.type))


def slots_of(topic: Topic, layout: TrainLayout, sample: bytes) -> list[Slot]:
    """Return the places of the numbers in the bytes, in their order.

    Raises
    ------
    ValueError
        If a place is not a float64, stamp or duration, or the ROS message does not begin with its stamp.
    """
    leaves = {leaf.path: leaf for leaf in layout_of(typestore(), topic.type, sample).leaves}
    stamp = next(iter(leaves.values()))
    if not (stamp.is_time and stamp.start + 8 == STAMP_END):
        raise ValueError(f"topic {topic.name}: a {topic.type} does not begin with its stamp")
    found: list[Slot] = []
    for path in dict.fromkeys(place.path for place in topic.places if place.field != "stamp"):
        leaf, sizes = leaves.get(path), _sizes(topic, layout, path)
        arrays = tuple(size for size in sizes if size is not None)
        if leaf is None or not (leaf.is_time or leaf.dtype == FLOAT64):
            raise ValueError(f"topic {topic.name}: {path} of a {topic.type} is not float64")
        if leaf.is_time:
            found.append(TimeSlot(path, leaf.start))
        elif arrays:
            found.append(ArraySlot(path, leaf.start, arrays, topic.finite))
        else:
            found.append(NumberSlot(path, leaf.start, topic.finite))
    return sorted(found, key=lambda slot: slot.start)
