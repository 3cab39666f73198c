"""Verdicts of benchmarks: a narrow miss is reported and passes, a wide miss fails."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

SPEC = importlib.util.spec_from_file_location("goals", Path(__file__).resolve().parents[1] / "bench" / "goals.py")
assert SPEC is not None
assert SPEC.loader is not None
goals = sys.modules["goals"] = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(goals)


@pytest.mark.parametrize(
    ("value", "at_least", "verdict", "status"),
    [
        (100.0, False, "met", 0),
        (120.0, False, "missed", 0),
        (151.0, False, "missed widely", 1),
        (100.0, True, "met", 0),
        (70.0, True, "missed", 0),
        (66.0, True, "missed widely", 1),
    ],
)
def test_verdict_and_exit_status(
    value: float, at_least: bool, verdict: str, status: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if an upper bound counts as a lower one, or a wide miss gives exit status 0."""
    goal = goals.Goal("something", value, 100.0, "us", at_least)
    assert goals.judge([goals.Goal("else", 1.0, 2.0), goal]) == status
    assert capsys.readouterr().out.splitlines()[1].endswith(f"100 us: {value:.3g}, {verdict}")
