"""Paper 000: heavy-haul train, RBFNN sliding mode with NDO. Claims, tables and figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from train_ato.reproduce import heavy_haul_judges as judges
from train_ato.reproduce import heavy_haul_lag
from train_ato.reproduce.claims import Claim, Paper, Results, Table
from train_ato.reproduce.heavy_haul_cases import CASES, IDEAL_LAWS, LAGGED_LAWS, LAGGED_TRAINS
from train_ato.reproduce.heavy_haul_figures import draw
from train_ato.reproduce.judges import largest, rms, variation

__all__ = ["PAPER"]

INDEPENDENT_IDEAL: Mapping[str, tuple[str, str]] = {
    "pid": (".106; .20", ".106"),
    "smc": (".0106; .06", ".0125; .06"),
    "rbf": (".0252; .09", ".0270; .09"),
    "rbf_ndo": (".0007; .04", ".0012; .03"),
    "smc_ks": (".0040", ".0080"),
    "rbf_ks": (".0029", ".0069"),
    "rbf_ks_ndo": (".0009", ".0017"),
}
"""Figures of an independent implementation on another driver's run, undisturbed and with (40)."""
INDEPENDENT_LAGGED: Mapping[str, tuple[str, str, str, str]] = {
    "twin_pid": (".012; .22", ".017; .26", ".053; .51", ".113; .54"),
    "twin_smc_ndo": (".022; .23", ".026; .29", ".054; .48", ".107; .73"),
    "predicted": (".015; .16", ".019; .22", ".086; .85", "diverges"),
}


def _pair(results: Results, key: str) -> str:
    result = results[key]
    if result.failure:
        return result.failure
    return f"{rms(result):.4f}; {largest(result):.2f}"


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


def _both(*keys: str) -> tuple[str, ...]:
    return tuple(f"{key}{suffix}" for key in keys for suffix in ("", " disturbed"))


def _improvement(percent: float, suffix: str) -> Claim:
    what = "under disturbance (40)" if suffix else "without disturbance"
    keys = tuple(f"{key}{suffix}" for key in ("smc", "smc_ndo", "rbf", "rbf_ndo", "smc_ks", "rbf_ks"))
    return Claim(
        f"RBFNN-SMC with NDO is more accurate than SMC {what}",
        f"{percent} %",
        keys,
        judges.improvement(percent, suffix),
    )


PAPER = Paper(
    number="000",
    title="heavy-haul train, multi-mass model, RBFNN sliding mode and disturbance observer",
    cases=CASES,
    claims=(
        Claim("speed error of RBFNN-SMC", "within +-0.15 km/h", ("rbf", "rbf_ndo"), judges.network_band),
        Claim("speed error of SMC", "within +-0.2 km/h", ("smc",), judges.smc_band),
        Claim("speed error of PID, shaped like its force", "-0.15 ... 0.27 km/h", ("pid",), judges.pid_band),
        Claim(
            "RBFNN-SMC tracks best, SMC second, PID worst",
            "order",
            ("pid", "smc", "rbf", "rbf_ndo", "rbf_ks", "smc_ks"),
            judges.ranking,
        ),
        _improvement(27.3, ""),
        _improvement(28.9, " disturbed"),
        Claim("RMSE with NDO unchanged by the disturbance", "nearly", _both("rbf_ndo", "smc"), judges.unchanged),
        Claim(
            "under (40) PID and SMC oscillate with it, the law with NDO does not",
            "figure 12",
            _both("pid", "smc", "rbf_ndo"),
            judges.oscillation,
        ),
        Claim("the network estimates delta", "within 5e-5 m/s²", ("rbf", "rbf_ks"), judges.network_accuracy),
        Claim(
            "the NDO observes the fast disturbance",
            "precisely",
            ("rbf_ndo disturbed", "rbf_ks_ndo disturbed", "ndo 1000 noise", "ndo 20 noise"),
            judges.observer_accuracy,
        ),
        Claim(
            "coupler forces stay in the safe range",
            "figure 10",
            ("pid", "smc", "rbf_ndo", "rbf_ndo disturbed"),
            judges.couplers,
        ),
        Claim(
            "the control force changes more smoothly than PID's",
            "figure 9",
            ("pid", "smc", "rbf", "rbf_ndo"),
            judges.smoothness,
        ),
        Claim(
            "the network improves SMC because f is 1 % wrong",
            "implied",
            ("smc", "rbf", "smc exact", "rbf exact"),
            judges.exact_model,
        ),
        *heavy_haul_lag.CLAIMS,
    ),
    figures=draw,
    tables=(
        Table(
            "ideal actuator, f_hat = f/1.01: rms; largest speed error in km/h",
            ("law", "undisturbed", "independent", "with (40)", "independent", "kN/s"),
            _ideal_rows,
        ),
        Table(
            "lag 0.4 s, delay 0.8 s: rms; largest speed error in km/h, couplers in kN, largest variation in kN/s",
            (
                "law",
                *(text for label, _ in LAGGED_TRAINS.values() for text in (label, "independent")),
                "couplers",
                "kN/s",
            ),
            _lagged_rows,
        ),
    ),
)
