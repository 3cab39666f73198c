"""Line for a run with brake interventions, takeovers of the braking law, or a disengaged ATO at its end."""

from collections.abc import Mapping
from typing import Any

ENGAGE = "engage it again at standstill: `train-ato inject engage`, or ato_requests of the scenario"


def summary_events(summary: Mapping[str, Any]) -> str:
    """Return number, times and reasons of the events, "" for a run without them.

    Parameters
    ----------
    summary
        Content of ``summary.json`` of one run.
    """
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
    """Return the events with their remedies, "" for a run without events.

    Parameters
    ----------
    summary
        Content of ``summary.json`` of one run.
    run
        Folder of the run, for the remedy.
    """
    parts = [summary_events(summary)]
    if summary.get("brake_interventions") or summary.get("takeovers"):
        parts.append(f"see speed and limits with `train-ato report {run}`")
    if summary.get("ato_disengaged_s") is not None:
        parts.append(ENGAGE)
    return "; ".join(part for part in parts if part)
