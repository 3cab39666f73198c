"""Paper 002: cascaded disturbance observer and fixed-time sliding mode on a freight train of five vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from train_ato.reproduce import freight_judges as judge
from train_ato.reproduce import freight_realistic as on_track
from train_ato.reproduce.claims import Claim, Paper, Results, Table
from train_ato.reproduce.freight_cases import CASES, DELAYS, LAWS, OBSERVER_TICKS, RATIOS
from train_ato.reproduce.freight_figures import draw
from train_ato.reproduce.freight_observers import FORMS

__all__ = ["PAPER"]


def _table_rows(results: Results) -> Sequence[Sequence[Any]]:
    rows: list[list[Any]] = []
    for key, (label, _) in LAWS.items():
        found = [on_track.realistic(results, f"{key} {delay}") for delay in DELAYS if f"{key} {delay}" in results]
        rows.append([label, *(f"{place:.2f} / {coupler:.2f}" for place, _, coupler in found)])
    return rows


def _ratio_rows(results: Results) -> Sequence[Sequence[Any]]:
    rows: list[list[Any]] = []
    for key in ("unit", "common", "common damped"):
        found = [on_track.realistic(results, f"{key} x{ratio}") for ratio in RATIOS]
        rows.append([LAWS[key][0], *(f"{place:.2f} / {coupler:.2f}" for place, _, coupler in found)])
    return rows


def _observer_rows(results: Results) -> Sequence[Sequence[Any]]:
    return [
        [
            f"{key} {name}",
            *(judge.percent(results[f"observers {key}"].summary[f"{name} {part}"]) for part in ("d1", "d2", "d1'")),
            judge.seconds(results[f"observers {key}"].summary[f"{name} settling"]),
        ]
        for key in OBSERVER_TICKS
        for name in FORMS
    ]


OBSERVERS = tuple(f"observers {key}" for key in OBSERVER_TICKS)
GAINS = tuple(key for key in CASES if key.startswith("gain "))

CLAIMS = (
    Claim(
        "the cascaded observer finds matched and unmatched disturbances",
        "within about 0.5 s",
        ("observers 0.01 ms", "observers 1 ms"),
        judge.observer,
    ),
    Claim("the observer is ready for use on board", "accurate estimates", OBSERVERS, judge.sampling),
    Claim(
        "the derivative of the unmatched disturbance is found, again after its jumps",
        "accurate",
        ("observers 1 ms",),
        judge.derivative,
    ),
    Claim(
        "the cars' speed follows",
        "after 1.7 s, gain 50",
        ("ideal", "gain 1.9 from 108 m", "gain 50 from 108 m"),
        judge.settling,
    ),
    Claim("the settling time is bounded whatever the start, (23) + (34)", "fixed time", GAINS, judge.bound),
    Claim("position and speed are tracked both", "robust tracking of both", ("ideal",), judge.both),
    Claim("the couplers return to 0 and stay there at the speed steps", "0 m", ("ideal",), judge.couplers),
    Claim(
        "the compared method stretches the couplers at the start",
        "150 m",
        ("ideal", "printed order"),
        judge.start,
        takes_failures=True,
    ),
    Claim("faster than conventional laws", "by more than 5 s", ("ideal", "pd slow", "pd fast"), judge.faster),
    Claim(
        "especially suited where matched and unmatched disturbances meet (here: on a train with limits, lag and delay)",
        "strong robustness",
        tuple(f"{key} {delay}" for key in ("print", "scaled", "scaled predicted") for delay in DELAYS),
        on_track.real_train,
    ),
    Claim(
        "goals of the realistic version: lag_smc, eso, predictor",
        "per car .20 m and coupler .43 m; slow .08 m/s, .27 m; common .6 m, .27 m; undisturbed .02 m (goal)",
        (
            *(f"{key} {delay}" for key in ("unit", "unit slow") for delay in DELAYS),
            *(f"common x{ratio}" for ratio in RATIOS),
            "unit undisturbed",
        ),
        on_track.goals,
    ),
    Claim(
        "one law that meets the three goals at once",
        "not reached before (goal)",
        (*(f"common damped {delay}" for delay in DELAYS), *(f"common damped x{ratio}" for ratio in RATIOS)),
        on_track.all_at_once,
    ),
)

PAPER = Paper(
    number="002",
    title="fixed-time sliding mode with a cascaded disturbance observer, five freight vehicles",
    cases=CASES,
    claims=CLAIMS,
    figures=draw,
    tables=(
        Table(
            "observers: rms error of the worst car over its disturbance's rms, and when d1 and d2 are within 10 % "
            "(0.01 ms: from .06 to .1 s alone)",
            ("sampling, form", "d1", "d2", "d1'", "settled"),
            _observer_rows,
        ),
        Table(
            "realistic version: position rms / largest coupler stretch in m over the delay",
            ("law", *(f"{delay:g} s" for delay in DELAYS)),
            _table_rows,
        ),
        Table(
            "the same at a true over believed delay of (believed 0.8 s)",
            ("law", *(f"{ratio:g}" for ratio in RATIOS)),
            _ratio_rows,
        ),
    ),
)
