"""Texts for mode, delay changes and end of a run, and file names of the pages."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from train_ato.scenario.scenario import Evaluation

MODES = {
    "engine": "Python loop without ROS",
    "composed": "ROS nodes in one process",
    "processes": "ROS nodes, one process per node",
}
REPORT, COMPARISON = "report.html", "comparison.html"


def longer(factor: float, add: float) -> str:
    """Return the text of a change of the command delay: first the factor, then the addition [s]."""
    parts = [f"times {factor:g}"] if factor != 1.0 or not add else []
    parts += [f"{abs(add):g} s {'longer' if add > 0 else 'shorter'}"] if add else []
    return f"command delay {', then '.join(parts)}"


def driven_laws(summary: Mapping[str, Any]) -> str:
    """Return the law of a run as text; after changes during the run, all laws with their times.

    Parameters
    ----------
    summary
        Content of ``summary.json``.
    """
    first = str(summary.get("controller", ""))
    rows = [row for row in summary.get("changes") or () if row["at_s"] > 0]
    laws = [(first, 0.0), *((str(row["value"]), row["at_s"]) for row in rows if row["name"] == "controller")]
    swaps = [f"{law} at {at_s:g} s" for (old, _), (law, at_s) in pairwise(laws) if law != old]
    if len(swaps) > MAX_SWAPS:
        swaps = [*swaps[: MAX_SWAPS - 1], f"... ({len(swaps)} changes)"]
    text = " → ".join([first, *swaps])
    changed = any("." in row["name"] for row in rows)
    return f"{text}, parameters changed" if changed else text


MAX_SWAPS = 4
"""Maximum number of changes of the law in a title."""


def evaluation_note(evaluation: Evaluation) -> str:
    """Return the part of the run that the error metrics leave out as text, "" for none."""
    parts = [f"km {evaluation.until / 1e3:g}"] if evaluation.until is not None else []
    parts += [f"{evaluation.until_time:g} s"] if evaluation.until_time is not None else []
    if not parts:
        return ""
    return f"error metrics end at {' or '.join(parts)}; those of the run include the braking to the stop"
