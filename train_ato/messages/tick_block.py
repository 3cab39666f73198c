"""Messages of consecutive ticks as arrays, in the order of publication."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
