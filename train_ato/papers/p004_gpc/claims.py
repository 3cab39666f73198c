"""Paper 004: multivariable nonlinear generalised predictive control of an EMU with three power units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from train_ato.papers.claims import CaseTable, Paper, Results
from train_ato.papers.p004_gpc import change_checks
from train_ato.papers.p004_gpc import checks as judge
from train_ato.papers.p004_gpc.cases import CASES, LAWS, PRINTED_FORMS, TRAINS
from train_ato.papers.p004_gpc.figures import draw
from train_ato.papers.printed_forms import printed_forms_table
from train_ato.papers.tracking import largest_position_error as unit_place
from train_ato.papers.tracking import largest_speed_error as speed


def _rows(results: Results) -> Sequence[Sequence[Any]]:
    return [
        [
            label,
            *(
                f"{speed(run):.3f} / {1e3 * judge.speed_rms(run):.1f} / {unit_place(run):.2f}"
                for run in (results[f"{key} {train}"] for key in LAWS)
            ),
        ]
        for train, (label, _) in TRAINS.items()
    ]


def _extra(results: Results) -> Sequence[Sequence[Any]]:
    shown = [key for key in CASES if not any(key == f"{law} {train}" for law in LAWS for train in TRAINS)]
    return [
        [
            key,
            f"{speed(results[key]):.3f}",
            f"{1e3 * judge.speed_rms(results[key]):.1f}",
            f"{unit_place(results[key]):.2f}",
            f"{judge.coupler(results[key]):.0f}",
        ]
        for key in shown
    ]


PAPER = Paper(
    number="004",
    title="nonlinear GPC of a CRH380A with three power units, delays 1.0/1.1/1.2 s and 0.6/0.7/0.8 s",
    cases=CASES,
    claims=[*judge.CLAIMS, *change_checks.CLAIMS],
    figures=draw,
    tables=(
        CaseTable(
            "short run (36 km): speed error max in m/s (only where v_ref > 1 m/s) / rms in mm/s / position error max "
            "in m; no PID is clamped",
            ("case", *(label for label, _ in LAWS.values())),
            _rows,
        ),
        CaseTable("more runs", ("run", "speed max m/s", "rms mm/s", "position m", "coupler kN"), _extra),
        printed_forms_table(PRINTED_FORMS),
    ),
)
