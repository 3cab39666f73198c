"""Judges of paper 004: what the runs say of its claims."""

from __future__ import annotations

import numpy as np

from train_ato.reproduce.claims import Judgement, Result, Results, Verdict
from train_ato.reproduce.funnel_series import off_profile
from train_ato.reproduce.gpc_cases import SAMPLINGS, WEIGHTS
from train_ato.reproduce.judges import history as series_of
from train_ato.reproduce.judges import variation
from train_ato.reproduce.tracking import largest, position_error, rms, speed_error, written

GOOD, FAIR, BAD = Verdict.REPRODUCED, Verdict.OTHER_SETTING, Verdict.NOT_REPRODUCED
MOVING = 1.0
"""Largest speed errors are taken while the reference is above this [m/s]."""
UNSTABLE = 0.05
"""A loop whose rms speed error is above this on its nominal train is not stable [m/s]."""
JUMP = 100.0
"""Time of the jump [s]."""


def place(result: Result) -> float:
    """Return the largest position error of any unit [m]."""
    return largest(position_error(series_of(result)))


def speed(result: Result) -> float:
    """Return the largest speed error of any unit while moving [m/s]."""
    history = series_of(result)
    return largest(speed_error(history)[history.reference_velocity > MOVING])


def speed_rms(result: Result) -> float:
    """Return the rms speed error over all units [m/s]."""
    return rms(speed_error(series_of(result)))


def coupler(result: Result) -> float:
    """Return the largest coupler force [kN]."""
    return float(max(result.summary["coupler_draft_max_kn"], -result.summary["coupler_buff_max_kn"]))


def _three(result: Result) -> str:
    return f"{speed(result):.3f} m/s, {1e3 * speed_rms(result):.1f} mm/s rms, {place(result):.2f} m"


def normal(results: Results) -> Judgement:
    """Judge the tracking over the whole line against PID."""
    ours, plain, preview = (results[f"{key} long"] for key in ("gpc", "pid", "pid preview"))
    measured = f"gpc {_three(ours)}; PID {_three(plain)}; PID + preview {_three(preview)}"
    if speed(ours) >= speed(plain):
        return Judgement(measured, BAD, "no better than the PID")
    if speed_rms(preview) <= 1.5 * speed_rms(ours):
        return Judgement(
            measured,
            GOOD,
            "at a sampling period of 1.2 s; most of it is the reference ahead, which a PID with preview has as well "
            "and is nearer with",
        )
    return Judgement(measured, GOOD, "at a sampling period of 1.2 s")


def sampling(results: Results) -> Judgement:
    """Judge N = 3, Nu = 2 over the sampling period."""
    errors = {period: speed_rms(results[f"Ts {period}"]) for period in SAMPLINGS}
    weights = [speed_rms(results[f"Ts 0.4 lambda {weight}"]) for weight in WEIGHTS]
    measured = ", ".join(f"{period:g} s {1e3 * error:.3g}" for period, error in errors.items())
    measured = f"mm/s rms over Ts: {measured}; at 0.4 s, any lambda from .001 to 10: at best {1e3 * min(weights):.3g}"
    if max(errors.values()) < UNSTABLE:
        return Judgement(measured, GOOD, "at any sampling period")
    if errors[1.2] < UNSTABLE and min(errors[0.2], errors[0.4], *weights) > UNSTABLE:
        return Judgement(
            measured,
            FAIR,
            "three samples must see beyond 1.2 s of delay and 0.4 s of lag: unstable or without motion at 0.4 s and "
            "below, whatever lambda; the paper does not print its period",
        )
    return Judgement(measured, BAD, "no period of those tried works")


def beyond(results: Results) -> Judgement:
    """Judge the G of the print, which takes U = 0 beyond Nu."""
    printed, held = results["gpc normal"], results["gpc held"]
    on_position = results["gpc on position"]
    measured = (
        f"position {written(place(printed), 'm')} with U = 0 beyond Nu, {written(place(held), 'm')} with U held, "
        f"{written(place(on_position), 'm')} with a gain of .02 1/s on the position"
    )
    if place(printed) < 0.2:
        return Judgement(measured, GOOD, "without an offset")
    if place(held) < place(printed):
        return Judgement(
            measured,
            FAIR,
            "weighting the command itself leaves an offset wherever a force is held; it adds up in the position",
        )
    return Judgement(measured, BAD, "the offset is elsewhere")


def jump(results: Results) -> Judgement:
    """Judge the jump of the parameters."""
    increments, without, printed, plain, preview = (
        results[f"{key} jump"] for key in ("gpc", "gpc fixed", "gpc absolute", "pid", "pid preview")
    )
    measured = (
        f"largest speed error {speed(increments):.2f} m/s identified on increments of the speed, {speed(printed):.2f} "
        f"on the speed as printed, {speed(without):.2f} without identification; PID {speed(plain):.2f}, PID + preview "
        f"{speed(preview):.2f}"
    )
    if speed(printed) < 0.5 * speed(plain):
        return Judgement(measured, GOOD, "as printed (with the sign of its error repaired)")
    if speed(increments) < 0.5 * speed(plain):
        return Judgement(
            measured,
            FAIR,
            "identified on increments; on the speed itself the projection moves the pole at 1 and the loop with it. "
            "PID + preview, which identifies nothing, is as good",
        )
    return Judgement(measured, BAD, "the jump is not held")


def settled_after(results: Results) -> Judgement:
    """Judge that the tracking goes on after the jump as before."""
    result, before = results["gpc jump"], results["gpc normal"]
    history, calm = series_of(result), series_of(before)
    later, as_before = (rms(speed_error(series)[series.time > JUMP + 60.0]) for series in (history, calm))
    still = rms(speed_error(series_of(results["gpc absolute jump"]))[history.time > JUMP + 60.0])
    measured = (
        f"from a minute after the jump {1e3 * later:.0f} mm/s rms, on the train without jump {1e3 * as_before:.0f}; "
        f"identified as printed {1e3 * still:.0f}"
    )
    if still < 2 * as_before:
        return Judgement(measured, GOOD, "the old performance, as printed")
    if later < 2 * as_before:
        return Judgement(measured, FAIR, "the old performance, identified on increments")
    if later < 0.5 * still:
        return Judgement(
            measured, FAIR, "stable on increments, but not the old performance: the delay is identified only slowly"
        )
    return Judgement(measured, BAD, "the old performance is not found again")


def network(results: Results) -> Judgement:
    """Judge the network for the unmodelled part."""
    kept, left_out, raw = (speed_rms(results[key]) for key in ("gpc normal", "no network", "raw residual"))
    measured = f"{1e3 * kept:.1f} mm/s rms with it, {1e3 * left_out:.0f} without, {1e3 * raw:.0f} with the raw residual"
    if kept < 0.5 * left_out:
        return Judgement(
            measured, GOOD, "it takes the resistance, as a slow integrator; learning at once, it destabilises"
        )
    return Judgement(measured, BAD, "it makes no difference")


def coupled(results: Results) -> Judgement:
    """Judge three independent laws on a coupled train."""
    units, free, mean = (results[key] for key in ("per unit", "per unit, free", "gpc normal"))
    measured = (
        f"three laws {speed(units):.2f} m/s, couplers {coupler(units):.0f} kN; without couplers {speed(free):.2f} m/s; "
        f"one law on the mean speed {speed(mean):.2f} m/s, {coupler(mean):.0f} kN"
    )
    if speed_rms(units) < UNSTABLE:
        return Judgement(measured, GOOD, "on coupled units as well")
    if speed_rms(free) < UNSTABLE:
        return Judgement(
            measured,
            FAIR,
            "each law takes its neighbours' pull for its own unmodelled part, and they lean on each other; sound only "
            "where no couplers are, as in the paper's equations",
        )
    return Judgement(measured, BAD, "unstable, with couplers and without")


def sturdy(results: Results) -> Judgement:
    """Judge delay, mass and noise."""
    trains = (
        ("half_more", "delay x1.5"),
        ("half_less", "x0.5"),
        ("heavy", "mass +20 %"),
        ("light", "-20 %"),
        ("noise", "noise"),
    )
    cells = [
        f"{label} {speed(results[f'gpc {key}']):.2f} ({speed(results[f'pid preview {key}']):.2f})"
        for key, label in trains
    ]
    measured = f"m/s, in brackets PID + preview: {', '.join(cells)}"
    masses = max(speed(results[f"gpc {key}"]) for key in ("heavy", "light"))
    weak = [label for key, label in trains if speed(results[f"gpc {key}"]) > 2 * speed(results["gpc normal"])]
    if not weak:
        return Judgement(measured, GOOD, "the errors do not double in any of them")
    if masses < 0.35:
        return Judgement(
            measured,
            FAIR,
            f"the mass is taken up by the network; weak: {', '.join(weak)} (half a delay too much, and noise without a "
            "T-filter)",
        )
    return Judgement(measured, BAD, "not even the mass is taken up")


def comfort(results: Results) -> Judgement:
    """Judge punctuality and comfort: stop and acceleration of the run."""
    result = results["gpc long"]
    stop = result.summary["stop_error_m"]
    acceleration = float(result.summary["acceleration_max"])
    series = series_of(result)
    wanted = float(np.abs(series.reference_acceleration).max())
    measured = (
        f"stop {'not made' if stop is None else written(float(stop), 'm')}, acceleration {acceleration:.2f} m/s² where "
        f"the profile has {wanted:.2f}, variation {variation(result):.1f} kN/s"
    )
    if stop is not None and abs(stop) < 0.5 and acceleration < wanted + 0.1:
        return Judgement(measured, GOOD, "as the profile")
    if acceleration < wanted + 0.1:
        return Judgement(
            measured,
            FAIR,
            "comfortable; for the place of the stop a gain on the position is needed, which the paper has not",
        )
    return Judgement(measured, BAD, "rougher than the profile")


def limited(results: Results) -> Judgement:
    """Judge the run with 200 kN."""
    ours, plain, preview = (place(results[f"{key} limited"]) for key in ("gpc", "pid", "pid preview"))
    history = series_of(results["pid preview planned"])
    off, _ = off_profile(history, "crh380a_gpc:short")
    measured = (
        f"gpc {written(ours, 'm')}, PID {written(plain, 'm')}, PID + preview {written(preview, 'm')}; with a profile "
        f"planned for it {written(largest(off), 'm')}"
    )
    if ours < 13.0:
        return Judgement(measured, GOOD, "it plans for the limit")
    if largest(off) < 13.0:
        return Judgement(measured, FAIR, "the law knows no limit: its profile has to")
    return Judgement(measured, BAD, "farther off than 13 m, whatever is planned")
