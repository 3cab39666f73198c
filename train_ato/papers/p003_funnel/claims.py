"""Paper 003: dynamic-surface funnel control of a high-speed train with input delay and saturation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from train_ato.papers.checks import variation
from train_ato.papers.claims import CaseTable, Paper, Results
from train_ato.papers.p003_funnel import checks as judge
from train_ato.papers.p003_funnel import saturation_checks
from train_ato.papers.p003_funnel.cases import CASES, LAWS, PRINTED_FORMS, TRAINS
from train_ato.papers.p003_funnel.figures import draw
from train_ato.papers.printed_forms import printed_forms_table
from train_ato.papers.tracking import largest_position_error as place
from train_ato.papers.tracking import largest_speed_error as speed
from train_ato.papers.tracking import written


def _rows(results: Results) -> Sequence[Sequence[Any]]:
    """Return one row per train: position max, rms and speed max of every law."""
    rows: list[list[Any]] = []
    for train, (label, _) in TRAINS.items():
        cells = []
        for key in LAWS:
            result = results.get(f"{key} {train}")
            if result is None or result.recording is None:
                cells.append("-")
            elif train == "noise":
                cells.append(f"{place(result):.3f} / {variation(result):.0f} kN/s")
            else:
                cells.append(f"{place(result):.3f} / {1e3 * judge.place_rms(result):.1f} / {speed(result):.3f}")
        rows.append([label, *cells])
    return rows


EXTRA = {
    "printed long": "printed, 286 km",
    "corrected long": "corrected, 286 km",
    "pid long": "PID + preview, 286 km",
    "predictor long": "PID + predictor + eso, 286 km",
    "printed long saturated": "printed, 286 km, 200 kN",
    "corrected long saturated": "corrected, 286 km, 200 kN",
    "printed network": "printed with its network",
    "corrected, f known": "corrected, f known instead of the network",
    "corrected no delay state": "corrected without the delay state",
    "printed light long": "printed, 286 km, mass -20 %",
    "lag modelled": "PID + predictor + eso, lag 0.4 s known",
    "pid alone": "PID without feed-forward",
}


def _extra(results: Results) -> Sequence[Sequence[Any]]:
    return [[label, *(written(figure(results[key]), unit) for figure, unit in FIGURES)] for key, label in EXTRA.items()]


FIGURES = ((place, "m"), (judge.place_rms, "m"), (speed, "m/s"))

PAPER = Paper(
    number="003",
    title="dynamic-surface funnel control of a CRH380A, delay 0.2 |sin t| s, 286 km",
    cases=CASES,
    claims=[*judge.CLAIMS, *saturation_checks.CLAIMS],
    figures=draw,
    tables=(
        CaseTable(
            "short run (36 km, the same phases): e1 max in m / e1 rms in mm / speed error max in m/s (rms and speed "
            "only where v_ref > 1 m/s)",
            ("case", *(label for label, _ in LAWS.values())),
            _rows,
        ),
        CaseTable(
            "more runs (rms and speed only where v_ref > 1 m/s)",
            ("run", "e1 max", "e1 rms", "speed error max"),
            _extra,
        ),
        printed_forms_table(PRINTED_FORMS),
    ),
)
