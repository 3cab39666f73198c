"""Comparison of two logs: every topic, every message in stamp order, every field."""

import dataclasses
import math
import struct
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from train_ato.log.mcap_records import Progress
from train_ato.log.reading import iter_raw, read_log
from train_ato.messages.codec import Wire
from train_ato.messages.topics import TOPICS
from train_ato.messages.variable_codec import status_name
from train_ato.scenario.changes import GIVEN

WALL = "wall_"
"""Prefix of diagnostic keys with wall-clock values, which are not compared.

Neither are start parameters: the repeated run has them in its scenario."""
_ORDER = {topic.name: place for place, topic in enumerate(TOPICS)}

WINDOW_NS = 60_000_000_000
"""Largest difference of the stamps of messages in memory [ns]."""
PORTION = 4096
"""Number of messages that are read from a log at once."""


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

    def _repr_html_(self) -> str:
        count = f"{self.differing} of {self.messages} messages differ"
        verdict = f"equal: {self.messages} messages" if self.equal else f"different: {count}"
        rows = (f"<p>{topic}: {number}</p>" for topic, number in self.topics.items())
        return f"<p><b>{verdict}</b></p>{''.join(rows)}"

    @property
    def equal(self) -> bool:
        """True if there is no difference."""
        return self.differing == 0


def compare_logs(
    one: Path, other: Path, wire: Wire, relative: float = 0.0, progress: Progress | None = None
) -> LogComparison:
    """Compare two logs of the same scenario.

    Both are read side by side; only the messages of the last :data:`WINDOW_NS` are in memory, unless a log has messages
    later than that.

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
    """
    for window in (WINDOW_NS, math.inf):
        with suppress(_LateMessage):
            return _Comparison((one, other), wire, relative, window, progress or (lambda share: None)).run()
    raise AssertionError  # no message is later than an endless window


class _LateMessage(Exception):
    """A message has a stamp before the window."""


class _Comparison:
    """Comparison of two logs; messages of a stamp are compared when both logs are a window beyond it."""

    def __init__(self, runs: tuple[Path, Path], wire: Wire, relative: float, window: float, progress: Progress) -> None:
        self._runs, self._wire, self._relative, self._window, self._progress = runs, wire, relative, window, progress
        self._open: dict[int, dict[str, tuple[list[bytes], list[bytes]]]] = {}
        self._newest, self._closed, self._share = [-math.inf, -math.inf], -math.inf, [0.0, 0.0]
        self._counts: tuple[Counter[str], Counter[str]] = (Counter(), Counter())
        self._differing: Counter[str] = Counter()
        self._scales: dict[str, _Scale] = {}
        self._first: Difference | None = None

    def run(self) -> LogComparison:
        """Read both logs and return the result."""
        logs = [iter_raw(run, progress=partial(self._report, side)) for side, run in enumerate(self._runs)]
        waiting = {0, 1}
        while waiting:
            side = min(waiting, key=lambda side: self._newest[side])
            for topic, stamp, data in islice(logs[side], PORTION):
                self._add(side, topic, stamp, data)
            if (entry := next(logs[side], None)) is None:
                waiting.discard(side)
                self._newest[side] = math.inf
            else:
                self._add(side, *entry)
            self._close(min(self._newest) - self._window)
        self._close(math.inf)
        messages = sum((self._counts[0] | self._counts[1]).values())
        topics = dict(sorted(self._differing.items(), key=lambda entry: _place(entry[0])))
        return LogComparison(messages, self._differing.total(), topics, self._first)

    def _report(self, side: int, share: float) -> None:
        self._share[side] = share
        self._progress(sum(self._share) / 2)

    def _add(self, side: int, topic: str, stamp: int, data: bytes) -> None:
        """Add a message of a log."""
        if len(data) > self._wire.longest(topic):
            raise ValueError(
                f"{self._runs[side]}: {topic}: a message of {len(data)} bytes, at most {self._wire.longest(topic)} for "
                "this train; name another log"
            )
        if stamp <= self._closed:
            raise _LateMessage
        self._counts[side][topic] += 1
        self._open.setdefault(stamp, {}).setdefault(topic, ([], []))[side].append(data)
        self._newest[side] = max(self._newest[side], stamp)

    def _close(self, until: float) -> None:
        """Compare the messages up to a stamp, included; diagnostics of one stamp in the order of their nodes."""
        for stamp in sorted(stamp for stamp in self._open if stamp <= until):
            topics = self._open.pop(stamp)
            for topic in sorted(topics, key=_place):
                mine, theirs = (
                    sorted(found, key=lambda data: (status_name(data), data)) if topic == "/diagnostics" else found
                    for found in topics[topic]
                )
                for a, b in zip_longest(mine, theirs):
                    if a != b:
                        self._compare(topic, stamp, a, b)
        self._closed = max(self._closed, until)

    def _compare(self, topic: str, stamp: int, a: bytes | None, b: bytes | None) -> None:
        """Compare two messages with different bytes field by field."""
        if topic not in self._scales:
            self._scales[topic] = _Scale(topic, self._runs[0], self._wire, self._relative)
        found = _difference(topic, stamp, a, b, wire=self._wire, scale=self._scales[topic])
        if found is not None:
            self._differing[topic] += 1
            self._first = self._first or found


def _place(topic: str) -> tuple[int, str]:
    """Return the place of a topic in the order of the topic table."""
    return _ORDER.get(topic, len(_ORDER)), topic


class _Scale:
    """Maximum magnitude of every field of a topic in a log, calculated at the first difference."""

    def __init__(self, topic: str, run: Path, wire: Wire, relative: float) -> None:
        self._topic, self._run, self._wire = topic, run, wire
        self._relative = relative
        self._largest: dict[str, float] | None = None

    def tolerance(self, name: str) -> float:
        """Return the permitted difference of two numbers of a field; negative if their bits must be equal."""
        if not self._relative:
            return -1.0
        if self._largest is None:
            self._largest = {}
            for _, _, message in read_log(self._run, self._wire.decode, (self._topic,)):
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


def _difference(
    topic: str, stamp: int, a: bytes | None, b: bytes | None, *, wire: Wire, scale: _Scale
) -> Difference | None:
    """Return the first different field of two messages of a stamp, None for equal ones; a missing message is None."""
    if a is None or b is None:
        return Difference(topic, stamp, "message", *(("missing" if data is None else "there") for data in (a, b)))
    left, right = wire.decode(topic, a), wire.decode(topic, b)
    for part in dataclasses.fields(left):
        found = _unequal(part.name, getattr(left, part.name), getattr(right, part.name), scale)
        if found is not None:
            return Difference(topic, stamp, *found)
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
