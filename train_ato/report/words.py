"""Words for how a run was driven, what was done to it and how it ended, and the names of the pages."""

from __future__ import annotations

WAYS = {
    "engine": "a plain loop without ROS",
    "composed": "ROS nodes in one process",
    "processes": "ROS nodes, a process each",
}
"""Ways of running, as ``summary.json`` names them."""
ENDS = {"interrupted": "interrupted", "failed": "failed", "killed": "killed"}
"""Ends of a run that did not reach its own."""
REPORT, COMPARISON = "report.html", "comparison.html"
"""Names of the pages of one run and of several, where none is given."""


def longer(factor: float, add: float) -> str:
    """Return a change of the commands' delay in words: it is multiplied first, then so many seconds are added."""
    told = [f"times {factor:g}"] if factor != 1.0 or not add else []
    told += [f"{abs(add):g} s {'longer' if add > 0 else 'shorter'}"] if add else []
    return f"delay of commands {', then '.join(told)}"
