"""Paper 002: cascaded disturbance observer and fixed-time sliding mode on a freight train of five vehicles."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from train_ato.papers.claims import CaseTable, Paper, Results
from train_ato.papers.p002_freight import checks as judge
from train_ato.papers.p002_freight import observer_checks
from train_ato.papers.p002_freight import realistic_checks as on_track
from train_ato.papers.p002_freight.cases import CASES, DELAYS, LAWS, OBSERVER_TICKS, PRINTED_FORMS, RATIOS
from train_ato.papers.p002_freight.figures import draw
from train_ato.papers.p002_freight.observer_checks import percent
from train_ato.papers.p002_freight.observer_trials import FORMS
from train_ato.papers.printed_forms import printed_forms_table


def _row(results: Results, law: str, settings: Iterable[str]) -> list[str]:
    found = [on_track.realistic(results, f"{law} {setting}") for setting in settings]
    return [LAWS[law][0], *(f"{place:.2f} / {coupler:.2f}" for place, _, coupler in found)]


def _table_rows(results: Results) -> Sequence[Sequence[Any]]:
    return [_row(results, law, (f"{delay}" for delay in DELAYS if f"{law} {delay}" in results)) for law in LAWS]


def _ratio_rows(results: Results) -> Sequence[Sequence[Any]]:
    return [_row(results, law, (f"x{ratio}" for ratio in RATIOS)) for law in ("unit", "common", "common damped")]


def _observer_rows(results: Results) -> Sequence[Sequence[Any]]:
    return [
        [
            f"{key} {name}",
            *(percent(results[f"observers {key}"].summary[f"{name} {part}"]) for part in ("d1", "d2", "d1'")),
            judge.time_text(results[f"observers {key}"].summary[f"{name} settling"]),
        ]
        for key in OBSERVER_TICKS
        for name in FORMS
    ]


PAPER = Paper(
    number="002",
    title="fixed-time sliding mode with a cascaded disturbance observer, five freight vehicles",
    cases=CASES,
    claims=[*observer_checks.CLAIMS, *judge.CLAIMS, *on_track.CLAIMS],
    figures=draw,
    tables=(
        CaseTable(
            "observers: rms error of the worst car over the rms of its disturbance, and time until d1 and d2 are "
            "within 10 % (0.01 ms: from 0.06 to 0.1 s only)",
            ("sampling, form", "d1", "d2", "d1'", "settled"),
            _observer_rows,
        ),
        CaseTable(
            "realistic version: position rms / largest coupler stretch in m over the delay",
            ("law", *(f"{delay:g} s" for delay in DELAYS)),
            _table_rows,
        ),
        CaseTable(
            "the same over the ratio of true to modelled delay (modelled 0.8 s)",
            ("law", *(f"{ratio:g}" for ratio in RATIOS)),
            _ratio_rows,
        ),
        printed_forms_table(PRINTED_FORMS),
    ),
)
