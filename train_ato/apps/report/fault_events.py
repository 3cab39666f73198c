"""Events of faults: those of the scenario, and the first refusals of every receiving end."""

from __future__ import annotations

from collections.abc import Iterator

from train_ato.apps.report.event import Event
from train_ato.loop.recording import Recording
from train_ato.messages.faults import message_faults, node_faults

__all__ = ["fault_events"]

REASON, MISSING = "refusal ", "missing "
"""Beginnings of the keys of the diagnostics of a receiving end."""


def fault_events(recording: Recording) -> Iterator[Event]:
    """Yield the faults of messages and nodes with their intervals, and the first refusal of each kind by a node."""
    begin, end = recording.span
    if recording.setup is not None:
        faults = recording.setup.scenario.faults
        nodes = node_faults(faults)
        for fault in message_faults(fault for fault in faults if fault not in nodes):
            if fault.begin <= end:
                last = end if fault.end is None else min(fault.end, end)
                yield Event("fault", max(fault.begin, begin), fault.described(), last)
        for node in nodes:
            if node.at <= end:
                yield Event("fault", max(node.at, begin), f"{node.do} {node.node}", end)
    seen: set[tuple[str, str, str]] = set()
    for report in recording.reports:
        for key, text in report.values.items():
            if not key.startswith((REASON, MISSING)):
                continue
            found = (report.node, key, text.split(" ")[0])
            if found not in seen:
                seen.add(found)
                topic = key.partition(" ")[2]
                what = f"refused a message: {text}" if key.startswith(REASON) else text
                yield Event("fault", report.stamp * 1e-9, f"{report.node}: {topic}: {what}")
