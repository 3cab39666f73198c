"""Effect of a message fault on the messages of a topic, between publisher and reader."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plant_sim.streams import random_stream
from train_ato.messages.faults import (
    CorruptFault,
    DelayFault,
    DropFault,
    FreezeFault,
    InsertFault,
    MessageFault,
    ReorderFault,
    RepeatFault,
)
from train_ato.messages.types import Array

OUT_OF_RANGE = 1e15
"""Value outside the range of every quantity."""
NEVER = 2**62
SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Arrival:
    """Message with its time of arrival [ns]; of one time the lowest order is first."""

    time: int
    order: float
    message: Any


class FaultEffect:
    """A fault in its interval, for one reader.

    Parameters
    ----------
    spec
        The fault.
    seed, name
        Seed and key of the random stream.
    last
        Last message before a fault that is added during the run.
    """

    def __init__(self, spec: MessageFault, seed: int, name: str, last: Any = None) -> None:
        self.spec = spec
        self._begin = round(spec.begin * SECOND)
        self._end = NEVER if spec.end is None else round(spec.end * SECOND)
        drawn = isinstance(spec, (DropFault, CorruptFault))
        self._random = random_stream(seed, f"fault/{name}") if drawn else None
        self._kept = last

    def acts(self, stamp: int) -> bool:
        """Return True if a message sent at a stamp [ns] has the fault."""
        return self._begin <= stamp < self._end

    def next_begin(self, stamp: int) -> int:
        """Return the begin of the fault after a stamp [ns], :data:`NEVER` without one."""
        return self._begin if self._begin > stamp else NEVER

    def pass_on(self, count: int, last: Any) -> None:
        """Take messages without the fault, the last one and the number of them, as :meth:`apply`."""
        if self._random is not None:
            self._random.random(3 * count)
        self._kept = last

    def apply(self, now: int, sent: Any, arrivals: list[Arrival]) -> list[Arrival]:
        """Return the arrivals of a message.

        Parameters
        ----------
        now
            Time of the sending [ns].
        sent
            The message.
        arrivals
            Its arrivals after the faults before this one.
        """
        draws = np.zeros(3) if self._random is None else self._random.random(3)
        if not self.acts(now):
            self._kept = sent
            return arrivals
        if self._kept is None:
            self._kept = sent
        return [changed for arrival in arrivals for changed in self._changed(arrival, draws)]

    def _changed(self, arrival: Arrival, draws: Array) -> list[Arrival]:
        spec, message = self.spec, arrival.message
        if isinstance(spec, DropFault):
            return [] if draws[0] < spec.probability else [arrival]
        if isinstance(spec, DelayFault):
            return [replace(arrival, time=arrival.time + round(spec.delay * SECOND))]
        if isinstance(spec, FreezeFault):
            return [replace(arrival, message=replace(self._kept, stamp=message.stamp))]
        if isinstance(spec, RepeatFault):
            return [replace(arrival, message=self._kept)] if spec.message == "old" else [arrival, arrival]
        if isinstance(spec, ReorderFault):
            block = round(spec.block * SECOND)
            end = self._begin + ((arrival.time - self._begin) // block + 1) * block
            return [replace(arrival, time=end, order=-arrival.order)]
        if isinstance(spec, InsertFault):
            foreign = replace(self._kept, stamp=message.stamp + round(spec.ahead * SECOND))
            return [replace(arrival, order=arrival.order - 0.5, message=foreign), arrival]
        return [replace(arrival, message=corrupted(message, spec, draws)) if draws[0] < spec.probability else arrival]


def corrupted(message: Any, spec: CorruptFault, draws: Array) -> Any:
    """Return a message with wrong values and its own stamp.

    Parameters
    ----------
    message
        Message with float64 values, single or in arrays.
    spec
        Kind of the wrong values.
    draws : Array, shape (3,)
        Random numbers in [0, 1); the last two choose the value and the bit.
    """
    entries = {field.name: getattr(message, field.name) for field in dataclasses.fields(message)}
    values = {name: np.array(entry, dtype=np.float64) for name, entry in entries.items() if not isinstance(entry, int)}
    if spec.value == "bit":
        sizes = [(name, index) for name, entry in values.items() for index in range(entry.size)]
        name, index = sizes[int(draws[1] * len(sizes))]
        bits = values[name].reshape(-1).view(np.uint64)
        bits[index] ^= np.uint64(1) << np.uint64(int(draws[2] * 64))
    for entry in values.values():
        if spec.value == "sign":
            np.negative(entry, out=entry)
        elif spec.value != "bit":
            entry[...] = {"nan": np.nan, "inf": np.inf, "range": OUT_OF_RANGE}[spec.value]
    changed = {name: float(value) if value.ndim == 0 else value for name, value in values.items()}
    return replace(message, **changed)
