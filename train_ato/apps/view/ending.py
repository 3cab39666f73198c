"""End of a run on the page: words of the end, verdict from the metrics of the run, address of the report."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from train_ato.log.versions import SUMMARY

REPORT_PAGE = "/report"
"""Path of the report on the server of the page."""
FINISHED, RUN_ENDED = "finished", "run ended"
"""States of a run after its regular end, and after any other one."""


@dataclass(frozen=True)
class Ending:
    """End of a run.

    Attributes
    ----------
    state
        :data:`FINISHED` or :data:`RUN_ENDED`; "" for a recorded run.
    verdict
        One line; "" before the metrics are written.
    report
        Address of the report on the server; "" without a log.
    """

    state: str
    verdict: str = ""
    report: str = ""


def ending_of(state: str, folder: Path | None) -> Ending:
    """Return the end of a run in a folder; without ``summary.json`` it has no verdict and no report."""
    summary = _read_summary(folder)
    return Ending(state, verdict(summary), REPORT_PAGE) if summary else Ending(state)


def _read_summary(folder: Path | None) -> dict[str, Any]:
    """Return the summary of a run folder; {} before it is written."""
    if folder is None:
        return {}
    try:
        return dict(json.loads((folder / SUMMARY).read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return {}


def verdict(summary: Mapping[str, Any]) -> str:
    """Return stop, overspeed, couplers and interventions of a run in one line; "" for a summary without metrics.

    Parameters
    ----------
    summary
        Content of ``summary.json``.
    """
    if "overspeed_max_kmh" not in summary:
        return ""
    stop, over = summary.get("stop_error_m"), float(summary["overspeed_max_kmh"])
    facts = ["no stop at the target" if stop is None else _stop_text(float(stop))]
    facts.append("no overspeed" if over <= 0.0 else f"overspeed {over:.2f} km/h")
    buff, draft = (float(summary.get(f"coupler_{name}_max_kn") or 0.0) for name in ("buff", "draft"))
    if buff or draft:
        facts.append(f"couplers {buff:.0f} to {draft:+.0f} kN")
    if summary.get("brake_interventions"):
        facts.append(f"{summary['brake_interventions']} brake interventions")
    status = str(summary.get("status", "done"))
    head = "" if status == "done" else f"{status}: "
    return head + "; ".join(facts)


def _stop_text(error: float) -> str:
    return f"stopped {abs(error):.2f} m {'beyond' if error > 0 else 'short of'} the target"
