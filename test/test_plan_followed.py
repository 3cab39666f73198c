"""Tracking of plans by the plant with lag, delay and couplers, nearly without saturation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from train_ato.loop.engine import run_engine
from train_ato.loop.setup import prepare
from train_ato.scenario.scenario import check_scenario

CASES: dict[str, dict[str, Any]] = {
    "metro on grades": {
        "duration": 130, "tick": 0.05,
        "plant": {"consist": "xuzhou_metro_3", "line": "xuzhou_metro_test", "start": {"position": -59}, "lag": 0.4},
        "links": {"command": {"delay": 0.3}},
        "profile": {"plan": {"end_km": 2}},
    },
    "eight coupled cars": {
        "duration": 560, "tick": 0.1,
        "plant": {"consist": "crh380a_eight_cars", "line": "highspeed_286km", "lag": 0.4},
        "links": {"command": {"delay": 0.3}},
        "profile": {"plan": {"end_km": 30, "jerk": 0.2, "acceleration": 0.43, "deceleration": 0.5}},
    },
    "106 vehicles with slack": {
        "duration": 720, "tick": 0.1,
        "plant": {"consist": "hxd1_c80_105", "line": "level", "start": {"position": -11.8055}, "lag": 0.4},
        "links": {"command": {"delay": 0.8}},
        "profile": {"plan": {"end_km": 4, "jerk": 0.01, "force_margin": 0.3}},
    },
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_plan_is_followed_within_the_force_limits(case: str) -> None:
    """Planned without its margin, the train of 106 vehicles is at a limit for 531 s and misses the stop by 78 m."""
    # No brake policy applies its air brake: a plan with the air brake would overrun the stop.
    data = {"schema": "train_ato/scenario/1", "name": "followed", "law": "pid", "compensation": "preview"}
    path = Path("followed.yaml")
    setup = prepare(check_scenario(data | CASES[case], path), path)
    summary = run_engine(setup).summary
    assert summary["ticks"] == setup.ticks
    assert summary["saturated_s"] < 0.01 * CASES[case]["duration"]
    assert abs(summary["stop_error_m"]) < 2.0 and summary["overspeed_max_kmh"] < 0.5
