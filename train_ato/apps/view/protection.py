"""States of supervision, train protection and ATO for the page, from diagnostics."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from train_ato.apps.report.protection_events import EXCEEDED
from train_ato.apps.view.feed import Mark
from train_ato.apps.view.snapshot import ProtectionStates
from train_ato.control.assurance import BRAKING_LAW
from train_ato.loop.protection_record import INTERVENTIONS, REACTIONS
from train_ato.loop.train_protection import REQUESTED, SUPERVISOR, Protection
from train_ato.messages.types import AtoState, Diagnostic

WAITING = frozenset(state.text for state in (AtoState.NOT_AVAILABLE, AtoState.AVAILABLE, AtoState.READY))
"""States of the ATO between two engagements, without a label in the strip charts."""


@dataclass
class ProtectionTracker:
    """States after the diagnostics so far.

    Attributes
    ----------
    states : ProtectionStates
    advice : str
        Remedy for gains or a delay that do not fit, as the controller reported it last.
    """

    states: ProtectionStates = field(default_factory=ProtectionStates)
    advice: str = ""

    def take(self, message: Diagnostic) -> list[Mark]:
        """Take one message of the diagnostics; return the changes that it reports as marks of the strip charts."""
        before, now = self.states, states_after(self.states, message)
        self.states = now
        time, marks = message.stamp * 1e-9, []
        if now.supervision != before.supervision and now.supervision in EXCEEDED:
            label = now.supervision if now.supervision in INTERVENTIONS else ""
            text = _text(now.supervision, now.supervision_reason)
            marks.append(Mark(time, label, text, acknowledge=now.supervision in INTERVENTIONS))
        if now.protection != before.protection and now.protection_reason not in ("", SUPERVISOR, REQUESTED):
            text = _text(f"train: {now.protection}", now.protection_reason)
            marks.append(Mark(time, now.protection, text, acknowledge=True))
        if before.ato and now.ato != before.ato:
            label = "" if now.ato in WAITING else now.ato.removeprefix(f"{AtoState.ENGAGED.text}, ")
            failed = now.ato == AtoState.FAILURE.text
            marks.append(Mark(time, label, _text(f"ATO {now.ato}", now.ato_reason), acknowledge=failed))
        if message.node == "controller":
            advice, self.advice = self.advice, message.values.get("advice", "")
            if self.advice not in ("", advice):
                marks.append(Mark(time, "", self.advice))
        return marks


def _text(state: str, reason: str) -> str:
    return f"{state}: {reason}" if reason else state


def states_after(states: ProtectionStates, message: Diagnostic) -> ProtectionStates:
    """Return the states after one message of the diagnostics."""
    values = message.values
    if message.node == "supervisor":
        return replace(states, supervision=message.message, supervision_reason=values.get("reason", ""))
    if message.node == "plant":
        reacting = REACTIONS.get(message.message, Protection.NONE) is not Protection.NONE
        reason = values.get("protection", "")
        return replace(states, protection=message.message if reacting else "", protection_reason=reason)
    if message.node == "controller" and "ato_state" in values:
        ato = values["ato_state"]
        shown = f"{ato}, {BRAKING_LAW}" if message.message == BRAKING_LAW else ato
        reason = "" if ato == AtoState.ENGAGED.text else values.get("ato_reason", "")
        return replace(states, ato=shown, ato_reason=reason)
    return states


def protection_history(reports: Iterable[Diagnostic]) -> tuple[list[float], list[ProtectionStates], list[Mark]]:
    """Return times [s] and states of all changes in a recorded run, and their marks."""
    tracker = ProtectionTracker()
    times, states, marks = [0.0], [tracker.states], []
    for report in reports:
        marks += tracker.take(report)
        if tracker.states != states[-1]:
            times.append(report.stamp * 1e-9)
            states.append(tracker.states)
    return times, states, marks
