"""Judges of paper 002 on its own train, without limits, lag and delay; ``freight_realistic.py`` judges the rest."""

from __future__ import annotations

from typing import Any

import numpy as np

from train_ato.reproduce.claims import Judgement, Result, Results, Verdict
from train_ato.reproduce.freight_cases import CASES, OBSERVER_TICKS
from train_ato.reproduce.freight_observers import FORMS, JUMPS
from train_ato.reproduce.judges import history as series_of
from train_ato.reproduce.tracking import (
    largest,
    last_outside,
    position_error,
    rms,
    speed_error,
    written,
)
from train_ato.types import Array

OFFSETS: Array = 80.0 * np.arange(5, dtype=np.float64)
STIFFNESS_KN = 160.0
"""Of a coupler [kN/m]."""
MASS = 80e3
GOOD, FAIR, BAD = Verdict.REPRODUCED, Verdict.OTHER_SETTING, Verdict.NOT_REPRODUCED


def seconds(value: float) -> str:
    """Return a time as it is written."""
    return written(value, "s")


def percent(value: float) -> str:
    """Return a part as it is written; ten times the whole is of no use to anybody."""
    return f"{100 * value:.2g} %" if abs(value) < 10 else "useless"


def observer(results: Results) -> Judgement:
    """Judge how fast and how well d1 and d2 are found."""
    fine, coarse = results["observers 0.01 ms"].summary, results["observers 1 ms"].summary
    print_fine, print_coarse = fine["printed settling"], coarse["printed settling"]
    measured = (
        f"as printed: within 10 % after {seconds(print_fine)} at a 0.01 ms step, {seconds(print_coarse)} at 1 ms "
        f"(error {percent(max(coarse['printed d1'], coarse['printed d2']))}); with implicit signs after "
        f"{seconds(coarse['implicit settling'])}"
    )
    if print_coarse <= 0.5:
        return Judgement(measured, GOOD, "the print works at a step a computer can take")
    if print_fine <= 0.5 or coarse["implicit settling"] <= 0.5:
        return Judgement(
            measured,
            FAIR,
            "the bare signs belong to continuous time: only at steps of some 0.01 ms, or with the signs taken "
            "implicitly, does it find the disturbances; its filter of 0.02 s leaves 6 to 11 %",
        )
    return Judgement(measured, BAD, "no form of it finds the disturbances within 0.5 s")


def sampling(results: Results) -> Judgement:
    """Judge what the observer is worth over the sampling time."""
    cells = []
    for key in OBSERVER_TICKS:
        figures = results[f"observers {key}"].summary
        best = min(FORMS, key=lambda name: figures[f"{name} d1"] + figures[f"{name} d2"])
        worst = max(figures["printed d1"], figures["printed d2"])
        cells.append(f"{key}: printed {percent(worst)}, best {best}")
    worsens = results["observers 10 ms"].summary["printed d1"] > 3 * results["observers 0.1 ms"].summary["printed d1"]
    verdict = BAD if worsens else GOOD
    return Judgement(
        "; ".join(cells),
        verdict,
        "an onboard computer samples at 10 ms and above: there the printed form is lost and a linear extended-state "
        "observer or implicit signs are what works"
        if worsens
        else "the printed form holds its accuracy at 10 ms",
    )


def derivative(results: Results) -> Judgement:
    """Judge the estimate of d1' and what happens at the jumps of d21."""
    figures = results["observers 1 ms"].summary
    forms = ("printed", "implicit", "levant", "eso")
    rate = "d1'"
    parts = [f"{name} {percent(figures[f'{name} {rate}'])}" for name in forms]
    again = min(figures[f"{name} again"] for name in forms[1:])
    measured = f"rms error of d1' at 1 ms: {', '.join(parts)}; after the jump again within 10 % in {seconds(again)}"
    print_good = figures["printed d1'"] <= 0.2
    if print_good:
        return Judgement(measured, GOOD, "the derivative is found as printed")
    if figures["implicit d1'"] <= 0.2 and again <= 1.0:
        return Judgement(
            measured,
            FAIR,
            "with implicit signs, behind the same filter; printed, the switching of k4 = 100 m/s² is in the estimate "
            "(its condition on k4 asks for 278, and the e3 in it contains the unknown d1)",
        )
    return Judgement(measured, BAD, "no form of the cascade finds d1' to 20 %")


def _settled(results: Results, key: str, band: float = 0.1) -> float:
    """Return when the worst car is within a band of its place for good, before the first speed step [s]."""
    history = series_of(results[key])
    return last_outside(history.time, position_error(history, OFFSETS), band, 0.0, JUMPS[0] - 0.005)


def _motion(history: Any) -> Array:
    """Return x' - v_r, which is v + d1 - v_r [m/s]."""
    return np.asarray(np.gradient(history.position, history.time, axis=0) - history.reference_velocity[:, None])


def settling(results: Results) -> Judgement:
    """Judge the 1.7 s of the speed."""
    history = series_of(results["ideal"])
    place = _settled(results, "ideal")
    speed = last_outside(history.time, _motion(history), 0.2, 0.0, JUMPS[0] - 0.005)
    nominal, printed = results["gain 1.9 from 108 m"].summary, results["gain 50 from 108 m"].summary
    measured = (
        f"gain 1.9: position within 0.1 m after {seconds(place)}, speed within 0.2 m/s after {seconds(speed)}, "
        f"force limited to {largest(history.command) / MASS:.0f} m/s²; without limit {seconds(nominal['settling'])} "
        f"and {nominal['acceleration']:.2g} m/s². Gain 50: {seconds(printed['settling'])}, "
        f"{printed['acceleration']:.2g} m/s²"
    )
    if place < 2.0 and speed < 2.0 and not 1.2 < printed["settling"] < 2.2:
        return Judgement(
            measured,
            FAIR,
            "1.7 s is what gains of 1.7 to 2 give, not the printed 50; no train has the force: 108 m in 1.7 s",
        )
    if 1.2 < printed["settling"] < 2.2:
        return Judgement(measured, GOOD, "the printed gain gives the printed time")
    return Judgement(measured, BAD, "the train is not in its place within 2 s")


def bound(results: Results) -> Judgement:
    """Judge the fixed-time bound."""
    keys = [key for key in CASES if key.startswith("gain ")]
    rows = [(key, results[key].summary) for key in keys]
    measured = "; ".join(
        f"{key}: {seconds(figures['settling'])} of {seconds(figures['bound'])}" for key, figures in rows
    )
    if all(figures["settling"] <= figures["bound"] for _, figures in rows):
        return Judgement(
            measured, GOOD, "seven times the distance takes as long, with 200 times the acceleration: that is the price"
        )
    return Judgement(measured, BAD, "a settling time lies beyond the bound")


def both(results: Results) -> Judgement:
    """Judge whether position and speed are tracked at once."""
    history = series_of(results["ideal"])
    steady = (history.time > 3.0) & (history.time < JUMPS[0] - 0.1)
    place = largest(position_error(history, OFFSETS)[steady])
    speed, motion = rms(speed_error(history)[steady]), rms(_motion(history)[steady])
    measured = (
        f"position {written(place, 'm')}, v - v_r {written(speed, 'm/s')} rms, "
        f"v + d1 - v_r {written(motion, 'm/s')} rms"
    )
    if place < 0.1 and speed > 10 * motion:
        return Judgement(
            measured,
            FAIR,
            "what tracks is v + d1: x' = v + d1 forbids that x and v both follow while d1 is not 0",
        )
    if place < 0.1:
        return Judgement(measured, GOOD, "position and speed both follow")
    return Judgement(measured, BAD, "the position does not follow")


def couplers(results: Results) -> Judgement:
    """Judge the couplers, at the start and at the steps of the speed."""
    history = series_of(results["ideal"])
    stretch = np.maximum(history.coupler_high, -history.coupler_low) / 1e3 / STIFFNESS_KN
    t = history.time
    before = float(stretch[(t > 3.0) & (t < JUMPS[0] - 0.1)].max())
    first, second = (float(stretch[(t >= at) & (t < at + 3.0)].max()) for at in JUMPS)
    measured = (
        f"at most {written(before, 'm')} from 3 s to 10 s; {written(first, 'm')} at the step at 10 s, where d21 and "
        f"d12 jump as well, {written(second, 'm')} at 20 s"
    )
    if max(before, second) < 0.1 and first < 0.1:
        return Judgement(measured, GOOD, "the cars move as one")
    if max(before, second) < 0.1:
        return Judgement(
            measured,
            FAIR,
            "the cars move as one except where a disturbance itself jumps by 10 m/s: until the observer has it again "
            "the couplers work",
        )
    return Judgement(measured, BAD, "the couplers keep working")


def start(results: Results) -> Judgement:
    """Judge the 150 m of the compared method."""
    began, reversed_began = (_stretch_at_start(results[key]) for key in ("ideal", "printed order"))
    history = series_of(results["printed order"])
    lost = float(np.abs(position_error(history, OFFSETS)).max())
    measured = (
        f"printed order: {written(reversed_began, 'm')} in every coupler at t = 0, and with 5000 m/s² the law is lost "
        f"from there ({written(lost, 'm')} off within {written(float(history.time[-1]), 's')}); physical order: "
        f"{written(began, 'm')}"
    )
    if began < 0.01 < reversed_began and lost > 1e3:
        return Judgement(
            measured,
            FAIR,
            "positions 108 ... 428 m with car 1 in front put the train back to front: the 150 m are that, under any "
            "law, and car 5 is 748 m off its place, from where the surface asks for 1e5 m/s; cars cannot stand so on "
            "a track",
        )
    return Judgement(measured, BAD, "the couplers' stretch at the start is not that of the order alone")


def _stretch_at_start(result: Result) -> float:
    position = series_of(result).position[0]
    return float(np.abs(np.diff(position) + np.diff(OFFSETS)).max())


def faster(results: Results) -> Judgement:
    """Judge the 5 s over a conventional law."""
    ours, slow, fast = (_settled(results, key) for key in ("ideal", "pd slow", "pd fast"))
    forces = [largest(series_of(results[key]).command) / MASS for key in ("pd slow", "pd fast")]
    measured = (
        f"within 0.1 m: fixed-time {seconds(ours)}; PD with poles at .8 1/s beyond {seconds(slow)} at "
        f"{forces[0]:.0f} m/s², with poles at 4 and 5 1/s {seconds(fast)} at {forces[1]:.0f} m/s²"
    )
    if slow - ours >= 5.0 and fast - ours < 5.0:
        return Judgement(
            measured,
            FAIR,
            "against a slow PD; a PD with the gains for it is as fast with less than half the force. The compared "
            "method is another paper's and its gains are not given",
        )
    if min(slow, fast) - ours >= 5.0:
        return Judgement(measured, GOOD, "no PD comes near")
    return Judgement(measured, BAD, "it is not 5 s faster than either PD")
