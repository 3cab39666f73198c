"""Records of the log for the messages of consecutive ticks, encoded at once.

A message of every tick has a fixed length, so that all ticks have the same bytes except for times and numbers. These
are written into the records of the messages; the other messages are put between them.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from train_ato.messages.codec.codec import Wire
from train_ato.messages.tick_block import TickBlock
from train_ato.messages.topics import EPOCH_NS

MESSAGE = struct.Struct("<BQHIQQ")
"""Head of a message: record type, length, channel, sequence number, log time and publish time [ns since 1970]."""
MESSAGE_TYPE, BEFORE_DATA, BEFORE_TIMES = 5, 22, 15
"""Type of the record; length of the record without its data; place of the times in the head [bytes]."""
Index = dict[int, list[int]]
"""Log time and place of every message by channel, one after the other."""


def message_head(channel: int, publish_ns: int, log_ns: int, length: int) -> bytes:
    """Return the head of a message with a length of its data [bytes]; the sequence number is 0, as in Jazzy."""
    return MESSAGE.pack(MESSAGE_TYPE, BEFORE_DATA + length, channel, 0, log_ns, publish_ns)


class TickRecords:
    """Records of a block of ticks, with publish time = log time = stamp.

    Parameters
    ----------
    block
        Messages.
    wire
        Encoder of the topics.
    channels
        Number of the channel by topic.

    Attributes
    ----------
    sizes : Array of int, shape (ticks,)
        Length of the records of every tick [bytes].
    """

    def __init__(self, block: TickBlock, wire: Wire, channels: Mapping[str, int]) -> None:
        self._times: NDArray[np.int64] = block.stamps + EPOCH_NS
        self._channels = [channels[topic] for topic, _ in block.rows]
        records = [wire.records[topic] for topic, _ in block.rows]
        blank: list[bytes] = [
            message_head(channel, 0, 0, len(record.blank)) + record.blank
            for channel, record in zip(self._channels, records, strict=True)
        ]
        self._starts = [0, *accumulate(map(len, blank))]
        self._length = self._starts[-1]
        ticks = np.tile(np.frombuffer(b"".join(blank), np.uint8), (self._times.size, 1))
        for record, (_, values), (start, end) in zip(records, block.rows, pairwise(self._starts), strict=True):
            begin = start + MESSAGE.size
            ticks[:, start + BEFORE_TIMES : begin].view("<u8")[:] = self._times[:, None]
            record.fill(ticks[:, begin:end].view(record.dtype)[:, 0], block.stamps, values)
        self._ticks = memoryview(ticks.ravel())  # type: ignore[arg-type]
        self._between: dict[int, list[tuple[int, int, bytes]]] = {}
        self.sizes = np.full(self._times.size, self._length, dtype=np.int64)
        for tick, messages in block.between.items():
            time, added = int(self._times[tick]), []
            for before, topic, message in messages:
                content = wire.encode(topic, message)
                whole = message_head(channels[topic], time, time, len(content)) + content
                added.append((before, channels[topic], whole))
                self.sizes[tick] += len(whole)
            self._between[tick] = added

    def part(self, first: int, end: int, place: int) -> tuple[bytes, Index]:
        """Return the records of some ticks and their index, for a place in the chunk [bytes]."""
        begins = place + np.concatenate(([0], np.cumsum(self.sizes[first : end - 1])))
        places = begins[:, None] + np.array(self._starts[:-1])
        parts: list[bytes | memoryview] = []
        others: Index = {}
        for tick in range(first, end):
            row = self._ticks[tick * self._length : (tick + 1) * self._length]
            if tick not in self._between:
                parts.append(row)
                continue
            time, done, added = int(self._times[tick]), 0, 0
            for before, channel, record in self._between[tick]:
                cut = self._starts[before]
                parts += [row[done:cut], record]
                others.setdefault(channel, []).extend((time, int(begins[tick - first]) + cut + added))
                done, added = cut, added + len(record)
                places[tick - first, before:] += len(record)
            parts.append(row[done:])
        times, index = self._times[first:end], others
        for channel, column in zip(self._channels, places.T, strict=True):
            index[channel] = np.column_stack((times, column)).ravel().tolist()
        return b"".join(parts), index
