"""Trials of the judges of paper 001."""

from __future__ import annotations

from typing import Any

import numpy as np
from judge_trials import Trial, edge
from recordings import with_series
from reproduce_results import result, series

from train_ato.papers.claims import Result
from train_ato.papers.p001_metro.cases import INERTIA, SWEEP, TRAINS

REGIME = np.where(np.arange(400) < 200, 0.8, 0.0)
"""Reference acceleration that ends after 10 s [m/s²]."""
LITERAL = ("ideal literal", "literal nominal")


def metro(rms: float = 0.01, largest: float = 0.05, over: float = 0.01, shake: float = 0.1, **more: Any) -> Result:
    """Return a run with rms and largest error [m/s], overshoot [m/s] and variation [m/s² per s]."""
    run = with_series(series(np.full(REGIME.size, over), np.zeros(REGIME.size)), reference_acceleration=REGIME)
    figures = {"command_variation_kn_per_s": shake * INERTIA / 1e3, **more}
    return result(run, speed_rmse_kmh=3.6 * rms, speed_error_max_kmh=3.6 * largest, **figures)


def long_run(rms: float = 0.01, **more: Any) -> Result:
    """Return a run of 450 s that oscillates with a period of 3.2 s."""
    wave = rms * 2**0.5 * np.sin(2 * np.pi * 0.05 * np.arange(9000) / 3.2)
    return result(series(wave, np.zeros(9000)), speed_rmse_kmh=3.6 * rms, **more)


def _both(figure: str, **values: float) -> dict[str, dict[str, float]]:
    return {key: {figure: value} for key, value in values.items()}


CLAIMS_OF_THE_PAPER = (
    Trial(
        "tracks the recommended speed",
        metro,
        {"ideal pid": {"rms": 0.1}, "pid nominal": {"rms": 0.1}},
        (
            *(edge(key, "rms", 0.0499, 0.0501) for key in LITERAL),
            *(edge(key, "rms", 0.0499, 0.0501, elsewhere=True) for key in ("ideal rbf", "rbf nominal")),
        ),
        elsewhere={key: {"rms": 5.0} for key in LITERAL},
        others=frozenset(
            ("ideal pid", "ideal pid_known", "ideal rbf", "pid nominal", "pid_preview nominal", "rbf nominal")
        ),
    ),
    Trial(
        "overshoot clearly improved",
        metro,
        {"ideal pid": {"over": 0.5}, "pid nominal": {"over": 0.5}},
        (
            *(edge(key, "over", 0.2499, 0.2501) for key in LITERAL),
            *(edge(key, "over", 0.2499, 0.2501, elsewhere=True) for key in ("ideal rbf", "rbf nominal")),
        ),
        elsewhere={key: {"over": 5.0} for key in LITERAL},
        others=frozenset(("ideal pid", "ideal rbf", "pid nominal", "rbf nominal")),
    ),
    Trial(
        "the network removes the chattering",
        metro,
        {key: {"rms": 0.02, "shake": 10.0} for key in ("ideal sign", "ideal sign 10 ms")},
        (
            edge("ideal literal", "shake", 0.99, 1.01),
            edge("ideal literal", "rms", 0.0199, 0.0201),
            edge("ideal rbf", "shake", 0.99, 1.01, elsewhere=True),
            edge("ideal rbf 10 ms", "rms", 0.0199, 0.0201, elsewhere=True),
        ),
        elsewhere={"ideal literal": {"rms": 5.0}},
        others=frozenset(("ideal sign", "ideal rbf", "ideal tanh", "ideal sign 10 ms", "ideal rbf 10 ms")),
    ),
    Trial(
        "corrected network",
        metro,
        {
            **{f"ideal {key} no noise 10 ms": {"rms": 0.0005} for key in ("rbf", "rbf fast")},
            **{f"ideal {key} no noise": {"rms": 0.001} for key in ("rbf", "rbf fast")},
        },
        (
            edge("ideal rbf no noise 10 ms", "rms", 0.00079, 0.00081),
            edge("ideal rbf no noise", "rms", 0.00219, 0.00221),
            edge("ideal rbf fast no noise 10 ms", "rms", 0.00079, 0.00081, elsewhere=True),
            edge("ideal rbf fast no noise", "rms", 0.00219, 0.00221, elsewhere=True),
        ),
        elsewhere={"ideal rbf no noise": {"rms": 0.03}},
        others=frozenset(("ideal rbf", "ideal rbf 10 ms", "ideal rbf fast no noise", "ideal rbf fast no noise 10 ms")),
    ),
    Trial(
        "rejects disturbances",
        metro,
        {"ideal pid disturbed": {"rms": 0.1}, "pid disturbed": {"rms": 0.1}},
        (
            edge("ideal literal disturbed", "rms", 0.0499, 0.0501),
            edge("rbf disturbed", "rms", 0.0499, 0.0501, elsewhere=True),
        ),
        elsewhere={"ideal literal disturbed": {"rms": 5.0}},
        others=frozenset(
            ("ideal pid disturbed", "ideal rbf disturbed", "pid disturbed", "pid_preview disturbed", "rbf disturbed")
        ),
    ),
    Trial(
        "PID loses its stability",
        metro,
        _both("rms", **{"ideal pid disturbed": 0.1, "pid disturbed": 0.1}),
        tuple(edge(f"{key} disturbed", "rms", 0.0201, 0.0199) for key in ("ideal pid", "pid")),
        others=frozenset(("ideal pid disturbed", "pid disturbed")),
    ),
    Trial(
        "the corrected compensation of the delay",
        metro,
        {"rbf none": {"rms": 0.1}},
        (edge("rbf pade", "rms", 0.0499, 0.0501),),
        others=frozenset(("rbf none", "rbf nominal", "rbf_predictor nominal")),
    ),
    Trial(
        "the sliding mode (9)",
        long_run,
        {},
        (edge("sign nominal", "rms", 0.0499, 0.0501), edge("ideal sign", "rms", 0.0499, 0.0501, elsewhere=True)),
        elsewhere={"sign nominal": {"rms": 0.3}},
        others=frozenset(("ideal sign",)),
    ),
    Trial(
        "the networks learn",
        metro,
        {"ideal sign": {"shake": 10.0}},
        (
            *(edge(key, "position_error_max_m", 4.99, 5.01) for key in (*LITERAL, "ideal literal disturbed")),
            edge("ideal literal", "shake", 0.99, 1.01),
        ),
        others=frozenset(("ideal sign",)),
    ),
    Trial(
        "with lag and delay the network",
        metro,
        _both("rms", **{"tanh disturbed": 0.02, "tanh_predictor disturbed": 0.02}),
        (
            edge("rbf_predictor disturbed", "rms", 0.0179, 0.0181),
            edge("rbf disturbed", "rms", 0.0179, 0.0181),
            edge("rbf disturbed", "rms", 0.0179, 0.0181, elsewhere=True),
        ),
        elsewhere={"rbf_predictor disturbed": {"rms": 0.03}},
        others=frozenset(
            ("tanh disturbed", "pid_preview disturbed", "tanh_predictor disturbed", "rbf slower", "tanh slower")
        ),
    ),
    Trial(
        "the identification network",
        metro,
        {"rbf unidentified disturbed": {"rms": 0.02}},
        (edge("rbf disturbed", "rms", 0.0179, 0.0181),),
        others=frozenset(("rbf unidentified disturbed",)),
    ),
)

GOALS = (
    Trial(
        "goal: disturbed, predictor",
        metro,
        {},
        (
            edge("tanh_predictor disturbed", "rms", 0.0299, 0.0301),
            edge("tanh_predictor disturbed", "largest", 0.129, 0.131),
        ),
    ),
    Trial("goal: disturbed, rbf", metro, {}, (edge("rbf disturbed", "rms", 0.0449, 0.0451),)),
    Trial(
        "goal: nominal",
        metro,
        {"tanh_predictor nominal": {"rms": 0.001}},
        (edge("tanh_predictor nominal", "rms", 0.00299, 0.00301),),
    ),
    Trial(
        "goal: delays",
        metro,
        {},
        (
            edge("tanh_predictor long_delay", "rms", 0.0499, 0.0501),
            *(edge(f"sweep {delay}", "rms", 0.0499, 0.0501) for delay in SWEEP),
        ),
        others=frozenset(("rbf long_delay",)),
    ),
    Trial(
        "held out",
        metro,
        {},
        (
            edge("tanh_predictor mismatch", "rms", 0.0429, 0.0431),
            edge("tanh_predictor mismatch", "largest", 0.409, 0.411),
            edge("tanh_predictor slower", "rms", 0.0359, 0.0361),
            edge("tanh_predictor slower", "largest", 0.159, 0.161),
        ),
    ),
    Trial(
        "goal: stop",
        metro,
        {},
        (
            *(edge(f"tanh_predictor {train}", "stop_error_m", -0.0499, -0.0501) for train in TRAINS),
            *(edge(f"tanh_predictor {train}", "overspeed_max_kmh", 0.499, 0.501) for train in TRAINS),
        ),
    ),
)

TRIALS = (*CLAIMS_OF_THE_PAPER, *GOALS)
