"""Events of restarted nodes, from the diagnostics of the plant."""

from __future__ import annotations

from collections.abc import Iterator

from plant_sim.data_text import parse_json
from train_ato.apps.report.event import Event
from train_ato.loop.plant import LOST_KEY, RESTARTS_KEY
from train_ato.loop.recording import Recording

__all__ = ["restart_events"]


def restart_events(recording: Recording) -> Iterator[Event]:
    """Yield the outages of restarted nodes, from the loss to the first report with all answers."""
    begin, reason = 0.0, ""
    before: dict[str, int] = {}
    for report in recording.changed_reports:
        if report.node != "plant":
            continue
        time = report.stamp * 1e-9
        lost = report.values.get(LOST_KEY, "")
        begin = begin if reason else time
        counts = _counts(report.values.get(RESTARTS_KEY, ""))
        names = [name for name, count in counts.items() if count > before.get(name, 0)]
        if names and not lost:
            listed = " and ".join(f"node {name}" for name in names)
            yield Event("fault", begin, f"{listed} restarted ({reason or 'reason unknown'})", time)
            before = counts
        reason = lost


def _counts(text: str) -> dict[str, int]:
    """Return the numbers of restarts by node; {} for a text of another version."""
    try:
        found = parse_json(text) if text else {}
    except ValueError:
        return {}
    return {str(name): int(count) for name, count in found.items()} if isinstance(found, dict) else {}
