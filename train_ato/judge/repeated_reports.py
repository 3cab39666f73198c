"""Diagnostics of a run: messages of a node that differ in stamp and numbers only are kept as columns of numbers."""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from train_ato.messages.types import Diagnostic
from train_ato.scenario import changes, interventions

Column = Sequence[float]
EVENTS = frozenset((changes.KEY, interventions.KEY, interventions.REQUEST_KEY))
"""Keys of changes during a run: a message with one of them stays a message."""
KINDS: dict[type, str] = {int: "q", float: "d"}
"""Kind of the numbers of a column, and code of its array."""
NODES = {name: place for place, name in enumerate(("plant", "supervisor", "profile", "observer", "controller"))}
"""Order of the messages of a stamp."""


@dataclass
class RepeatedReport:
    """Consecutive diagnostics of a node with equal texts.

    Attributes
    ----------
    first : Diagnostic
        First message.
    stamps : sequence of int
        Stamps of all messages [ns], rising.
    numbers : dict of sequence
        Numbers of every message by key; the message has their ``repr``.
    """

    first: Diagnostic
    stamps: Sequence[int]
    numbers: Mapping[str, Column] = field(default_factory=dict)

    def at(self, index: int) -> Diagnostic:
        """Return one message."""
        first, values = self.first, dict(self.first.values)
        for key, column in self.numbers.items():
            values[key] = repr(column[index])
        return Diagnostic(self.stamps[index], first.node, first.level, first.message, values)

    def all(self) -> Iterator[Diagnostic]:
        """Yield the messages."""
        return map(self.at, range(len(self.stamps)))

    def between(self, begin: float, end: float) -> RepeatedReport:
        """Return the messages from one stamp to another [ns], both included."""
        part = slice(bisect_left(self.stamps, begin), bisect_right(self.stamps, end))
        numbers = {key: column[part] for key, column in self.numbers.items()}
        return RepeatedReport(self.first, self.stamps[part], numbers)

    def column(self, key: str) -> Sequence[Any]:
        """Return a value of every message as number or text; None if missing."""
        return self.numbers.get(key) or [self.first.values.get(key)] * len(self.stamps)


Report = Diagnostic | RepeatedReport


class KeptReports:
    """Collector of diagnostics, which joins repeated ones."""

    def __init__(self) -> None:
        self._found: list[Report] = []
        self._open: dict[str, _OpenReport] = {}
        self._last: dict[str, int] = {}
        self._in_order = True

    def add(self, report: Report) -> None:
        """Add diagnostics of a node."""
        part = RepeatedReport(report, (report.stamp,)) if isinstance(report, Diagnostic) else report
        node, columns = part.first.node, {key: _column(values) for key, values in part.numbers.items()}
        self._in_order &= part.stamps[0] >= self._last.get(node, 0)
        self._last[node] = part.stamps[-1]
        if not EVENTS.isdisjoint(part.first.values) or None in columns.values():
            self._open.pop(node, None)
            self._found.append(report)
        elif node not in self._open or not self._open[node].take(part):
            self._open[node] = _OpenReport(part, columns)
            self._found.append(self._open[node])

    def finish(self) -> tuple[Report, ...]:
        """Return the diagnostics; of messages that were not in the order of their stamps, single ones."""
        return tuple(self._found) if self._in_order else all_reports(self._found)


class _OpenReport(RepeatedReport):
    """Repeated diagnostics to which others can be added."""

    def __init__(self, part: RepeatedReport, columns: dict[str, Any]) -> None:
        self._columns: dict[str, array[Any]] = columns
        super().__init__(part.first, array("q", part.stamps), self._columns)

    def take(self, other: RepeatedReport) -> bool:
        """Add diagnostics; return False if a text or the kind of a number is another, or they are not later."""
        mine, theirs = self.first, other.first
        if (mine.level, mine.message) != (theirs.level, theirs.message) or other.stamps[0] <= self.stamps[-1]:
            return False
        if mine.values.keys() != theirs.values.keys():
            return False
        added: dict[str, array[Any]] = {}
        different = {key for key, text in mine.values.items() if theirs.values[key] != text}
        for key in self._columns.keys() | other.numbers.keys() | different:
            kind, column = self._kind(key), _numbers(other, key)
            if column is None or kind != column.typecode:
                return False
            added[key] = column
        for key, column in added.items():
            if key not in self._columns:
                number = float(mine.values[key]) if column.typecode == "d" else int(mine.values[key])
                self._columns[key] = array(column.typecode, [number]) * len(self.stamps)
            self._columns[key].extend(column)
        assert isinstance(self.stamps, array)
        self.stamps.extend(other.stamps)
        return True

    def _kind(self, key: str) -> str | None:
        """Return the kind of the numbers of a key, None for a text."""
        if (column := self._columns.get(key)) is not None:
            return column.typecode
        number = _number(self.first.values[key])
        return None if number is None else KINDS[type(number)]


def _column(numbers: Column) -> array[Any] | None:
    """Return numbers of one kind as an array, else None."""
    kinds = set(map(type, numbers))
    code = KINDS.get(kinds.pop()) if len(kinds) == 1 else None
    return None if code is None else array(code, numbers)


def _numbers(report: RepeatedReport, key: str) -> array[Any] | None:
    """Return the numbers of a key, None for a text."""
    if key in report.numbers:
        return _column(report.numbers[key])
    number = _number(report.first.values[key])
    return None if number is None else array(KINDS[type(number)], [number]) * len(report.stamps)


def _number(text: str) -> float | int | None:
    """Return the number whose ``repr`` a text is, else None."""
    for kind in (int, float):
        try:
            number = kind(text)
        except ValueError:
            continue
        if repr(number) == text and (kind is float or abs(number) < 2**63):
            return number
    return None


def all_reports(reports: Sequence[Report]) -> tuple[Diagnostic, ...]:
    """Return single messages by rising stamps, those of a stamp in the order of the nodes."""
    return _in_order(reports, lambda repeated: repeated.all())


def changed_reports(reports: Sequence[Report]) -> tuple[Diagnostic, ...]:
    """Return the messages of :func:`all_reports` without those between the first and the last one of equal texts."""
    return _in_order(reports, lambda repeated: (repeated.at(index) for index in sorted({0, len(repeated.stamps) - 1})))


def _in_order(reports: Sequence[Report], messages: Any) -> tuple[Diagnostic, ...]:
    if all(isinstance(report, Diagnostic) for report in reports):
        return tuple(reports)  # type: ignore[arg-type]
    found: list[Diagnostic] = []
    for report in reports:
        found += (report,) if isinstance(report, Diagnostic) else messages(report)
    return tuple(sorted(found, key=lambda message: (message.stamp, NODES.get(message.node, len(NODES)))))
