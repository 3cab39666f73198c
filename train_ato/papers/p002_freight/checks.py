"""Judges of paper 002 on its own train, without limits, lag and delay."""

from __future__ import annotations

from typing import Any

import numpy as np

from train_ato.messages.types import Array
from train_ato.papers.checks import BAD, FAIR, GOOD
from train_ato.papers.checks import recording as series_of
from train_ato.papers.claims import Claims, Judgement, Result, Results
from train_ato.papers.p002_freight.cases import CASES, OBSERVER_TICKS
from train_ato.papers.p002_freight.observer_trials import FORMS, JUMPS
from train_ato.papers.tracking import (
    largest,
    last_outside,
    position_error,
    rms,
    speed_error,
    written,
)

OFFSETS: Array = 80.0 * np.arange(5, dtype=np.float64)
STIFFNESS_KN = 160.0
"""Stiffness of a coupler [kN/m]."""
MASS = 80e3
"""Mass of a car [kg]."""
CLAIMS = Claims()


def time_text(value: float) -> str:
    """Return a time with its unit as text."""
    return written(value, "s")


def percent(value: float) -> str:
    """Return a fraction in per cent as text; ``useless`` from a factor of 10 on."""
    return f"{100 * value:.2g} %" if abs(value) < 10 else "useless"


@CLAIMS.judged_by(
    "the cascaded observer finds matched and unmatched disturbances",
    "within about 0.5 s",
    ("observers 0.01 ms", "observers 1 ms"),
)
def disturbances_found(results: Results) -> Judgement:
    """Judge settling time and accuracy of the estimates of d1 and d2."""
    fine, coarse = results["observers 0.01 ms"].summary, results["observers 1 ms"].summary
    print_fine, print_coarse = fine["printed settling"], coarse["printed settling"]
    measured = (
        f"as printed: within 10 % after {time_text(print_fine)} at a 0.01 ms step, {time_text(print_coarse)} at 1 ms "
        f"(error {percent(max(coarse['printed d1'], coarse['printed d2']))}); with implicit signs after "
        f"{time_text(coarse['implicit settling'])}"
    )
    if print_coarse <= 0.5:
        return Judgement(measured, GOOD, "the printed form works at a practical step")
    if print_fine <= 0.5 or coarse["implicit settling"] <= 0.5:
        return Judgement(
            measured,
            FAIR,
            "explicit sign functions suit continuous time only: the observer finds the disturbances at steps of "
            "about 0.01 ms or with implicit signs; its filter of 0.02 s leaves 6 to 11 %",
        )
    return Judgement(measured, BAD, "no form of it finds the disturbances within 0.5 s")


@CLAIMS.judged_by(
    "the observer is ready for use on board", "accurate estimates", (f"observers {key}" for key in OBSERVER_TICKS)
)
def observer_sampling(results: Results) -> Judgement:
    """Judge the accuracy of the observer over the sampling time."""
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
        "an onboard computer samples at 10 ms and above: there the printed form fails, and a linear extended-state "
        "observer or implicit signs work"
        if worsens
        else "the printed form holds its accuracy at 10 ms",
    )


@CLAIMS.judged_by(
    "the derivative of the unmatched disturbance is found, again after its jumps", "accurate", ("observers 1 ms",)
)
def derivative(results: Results) -> Judgement:
    """Judge the estimate of d1', also after the jumps of d21."""
    figures = results["observers 1 ms"].summary
    forms = ("printed", "implicit", "levant", "eso")
    rate = "d1'"
    parts = [f"{name} {percent(figures[f'{name} {rate}'])}" for name in forms]
    again = min(figures[f"{name} again"] for name in forms[1:])
    measured = f"rms error of d1' at 1 ms: {', '.join(parts)}; after the jump again within 10 % in {time_text(again)}"
    print_good = figures["printed d1'"] <= 0.2
    if print_good:
        return Judgement(measured, GOOD, "the derivative is found as printed")
    if figures["implicit d1'"] <= 0.2 and again <= 1.0:
        return Judgement(
            measured,
            FAIR,
            "with implicit signs and the same filter; as printed, the switching of k4 = 100 m/s² is in the estimate "
            "(its condition on k4 requires 278, and its e3 contains the unknown d1)",
        )
    return Judgement(measured, BAD, "no form of the cascade finds d1' to 20 %")


def _settled(results: Results, key: str) -> float:
    """Return the settling time of the worst position error to 0.1 m, before the first speed step [s]."""
    recording = series_of(results[key])
    return last_outside(recording.time, position_error(recording, OFFSETS), 0.1, 0.0, JUMPS[0] - 0.005)


def _motion(recording: Any) -> Array:
    """Return x' - v_r, which is v + d1 - v_r [m/s]."""
    return np.asarray(np.gradient(recording.position, recording.time, axis=0) - recording.reference_velocity[:, None])


@CLAIMS.judged_by(
    "the cars' speed follows", "after 1.7 s, gain 50", ("ideal", "gain 1.9 from 108 m", "gain 50 from 108 m")
)
def settling(results: Results) -> Judgement:
    """Judge the settling time of the speed, 1.7 s."""
    recording = series_of(results["ideal"])
    place = _settled(results, "ideal")
    speed = last_outside(recording.time, _motion(recording), 0.2, 0.0, JUMPS[0] - 0.005)
    nominal, printed = results["gain 1.9 from 108 m"].summary, results["gain 50 from 108 m"].summary
    measured = (
        f"gain 1.9: position within 0.1 m after {time_text(place)}, speed within 0.2 m/s after {time_text(speed)}, "
        f"force limited to {largest(recording.command) / MASS:.0f} m/s²; without limit "
        f"{time_text(nominal['settling'])} and {nominal['acceleration']:.2g} m/s². Gain 50: "
        f"{time_text(printed['settling'])}, "
        f"{printed['acceleration']:.2g} m/s²"
    )
    if place < 2.0 and speed < 2.0 and not 1.2 < printed["settling"] < 2.2:
        return Judgement(
            measured,
            FAIR,
            "1.7 s is the result of gains of 1.7 to 2, not of the printed 50; no train has the force for 108 m in "
            "1.7 s",
        )
    if 1.2 < printed["settling"] < 2.2:
        return Judgement(measured, GOOD, "the printed gain gives the printed time")
    return Judgement(measured, BAD, "the position error is too large after 2 s")


@CLAIMS.judged_by(
    "the settling time is bounded for any start, (23) + (34)",
    "fixed time",
    (key for key in CASES if key.startswith("gain ")),
)
def bound(results: Results) -> Judgement:
    """Judge the bound of the settling time."""
    keys = [key for key in CASES if key.startswith("gain ")]
    rows = [(key, results[key].summary) for key in keys]
    measured = "; ".join(
        f"{key}: {time_text(figures['settling'])} of {time_text(figures['bound'])}" for key, figures in rows
    )
    if all(figures["settling"] <= figures["bound"] for _, figures in rows):
        return Judgement(
            measured, GOOD, "seven times the distance takes the same time, with 200 times the acceleration"
        )
    return Judgement(measured, BAD, "a settling time lies beyond the bound")


@CLAIMS.judged_by("position and speed are both tracked", "robust tracking of both", ("ideal",))
def both(results: Results) -> Judgement:
    """Judge simultaneous tracking of position and speed."""
    recording = series_of(results["ideal"])
    steady = (recording.time > 3.0) & (recording.time < JUMPS[0] - 0.1)
    place = largest(position_error(recording, OFFSETS)[steady])
    speed, motion = rms(speed_error(recording)[steady]), rms(_motion(recording)[steady])
    measured = (
        f"position {written(place, 'm')}, v - v_r {written(speed, 'm/s')} rms, "
        f"v + d1 - v_r {written(motion, 'm/s')} rms"
    )
    if place < 0.1 and speed > 10 * motion:
        return Judgement(
            measured,
            FAIR,
            "v + d1 follows: since x' = v + d1, x and v cannot both follow while d1 is not 0",
        )
    if place < 0.1:
        return Judgement(measured, GOOD, "position and speed both follow")
    return Judgement(measured, BAD, "the position does not follow")


@CLAIMS.judged_by("the couplers return to 0 and stay there at the speed steps", "0 m", ("ideal",))
def couplers(results: Results) -> Judgement:
    """Judge the coupler stretch at the steps of the speed."""
    recording = series_of(results["ideal"])
    stretch = np.maximum(recording.coupler_draft_max, -recording.coupler_buff_max) / 1e3 / STIFFNESS_KN
    t = recording.time
    before = float(stretch[(t > 3.0) & (t < JUMPS[0] - 0.1)].max())
    first, second = (float(stretch[(t >= at) & (t < at + 3.0)].max()) for at in JUMPS)
    measured = (
        f"at most {written(before, 'm')} from 3 s to 10 s; {written(first, 'm')} at the step at 10 s, where d21 and "
        f"d12 jump as well, {written(second, 'm')} at 20 s"
    )
    if max(before, second) < 0.1 and first < 0.1:
        return Judgement(measured, GOOD, "the cars move together")
    if max(before, second) < 0.1:
        return Judgement(
            measured,
            FAIR,
            "the cars move together except when a disturbance jumps by 10 m/s: the couplers are loaded until the "
            "observer has settled again",
        )
    return Judgement(measured, BAD, "the couplers stay loaded")


@CLAIMS.judged_by(
    "the compared method stretches the couplers at the start", "150 m", ("ideal", "printed order"), takes_failures=True
)
def start(results: Results) -> Judgement:
    """Judge the coupler stretch of the compared method at the start, 150 m."""
    began, reversed_began = (_stretch_at_start(results[key]) for key in ("ideal", "printed order"))
    recording = series_of(results["printed order"])
    lost = float(np.abs(position_error(recording, OFFSETS)).max())
    measured = (
        f"printed order: {written(reversed_began, 'm')} in every coupler at t = 0, and with 5000 m/s² control is lost "
        f"from there ({written(lost, 'm')} off within {written(float(recording.time[-1]), 's')}); physical order: "
        f"{written(began, 'm')}"
    )
    if began < 0.01 < reversed_began and lost > 1e3:
        return Judgement(
            measured,
            FAIR,
            "positions 108 ... 428 m with car 1 in front reverse the order of the train: the 150 m follow from this "
            "under any law, and car 5 has a position error of 748 m, for which the surface demands 1e5 m/s; no track "
            "permits this order",
        )
    return Judgement(measured, BAD, "the couplers' stretch at the start is not that of the order alone")


def _stretch_at_start(result: Result) -> float:
    position = series_of(result).position[0]
    return float(np.abs(np.diff(position) + np.diff(OFFSETS)).max())


@CLAIMS.judged_by("faster than conventional laws", "by more than 5 s", ("ideal", "pd slow", "pd fast"))
def faster(results: Results) -> Judgement:
    """Judge the advantage over a conventional law, 5 s."""
    ours, slow, fast = (_settled(results, key) for key in ("ideal", "pd slow", "pd fast"))
    forces = [largest(series_of(results[key]).command) / MASS for key in ("pd slow", "pd fast")]
    measured = (
        f"within 0.1 m: fixed-time {time_text(ours)}; PD with poles at 0.8 1/s beyond {time_text(slow)} at "
        f"{forces[0]:.0f} m/s², with poles at 4 and 5 1/s {time_text(fast)} at {forces[1]:.0f} m/s²"
    )
    if slow - ours >= 5.0 and fast - ours < 5.0:
        return Judgement(
            measured,
            FAIR,
            "against a slow PD; a PD with higher gains is as fast with less than half the force. The compared method "
            "is from another paper, and its gains are not given",
        )
    if min(slow, fast) - ours >= 5.0:
        return Judgement(measured, GOOD, "no PD is nearly as fast")
    return Judgement(measured, BAD, "it is not 5 s faster than either PD")
