"""Closed-loop figures of the heavy-haul scenario, 45 km and the stop, compared with measured ones."""

import functools
from typing import Any

import pytest
from engine_runs import setup_of

from train_ato.loop.engine import run_engine

pytestmark = pytest.mark.campaign


@functools.cache
def summary(scenario: str, *assignments: str) -> dict[str, Any]:
    outcome = run_engine(setup_of(scenario, *assignments))
    assert outcome.failure is None
    return outcome.summary


KEYS = (
    "speed_rmse_kmh", "speed_error_max_kmh", "coupler_draft_max_kn", "coupler_buff_max_kn",
    "command_variation_kn_per_s", "stop_error_m",
)  # fmt: skip
NEAR, NEAR_STOP = 0.05, 0.05
"""Half width of the bounds, relative, and of those on the stop [m]: only for other processors, and both ways."""
PRINTED = ("law=smc", "laws.smc.gains=printed", "laws.smc.ks=0", "laws.smc.anti_windup=false")
"""Sliding mode of paper 000 without linear reaching term and anti-windup."""
HARD = "+disturbed+strong_mismatch"
MEASURED: dict[tuple[str, tuple[str, ...]], tuple[float, ...]] = {
    # speed error rms and largest [km/h], draft and buff [kN], variation [kN/s], stop [m]
    (":ideal", PRINTED): (0.01079, 0.09026, 552.9, -717.1, 7.491, -0.2138),
    (":ideal+disturbed", PRINTED): (0.01234, 0.08363, 547.8, -715.6, 8.186, -0.03661),
    ("", ()): (0.1715, 0.9917, 552.0, -433.7, 23.77, -0.07914),
    (":disturbed", ()): (0.1712, 0.9995, 549.4, -435.1, 23.83, 0.1566),
    (":mismatch", ()): (0.1928, 1.057, 564.0, -439.8, 23.85, -0.5015),
    (":triggered", ()): (0.2002, 1.113, 552.0, -515.0, 23.18, -0.07922),
    (f":tuned{HARD}", ()): (0.1755, 0.8845, 576.4, -454.7, 25.22, -1.666),
    (":tuned", ("law=smc",)): (0.1353, 0.8097, 550.1, -451.0, 24.59, -0.04292),
    (f":tuned{HARD}", ("law=smc",)): (0.1739, 0.8403, 582.4, -454.0, 24.83, -0.3491),
    (":tuned", ("law=rbf_smc",)): (0.1417, 0.8365, 550.6, -446.5, 24.14, 0.04555),
    (f":tuned{HARD}", ("law=rbf_smc",)): (0.1787, 0.8683, 584.1, -454.1, 24.64, -0.05421),
    (":tuned", ("law=rbf_switching_smc",)): (0.1308, 0.7922, 548.9, -452.4, 24.77, -0.03281),
    (f":tuned{HARD}", ("law=rbf_switching_smc",)): (0.1749, 0.8594, 580.0, -454.3, 25.31, -0.1915),
    (":tuned", ("law=funnel",)): (0.1444, 0.8436, 551.0, -435.1, 24.07, -0.01463),
    (f":tuned{HARD}", ("law=funnel",)): (0.1908, 0.9116, 584.7, -454.5, 24.42, -0.2866),
    (":tuned", ("law=gpc",)): (0.1519, 1.076, 555.0, -436.6, 27.79, 0.01821),
    (f":tuned{HARD}", ("law=gpc",)): (0.1971, 1.144, 585.9, -455.0, 27.76, -0.2792),
    (":tuned", ("law=lag_smc",)): (0.07136, 0.5668, 547.0, -518.5, 7.224, 0.1203),
    (f":tuned{HARD}", ("law=lag_smc",)): (0.08229, 0.4603, 573.4, -540.6, 8.365, -0.1128),
    (":tuned+twin", ("law=smc",)): (0.007352, 0.1078, 547.0, -562.3, 7.076, 0.05700),
    (":tuned+twin", ("law=rbf_smc",)): (0.005707, 0.06639, 547.0, -561.1, 6.855, 0.01575),
    (":tuned+twin", ("law=rbf_switching_smc",)): (0.008210, 0.1128, 547.1, -562.5, 7.167, 0.1189),
}


@pytest.mark.parametrize(
    ("variant", "assignments"), MEASURED, ids=[f"{case[0]} {' '.join(case[1])}" for case in MEASURED]
)
def test_the_figures_are_near_those_measured(variant: str, assignments: tuple[str, ...]) -> None:
    """Breaks if plant, law, link or preview change the result: a lost gain, oscillating couplers."""
    result = summary(f"daqin_heavy_haul{variant}", *assignments)
    measured = MEASURED[variant, assignments]
    assert [result[key] for key in KEYS[:-1]] == pytest.approx(list(measured[:-1]), rel=NEAR)
    assert abs(result["stop_error_m"] - measured[-1]) <= NEAR_STOP
    assert result["overspeed_max_kmh"] == 0


@pytest.mark.parametrize(
    ("law", "rms", "draft"),
    [("smc", 0.4975, 729), ("rbf_switching_smc", 0.9986, 855), ("funnel", 1.016, 851), ("gpc", 1.682, 900)],
)
def test_published_gains_swing_in_the_couplers(law: str, rms: float, draft: float) -> None:
    """Effect of fitted gains; breaks if `gains: printed` has others than those of the paper."""
    # The laws oscillate without end: a bound of 10 % below the measured figure permits another phase.
    result = summary("daqin_heavy_haul", f"law={law}", f"laws.{law}.gains=printed")
    assert result["speed_rmse_kmh"] > 0.9 * rms and result["coupler_draft_max_kn"] > 0.9 * draft


def test_the_printed_law_is_lost_with_lag_and_delay() -> None:
    """Unstable above a total lag of 0.17 s. At 1.2 s it winds up: 33.2 and 68 km/h, 1549 kN, 4442 m past the stop."""
    # These are the figures of the law alone; with supervision the braking law stops the train ahead of the stop.
    alone = ("laws.smc.integral_limit=1e12", "compensation=none", "supervision.enabled=false")
    result = summary("daqin_heavy_haul", *PRINTED, *alone)
    assert result["speed_rmse_kmh"] > 0.9 * 33.2 and result["speed_error_max_kmh"] > 0.9 * 68.0
    assert result["coupler_draft_max_kn"] > 0.9 * 1549 and result["stop_error_m"] > 0.9 * 4442
