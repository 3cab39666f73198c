"""Block ``faults:`` of a scenario: faults of messages and of nodes, by their time.

A fault of messages acts between the publisher of a topic and its readers.  A fault of a node is the fault of all its
messages; with one process per node the process itself is killed or stopped too.  EN 50159, 5.2 lists the threats to a
message: repetition, deletion, insertion, re-sequencing, corruption, delay and masquerade.
"""

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from plant_sim.elementary import random_stream
from plant_sim.input_error import close_match
from plant_sim.si_model import SiModel, option
from plant_sim.units import Ratio, Time
from train_ato.messages.topic import Rate, Role
from train_ato.messages.topics import TOPICS, published_by
from train_ato.messages.types import Array

MAX_FAULT_TIME = 600.0
"""Largest delay, block or lead of a fault [s]."""

FAULT_TOPICS: dict[str, tuple[str, ...]] = {
    topic.name: tuple(role.value for role in topic.readers)
    for topic in TOPICS
    if topic.rate in (Rate.TICK, Rate.SUPERVISION) and topic.readers
}
"""Topics of the loop with their readers."""

Reader = Literal["plant", "profile", "observer", "controller", "supervisor"]


class _TopicFault(SiModel):
    """Base of the faults of messages: topic, reader and interval."""

    topic: str = Field(description=f"one of {', '.join(FAULT_TOPICS)}", examples=["ato/command"])
    reader: Reader | None = option(None, "node whose messages have the fault; default: every reader")
    begin: Time = option(0.0, "stamp of the first message with the fault", example=60.0, ge=0)
    end: Time | None = option(None, "stamp of the first message without it; default: none", example=70.0, gt=0)

    @field_validator("topic")
    @classmethod
    def _known(cls, topic: str) -> str:
        if topic not in FAULT_TOPICS:
            raise ValueError(
                f"'{topic}' is no topic of the loop{close_match(topic, FAULT_TOPICS)}; use one of "
                f"{', '.join(FAULT_TOPICS)}"
            )
        return topic

    @model_validator(mode="after")
    def _consistent(self) -> "_TopicFault":
        if self.end is not None and self.end <= self.begin:
            raise ValueError(f"end {self.end:g} s must be after begin {self.begin:g} s")
        readers = FAULT_TOPICS[self.topic]
        if self.reader is not None and self.reader not in readers:
            raise ValueError(f"reader {self.reader} does not read {self.topic}; use one of {', '.join(readers)}")
        return self

    def described(self) -> str:
        """Return a readable description with its values."""
        values = self.model_dump(exclude={"topic", "reader", "begin", "end", "do"})
        strength = ", ".join(f"{name} {value}" for name, value in values.items())
        return f"{self.model_dump()['do']} {self.topic}{f': {strength}' if strength else ''}"


class DropFault(_TopicFault):
    """Deletion: messages do not arrive."""

    do: Literal["drop"] = "drop"
    probability: Ratio = option(1.0, "probability of the fault of each message", example=0.3, gt=0, le=1)


class DelayFault(_TopicFault):
    """Delay, added to that of the link."""

    do: Literal["delay"] = "delay"
    delay: Time = Field(gt=0, le=MAX_FAULT_TIME, description="additional delay", examples=[0.5])


class FreezeFault(_TopicFault):
    """Masquerade: a sender repeats the content of its last message before the fault, with new stamps."""

    do: Literal["freeze"] = "freeze"


class RepeatFault(_TopicFault):
    """Repetition: the last message before the fault with its old stamp, or every message twice."""

    do: Literal["repeat"] = "repeat"
    message: Literal["old", "each"] = option(
        "old", "repeated message: the last one before the fault in place of the new ones, or each one twice"
    )


class ReorderFault(_TopicFault):
    """Re-sequencing: the messages of a block of time arrive at its end, the newest first."""

    do: Literal["reorder"] = "reorder"
    block: Time = Field(gt=0, le=MAX_FAULT_TIME, description="duration of a block of messages", examples=[0.5])


class InsertFault(_TopicFault):
    """Insertion: before every message a foreign one arrives.

    Its content is that of the last message before the fault. Its stamp is later than the true stamp by ``ahead``.
    """

    do: Literal["insert"] = "insert"
    ahead: Time = option(
        0.0, "time by which the stamp of the foreign message is ahead", example=0.5, ge=0, le=MAX_FAULT_TIME
    )


class CorruptFault(_TopicFault):
    """Corruption of the values: NaN, infinity, 1e15 (range), the other sign, or one random wrong bit of one value."""

    do: Literal["corrupt"] = "corrupt"
    value: Literal["nan", "inf", "range", "sign", "bit"] = Field(description="kind of the wrong value")
    probability: Ratio = option(1.0, "probability of the fault of each message", example=0.3, gt=0, le=1)


MessageFault = Annotated[
    DropFault | DelayFault | FreezeFault | RepeatFault | ReorderFault | InsertFault | CorruptFault,
    Field(discriminator="do"),
]


class _NodeFault(SiModel):
    """Base of the faults of a node."""

    node: Literal["profile", "observer", "controller", "supervisor", "recorder"] = Field(
        description="node with the fault"
    )
    at: Time = Field(ge=0, description="time from which the node has the fault", examples=[60.0])

    @property
    def role(self) -> Role:
        """Role of the node."""
        return Role(self.node)


class KillFault(_NodeFault):
    """End of a node; with one process per node by SIGKILL."""

    do: Literal["kill"] = "kill"


class StopFault(_NodeFault):
    """Suspension of a node for the rest of the run; with one process per node by SIGSTOP."""

    do: Literal["stop"] = "stop"


class SlowFault(_NodeFault):
    """Answers of a node that arrive late."""

    do: Literal["slow"] = "slow"
    delay: Time = Field(gt=0, le=MAX_FAULT_TIME, description="additional delay of its messages", examples=[0.5])


class DuplicateFault(_NodeFault):
    """Second, equal node that sends the same messages."""

    do: Literal["duplicate"] = "duplicate"


NodeFault = KillFault | StopFault | SlowFault | DuplicateFault
Fault = Annotated[MessageFault | NodeFault, Field(discriminator="do")]


def node_faults(faults: Iterable[Fault]) -> tuple[NodeFault, ...]:
    """Return the faults of nodes."""
    return tuple(fault for fault in faults if isinstance(fault, _NodeFault))


def message_faults(faults: Iterable[Fault]) -> tuple[MessageFault, ...]:
    """Return faults as faults of messages; the fault of a node is that of all topics it publishes for the loop."""
    found: list[MessageFault] = []
    for fault in faults:
        if isinstance(fault, _NodeFault):
            found += _of_node(fault)
        else:
            found.append(fault)
    return tuple(found)


def _of_node(fault: NodeFault) -> list[MessageFault]:
    topics = [topic.name for topic in published_by(fault.role) if topic.name in FAULT_TOPICS]
    if isinstance(fault, SlowFault):
        return [DelayFault(topic=topic, begin=fault.at, delay=fault.delay) for topic in topics]
    if isinstance(fault, DuplicateFault):
        return [RepeatFault(topic=topic, begin=fault.at, message="each") for topic in topics]
    return [DropFault(topic=topic, begin=fault.at) for topic in topics]


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
