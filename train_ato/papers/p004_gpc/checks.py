"""Judges of the claims of paper 004."""

from __future__ import annotations

import numpy as np

from train_ato.papers.checks import BAD, FAIR, GOOD, variation
from train_ato.papers.checks import recording as series_of
from train_ato.papers.claims import Claims, Judgement, Result, Results
from train_ato.papers.p003_funnel.series import off_profile
from train_ato.papers.p004_gpc.cases import SAMPLINGS, WEIGHTS
from train_ato.papers.tracking import largest, largest_speed_error, rms, speed_error, written
from train_ato.papers.tracking import largest_position_error as unit_place

CLAIMS = Claims()
UNSTABLE = 0.05
"""Rms speed error on the nominal train from which a loop is unstable [m/s]."""
JUMP = 100.0
"""Time of the jump [s]."""


def speed_rms(result: Result) -> float:
    """Return the rms speed error over all units [m/s]."""
    return rms(speed_error(series_of(result)))


def coupler(result: Result) -> float:
    """Return the largest coupler force [kN]."""
    return float(max(result.summary["coupler_draft_max_kn"], -result.summary["coupler_buff_max_kn"]))


def _three(result: Result) -> str:
    return f"{largest_speed_error(result):.3f} m/s, {1e3 * speed_rms(result):.1f} mm/s rms, {unit_place(result):.2f} m"


@CLAIMS.judged_by(
    "more exact than PID over Jinan - Xuzhou", "better; no figures", ("gpc long", "pid long", "pid preview long")
)
def normal(results: Results) -> Judgement:
    """Judge the tracking over the whole line against PID."""
    ours, plain, preview = (results[f"{key} long"] for key in ("gpc", "pid", "pid preview"))
    measured = f"gpc {_three(ours)}; PID {_three(plain)}; PID + preview {_three(preview)}"
    if largest_speed_error(ours) >= largest_speed_error(plain):
        return Judgement(measured, BAD, "no better than the PID")
    if speed_rms(preview) <= 1.5 * speed_rms(ours):
        return Judgement(
            measured,
            GOOD,
            "at a sampling period of 1.2 s; most of the advantage is the preview of the reference, with which a PID "
            "is more accurate",
        )
    return Judgement(measured, GOOD, "at a sampling period of 1.2 s")


@CLAIMS.judged_by(
    "N = 3, Nu = 2",
    "stable",
    (*(f"Ts {period}" for period in SAMPLINGS), *(f"Ts 0.4 lambda {weight}" for weight in WEIGHTS)),
)
def sampling(results: Results) -> Judgement:
    """Judge the stability of N = 3, Nu = 2 over the sampling period."""
    errors = {period: speed_rms(results[f"Ts {period}"]) for period in SAMPLINGS}
    weights = [speed_rms(results[f"Ts 0.4 lambda {weight}"]) for weight in WEIGHTS]
    measured = ", ".join(f"{period:g} s {1e3 * error:.3g}" for period, error in errors.items())
    measured = f"mm/s rms over Ts: {measured}; at 0.4 s, any lambda from 0.001 to 10: at best {1e3 * min(weights):.3g}"
    if max(errors.values()) < UNSTABLE:
        return Judgement(measured, GOOD, "at any sampling period")
    if errors[1.2] < UNSTABLE and min(errors[0.2], errors[0.4], *weights) > UNSTABLE:
        return Judgement(
            measured,
            FAIR,
            "three samples must extend beyond 1.2 s of delay and 0.4 s of lag: unstable or without motion at 0.4 s "
            "and below, for any lambda; the paper does not give its period",
        )
    return Judgement(measured, BAD, "no period of those tried works")


@CLAIMS.judged_by("(22) leaves no steady error", "0", ("gpc normal", "gpc held", "gpc on position"))
def beyond(results: Results) -> Judgement:
    """Judge the steady error of the printed G, with U = 0 beyond Nu."""
    printed, held = results["gpc normal"], results["gpc held"]
    on_position = results["gpc on position"]
    measured = (
        f"position {written(unit_place(printed), 'm')} with U = 0 beyond Nu, "
        f"{written(unit_place(held), 'm')} with U held, "
        f"{written(unit_place(on_position), 'm')} with a gain of 0.02 1/s on the position"
    )
    if unit_place(printed) < 0.2:
        return Judgement(measured, GOOD, "without an offset")
    if unit_place(held) < unit_place(printed):
        return Judgement(
            measured,
            FAIR,
            "a weight on the command itself leaves an offset while a force is held; it accumulates in the position",
        )
    return Judgement(measured, BAD, "the offset is elsewhere")


@CLAIMS.judged_by(
    "a small jump when the parameters jump, less than PID",
    "slight",
    tuple(f"{key} jump" for key in ("gpc", "gpc fixed", "gpc absolute", "pid", "pid preview")),
)
def jump(results: Results) -> Judgement:
    """Judge the jump of the parameters."""
    increments, without, printed, plain, preview = (
        results[f"{key} jump"] for key in ("gpc", "gpc fixed", "gpc absolute", "pid", "pid preview")
    )
    measured = (
        f"largest speed error {largest_speed_error(increments):.2f} m/s identified on increments of the speed, "
        f"{largest_speed_error(printed):.2f} on the speed as printed, {largest_speed_error(without):.2f} without "
        f"identification; PID {largest_speed_error(plain):.2f}, PID + preview {largest_speed_error(preview):.2f}"
    )
    if largest_speed_error(printed) < 0.5 * largest_speed_error(plain):
        return Judgement(measured, GOOD, "as printed (with the sign of its error repaired)")
    if largest_speed_error(increments) < 0.5 * largest_speed_error(plain):
        return Judgement(
            measured,
            FAIR,
            "identified on increments; on the speed itself the projection shifts the pole at 1 and changes the loop. "
            "PID + preview is as good without identification",
        )
    return Judgement(measured, BAD, "the jump is not compensated")


@CLAIMS.judged_by(
    "after the jump the tracking is smooth again", "as before", ("gpc jump", "gpc absolute jump", "gpc normal")
)
def settled_after(results: Results) -> Judgement:
    """Judge the tracking after the jump."""
    result, before = results["gpc jump"], results["gpc normal"]
    recording, calm = series_of(result), series_of(before)
    later, as_before = (rms(speed_error(series)[series.time > JUMP + 60.0]) for series in (recording, calm))
    still = rms(speed_error(series_of(results["gpc absolute jump"]))[recording.time > JUMP + 60.0])
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
    return Judgement(measured, BAD, "the tracking does not recover")


@CLAIMS.judged_by(
    "the network takes resistance and disturbance", "estimated on line", ("gpc normal", "no network", "raw residual")
)
def network(results: Results) -> Judgement:
    """Judge the contribution of the network for the unmodelled part."""
    kept, left_out, raw = (speed_rms(results[key]) for key in ("gpc normal", "no network", "raw residual"))
    measured = f"{1e3 * kept:.1f} mm/s rms with it, {1e3 * left_out:.0f} without, {1e3 * raw:.0f} with the raw residual"
    if kept < 0.5 * left_out:
        return Judgement(
            measured,
            GOOD,
            "it compensates the resistance, as a slow integrator; with immediate learning it destabilises the loop",
        )
    return Judgement(measured, BAD, "it makes no difference")


@CLAIMS.judged_by(
    "multivariable: one law for each of the three units", "stable", ("per unit", "per unit, free", "gpc normal")
)
def coupled(results: Results) -> Judgement:
    """Judge three independent laws on a coupled train."""
    units, free, mean = (results[key] for key in ("per unit", "per unit, free", "gpc normal"))
    measured = (
        f"three laws {largest_speed_error(units):.2f} m/s, couplers {coupler(units):.0f} kN; without couplers "
        f"{largest_speed_error(free):.2f} m/s; one law on the mean speed "
        f"{largest_speed_error(mean):.2f} m/s, {coupler(mean):.0f} kN"
    )
    if speed_rms(units) < UNSTABLE:
        return Judgement(measured, GOOD, "on coupled units as well")
    if speed_rms(free) < UNSTABLE:
        return Judgement(
            measured,
            FAIR,
            "each law estimates the coupler forces of its neighbours as its own unmodelled part, and the laws act "
            "against each other; stable only without couplers, as in the equations of the paper",
        )
    return Judgement(measured, BAD, "unstable, with couplers and without")


@CLAIMS.judged_by(
    "robust",
    "robust",
    tuple(
        f"{key} {train}"
        for key in ("gpc", "pid preview")
        for train in ("normal", "half_more", "half_less", "heavy", "light", "noise")
    ),
)
def sturdy(results: Results) -> Judgement:
    """Judge the robustness to delay, mass and noise."""
    trains = (
        ("half_more", "delay x1.5"),
        ("half_less", "x0.5"),
        ("heavy", "mass +20 %"),
        ("light", "-20 %"),
        ("noise", "noise"),
    )
    cells = [
        f"{label} {largest_speed_error(results[f'gpc {key}']):.2f} "
        f"({largest_speed_error(results[f'pid preview {key}']):.2f})"
        for key, label in trains
    ]
    measured = f"m/s, in brackets PID + preview: {', '.join(cells)}"
    masses = max(largest_speed_error(results[f"gpc {key}"]) for key in ("heavy", "light"))
    weak = [
        label
        for key, label in trains
        if largest_speed_error(results[f"gpc {key}"]) > 2 * largest_speed_error(results["gpc normal"])
    ]
    if not weak:
        return Judgement(measured, GOOD, "the errors do not double in any of them")
    if masses < 0.35:
        return Judgement(
            measured,
            FAIR,
            f"the network compensates the mass; weak: {', '.join(weak)} (half a delay too much, and noise without a "
            "T-filter)",
        )
    return Judgement(measured, BAD, "not even the mass is compensated")


@CLAIMS.judged_by("punctual, safe and comfortable", "met", ("gpc long",))
def comfort(results: Results) -> Judgement:
    """Judge punctuality and comfort: stop and acceleration of the run."""
    result = results["gpc long"]
    stop = result.summary["stop_error_m"]
    acceleration = float(result.summary["acceleration_max"])
    series = series_of(result)
    wanted = float(np.abs(series.reference_acceleration).max())
    measured = (
        f"stop {'not reached' if stop is None else written(float(stop), 'm')}, acceleration {acceleration:.2f} m/s² "
        f"(profile {wanted:.2f}), variation {variation(result):.1f} kN/s"
    )
    if stop is not None and abs(stop) < 0.5 and acceleration < wanted + 0.1:
        return Judgement(measured, GOOD, "as the profile")
    if acceleration < wanted + 0.1:
        return Judgement(
            measured,
            FAIR,
            "comfortable; an exact stop needs a gain on the position, which is not in the paper",
        )
    return Judgement(measured, BAD, "rougher than the profile")


@CLAIMS.judged_by(
    "with 200 kN for the train",
    "43 m as printed; 11 m with a long look ahead (independent)",
    ("gpc limited", "pid limited", "pid preview limited", "pid preview planned"),
)
def limited(results: Results) -> Judgement:
    """Judge the run with 200 kN."""
    ours, plain, preview = (unit_place(results[f"{key} limited"]) for key in ("gpc", "pid", "pid preview"))
    recording = series_of(results["pid preview planned"])
    off, _ = off_profile(recording, "crh380a_gpc:short")
    measured = (
        f"gpc {written(ours, 'm')}, PID {written(plain, 'm')}, PID + preview {written(preview, 'm')}; with a profile "
        f"planned for it {written(largest(off), 'm')}"
    )
    if ours < 13.0:
        return Judgement(measured, GOOD, "the law plans for the limit")
    if largest(off) < 13.0:
        return Judgement(measured, FAIR, "the law has no force limit, so the profile must include it")
    return Judgement(measured, BAD, "more than 13 m off with any profile")
