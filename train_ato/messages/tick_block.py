"""Messages of consecutive ticks as arrays, in the order of publication."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train_ato.messages.topics import BY_NAME

Values = dict[str, NDArray[Any]]
"""Values of the messages of a topic by field, each of shape (ticks, n); durations [ns] as integers."""


@dataclass(frozen=True)
class TickBlock:
    """Messages of consecutive ticks.

    Attributes
    ----------
    stamps : Array of int, shape (ticks,)
        Stamps [ns].
    rows : list of tuple
        Topic and values of the messages of every tick, in the order of publication.
    between : dict of list
        Other messages by the number of their tick, in order: number of the message of ``rows`` before which it is
        published, topic, message.
    """

    stamps: NDArray[np.int64]
    rows: list[tuple[str, Values]]
    between: dict[int, list[tuple[int, str, Any]]]

    def messages(self) -> Iterator[tuple[int, list[tuple[str, Any]]]]:
        """Yield the stamp [ns] of every tick, and its messages with their topics in the order of publication."""
        for tick, stamp in enumerate(self.stamps.tolist()):
            found = [(topic, message_at(topic, stamp, values, tick)) for topic, values in self.rows]
            for number, topic, message in reversed(self.between.get(tick, ())):
                found.insert(number, (topic, message))
            yield stamp, found


def message_at(topic: str, stamp: int, values: Values, tick: int) -> Any:
    """Return the message of a tick from the values of its topic."""
    entry = BY_NAME[topic]
    row = {place.field: values[place.field][tick] for place in entry.places if place.field != "stamp"}
    single = {place.field: row[place.field].item() for place in entry.places if place.field in row and not place.owner}
    return entry.message(stamp, **row | single)
