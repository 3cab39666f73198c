"""Block ``faults:`` of a scenario: faults of messages and of nodes, by their time.

A fault of messages acts between the publisher of a topic and its readers.  A fault of a node is the fault of all its
messages; with one process per node the process itself is killed or stopped too.  EN 50159, 5.2 lists the threats to a
message: repetition, deletion, insertion, re-sequencing, corruption, delay and masquerade.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from plant_sim.input_error import close_match
from plant_sim.si_model import SiModel
from plant_sim.units import Ratio, Time
from train_ato.messages.topic import Rate, Role
from train_ato.messages.topics import TOPICS, published_by

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

    topic: str = Field(description=f"one of {', '.join(FAULT_TOPICS)}")
    reader: Reader | None = Field(None, description="node whose messages have the fault; default: every reader")
    begin: Time = Field(0.0, ge=0, description="stamp of the first message with the fault")
    end: Time | None = Field(None, gt=0, description="stamp of the first message without it; default: none")

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
    def _consistent(self) -> _TopicFault:
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
    probability: Ratio = Field(1.0, gt=0, le=1)


class DelayFault(_TopicFault):
    """Delay, added to that of the link."""

    do: Literal["delay"] = "delay"
    delay: Time = Field(gt=0, le=MAX_FAULT_TIME)


class FreezeFault(_TopicFault):
    """Masquerade: a sender repeats the content of its last message before the fault, with new stamps."""

    do: Literal["freeze"] = "freeze"


class RepeatFault(_TopicFault):
    """Repetition: the last message before the fault with its old stamp, or every message twice."""

    do: Literal["repeat"] = "repeat"
    message: Literal["old", "each"] = Field(
        "old", description="the last one before the fault in place of the new ones, or each one twice"
    )


class ReorderFault(_TopicFault):
    """Re-sequencing: the messages of a block of time arrive at its end, the newest first."""

    do: Literal["reorder"] = "reorder"
    block: Time = Field(gt=0, le=MAX_FAULT_TIME)


class InsertFault(_TopicFault):
    """Insertion: before every message a foreign one arrives.

    Its content is that of the last message before the fault; its stamp is ``ahead`` of the true one.
    """

    do: Literal["insert"] = "insert"
    ahead: Time = Field(0.0, ge=0, le=MAX_FAULT_TIME)


class CorruptFault(_TopicFault):
    """Corruption of the values: NaN, infinity, 1e15 (range), the other sign, or one random wrong bit of one value."""

    do: Literal["corrupt"] = "corrupt"
    value: Literal["nan", "inf", "range", "sign", "bit"]
    probability: Ratio = Field(1.0, gt=0, le=1)


MessageFault = Annotated[
    DropFault | DelayFault | FreezeFault | RepeatFault | ReorderFault | InsertFault | CorruptFault,
    Field(discriminator="do"),
]


class _NodeFault(SiModel):
    """Base of the faults of a node."""

    node: Literal["profile", "observer", "controller", "supervisor", "recorder"]
    at: Time = Field(ge=0, description="stamp of its first message with the fault")

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
    delay: Time = Field(gt=0, le=MAX_FAULT_TIME)


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
