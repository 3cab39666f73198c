"""Paper 000: heavy-haul train, RBFNN sliding mode with NDO. Claims, tables and figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from train_ato.papers.checks import largest_kmh, rms_kmh, variation
from train_ato.papers.claims import CaseTable, Paper, Results
from train_ato.papers.p000_heavy_haul import checks, lag_checks, network_checks
from train_ato.papers.p000_heavy_haul.cases import CASES, IDEAL_LAWS, LAGGED_LAWS, LAGGED_TRAINS, PRINTED_FORMS
from train_ato.papers.p000_heavy_haul.figures import draw
from train_ato.papers.printed_forms import printed_forms_table

INDEPENDENT_IDEAL: Mapping[str, tuple[str, str]] = {
    "pid": ("0.106; 0.20", "0.106"),
    "smc": ("0.0106; 0.06", "0.0125; 0.06"),
    "rbf": ("0.0252; 0.09", "0.0270; 0.09"),
    "rbf_ndo": ("0.0007; 0.04", "0.0012; 0.03"),
    "smc_ks": ("0.0040", "0.0080"),
    "rbf_ks": ("0.0029", "0.0069"),
    "rbf_ks_ndo": ("0.0009", "0.0017"),
}
"""Figures of an independent implementation on another driver's run, undisturbed and with (40)."""
INDEPENDENT_LAGGED: Mapping[str, tuple[str, str, str, str]] = {
    "twin_pid": ("0.012; 0.22", "0.017; 0.26", "0.053; 0.51", "0.113; 0.54"),
    "twin_smc_ndo": ("0.022; 0.23", "0.026; 0.29", "0.054; 0.48", "0.107; 0.73"),
    "predicted": ("0.015; 0.16", "0.019; 0.22", "0.086; 0.85", "diverges"),
}


def _pair(results: Results, key: str) -> str:
    result = results[key]
    if result.failure:
        return result.failure
    return f"{rms_kmh(result):.4f}; {largest_kmh(result):.2f}"


def _ideal_rows(results: Results) -> list[tuple[Any, ...]]:
    return [
        (
            label,
            _pair(results, key),
            INDEPENDENT_IDEAL.get(key, ("", ""))[0],
            _pair(results, f"{key} disturbed"),
            INDEPENDENT_IDEAL.get(key, ("", ""))[1],
            f"{variation(results[key]):.1f}",
        )
        for key, (label, _) in IDEAL_LAWS.items()
    ]


def _lagged_rows(results: Results) -> list[tuple[Any, ...]]:
    rows = []
    for key, (label, _) in LAGGED_LAWS.items():
        row = [label]
        for train, stated in zip(LAGGED_TRAINS, INDEPENDENT_LAGGED.get(key, ("",) * 4), strict=True):
            row += [_pair(results, f"{key} {train}"), stated]
        runs = [results[f"{key} {train}"] for train in LAGGED_TRAINS]
        low = min(run.summary["coupler_buff_max_kn"] for run in runs)
        high = max(run.summary["coupler_draft_max_kn"] for run in runs)
        rows.append((*row, f"{low:.0f} ... {high:+.0f}", f"{max(variation(run) for run in runs):.1f}"))
    return rows


PAPER = Paper(
    number="000",
    title="heavy-haul train, multi-mass model, RBFNN sliding mode and disturbance observer",
    cases=CASES,
    claims=[*checks.CLAIMS, *network_checks.CLAIMS, *lag_checks.CLAIMS],
    figures=draw,
    tables=(
        CaseTable(
            "ideal actuator, f_hat = f/1.01: rms; largest speed error in km/h",
            ("law", "undisturbed", "independent", "with (40)", "independent", "kN/s"),
            _ideal_rows,
        ),
        CaseTable(
            "lag 0.4 s, delay 0.8 s: rms; largest speed error in km/h, couplers in kN, largest variation in kN/s (last "
            "row: the independent figures are of another law on that prediction)",
            (
                "law",
                *(text for label, _ in LAGGED_TRAINS.values() for text in (label, "independent")),
                "couplers",
                "kN/s",
            ),
            _lagged_rows,
        ),
        printed_forms_table(PRINTED_FORMS),
    ),
)
