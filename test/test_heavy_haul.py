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


TUNED = ("pid", "smc", "rbf_smc", "rbf_switching_smc", "funnel", "gpc", "lag_smc")


@pytest.mark.slow
@pytest.mark.parametrize("variants", ["", "+disturbed+strong_mismatch"])
@pytest.mark.parametrize("law", TUNED)
def test_every_law_tracks_with_the_gains_for_this_train(law: str, variants: str) -> None:
    """Breaks if a gain of `tuned` is lost, or a law changes so that it swings in the couplers' waves again."""
    result = summary(f"daqin_heavy_haul:tuned{variants}", f"controller={law}")
    assert result["speed_rmse_kmh"] <= 0.35
    assert result["coupler_draft_max_kn"] <= (620 if "strong" in variants else 600)
    assert result["coupler_buff_max_kn"] >= -600
    assert result["command_variation_kn_per_s"] <= 50
    assert abs(result["stop_error_m"]) <= 1.5


@pytest.mark.slow
@pytest.mark.parametrize("law", ["smc", "rbf_smc", "rbf_switching_smc"])
def test_tuned_laws_under_twin(law: str) -> None:
    """The twin's force and the same gains: the goal of pid, .02 km/h."""
    assert summary("daqin_heavy_haul:tuned+twin", f"controller={law}")["speed_rmse_kmh"] <= 0.02


@pytest.mark.slow
@pytest.mark.parametrize("law", ["smc", "rbf_switching_smc", "funnel", "gpc"])
def test_published_gains_swing_in_the_couplers(law: str) -> None:
    """What `tuned` is for; breaks if the defaults were changed in place of the scenario's gains."""
    result = summary("daqin_heavy_haul", f"controller={law}")
    assert result["speed_rmse_kmh"] > 0.35
    assert result["coupler_draft_max_kn"] > 600


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
