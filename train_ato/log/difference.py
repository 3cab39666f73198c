"""Comparison of two logs: every topic, every message in stamp order, every field."""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from train_ato.log.reading import Progress, iter_raw
from train_ato.messages.codec.codec import Wire
from train_ato.messages.topics import TOPICS
from train_ato.scenario.changes import GIVEN

WALL = "wall_"
"""Prefix of diagnostic keys with wall-clock values, which are not compared.

Neither are start parameters: the repeated run has them in its scenario."""
_ORDER = {topic.name: place for place, topic in enumerate(TOPICS)}

Entry = tuple[int, bytes]
"""Stamp [ns] and bytes of a message."""


@dataclass(frozen=True)
class Difference:
    """One field in which two messages differ.

    Attributes
    ----------
    topic : str
        Name in the topic table.
    stamp : int
        Stamp of the message [ns].
    field : str
        Field of the message, with ``[i]`` for the place in an array; ``message`` if the message is missing in one log.
    one, other : str
        Values in the two logs.
    """

    topic: str
    stamp: int
    field: str
    one: str
    other: str

    def __str__(self) -> str:
        return f"{self.topic} at {self.stamp * 1e-9:.3f} s, {self.field}: {self.one} and {self.other}"


@dataclass(frozen=True)
class LogComparison:
    """Result of the comparison of two logs.

    Attributes
    ----------
    messages, differing : int
        Numbers of compared messages, and of different or missing ones.
    topics : dict of str to int
        Number of different messages by topic.
    first : Difference or None
        Earliest difference; for equal stamps, in the order of the topic table.
    """

    messages: int = 0
    differing: int = 0
    topics: dict[str, int] = field(default_factory=dict)
    first: Difference | None = None

    @property
    def equal(self) -> bool:
        """True if there is no difference."""
        return self.differing == 0


def compare_logs(
    one: Path, other: Path, wire: Wire, relative: float = 0.0, progress: Progress | None = None
) -> LogComparison:
    """Compare two logs of the same scenario.

    Parameters
    ----------
    one, other
        Run folders or MCAP files.
    wire
        Decoder for the train of both.
    relative
        Tolerance of numbers, relative to the maximum magnitude of their field in ``one``; 0 requires equal bits.
    progress
        Receiver of the completed fraction.

    Raises
    ------
    ValueError
        If one of the files is not a log, or damaged, or has a message too long for the train.
    """
    report = progress or _silent
    left = _by_topic(one, wire, lambda share: report(0.4 * share))
    right = _by_topic(other, wire, lambda share: report(0.4 + 0.4 * share))
    messages = 0
    topics: dict[str, int] = {}
    found: list[Difference] = []
    names = sorted({*left, *right}, key=lambda name: _ORDER.get(name, len(_ORDER)))
    for number, topic in enumerate(names):
        report(0.8 + 0.2 * number / len(names))
        mine, theirs = left.get(topic, []), right.get(topic, [])
        messages += max(len(mine), len(theirs))
        scale = _Scale(topic, mine, wire, relative)
        for a, b in _paired(mine, theirs):
            difference = _difference(topic, a, b, wire, scale)
            if difference is not None:
                topics[topic] = topics.get(topic, 0) + 1
                found.append(difference)
    first = min(found, key=lambda entry: entry.stamp, default=None)
    return LogComparison(messages, len(found), topics, first)


def _silent(share: float) -> None:
    pass


def _by_topic(run: Path, wire: Wire, progress: Progress) -> dict[str, list[Entry]]:
    """Return the messages by topic in stamp order; diagnostics of one stamp in the order of their content."""
    messages: dict[str, list[Entry]] = {}
    for topic, stamp, data in iter_raw(run, progress=progress):
        if len(data) > wire.longest(topic):
            raise ValueError(
                f"{run}: {topic}: a message of {len(data)} bytes, at most {wire.longest(topic)} for this train; "
                "name another log"
            )
        messages.setdefault(topic, []).append((stamp, data))
    for topic, entries in messages.items():
        entries.sort(key=lambda entry: entry if topic == "/diagnostics" else entry[:1])
    return messages


def _paired(one: list[Entry], other: list[Entry]) -> Iterator[tuple[Entry | None, Entry | None]]:
    """Pair the messages of equal stamps; None for a missing message."""
    if [entry[0] for entry in one] == [entry[0] for entry in other]:
        yield from zip(one, other, strict=True)
        return
    stamps = {stamp: ([], []) for stamp in sorted({entry[0] for entry in (*one, *other)})}  # type: ignore[var-annotated]
    for side, entries in enumerate((one, other)):
        for entry in entries:
            stamps[entry[0]][side].append(entry)
    for mine, theirs in stamps.values():
        yield from zip_longest(mine, theirs)


class _Scale:
    """Maximum magnitude of every field of a topic, calculated at the first difference."""

    def __init__(self, topic: str, entries: list[Entry], wire: Wire, relative: float) -> None:
        self._topic, self._entries, self._wire = topic, entries, wire
        self._relative = relative
        self._largest: dict[str, float] | None = None

    def tolerance(self, name: str) -> float:
        """Return the permitted difference of two numbers of a field; negative if their bits must be equal."""
        if not self._relative:
            return -1.0
        if self._largest is None:
            self._largest = {}
            for _, data in self._entries:
                message = self._wire.decode(self._topic, data)
                for part in dataclasses.fields(message):
                    self._look(part.name, getattr(message, part.name))
        return self._relative * self._largest.get(name, 0.0)

    def _look(self, name: str, value: Any) -> None:
        assert self._largest is not None
        if isinstance(value, dict):
            for key, text in value.items():
                if (number := _number(text)) is not None:
                    self._look(f"{name}[{key}]", number)
        elif isinstance(value, (np.ndarray, float, int)):
            size = float(np.abs(value).max(initial=0.0)) if isinstance(value, np.ndarray) else abs(float(value))
            self._largest[name] = max(self._largest.get(name, 0.0), size)


def _difference(topic: str, a: Entry | None, b: Entry | None, wire: Wire, scale: _Scale) -> Difference | None:
    """Return the first different field of two messages of a stamp, None for equal messages."""
    if a is None or b is None:
        stamp = a[0] if a is not None else b[0] if b is not None else 0
        return Difference(topic, stamp, "message", *(("missing" if entry is None else "there") for entry in (a, b)))
    if a[1] == b[1]:
        return None
    left, right = wire.decode(topic, a[1]), wire.decode(topic, b[1])
    for part in dataclasses.fields(left):
        found = _unequal(part.name, getattr(left, part.name), getattr(right, part.name), scale)
        if found is not None:
            return Difference(topic, a[0], *found)
    return None


def _unequal(name: str, a: Any, b: Any, scale: _Scale) -> tuple[str, str, str] | None:
    """Return place and values of the first difference of two fields, None if they are equal."""
    if isinstance(a, np.ndarray):
        return _unequal_arrays(name, a, b, scale)
    if isinstance(a, dict):
        for key in [*a, *(key for key in b if key not in a)]:
            if key.startswith(WALL) or key == GIVEN:
                continue
            if not _alike(a.get(key), b.get(key), scale, f"{name}[{key}]"):
                return f"{name}[{key}]", _shown(a.get(key)), _shown(b.get(key))
        return None
    if isinstance(a, float):
        near = abs(a - b) <= scale.tolerance(name)
        return None if near or struct.pack("<d", a) == struct.pack("<d", b) else (name, _shown(a), _shown(b))
    return None if a == b else (name, _shown(a), _shown(b))


def _unequal_arrays(name: str, a: Any, b: Any, scale: _Scale) -> tuple[str, str, str] | None:
    if a.dtype != b.dtype or a.shape != b.shape:
        return name, f"{a.shape} {a.dtype}", f"{b.shape} {b.dtype}"
    if a.tobytes() == b.tobytes():
        return None
    other = a.view(np.uint64) != b.view(np.uint64) if a.dtype.itemsize == 8 else a != b
    if a.dtype.kind == "f":
        other &= ~(np.abs(a - b) <= scale.tolerance(name))
    if not other.any():
        return None
    place = int(np.flatnonzero(other)[0])
    return f"{name}[{place}]", _shown(a[place].item()), _shown(b[place].item())


def _alike(a: str | None, b: str | None, scale: _Scale, name: str) -> bool:
    """Return True for equal texts, or numbers within the tolerance."""
    if a == b:
        return True
    one, other = _number(a), _number(b)
    return one is not None and other is not None and abs(one - other) <= scale.tolerance(name)


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _shown(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 40 else f"{text[:37]}..."
