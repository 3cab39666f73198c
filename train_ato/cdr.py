"""CDR, the encoding of ROS 2: message types, stamps, and templates of messages whose layout is fixed."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from train_ato.topics import EPOCH_NS
from train_ato.types import Array

_TIME = struct.Struct("<iI")
_FLOAT = struct.Struct("<d")
SECOND = 1_000_000_000


@lru_cache(maxsize=1)
def typestore() -> Any:
    """Return the message types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def stamp_of(data: bytes) -> int:
    """Return the stamp of any message of the topic table [ns since the start of the run]; it always comes first.

    Raises
    ------
    ValueError
        If the bytes are too short to hold a stamp.
    """
    if len(data) < 12:
        raise ValueError(f"{len(data)} bytes hold no stamp")
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return int(seconds) * SECOND + int(nanoseconds) - EPOCH_NS


def time_message(stamp: int) -> Any:
    """Return a stamp as builtin_interfaces/Time."""
    seconds, nanoseconds = divmod(EPOCH_NS + stamp, SECOND)
    return typestore().types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)


def header(stamp: int) -> Any:
    """Return a header without a frame: every quantity of the stack is along the line."""
    return typestore().types["std_msgs/msg/Header"](stamp=time_message(stamp), frame_id="")


class Template:
    """Fixed layout of one message: constant bytes with places for the stamp and for blocks of float64.

    Parameters
    ----------
    type_name
        ROS type.
    make
        Makes the message from a stamp and the blocks; used here, to find the places, and by the slow way of reading.
    sizes
        Number of float64 in every block, in the order in which they stand in the message.
    """

    def __init__(self, type_name: str, make: Callable[[int, Sequence[Array]], Any], sizes: Sequence[int]) -> None:
        self.type_name = type_name
        self._make = make
        self.sizes = tuple(sizes)
        probe: list[Array] = [
            np.arange(size, dtype=np.float64) + 3141.59 * (i + 1) for i, size in enumerate(self.sizes)
        ]
        sample = self.serialise(123_456_789_012, probe)
        place, spans = 4, [(4, 12)]
        for block in probe:
            place = sample.find(block.tobytes(), spans[-1][1]) if block.size else spans[-1][1]
            spans.append((place, place + 8 * block.size))
        self._starts = tuple(start for start, _ in spans[1:])
        ends = [0, *(end for _, end in spans)]
        self._constants = tuple(
            sample[begin:end] for begin, end in zip(ends, [*(start for start, _ in spans), len(sample)], strict=True)
        )
        self._checks = tuple(
            (begin, begin + len(constant), constant)
            for begin, constant in zip(ends, self._constants, strict=True)
            if constant
        )
        self.length = len(sample)
        self._blank = sample
        again: list[Array] = [block + 0.25 for block in probe]
        if self.fill(777_000_000_001, again) != self.serialise(777_000_000_001, again):
            raise AssertionError(f"{type_name}: the layout of this message is not fixed")

    def serialise(self, stamp: int, blocks: Sequence[Array]) -> bytes:
        """Return the bytes the long way round."""
        return bytes(typestore().serialize_cdr(self._make(stamp, blocks), self.type_name))

    def fill(self, stamp: int, blocks: Sequence[Array]) -> bytes:
        """Return the message with this stamp and these blocks of contiguous float64."""
        constants = self._constants
        parts: list[Any] = [constants[0], _TIME.pack(*divmod(EPOCH_NS + stamp, SECOND)), constants[1]]
        for block, constant in zip(blocks, constants[2:], strict=True):
            parts.append(block)
            parts.append(constant)
        data = b"".join(parts)
        if len(data) != self.length:
            raise ValueError(f"fields of {[len(block) for block in blocks]} values where {list(self.sizes)} are due")
        return data

    def fill_floats(self, stamp: int, values: Sequence[float]) -> bytes:
        """Return the message with this stamp and these values, where every block is a single float64."""
        data = bytearray(self._blank)
        _TIME.pack_into(data, 4, *divmod(EPOCH_NS + stamp, SECOND))
        for start, value in zip(self._starts, values, strict=True):
            _FLOAT.pack_into(data, start, value)
        return bytes(data)

    def read_floats(self, data: bytes) -> tuple[int, list[float]] | None:
        """Return stamp and values, where every block is a single float64, or None if a constant byte differs."""
        if not self._fits(data):
            return None
        seconds, nanoseconds = _TIME.unpack_from(data, 4)
        values = [_FLOAT.unpack_from(data, start)[0] for start in self._starts]
        return seconds * SECOND + nanoseconds - EPOCH_NS, values

    def _fits(self, data: bytes) -> bool:
        """Tell whether the constant bytes are those of the template."""
        if len(data) != self.length:
            return False
        for begin, end, constant in self._checks:  # noqa: SIM110 (a generator costs three times as much here)
            if data[begin:end] != constant:
                return False
        return True

    def read(self, data: bytes) -> tuple[int, list[Array]] | None:
        """Return stamp and blocks, or None if a constant byte differs."""
        if not self._fits(data):
            return None
        seconds, nanoseconds = _TIME.unpack_from(data, 4)
        blocks = [
            np.frombuffer(data, np.float64, size, start).copy()
            for size, start in zip(self.sizes, self._starts, strict=True)
        ]
        return seconds * SECOND + nanoseconds - EPOCH_NS, blocks
