"""Closed-loop table of the heavy-haul scenario, the whole 45 km and the stop."""

from __future__ import annotations

import functools
from typing import Any

import pytest

from train_ato.engine import run_engine
from train_ato.run_setup import prepare
from train_ato.scenario import load


@functools.cache
def summary(scenario: str, *assignments: str) -> dict[str, Any]:
    outcome = run_engine(prepare(*load(scenario, assignments)))
    assert outcome.failure is None
    return outcome.summary


PRINTED = ("controller=smc", "controllers.smc.ks=0", "controllers.smc.anti_windup=false")
"""The sliding mode of paper 000 without what repairs it: the linear reaching term, and the anti-windup."""
TRACKED: list[tuple[str, str, tuple[str, ...], float, float]] = [
    ("printed smc, ideal actuator", "daqin_heavy_haul:ideal", PRINTED, 0.02, 0.15),
    ("printed smc, ideal, disturbance (40)", "daqin_heavy_haul:ideal+disturbed", PRINTED, 0.02, 0.15),
    ("default, lag .4 s and delay .8 s", "daqin_heavy_haul", (), 0.35, 1.2),
    ("default, disturbance (40)", "daqin_heavy_haul:disturbed", (), 0.35, 1.2),
    ("default, mismatch", "daqin_heavy_haul:mismatch", (), 0.35, 1.5),
    ("default, brake by rule", "daqin_heavy_haul:triggered", (), 0.35, 1.5),
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "assignments", "rmse", "worst"), [c[1:] for c in TRACKED], ids=[c[0] for c in TRACKED]
)
def test_the_profile_is_tracked(scenario: str, assignments: tuple[str, ...], rmse: float, worst: float) -> None:
    """Breaks if plant, law, link or preview change what the train does; km/h over the section to km 45."""
    result = summary(scenario, *assignments)
    assert result["speed_rmse_kmh"] <= rmse
    assert result["speed_error_max_kmh"] <= worst
    assert result["coupler_draft_max_kn"] <= 800
    assert result["coupler_buff_max_kn"] >= -800
    assert result["overspeed_max_kmh"] == 0


@pytest.mark.slow
def test_the_train_stops_on_its_place() -> None:
    """Within half a metre after 49 km, braked electrically on the level tail."""
    assert abs(summary("daqin_heavy_haul")["stop_error_m"]) <= 0.5


@pytest.mark.slow
def test_the_printed_law_is_lost_with_lag_and_delay() -> None:
    """Unstable beyond 0.17 s of total lag. With 1.2 s it winds up and misses the stop by far."""
    result = summary("daqin_heavy_haul", *PRINTED, "compensation=none")
    assert result["speed_rmse_kmh"] > 2
    assert result["speed_error_max_kmh"] > 10
    assert result["coupler_draft_max_kn"] > 1000


@pytest.mark.slow
def test_disturbance_costs_the_printed_law_little() -> None:
    """By about a quarter; a disturbance that never reaches the train would cost nothing."""
    calm = summary("daqin_heavy_haul:ideal", *PRINTED)["speed_rmse_kmh"]
    rough = summary("daqin_heavy_haul:ideal+disturbed", *PRINTED)["speed_rmse_kmh"]
    assert 1.05 * calm < rough < 1.6 * calm
