"""Words for how a run was driven and how it ended, and the names of the pages."""

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
