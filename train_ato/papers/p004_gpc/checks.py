"""Judges of the claims of paper 004."""

import math
from typing import Any

import numpy as np

from train_ato.judge.recording import Recording
from train_ato.papers import claims as c
from train_ato.papers.claims import largest_position_error as unit_place
from train_ato.papers.claims import recording as series_of
from train_ato.papers.p003_funnel.checks import off_profile

SAMPLINGS = (0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.6)
"""Sampling periods of the law [s]."""
WEIGHTS = (0.001, 0.01, 1.0, 10.0)
"""Values of lambda at 0.4 s, beside 0.1 [s²]."""
JUMP = 100.0
"""Time of the jump of the variant `jump` [s]."""
SHORT = "crh380a_gpc:short"
LAWS, TRAINS, SINGLE, PRINTED_FORMS = c.read_paper_runs(__package__)


def _gpc(**parameters: Any) -> c.Case:
    return c.Case(SHORT, {**LAWS["gpc"][1], "laws": {"gpc": parameters}})


CASES = (
    SINGLE
    | {
        f"{key} {train}": c.Case(f"{SHORT}{variants}", changes)
        for key, (_, changes) in LAWS.items()
        for train, (_, variants) in TRAINS.items()
    }
    | {f"Ts {sampling}": _gpc(sampling=sampling) for sampling in SAMPLINGS}
    | {f"Ts {sampling} held": _gpc(sampling=sampling, beyond_horizon="hold") for sampling in SAMPLINGS}
    | {f"Ts 0.4 lambda {weight}": _gpc(sampling=0.4, command_weight=weight) for weight in WEIGHTS}
)
"""Runs of the CRH380A as three power units for paper 004: 286 km for the figures of the paper, else short."""
CLAIMS = c.Claims()
WHERE_MOVING = f"largest speed errors only where v_ref > {c.MOVING:g} m/s"
STABLE_RMS = 0.05
"""Rms speed error on the nominal train from which a loop is not stable [m/s]."""
CONVENTION = "convention for a stable loop"
MORE_EXACT = c.ratio("largest speed error over PID", c.BETTER, "paper: better")
MORE_EXACT_RMS = c.ratio("rms over PID", c.BETTER, "paper: better")
EVERY_PERIOD = c.Bound("largest rms over the sampling periods", STABLE_RMS, "m/s", CONVENTION)
SOME_PERIOD = c.Bound("smallest rms over the sampling periods", STABLE_RMS, "m/s", CONVENTION)
NO_OFFSET = c.Bound("position error, printed", 0.2, "m", c.GOAL)
NO_OFFSET_REPAIRED = c.Bound("position error, U held or gain on the position", 0.2, "m", c.GOAL)
ESTIMATES = c.ratio("rms with over without the network", c.MUCH_BETTER, "paper: compensates")
COUPLED = c.Bound("rms of three laws, with couplers", STABLE_RMS, "m/s", CONVENTION)
FREE = c.Bound("rms of three laws, without couplers", STABLE_RMS, "m/s", CONVENTION)
PUNCTUAL = c.Bound("stop error", 0.5, "m", "usual stopping accuracy of main lines")
PUNCTUAL_REPAIRED = c.Bound("stop error, gain on the position", 0.5, "m", "usual stopping accuracy of main lines")
JERK = c.Bound("jerk over 1 s", 0.75, "m/s³", "usual jerk in service")
JERK_REPAIRED = c.Bound("jerk over 1 s, gain on the position", 0.75, "m/s³", "usual jerk in service")
EFFICIENT = c.ratio(
    "energy of traction over PID + preview", 1.0 + c.UNCHANGED, "efficient: that of the profile, unchanged"
)
ON_PROFILE = c.Bound("largest speed error", 0.4, "m/s", "goal of this project at any delay")
WITHIN_12 = c.Bound("position error at 200 kN", 12.0, "m", c.GOAL)
WITHIN_12_PLANNED = c.Bound("the same, gpc on a profile for 200 kN", 12.0, "m", c.GOAL)
AS_INDEPENDENT = c.about("position error at 200 kN, not planned", 43.0, "m", "independent", c.TENTH)


def speed_rms(result: c.Result) -> float:
    """Return the rms speed error over all units [m/s]."""
    return c.rms(c.speed_error(series_of(result)))


def coupler(result: c.Result) -> float:
    """Return the largest coupler force [kN]."""
    return float(max(result.summary["coupler_draft_max_kn"], -result.summary["coupler_buff_max_kn"]))


def _three(result: c.Result) -> str:
    return (
        f"{c.largest_speed_error(result):.3f} m/s, {1e3 * speed_rms(result):.1f} mm/s rms, {unit_place(result):.2f} m"
    )


@CLAIMS.judged_by(
    "more exact than PID over Jinan - Xuzhou",
    "better; no figures",
    ("gpc long", "pid long", "pid preview long", "pid clamped long"),
)
def normal(results: c.Results) -> c.Judgement:
    """Judge the tracking over the whole line against PID."""
    ours, plain, preview, clamped = (results[f"{key} long"] for key in ("gpc", "pid", "pid preview", "pid clamped"))
    measured = (
        f"gpc {_three(ours)}; PID {_three(plain)} (integral clamped to 20 m: {_three(clamped)}); PID + preview "
        f"{_three(preview)}; {WHERE_MOVING}"
    )
    checks = [
        MORE_EXACT.check(c.largest_speed_error(ours) / c.largest_speed_error(plain)),
        MORE_EXACT_RMS.check(speed_rms(ours) / speed_rms(plain)),
    ]
    return c.conclude(
        measured,
        checks,
        "at a sampling period of 1.2 s, against a PID without feed-forward, whose gains the paper does not give; a PID "
        f"with preview of the reference has {speed_rms(preview) / speed_rms(ours):.2f} of the rms of gpc",
        otherwise="no better than the PID",
    )


@CLAIMS.judged_by(
    "N = 3, Nu = 2",
    "stable",
    (*(f"Ts {period}" for period in SAMPLINGS), *(f"Ts 0.4 lambda {weight}" for weight in WEIGHTS)),
    c.THREE,
)
def sampling(results: c.Results) -> c.Judgement:
    """Judge the stability of N = 3, Nu = 2 over the sampling period."""
    errors = {period: speed_rms(results[f"Ts {period}"]) for period in SAMPLINGS}
    weights = [speed_rms(results[f"Ts 0.4 lambda {weight}"]) for weight in WEIGHTS]
    measured = ", ".join(f"{period:g} s {1e3 * error:.3g}" for period, error in errors.items())
    measured = f"mm/s rms over Ts: {measured}; at 0.4 s, any lambda from 0.001 to 10: at best {1e3 * min(weights):.3g}"
    works = ", ".join(f"{period:g}" for period, error in errors.items() if error <= STABLE_RMS)
    return c.conclude(
        measured,
        [EVERY_PERIOD.check(c.worst(errors.values()))],
        "at any sampling period",
        elsewhere=[SOME_PERIOD.check(min(filter(math.isfinite, errors.values()), default=math.nan))],
        changed=f"only at {works} s: three samples must extend beyond 1.2 s of delay and 0.4 s of lag; the paper does "
        "not give its period",
        otherwise="no period of those tried works",
    )


@CLAIMS.judged_by("(22) leaves no steady error", "0", ("gpc normal", "gpc held", "gpc on position"), c.THREE)
def beyond(results: c.Results) -> c.Judgement:
    """Judge the steady error of the printed G, with U = 0 beyond Nu."""
    printed, held, on_position = (unit_place(results[key]) for key in ("gpc normal", "gpc held", "gpc on position"))
    measured = (
        f"position {c.written(printed, 'm')} with U = 0 beyond Nu, {c.written(held, 'm')} with U held, "
        f"{c.written(on_position, 'm')} with a gain of 0.02 1/s on the position"
    )
    return c.conclude(
        measured,
        [NO_OFFSET.check(printed)],
        "without an offset",
        elsewhere=[NO_OFFSET_REPAIRED.check(c.least((held, on_position)))],
        changed="with U held or with a gain on the position, which is not in the paper",
        otherwise="a weight on the command itself leaves an offset of the speed while a force is held; it accumulates "
        "in the position, less with U held and with a gain on the position, but beyond the goal",
    )


@CLAIMS.judged_by(
    "the network takes resistance and disturbance", "estimated on line", ("gpc normal", "no network", "raw residual")
)
def network(results: c.Results) -> c.Judgement:
    """Judge the contribution of the network for the unmodelled part."""
    kept, left_out, raw = (speed_rms(results[key]) for key in ("gpc normal", "no network", "raw residual"))
    return c.conclude(
        f"{1e3 * kept:.1f} mm/s rms with it, {1e3 * left_out:.0f} without, {1e3 * raw:.0f} with the raw residual",
        [ESTIMATES.check(kept / left_out)],
        "it compensates the resistance, as a slow integrator; with immediate learning the rms is "
        f"{raw / kept:.0f} times as large",
        otherwise="less than half of the error is due to what it estimates",
    )


@CLAIMS.judged_by(
    "multivariable: one law for each of the three units",
    "stable",
    ("per unit", "per unit, free", "gpc normal"),
    c.THREE,
)
def coupled(results: c.Results) -> c.Judgement:
    """Judge three independent laws on a coupled train."""
    units, free, mean = (results[key] for key in ("per unit", "per unit, free", "gpc normal"))
    measured = (
        f"three laws {c.largest_speed_error(units):.2f} m/s, couplers {coupler(units):.0f} kN; without couplers "
        f"{c.largest_speed_error(free):.2f} m/s; one law on the mean speed "
        f"{c.largest_speed_error(mean):.2f} m/s, {coupler(mean):.0f} kN"
    )
    return c.conclude(
        f"{measured} ({WHERE_MOVING})",
        [COUPLED.check(speed_rms(units))],
        "on coupled units as well",
        elsewhere=[FREE.check(speed_rms(free))],
        changed="each law estimates the coupler forces of its neighbours as its own unmodelled part, and the laws act "
        "against each other; stable only without couplers, as in the equations of the paper",
        otherwise="not stable, with couplers and without",
    )


@CLAIMS.judged_by("punctual, safe and comfortable", "met", ("gpc long", "gpc on position"), c.THREE)
def comfort(results: c.Results) -> c.Judgement:
    """Judge stop and jerk of the run."""
    stops, jerks = {}, {}
    for key in ("gpc long", "gpc on position"):
        stop = results[key].summary["stop_error_m"]
        stops[key] = np.nan if stop is None else abs(float(stop))
        jerks[key] = float(results[key].summary["jerk_1s_max"])
    result = results["gpc long"]
    measured = (
        f"stop {c.written(stops['gpc long'], 'm')} off, jerk over 1 s {jerks['gpc long']:.2f} m/s³, acceleration "
        f"{float(result.summary['acceleration_max']):.2f} m/s², variation {c.variation(result):.1f} kN/s; with a gain "
        f"on the position (36 km) {c.written(stops['gpc on position'], 'm')}, {jerks['gpc on position']:.2f} m/s³"
    )
    return c.conclude(
        measured,
        [PUNCTUAL.check(stops["gpc long"]), JERK.check(jerks["gpc long"])],
        "stop and jerk within the usual values",
        elsewhere=[PUNCTUAL_REPAIRED.check(stops["gpc on position"]), JERK_REPAIRED.check(jerks["gpc on position"])],
        changed="the stop needs a gain on the position, which is not in the paper",
        otherwise="beyond the usual stop error or jerk, with a gain on the position as well",
    )


@CLAIMS.judged_by("efficient", "met; no figures", ("gpc long", "pid preview long"))
def efficiency(results: c.Results) -> c.Judgement:
    """Judge the energy of the run against that of PID with preview, which keeps the profile best."""
    ours, preview = (float(results[f"{key} long"].summary["energy_traction_kwh"]) for key in ("gpc", "pid preview"))
    return c.conclude(
        f"{ours:.0f} kWh of traction, PID + preview {preview:.0f} kWh on the same profile",
        [EFFICIENT.check(ours / preview), ON_PROFILE.check(c.largest_speed_error(results["gpc long"]))],
        "the paper names no measure; here the law adds no energy to that of the profile, which it does not choose",
        otherwise="the law takes more energy than the profile needs, or leaves the profile",
    )


@CLAIMS.judged_by(
    "goal with 200 kN for the train",
    "12 m (goal); 43 m as printed (independent)",
    ("gpc limited", "gpc planned", "pid limited", "pid preview limited", "pid preview planned"),
    c.THREE,
)
def limited(results: c.Results) -> c.Judgement:
    """Judge the run with 200 kN, on the profile for 225.7 kN and on one planned for 200 kN."""
    ours, plain, preview = (unit_place(results[f"{key} limited"]) for key in ("gpc", "pid", "pid preview"))
    ahead, other = (
        c.largest(off_profile(series_of(results[f"{key} planned"]), "crh380a_gpc:short")[0])
        for key in ("gpc", "pid preview")
    )
    measured = (
        f"gpc {c.written(ours, 'm')}, PID {c.written(plain, 'm')}, PID + preview {c.written(preview, 'm')}; on a "
        f"profile planned for it gpc {c.written(ahead, 'm')}, PID + preview {c.written(other, 'm')}"
    )
    return c.conclude(
        measured,
        [WITHIN_12.check(ours)],
        "the law plans for the limit",
        elsewhere=[WITHIN_12_PLANNED.check(ahead), *(bound.check(ours) for bound in AS_INDEPENDENT)],
        changed="only on a profile planned for the limit, since the law has no force limit; else as far off as the "
        "independent implementation",
        otherwise="beyond 12 m with any profile, or farther off than the independent implementation without a plan",
    )


STEADY = 1e-3
"""Reference acceleration of a constant speed [m/s²]."""
WINDOW = 10.0
"""Length of the mean from which the oscillation is counted [s]."""


def command_oscillation(recording: Recording, begin: float) -> tuple[float, float, float]:
    """Return amplitude [kN], period [s] and variation [kN/s] of the command of the train at constant speed.

    The longest interval of constant speed after a time is evaluated. The values are half of the range of the command,
    the crossings of its mean over 10 s, and the sum of its changes over the time.

    Raises
    ------
    ValueError
        If no interval of constant speed is longer than the window.
    """
    time, force = recording.time, recording.command.sum(axis=1) / 1e3
    steady = np.flatnonzero((time > begin) & (np.abs(recording.reference_acceleration) < STEADY))
    part = max(np.split(steady, np.flatnonzero(np.diff(steady) > 1) + 1), key=len)
    count = round(WINDOW / (time[1] - time[0]))
    if part.size <= count:
        raise ValueError(f"no constant speed for {WINDOW:g} s after {begin:g} s")
    t, u = time[part], force[part]
    off = u[count // 2 : u.size - (count - 1) // 2] - np.convolve(u, np.ones(count) / count, "valid")
    crossings = np.count_nonzero(np.diff(off > 0.0))
    length = float(t[-1] - t[0])
    period = 2.0 * (off.size - 1) * length / (t.size - 1) / crossings if crossings else np.nan
    return 0.5 * float(np.ptp(u)), period, float(np.abs(np.diff(u)).sum()) / length


LATER = JUMP + 60.0
"""Begin of the evaluation after the jump [s]."""
SMALL_JUMP = c.ratio("largest speed error over PID, as printed", c.MUCH_BETTER, "paper: slight against large")
SMALL_JUMP_INCREMENTS = c.ratio("the same, on increments", c.MUCH_BETTER, "paper: slight against large")
AS_BEFORE = c.ratio("rms over that without jump, as printed", c.ROBUST, "paper: good performance kept, at most doubled")
AS_BEFORE_INCREMENTS = c.ratio("the same, on increments", c.ROBUST, "paper: good performance kept, at most doubled")
NOMINAL = c.Bound("nominal speed error", 0.4, "m/s", "goal of this project at any delay")
CALM = c.Bound("rms without jump", STABLE_RMS, "m/s", CONVENTION)
STURDY = c.ratio("largest speed error over the nominal one", c.ROBUST, "robust: at most doubled")


@CLAIMS.judged_by(
    "a small jump when the parameters jump, less than PID",
    "slight",
    tuple(f"{key} jump" for key in ("gpc", "gpc fixed", "gpc absolute", "pid", "pid preview")),
    c.THREE,
)
def jump(results: c.Results) -> c.Judgement:
    """Judge the jump of the parameters."""
    increments, without, printed, plain, preview = (
        c.largest_speed_error(results[f"{key} jump"])
        for key in ("gpc", "gpc fixed", "gpc absolute", "pid", "pid preview")
    )
    measured = (
        f"largest speed error {increments:.2f} m/s identified on increments of the speed, {printed:.2f} on the speed "
        f"as printed, {without:.2f} without identification; PID {plain:.2f}, PID + preview {preview:.2f} "
        f"({WHERE_MOVING})"
    )
    return c.conclude(
        measured,
        [SMALL_JUMP.check(printed / plain)],
        "as printed (with the sign of its error repaired)",
        elsewhere=[SMALL_JUMP_INCREMENTS.check(increments / plain)],
        changed="only identified on increments; on the speed itself the projection shifts the pole at 1 and changes "
        f"the loop. PID + preview has {preview / increments:.2f} of the error of gpc without identification",
        otherwise="the jump is not compensated",
    )


@CLAIMS.judged_by(
    "after the jump the tracking is smooth again", "as before", ("gpc jump", "gpc absolute jump", "gpc normal"), c.THREE
)
def settled_after(results: c.Results) -> c.Judgement:
    """Judge the tracking after the jump."""
    later, still, as_before = (
        c.rms(c.speed_error(series)[series.time > LATER])
        for series in (series_of(results[key]) for key in ("gpc jump", "gpc absolute jump", "gpc normal"))
    )
    amplitude, period, changes = command_oscillation(series_of(results["gpc jump"]), LATER)
    measured = (
        f"from a minute after the jump {1e3 * later:.0f} mm/s rms, on the train without jump {1e3 * as_before:.0f}; "
        f"identified as printed {1e3 * still:.0f}"
    )
    return c.conclude(
        measured,
        [AS_BEFORE.check(still / as_before), CALM.check(as_before)],
        "the old performance, as printed",
        elsewhere=[AS_BEFORE_INCREMENTS.check(later / as_before), CALM.check(as_before)],
        changed="the old performance, only identified on increments",
        otherwise=f"identified on increments a limit cycle remains: at constant speed the command oscillates by "
        f"{amplitude:.0f} kN with a period of {period:.1f} s, {changes:.0f} kN/s; the delay is identified only slowly",
    )


STURDY_TRAINS = (
    ("half_more", "delay x1.5"), ("half_less", "x0.5"), ("heavy", "mass +20 %"), ("light", "-20 %"),
    ("noise", "noise"),
)  # fmt: skip
"""Trains of the robustness and their labels."""


@CLAIMS.judged_by(
    "robust",
    "robust",
    (
        f"{key} {train}"
        for key in ("gpc", "pid preview")
        for train in ("normal", *(train for train, _ in STURDY_TRAINS))
    ),
)
def sturdy(results: c.Results) -> c.Judgement:
    """Judge the robustness to delay, mass and noise: at most twice the nominal error."""
    errors = {label: c.largest_speed_error(results[f"gpc {key}"]) for key, label in STURDY_TRAINS}
    others = {label: c.largest_speed_error(results[f"pid preview {key}"]) for key, label in STURDY_TRAINS}
    cells = ", ".join(f"{label} {error:.2f} ({others[label]:.2f})" for label, error in errors.items())
    nominal = c.largest_speed_error(results["gpc normal"])
    shares = {label: error / nominal for label, error in errors.items()}
    weak = [f"{label} ({share:.1f} times)" for label, share in shares.items() if not STURDY.check(share).holds]
    return c.conclude(
        f"nominal {nominal:.2f} m/s; in brackets PID + preview: {cells}; {WHERE_MOVING}",
        [STURDY.check(c.worst(shares.values())), NOMINAL.check(nominal)],
        "the errors do not double in any of them",
        otherwise=f"more than twice the nominal error: {', '.join(weak) or 'none'} (the loop has no T-filter)",
    )
