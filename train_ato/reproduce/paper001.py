"""Paper 001: metro train, sliding mode with an RBF network for the switching term. Claims, table and figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from train_ato.reproduce import metro_judges as judges
from train_ato.reproduce.claims import Claim, Paper, Results, Table
from train_ato.reproduce.metro_cases import CASES, LAWS, SWEEP, TRAINS
from train_ato.reproduce.metro_figures import draw

__all__ = ["PAPER"]

INDEPENDENT: Mapping[str, tuple[str, str, str, str]] = {
    "nominal": (".081 / .62", ".015 / .11", ".015 / .11", ".002 / .014"),
    "disturbed": (".085 / .64", ".039 / .13", ".039 / .14", ".025 / .11"),
    "mismatch": (".100 / .68", ".054 / .42", ".055 / .42", ".043 / .41"),
    "slower": (".127 / .86", ".063 / .28", ".066 / .36", ".036 / .16"),
    "long_delay": ("-", ".49 / 1.3", ".54 / 1.3", ".049 / ~.2"),
}
"""Figures of an independent implementation: PID, PID + preview, RBF, best with predictor and observer."""


def _rows(results: Results) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = []
    for train, (label, _) in TRAINS.items():
        here = (judges.pair(results[f"{key} {train}"]) for key in LAWS)
        rows.append((label, *here))
        rows.append(("   independent", *INDEPENDENT[train][:3], "", "", INDEPENDENT[train][3]))
    return rows


def _ideal_rows(results: Results) -> list[tuple[Any, ...]]:
    named = {
        "ideal pid": "PID",
        "ideal pid_known": "PID + feed-forward",
        "ideal sign": "sgn(s), 50 ms",
        "ideal sign 10 ms": "sgn(s), 10 ms",
        "ideal tanh": "tanh(s/phi)",
        "ideal rbf": "RBF corrected, 50 ms",
        "ideal rbf 10 ms": "RBF corrected, 10 ms",
    }
    return [
        (label, judges.pair(results[key]), f"{judges.shaking(results[key]):.3f}", results[key].summary["stop_error_m"])
        for key, label in named.items()
    ]


BEST = tuple(f"tanh_predictor {train}" for train in TRAINS)
PAPER = Paper(
    number="001",
    title="metro train, sliding mode with an RBF network for the switching term",
    cases=CASES,
    claims=(
        Claim(
            "tracks the recommended speed more accurately than PID",
            "figures 4-7",
            ("ideal pid", "ideal pid_known", "ideal rbf", "pid nominal", "pid_preview nominal", "rbf nominal"),
            judges.accuracy,
        ),
        Claim(
            "no overshoot where the regime changes",
            "figures 4-7",
            ("ideal pid", "ideal rbf", "pid nominal", "rbf nominal"),
            judges.overshoot,
        ),
        Claim(
            "the network removes the chattering of the sliding mode and keeps the tracking",
            "figure 7",
            ("ideal sign", "ideal rbf", "ideal tanh", "ideal sign 10 ms", "ideal rbf 10 ms"),
            judges.chattering,
        ),
        Claim(
            "corrected network, ideal actuator (independent)",
            ".0004 m/s rms at 10 ms, .0011 at 50 ms, within a factor of 2",
            ("ideal rbf", "ideal rbf 10 ms"),
            judges.ideal_figures,
        ),
        Claim(
            "rejects disturbances better than PID",
            "significantly",
            (
                "ideal pid disturbed",
                "ideal rbf disturbed",
                "pid disturbed",
                "pid_preview disturbed",
                "rbf disturbed",
            ),
            judges.disturbance,
        ),
        Claim(
            "the compensation of the delay by (4), (5) keeps the accuracy",
            "compensated",
            ("rbf none", "rbf pade", "rbf nominal", "rbf_predictor nominal"),
            judges.delay_compensation,
        ),
        Claim(
            "the sliding mode (9) with sgn(s) controls a train with lag and delay",
            "stable",
            ("sign nominal", "ideal sign"),
            judges.relay,
        ),
        Claim(
            "the networks learn by (11)-(14) as printed",
            "chattering goes to 0",
            ("ideal literal", "ideal literal disturbed", "literal nominal"),
            judges.literal,
            takes_failures=True,
        ),
        Claim(
            "with lag and delay the network improves on a smooth switching term",
            "implied",
            (
                "rbf disturbed",
                "tanh disturbed",
                "pid_preview disturbed",
                "rbf_predictor disturbed",
                "tanh_predictor disturbed",
                "rbf slower",
                "tanh slower",
            ),
            judges.network_use,
        ),
        Claim(
            "the identification network (14) improves the tracking",
            "implied",
            ("rbf disturbed", "rbf unidentified disturbed"),
            judges.identification,
        ),
        Claim(
            "goal: disturbed, predictor and observer",
            "rms <= .03, largest <= .13 m/s",
            ("tanh_predictor disturbed",),
            judges.goal_disturbed,
        ),
        Claim("goal: disturbed, rbf_switching_smc", "rms <= .045 m/s", ("rbf disturbed",), judges.goal_rbf),
        Claim("goal: nominal", "rms <= .003 m/s", ("tanh_predictor nominal",), judges.goal_nominal),
        Claim(
            "goal: delays up to 1.0 s",
            "rms <= .05 m/s",
            (
                *(f"sweep {delay}" for delay in SWEEP),
                "tanh_predictor disturbed",
                "tanh_predictor long_delay",
                "rbf long_delay",
            ),
            judges.goal_delay,
        ),
        Claim(
            "held out: mismatch and slower actuator",
            ".043 / .41 and .036 / .16 m/s (independent)",
            ("tanh_predictor mismatch", "tanh_predictor slower"),
            judges.goal_mismatch,
        ),
        Claim("goal: stop and limit", "within 0.05 m, overspeed < 0.5 km/h", BEST[:2], judges.goal_stop),
    ),
    figures=draw,
    tables=(
        Table(
            "lag 0.4 s, delay 0.3 s: rms / largest speed error in m/s",
            ("case", *(label for label, _ in LAWS.values())),
            _rows,
        ),
        Table(
            "ideal actuator, no disturbance",
            ("law", "rms / largest in m/s", "variation in m/s² per s", "stop error in m"),
            _ideal_rows,
        ),
    ),
)
