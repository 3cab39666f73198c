"""Diagnostics of compiled ticks: messages of a node that differ in stamp and numbers only, made when they are read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from train_ato.messages.types import Diagnostic

__all__ = ["RepeatedReport", "Report", "all_reports", "changed_reports"]


@dataclass(frozen=True)
class RepeatedReport:
    """Consecutive diagnostics of a node with equal texts.

    Attributes
    ----------
    first : Diagnostic
        First message.
    stamps : list of int
        Stamps of all messages [ns], rising.
    numbers : dict of list
        Numbers of every message by key; the message has their ``repr``.
    """

    first: Diagnostic
    stamps: list[int]
    numbers: dict[str, list[float]] = field(default_factory=dict)

    def at(self, index: int) -> Diagnostic:
        """Return one message."""
        values = self.first.values | {key: repr(column[index]) for key, column in self.numbers.items()}
        return replace(self.first, stamp=self.stamps[index], values=values)

    def all(self) -> Iterator[Diagnostic]:
        """Yield the messages."""
        return map(self.at, range(len(self.stamps)))

    def column(self, key: str) -> Sequence[Any]:
        """Return a value of every message as number or text; None if missing."""
        return self.numbers.get(key) or [self.first.values.get(key)] * len(self.stamps)


Report = Diagnostic | RepeatedReport


def all_reports(reports: Sequence[Report]) -> tuple[Diagnostic, ...]:
    """Return single messages in the order of the reports, with those of compiled ticks by rising stamps."""
    return _in_order(reports, lambda repeated: repeated.all())


def changed_reports(reports: Sequence[Report]) -> tuple[Diagnostic, ...]:
    """Return the messages of :func:`all_reports` without those between the first and the last one of equal texts."""
    return _in_order(reports, lambda repeated: (repeated.at(0), repeated.at(-1)))


def _in_order(reports: Sequence[Report], messages: Any) -> tuple[Diagnostic, ...]:
    if all(isinstance(report, Diagnostic) for report in reports):
        return tuple(reports)  # type: ignore[arg-type]
    found: list[Diagnostic] = []
    for report in reports:
        found += (report,) if isinstance(report, Diagnostic) else messages(report)
    return tuple(sorted(found, key=lambda message: message.stamp))
