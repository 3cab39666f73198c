"""Decoding of small messages of fixed length in one call of ``struct``."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any

import numpy as np

from train_ato.messages.codec.cdr import SECOND
from train_ato.messages.codec.slots import STAMP_END, ArraySlot, Slot, TimeSlot
from train_ato.messages.topics import EPOCH_NS

MOST_BYTES = 512
"""Largest length of a small message."""


class SmallMessage:
    """Places of all values in one format of ``struct``; any irregular message is left to the general decoder.

    Parameters
    ----------
    sample
        Bytes of a message with stamp and numbers 0.
    slots
        Places of its numbers, rising.
    order
        Number of the value, in the order of the slots, of every field of the dataclass.
    finite
        True for a topic with finite values only.
    """

    def __init__(self, sample: bytes, slots: Sequence[Slot], order: Sequence[int], finite: bool) -> None:
        self._length, form, end = len(sample), "<4siI", STAMP_END
        constants, expected = [0], [sample[:4]]
        numbers: list[int] = []
        makers: list[tuple[bool, int, int]] = []
        self._times: dict[int, int] = {}
        count = 3
        for slot in slots:
            form += f"{slot.start - end}s"
            constants.append(count)
            expected.append(sample[end : slot.start])
            count += 1
            sizes = slot.sizes if isinstance(slot, ArraySlot) else (1,)
            if isinstance(slot, TimeSlot):
                form += "iI"
                self._times[len(makers)] = count
                makers.append((False, 0, 0))
                count += 2
            else:
                form += f"{slot.size}d"
                for size in sizes:
                    makers.append((isinstance(slot, ArraySlot), len(numbers), len(numbers) + size))
                    numbers += range(count, count + size)
                    count += size
            end = slot.start + 8 * slot.size
        constants.append(count)
        expected.append(sample[end:])
        self._unpack = struct.Struct(f"{form}{len(sample) - end}s").unpack
        self._constants, self._expected = itemgetter(*constants), tuple(expected)
        self._numbers = _several(numbers)
        self._makers = [makers[place] for place in order]
        self._timed = [(field, self._times[place]) for field, place in enumerate(order) if place in self._times]
        self._finite = finite

    def read(self, data: bytes) -> tuple[int, list[Any]] | None:
        """Return stamp and values of the fields, arrays as copies; None for a message that the general decoder reads.

        Durations are those of the bytes, without the shift to the start of the run.
        """
        if len(data) != self._length:
            return None
        found = self._unpack(data)
        if self._constants(found) != self._expected:
            return None
        numbers = self._numbers(found)
        if self._finite and not all(map(math.isfinite, numbers)):
            return None
        values = [
            np.array(numbers[begin:end]) if array else numbers[begin] if end else 0
            for array, begin, end in self._makers
        ]
        for field, place in self._timed:
            values[field] = found[place] * SECOND + found[place + 1]
        return found[1] * SECOND + found[2] - EPOCH_NS, values


def _several(places: Sequence[int]) -> Callable[[Any], tuple[float, ...]]:
    """Return a function from the unpacked values to those at some places, as a tuple for any number of places."""
    if len(places) > 1:
        return itemgetter(*places)
    return lambda found: tuple(found[place] for place in places)
