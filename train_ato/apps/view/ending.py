"""End of a run on the page: words of the end, verdict from the metrics of the run, address of the report."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from train_ato.log.versions import SUMMARY
from train_ato.loop.verdict import verdict_line

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
    return Ending(state, verdict_line(summary), REPORT_PAGE) if summary else Ending(state)


def _read_summary(folder: Path | None) -> dict[str, Any]:
    """Return the summary of a run folder; {} before it is written."""
    if folder is None:
        return {}
    try:
        return dict(json.loads((folder / SUMMARY).read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return {}
