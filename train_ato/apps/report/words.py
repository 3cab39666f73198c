"""Texts for mode, delay changes and end of a run, and file names of the pages."""

from __future__ import annotations

MODES = {
    "engine": "Python loop without ROS",
    "composed": "ROS nodes in one process",
    "processes": "ROS nodes, one process per node",
}
"""Texts of the modes in ``summary.json``."""
ENDS = {"interrupted": "interrupted", "failed": "failed", "killed": "killed"}
"""Texts of an early end of a run."""
REPORT, COMPARISON = "report.html", "comparison.html"
"""Default file names of the page of one run and of several."""


def longer(factor: float, add: float) -> str:
    """Return the text of a change of the command delay: first the factor, then the addition [s]."""
    parts = [f"times {factor:g}"] if factor != 1.0 or not add else []
    parts += [f"{abs(add):g} s {'longer' if add > 0 else 'shorter'}"] if add else []
    return f"command delay {', then '.join(parts)}"
