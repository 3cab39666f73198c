"""Event of a run, for marks and lists in figures and pages."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Event"]


@dataclass(frozen=True)
class Event:
    """Event of a run.

    Attributes
    ----------
    kind
        Key of :data:`train_ato.apps.report.quantities.KINDS`.
    begin, end
        Times [s]; ``end`` is None for an event without duration.
    text
        Description.
    """

    kind: str
    begin: float
    text: str
    end: float | None = None
