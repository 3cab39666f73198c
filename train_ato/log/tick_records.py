"""Records of the log for the messages of consecutive ticks, encoded at once.

A message of every tick has a fixed length, so that all ticks have the same bytes except for times and numbers. These
are written column by column; the other messages are put between them.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

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
        times = self._times[:, None].astype("<u8").view(np.uint8)
        parts, self._starts, self._channels = [], [0], [channels[topic] for topic, _ in block.rows]
        for (topic, values), channel in zip(block.rows, self._channels, strict=True):
            data = wire.encode_each(topic, block.stamps, values)
            head = np.frombuffer(message_head(channel, 0, 0, data.shape[1]), dtype=np.uint8)
            heads = np.tile(head, (len(times), 1))
            heads[:, BEFORE_TIMES : BEFORE_TIMES + 16] = np.tile(times, 2)
            parts += [heads, data]
            self._starts.append(self._starts[-1] + head.size + data.shape[1])
        self._length = self._starts[-1]
        self._ticks = memoryview(np.concatenate(parts, axis=1).ravel())  # type: ignore[arg-type]
        self._between: dict[int, list[tuple[int, int, bytes]]] = {}
        self.sizes = np.full(len(times), self._length, dtype=np.int64)
        for tick, messages in block.between.items():
            time, records = int(self._times[tick]), []
            for before, topic, message in messages:
                content = wire.encode(topic, message)
                record = message_head(channels[topic], time, time, len(content)) + content
                records.append((before, channels[topic], record))
                self.sizes[tick] += len(record)
            self._between[tick] = records

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
