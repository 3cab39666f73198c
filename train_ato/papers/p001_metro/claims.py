"""Paper 001: metro train, sliding mode with an RBF network for the switching term. Claims, table and figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from train_ato.papers.claims import CaseTable, Paper, Results
from train_ato.papers.p001_metro import checks as judges
from train_ato.papers.p001_metro import goal_checks, network_checks
from train_ato.papers.p001_metro.cases import CASES, LAWS, PRINTED_FORMS, TRAINS
from train_ato.papers.p001_metro.figures import draw
from train_ato.papers.printed_forms import printed_forms_table

INDEPENDENT: Mapping[str, tuple[str, str, str, str]] = {
    "nominal": ("0.081 / 0.62", "0.015 / 0.11", "0.015 / 0.11", "0.002 / 0.014"),
    "disturbed": ("0.085 / 0.64", "0.039 / 0.13", "0.039 / 0.14", "0.025 / 0.11"),
    "mismatch": ("0.100 / 0.68", "0.054 / 0.42", "0.055 / 0.42", "0.043 / 0.41"),
    "slower": ("0.127 / 0.86", "0.063 / 0.28", "0.066 / 0.36", "0.036 / 0.16"),
    "long_delay": ("-", "0.49 / 1.3", "0.54 / 1.3", "0.049 / ~0.2"),
}
"""Independent figures: PID; PID and RBF with a Padé feed-forward, not a preview; best with predictor and observer."""


def _rows(results: Results) -> list[tuple[Any, ...]]:
    rows: list[tuple[Any, ...]] = []
    for train, (label, _) in TRAINS.items():
        here = (judges.pair(results[f"{key} {train}"]) for key in LAWS)
        rows.append((label, *here))
        rows.append(("   independent (*)", *INDEPENDENT[train][:3], "", "", INDEPENDENT[train][3]))
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


PAPER = Paper(
    number="001",
    title="metro train, sliding mode with an RBF network for the switching term",
    cases=CASES,
    claims=[*judges.CLAIMS, *network_checks.CLAIMS, *goal_checks.CLAIMS],
    figures=draw,
    tables=(
        CaseTable(
            "lag 0.4 s, delay 0.3 s: rms / largest speed error in m/s; (*) the independent PID and RBF have a Padé "
            "feed-forward instead of the preview, and the last column is the best of several independent laws with "
            "predictor (and observer)",
            ("case", *(label for label, _ in LAWS.values())),
            _rows,
        ),
        CaseTable(
            "ideal actuator, no disturbance",
            ("law", "rms / largest in m/s", "variation in m/s² per s", "stop error in m"),
            _ideal_rows,
        ),
        printed_forms_table(PRINTED_FORMS),
    ),
)
