"""Paper 003: dynamic-surface funnel control of a high-speed train with input delay and saturation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from train_ato.reproduce import funnel_judges as judge
from train_ato.reproduce.claims import Claim, Paper, Results, Table
from train_ato.reproduce.funnel_cases import CASES, LAWS, TRAINS
from train_ato.reproduce.funnel_figures import draw
from train_ato.reproduce.judges import variation
from train_ato.reproduce.tracking import written

__all__ = ["PAPER"]


def _rows(results: Results) -> Sequence[Sequence[Any]]:
    """Return a row for every train: position max, rms and speed max of every law."""
    rows: list[list[Any]] = []
    for train, (label, _) in TRAINS.items():
        cells = []
        for key in LAWS:
            result = results.get(f"{key} {train}")
            if result is None or result.history is None:
                cells.append("-")
            elif train == "noise":
                cells.append(f"{judge.place(result):.3f} / {variation(result):.0f} kN/s")
            else:
                cells.append(
                    f"{judge.place(result):.3f} / {1e3 * judge.place_rms(result):.1f} / {judge.speed(result):.3f}"
                )
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
    "printed raw light": "printed, gains not clipped, mass -20 %",
    "lag modelled": "PID + predictor + eso, lag 0.4 s known",
    "pid alone": "PID without feed-forward",
}


def _extra(results: Results) -> Sequence[Sequence[Any]]:
    return [[label, *(written(figure(results[key]), unit) for figure, unit in FIGURES)] for key, label in EXTRA.items()]


FIGURES = ((judge.place, "m"), (judge.place_rms, "m"), (judge.speed, "m/s"))
MISMATCH = tuple(f"printed {key}" for key in ("half_more", "later", "lagging", "light"))
NOISY = tuple(f"{key} noise" for key in ("printed", "corrected", "pid", "predictor", "quiet"))

CLAIMS = (
    Claim(
        "tracking without saturation",
        "position to centimetres, speed to millimetres per second",
        ("printed long", "corrected long"),
        judge.centimetres,
    ),
    Claim(
        "Theorem 1: the errors converge to 0 without saturation",
        "0",
        ("printed long", "corrected long"),
        judge.asymptotic,
    ),
    Claim(
        "the delay state takes the delay's influence away",
        "effective",
        ("corrected nominal", "corrected no delay state", "pid nominal", "pid alone"),
        judge.delay,
    ),
    Claim("200 kN are a cut of the demand", "11.4 %", ("printed long",), judge.cut),
    Claim(
        "stable in saturation",
        "just over 40 m, about 4 m/s, 77 s of deep saturation in braking",
        ("printed long saturated",),
        judge.saturated,
    ),
    Claim(
        "recovery when the saturation ends",
        "speed within cm/s after 22 s, position back to cm",
        ("printed long saturated",),
        judge.recovery,
    ),
    Claim(
        "without handling of the saturation the train is lost",
        "kilometres (about 5 km), 20 to 40 m/s",
        ("unhandled long", "unhandled 10 ms", "unhandled", "unhandled clipped", "unhandled aware"),
        judge.unhandled,
    ),
    Claim(
        "the same at finer ticks",
        "kilometres (about 5 km), 20 to 40 m/s",
        ("unhandled long 10 ms", "unhandled 1 ms"),
        judge.unhandled_fine,
    ),
    Claim(
        "the dynamic funnel keeps performance and constraint together",
        "errors bounded by the funnel",
        ("printed saturated", "fixed gains", "unhandled aware"),
        judge.funnel,
    ),
    Claim(
        "robust to the train's parameters",
        "good",
        (*MISMATCH, "printed position noise", "corrected position noise"),
        judge.mismatch,
    ),
    Claim(
        "goal at 200 kN: a profile planned for the force",
        "13 m and 1 m/s (goal)",
        ("predictor planned", "predictor replanned"),
        judge.planned,
    ),
    Claim("goal with 0.05 m/s of noise: variation of the command", "60 kN/s (goal)", NOISY, judge.quiet),
)

PAPER = Paper(
    number="003",
    title="dynamic-surface funnel control of a CRH380A, delay 0.2 |sin t| s, 286 km",
    cases=CASES,
    claims=CLAIMS,
    figures=draw,
    tables=(
        Table(
            "short run (36 km, the same phases): e1 max in m / e1 rms in mm / speed error max in m/s",
            ("case", *(label for label, _ in LAWS.values())),
            _rows,
        ),
        Table("more runs", ("run", "e1 max", "e1 rms", "speed error max"), _extra),
    ),
)
