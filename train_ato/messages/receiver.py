"""Receiving end of a topic: faults of the transmission, and the defences of EN 50159 against them.

====================  ================================================================
threat                defence
====================  ================================================================
repetition            a stamp that is not newer than the last one is refused
deletion, delay       the age of the newest message is limited, also in the reactions of the train
insertion             a stamp ahead of the time is refused
re-sequencing         as repetition
corruption            a value that is not finite, not possible or not permitted is refused
masquerade            two different messages of one stamp are both refused; a check of the reader compares the content,
                      for the brake release its alive counter
====================  ================================================================
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from train_ato.messages.faults import NEVER, Arrival, FaultEffect, MessageFault
from train_ato.messages.topic import Role, Topic
from train_ato.messages.types import BrakeRelease
from train_ato.messages.validity import MAX_MAGNITUDES


class AliveCheck:
    """Check of the alive counter of the brake releases: EN 50159, 7.3.2, against a sender that repeats its content."""

    def __init__(self) -> None:
        self._last = -1.0

    def problem(self, message: BrakeRelease) -> str:
        """Return the problem of a message as text, "" with a counter above that of the last valid message."""
        counters = message.alive.tolist()
        alive = counters[0]
        if not alive >= 0.0 or counters.count(alive) < len(counters):
            return f"alive counter {alive:g} not possible"
        if alive <= self._last:
            return f"alive counter {alive:g} repeated"
        self._last = alive
        return ""


@lru_cache(maxsize=64)
def validity_check(topic: Topic) -> Callable[[Any], str]:
    """Return a function that returns the problem of a message of a topic as text, "" for a valid message.

    A value is valid if it is one of the permitted values of its field, or within :data:`MAX_MAGNITUDES` of its unit. In
    a topic with ``finite=False`` a value without permitted ones may be NaN. All readers of a topic share one function.
    It checks a message once for consecutive readers, which do not change it.
    """
    fields = []
    for place in topic.places:
        description = topic.description(place)
        if description.permitted or description.unit in MAX_MAGNITUDES:
            fields.append((place.field, description.permitted, MAX_MAGNITUDES.get(description.unit, 0.0)))
    finite = topic.finite
    last: tuple[Any, str] = None, ""

    def problem(message: Any) -> str:
        nonlocal last
        known, text = last  # one read: runs in other threads use the same function
        if message is known:
            return text
        for name, permitted, bound in fields:
            value = getattr(message, name)
            for entry in (value,) if type(value) is float else value.tolist():
                if entry in permitted if permitted else -bound <= entry <= bound:
                    continue
                if permitted or finite or entry == entry:
                    text = f"{name} {entry:g}"
                    last = message, text
                    return text
        last = message, ""
        return ""

    return problem


class Receiver:
    """Newest valid message of a topic at a reader.

    Parameters
    ----------
    topic, reader
        The topic and the node that reads it.
    faults
        Faults of the run.
    seed
        Seed of the run.
    checked
        True: invalid messages are refused and the age is limited; False: the newest arrival is used as it is.
    max_age
        Largest age of a message [ns]; None: no limit.

    Attributes
    ----------
    fresh, missing : bool
        True if the last call accepted a new message; True if it found none of the permitted age.
    missed, refused : int
        Number of calls without the sent message, and of refused messages.
    refusal : str
        Reason of the last refusal.
    changed : bool
        True after the begin or the end of a fault and after a refusal for a new reason; the reader resets it.
    check : callable or None
        Check by the reader; returns the problem of a message as text, "" for a valid message.
    """

    def __init__(
        self,
        topic: Topic,
        reader: Role,
        faults: Sequence[MessageFault],
        seed: int,
        *,
        checked: bool,
        max_age: int | None = None,
    ) -> None:
        self._topic, self._reader, self._seed = topic, reader, seed
        self._checked = checked
        self._max_age = max_age
        self._problem = validity_check(topic)
        self._effects: list[FaultEffect] = []
        self._numbers = 0
        self._waiting: list[Arrival] = []
        self._newest: Any = None
        self._before: Any = None
        self._last = -1
        self._sent = 0
        self._acting: list[bool] = []
        self.check: Callable[[Any], str] | None = None
        self.fresh = self.missing = self.changed = False
        self.missed = self.refused = 0
        self.refusal = ""
        for fault in faults:
            self.add(fault)

    def add(self, fault: MessageFault) -> None:
        """Add a fault; one of another topic or reader has no effect."""
        if fault.topic == self._topic.name and fault.reader in (None, self._reader.value):
            name = f"{self._topic.name}/{self._reader.value}/{self._numbers}"
            self._effects.append(FaultEffect(fault, self._seed, name, self._newest))
            self._acting.append(False)
        self._numbers += 1

    def receive(self, now: int, message: Any) -> Any:
        """Return the newest valid message at a time [ns]; None without one.

        Parameters
        ----------
        now
            Time of the reader [ns].
        message
            Message sent at this time, or None.
        """
        if not (self._checked or self._effects):
            self.fresh = message is not None
            return message
        self.fresh = False
        if self._effects:
            acting = [effect.acts(now) for effect in self._effects]
            self.changed |= acting != self._acting
            self._acting = acting
            for arrival in self._arrived(now, message):
                self._take(now, arrival)
        elif message is not None:
            check = self.check
            if self._last < message.stamp <= now and not (self._problem(message) or (check and check(message))):
                self._before, self._newest, self._last, self.fresh = self._newest, message, message.stamp, True
            else:
                self._take(now, message)
        if message is not None and not self.fresh:
            self.missed += 1
        if not self._checked and self._newest is None:
            self._newest = message  # the initial state is known, as in a link
        newest = self._newest
        missing = newest is None or (self._checked and self._max_age is not None and now - newest.stamp > self._max_age)
        self.changed |= missing != self.missing
        self.missing = missing
        return None if missing else newest

    def is_regular(self, now: int) -> bool:
        """Return True if valid messages are received as they are sent, from a time [ns] to the next fault."""
        if self.missing or self.changed or self._waiting or any(self._acting):
            return False
        return not any(effect.acts(now) for effect in self._effects)

    def next_fault(self, now: int) -> int:
        """Return the begin of the next fault after a time [ns]."""
        return min((effect.next_begin(now) for effect in self._effects), default=NEVER)

    def accept(self, count: int, messages: Sequence[Any]) -> None:
        """Take valid messages that were received as they were sent.

        Parameters
        ----------
        count
            Number of the messages, at least 1.
        messages
            The last two of them in order, or the only one.
        """
        if not (self._checked or self._effects):
            return
        if self._effects:
            self._sent += count
            for effect in self._effects:
                effect.pass_on(count, messages[-1])
        self._before = messages[-2] if len(messages) > 1 else self._newest
        self._newest = messages[-1]
        self._last = self._newest.stamp

    def _arrived(self, now: int, message: Any) -> list[Any]:
        """Queue a sent message with the effects of the faults; return the messages that arrive now, in order."""
        if message is not None:
            self._sent += 1
            arrivals = [Arrival(now, float(self._sent), message)]
            for effect in self._effects:
                arrivals = effect.apply(now, message, arrivals)
            self._waiting = sorted([*self._waiting, *arrivals], key=lambda arrival: (arrival.time, arrival.order))
        due = [arrival.message for arrival in self._waiting if arrival.time <= now]
        self._waiting = self._waiting[len(due) :]
        return due

    def _take(self, now: int, message: Any) -> None:
        """Accept or refuse an arrival."""
        problem = ""
        if self._checked:
            if not self._last < message.stamp <= now:
                problem = self._stamp_problem(now, message)
            problem = problem or self._problem(message)
            if not problem and self.check is not None:
                problem = self.check(message)
        if not problem:
            self._before, self._newest = self._newest, message
            self._last = message.stamp
            self.fresh = True
            return
        self.refused += 1
        self.changed |= problem.split(" ")[0] != self.refusal.split(" ")[0]
        self.refusal = problem

    def _stamp_problem(self, now: int, message: Any) -> str:
        if message.stamp > now:
            return f"stamp {(message.stamp - now) * 1e-9:.3f} s ahead"
        newest = self._newest
        if newest is None or message.stamp < self._last or _equal(message, newest):
            return f"repeated stamp {message.stamp * 1e-9:.3f} s"
        self._newest, self.fresh = self._before, False
        return f"contradictory messages of stamp {message.stamp * 1e-9:.3f} s"

    @property
    def is_faultless(self) -> bool:
        """True without faults and without a missed or refused message; :meth:`diagnostics` are then empty."""
        return not (self._effects or self.missed or self.refused)

    @property
    def acting(self) -> list[str]:
        """Descriptions of the faults that act now."""
        return [effect.spec.described() for effect, acts in zip(self._effects, self._acting, strict=True) if acts]

    def diagnostics(self) -> dict[str, str]:
        """Return the counts as text; empty without a missed or refused message."""
        if not (self.missed or self.refused):
            return {}
        name = self._topic.name
        values = {f"missed {name}": str(self.missed), f"refused {name}": str(self.refused)}
        if self.refusal:
            values[f"refusal {name}"] = self.refusal
        if self.missing:
            values[f"missing {name}"] = "no valid message"
        return values


def _equal(message: Any, other: Any) -> bool:
    """Return True if two messages of one type are equal; NaN equals NaN."""
    for field in dataclasses.fields(message):
        a, b = getattr(message, field.name), getattr(other, field.name)
        if not np.array_equal(np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64), equal_nan=True):
            return False
    return True
