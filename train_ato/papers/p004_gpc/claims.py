"""Paper 004: multivariable nonlinear generalised predictive control of an EMU with three power units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from train_ato.reproduce import gpc_judges as judge
from train_ato.reproduce.claims import Claim, Paper, Results, Table
from train_ato.reproduce.gpc_cases import CASES, LAWS, SAMPLINGS, TRAINS, WEIGHTS
from train_ato.reproduce.gpc_figures import draw

__all__ = ["PAPER"]


def _rows(results: Results) -> Sequence[Sequence[Any]]:
    return [
        [
            label,
            *(
                f"{judge.speed(run):.3f} / {1e3 * judge.speed_rms(run):.1f} / {judge.place(run):.2f}"
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
            f"{judge.speed(results[key]):.3f}",
            f"{1e3 * judge.speed_rms(results[key]):.1f}",
            f"{judge.place(results[key]):.2f}",
            f"{judge.coupler(results[key]):.0f}",
        ]
        for key in shown
    ]


STURDY = ("normal", "half_more", "half_less", "heavy", "light", "noise")

CLAIMS = (
    Claim(
        "more exact than PID over Jinan - Xuzhou",
        "better; no figures",
        ("gpc long", "pid long", "pid preview long"),
        judge.normal,
    ),
    Claim(
        "N = 3, Nu = 2",
        "stable",
        (*(f"Ts {period}" for period in SAMPLINGS), *(f"Ts 0.4 lambda {weight}" for weight in WEIGHTS)),
        judge.sampling,
    ),
    Claim("(22) leaves no steady error", "0", ("gpc normal", "gpc held", "gpc on position"), judge.beyond),
    Claim(
        "a small jump when the parameters jump, less than PID",
        "slight",
        tuple(f"{key} jump" for key in ("gpc", "gpc fixed", "gpc absolute", "pid", "pid preview")),
        judge.jump,
    ),
    Claim(
        "after the jump the tracking is smooth again",
        "as before",
        ("gpc jump", "gpc absolute jump", "gpc normal"),
        judge.settled_after,
    ),
    Claim(
        "the network takes resistance and disturbance",
        "estimated on line",
        ("gpc normal", "no network", "raw residual"),
        judge.network,
    ),
    Claim(
        "multivariable: one law for each of the three units",
        "stable",
        ("per unit", "per unit, free", "gpc normal"),
        judge.coupled,
    ),
    Claim(
        "robust", "robust", tuple(f"{key} {train}" for key in ("gpc", "pid preview") for train in STURDY), judge.sturdy
    ),
    Claim("punctual, safe and comfortable", "met", ("gpc long",), judge.comfort),
    Claim(
        "with 200 kN for the train",
        "43 m as printed; 11 m with a long look ahead (independent)",
        ("gpc limited", "pid limited", "pid preview limited", "pid preview planned"),
        judge.limited,
    ),
)

PAPER = Paper(
    number="004",
    title="nonlinear GPC of a CRH380A with three power units, delays 1.0/1.1/1.2 s and 0.6/0.7/0.8 s",
    cases=CASES,
    claims=CLAIMS,
    figures=draw,
    tables=(
        Table(
            "short run (36 km): speed error max in m/s / rms in mm/s / position error max in m",
            ("case", *(label for label, _ in LAWS.values())),
            _rows,
        ),
        Table("more runs", ("run", "speed max m/s", "rms mm/s", "position m", "coupler kN"), _extra),
    ),
)
