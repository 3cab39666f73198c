"""Events of supervision, train protection and ATO, from the diagnostics of a run with a supervisor."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from train_ato.apps.report.event import Event
from train_ato.control.assurance import BRAKING_LAW
from train_ato.loop.protection_record import REACTIONS, StateSpan, state_spans
from train_ato.loop.recording import Recording
from train_ato.loop.train_protection import Protection
from train_ato.messages.types import AtoState, Diagnostic
from train_ato.supervision.supervisor import SupervisionState

__all__ = ["engagements", "is_protection_report", "protection_events"]

EXCEEDED = frozenset(state.text for state in SupervisionState if state >= SupervisionState.OVERSPEED)
"""States of the supervision above the permitted speed; an indication precedes every stop."""


def protection_events(recording: Recording) -> Iterator[Event]:
    """Yield the states of a run with a supervisor: exceeded limits, reactions of the train, changes of the ATO."""
    if "supervisor" not in recording.diagnostics:
        return
    for span in state_spans(recording.changed_reports, "supervisor"):
        if span.state in EXCEEDED:
            lasting = f" for {span.end - span.begin:.1f} s" if span.end > span.begin else ""
            yield Event("supervision", span.begin, _text(f"{span.state}{lasting}", span.reason))
    for span in state_spans(recording.changed_reports, "plant"):
        if REACTIONS.get(span.state, Protection.NONE) is not Protection.NONE:
            yield Event("protection", span.begin, _text(f"train: {span.state}", span.reason), _end(span))
    before = AtoState.ENGAGED.text
    for span in state_spans(recording.changed_reports, "ato"):
        if span.state != before:
            yield Event("ato", span.begin, _text(f"ATO {before} → {span.state}", span.reason))
        before = span.state
    for span in state_spans(recording.changed_reports, "controller"):
        if span.state == BRAKING_LAW:
            yield Event("ato", span.begin, "the braking law drives in place of the law", _end(span))


def engagements(reports: Iterable[Diagnostic]) -> list[float]:
    """Return the times at which the ATO was engaged during the run [s]."""
    spans = state_spans(reports, "ato")
    return [span.begin for span in spans[1:] if span.state == AtoState.ENGAGED.text]


def _text(state: str, reason: str) -> str:
    return f"{state}: {reason}" if reason else state


def _end(span: StateSpan) -> float | None:
    """Return the end of a state; None for a single report."""
    return span.end if span.end > span.begin else None


def is_protection_report(report: Diagnostic) -> bool:
    """Return True for a report of a state that :func:`protection_events` contains, so that it is no fault."""
    if report.node == "controller":
        return report.level > 0 and report.message in (report.values.get("ato_state"), BRAKING_LAW)
    return report.node == "supervisor" or (report.node == "plant" and "protection" in report.values)
