"""Events of refused messages, from the diagnostics of the receiving ends."""

from __future__ import annotations

from collections.abc import Iterator

from train_ato.apps.report.event import Event
from train_ato.loop.recording import Recording

__all__ = ["refusal_events"]

REASON, MISSING = "refusal ", "missing "
"""Beginnings of the keys of the diagnostics of a receiving end."""


def refusal_events(recording: Recording) -> Iterator[Event]:
    """Yield the first refusal of each kind by each node, and its first missing message of each topic."""
    seen: set[tuple[str, str, str]] = set()
    for report in recording.changed_reports:
        for key, text in report.values.items():
            if not key.startswith((REASON, MISSING)):
                continue
            found = (report.node, key, text.split(" ")[0])
            if found not in seen:
                seen.add(found)
                topic = key.partition(" ")[2]
                what = f"refused a message: {text}" if key.startswith(REASON) else text
                yield Event("fault", report.stamp * 1e-9, f"{report.node}: {topic}: {what}")
