"""States of supervision, train protection and ATO over a run, from its diagnostics, and its events as text."""

import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from train_ato.control.assurance import BRAKING_LAW
from train_ato.judge.run_end import FAILED
from train_ato.messages.types import AtoState, Diagnostic, Protection
from train_ato.supervision.supervisor import SupervisionState

_PLACES: dict[str, tuple[str | None, str]] = {
    "supervisor": (None, "reason"),
    "plant": (None, "protection"),
    "controller": (None, "takeover"),
    "ato": ("ato_state", "ato_reason"),
}
"""Keys of state and reason in the diagnostics of a node; without a key the state is the message.

The node of ``ato`` is the controller.
"""
INTERVENTIONS = frozenset(state.text for state in SupervisionState if state >= SupervisionState.SERVICE_BRAKE)
"""States of the supervision with a brake intervention."""
REACTIONS = {level.text: level for level in Protection}
"""Reactions of the train by their text."""


@dataclass(frozen=True)
class StateSpan:
    """One state of a node.

    Attributes
    ----------
    begin, end : float
        First report of the state, and of the next one or the last report [s].
    state, reason : str
        Texts of the diagnostics; "" without a reason.
    """

    begin: float
    end: float
    state: str
    reason: str


def state_spans(reports: Iterable[Diagnostic], part: str) -> list[StateSpan]:
    """Return the states of ``supervisor``, ``plant``, ``controller`` or ``ato`` in order of time.

    The reason of a state is that of its first report.  Diagnostics without a state are left out.
    """
    key, reason = _PLACES[part]
    node = "controller" if part == "ato" else part
    spans: list[StateSpan] = []
    for report in reports:
        state = report.message if key is None else report.values.get(key, "")
        if report.node != node or not state:
            continue
        time = report.stamp / 1e9
        if spans:
            spans[-1] = replace(spans[-1], end=time)
        if not spans or spans[-1].state != state:
            spans.append(StateSpan(time, time, state, report.values.get(reason, "")))
    return spans


def protection_summary(reports: Sequence[Diagnostic]) -> dict[str, Any]:
    """Return the entries of ``summary.json`` for a run with a supervisor, {} without its diagnostics.

    Returns
    -------
    dict
        ``brake_interventions``: number of interventions of the supervisor, each to the release of the brakes.
        ``first_intervention``, ``first_intervention_s``: the first one with its reason, and its time [s].
        ``strongest_reaction``: of the train, for any reason.  ``takeovers``: number of times the braking law replaced
        the law.  ``first_takeover``, ``first_takeover_s``: the first one with speed, place and limit, and its time [s].
        ``ato_state``: at the end.  ``ato_disengaged``, ``ato_disengaged_s``: reason and time [s] of the end
        of the last engagement, None while engaged.
    """
    spans = state_spans(reports, "supervisor")
    if not spans:
        return {}
    begun = [
        span
        for before, span in zip([None, *spans], spans, strict=False)
        if span.state in INTERVENTIONS and (before is None or before.state not in INTERVENTIONS)
    ]
    first = begun[0] if begun else None
    taken = [span for span in state_spans(reports, "controller") if span.state == BRAKING_LAW]
    levels = [REACTIONS[span.state] for span in state_spans(reports, "plant") if span.state in REACTIONS]
    return {
        "brake_interventions": len(begun),
        "first_intervention_s": None if first is None else first.begin,
        "first_intervention": None if first is None else f"{first.state}: {first.reason}",
        "strongest_reaction": max(levels, default=Protection.NONE).text,
        "takeovers": len(taken),
        "first_takeover_s": taken[0].begin if taken else None,
        "first_takeover": taken[0].reason if taken else None,
        **_last_engagement(state_spans(reports, "ato")),
    }


def _last_engagement(spans: Sequence[StateSpan]) -> dict[str, Any]:
    """Return the state of the ATO at the end, and the end of its last engagement."""
    if not spans:
        return {}
    ended = None
    for span in reversed(spans):
        if span.state == AtoState.ENGAGED.text:
            break
        ended = span
    return {
        "ato_state": spans[-1].state,
        "ato_disengaged_s": None if ended is None else ended.begin,
        "ato_disengaged": None if ended is None else ended.reason,
    }


ENGAGE = "engage it again at standstill: `train-ato inject engage`, or ato_requests of the scenario"


def summary_events(summary: Mapping[str, Any]) -> str:
    """Return number, times and reasons of the events in a summary of a run as text, "" without them."""
    parts = []
    if count := summary.get("brake_interventions") or 0:
        first = f"{summary['first_intervention_s']:.1f} s ({summary['first_intervention']})"
        number = "one brake intervention" if count == 1 else f"{count} brake interventions"
        parts.append(f"{number} of the supervisor, {'' if count == 1 else 'the first '}at {first}")
    if count := summary.get("takeovers") or 0:
        number = "one takeover by the braking law" if count == 1 else f"{count} takeovers by the braking law"
        if (begin := summary.get("first_takeover_s")) is not None:
            number += f", {'' if count == 1 else 'the first '}at {begin:.1f} s ({summary['first_takeover']})"
        parts.append(number)
    if summary.get("ato_disengaged_s") is not None:
        ended = f"{summary['ato_disengaged_s']:.1f} s ({summary['ato_disengaged']})"
        parts.append(f"the ATO was disengaged at {ended}, its state at the end is {summary['ato_state']}")
    return "; ".join(parts)


def protection_note(summary: Mapping[str, Any], run: str) -> str:
    """Return the events of a summary with their remedies, "" without events; ``run`` is the folder of the run."""
    parts = [summary_events(summary)]
    if summary.get("brake_interventions") or summary.get("takeovers"):
        parts.append(f"see speed and limits with `train-ato report {shlex.quote(run)}`")
    if summary.get("ato_disengaged_s") is not None and summary.get("status") != FAILED:
        parts.append(ENGAGE)
    return "; ".join(part for part in parts if part)
