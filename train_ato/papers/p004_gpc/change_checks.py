"""Judges of paper 004 on changes of the train: jump, mismatch, noise."""

from __future__ import annotations

import numpy as np

from train_ato.loop.recording import Recording
from train_ato.papers.bounds import MUCH_BETTER, ROBUST, Bound, ratio, worst
from train_ato.papers.checks import conclude
from train_ato.papers.checks import recording as series_of
from train_ato.papers.claims import THREE, Claims, Judgement, Results
from train_ato.papers.p004_gpc.cases import JUMP
from train_ato.papers.p004_gpc.checks import CONVENTION, STABLE_RMS, WHERE_MOVING
from train_ato.papers.tracking import largest_speed_error, rms, speed_error

STEADY = 1e-3
"""Reference acceleration of a constant speed [m/s²]."""
WINDOW = 10.0
"""Length of the mean from which the oscillation is counted [s]."""


def command_oscillation(recording: Recording, begin: float) -> tuple[float, float, float]:
    """Return amplitude [kN], period [s] and variation [kN/s] of the command of the train at constant speed.

    The longest interval of constant speed after a time is evaluated: half of the range of the command, crossings of
    its mean over 10 s, and sum of its changes over the time.

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


CLAIMS = Claims()
LATER = JUMP + 60.0
"""Begin of the evaluation after the jump [s]."""
SMALL_JUMP = ratio("largest speed error over PID, as printed", MUCH_BETTER, "paper: slight against large")
SMALL_JUMP_INCREMENTS = ratio("the same, on increments", MUCH_BETTER, "paper: slight against large")
AS_BEFORE = ratio("rms over that without jump, as printed", ROBUST, "paper: good performance kept, at most doubled")
AS_BEFORE_INCREMENTS = ratio("the same, on increments", ROBUST, "paper: good performance kept, at most doubled")
NOMINAL = Bound("nominal speed error", 0.4, "m/s", "goal of this project at any delay")
CALM = Bound("rms without jump", STABLE_RMS, "m/s", CONVENTION)
STURDY = ratio("largest speed error over the nominal one", ROBUST, "robust: at most doubled")


@CLAIMS.judged_by(
    "a small jump when the parameters jump, less than PID",
    "slight",
    tuple(f"{key} jump" for key in ("gpc", "gpc fixed", "gpc absolute", "pid", "pid preview")),
    THREE,
)
def jump(results: Results) -> Judgement:
    """Judge the jump of the parameters."""
    increments, without, printed, plain, preview = (
        largest_speed_error(results[f"{key} jump"])
        for key in ("gpc", "gpc fixed", "gpc absolute", "pid", "pid preview")
    )
    measured = (
        f"largest speed error {increments:.2f} m/s identified on increments of the speed, {printed:.2f} on the speed "
        f"as printed, {without:.2f} without identification; PID {plain:.2f}, PID + preview {preview:.2f} "
        f"({WHERE_MOVING})"
    )
    return conclude(
        measured,
        [SMALL_JUMP.check(printed / plain)],
        "as printed (with the sign of its error repaired)",
        elsewhere=[SMALL_JUMP_INCREMENTS.check(increments / plain)],
        changed="only identified on increments; on the speed itself the projection shifts the pole at 1 and changes "
        f"the loop. PID + preview has {preview / increments:.2f} of the error of gpc without identification",
        otherwise="the jump is not compensated",
    )


@CLAIMS.judged_by(
    "after the jump the tracking is smooth again", "as before", ("gpc jump", "gpc absolute jump", "gpc normal"), THREE
)
def settled_after(results: Results) -> Judgement:
    """Judge the tracking after the jump."""
    later, still, as_before = (
        rms(speed_error(series)[series.time > LATER])
        for series in (series_of(results[key]) for key in ("gpc jump", "gpc absolute jump", "gpc normal"))
    )
    amplitude, period, changes = command_oscillation(series_of(results["gpc jump"]), LATER)
    measured = (
        f"from a minute after the jump {1e3 * later:.0f} mm/s rms, on the train without jump {1e3 * as_before:.0f}; "
        f"identified as printed {1e3 * still:.0f}"
    )
    return conclude(
        measured,
        [AS_BEFORE.check(still / as_before), CALM.check(as_before)],
        "the old performance, as printed",
        elsewhere=[AS_BEFORE_INCREMENTS.check(later / as_before), CALM.check(as_before)],
        changed="the old performance, only identified on increments",
        otherwise=f"identified on increments a limit cycle remains: at constant speed the command oscillates by "
        f"{amplitude:.0f} kN with a period of {period:.1f} s, {changes:.0f} kN/s; the delay is identified only slowly",
    )


TRAINS = (
    ("half_more", "delay x1.5"),
    ("half_less", "x0.5"),
    ("heavy", "mass +20 %"),
    ("light", "-20 %"),
    ("noise", "noise"),
)
"""Trains of the robustness and their labels."""


@CLAIMS.judged_by(
    "robust",
    "robust",
    (f"{key} {train}" for key in ("gpc", "pid preview") for train in ("normal", *(train for train, _ in TRAINS))),
)
def sturdy(results: Results) -> Judgement:
    """Judge the robustness to delay, mass and noise: at most twice the nominal error."""
    errors = {label: largest_speed_error(results[f"gpc {key}"]) for key, label in TRAINS}
    others = {label: largest_speed_error(results[f"pid preview {key}"]) for key, label in TRAINS}
    cells = ", ".join(f"{label} {error:.2f} ({others[label]:.2f})" for label, error in errors.items())
    nominal = largest_speed_error(results["gpc normal"])
    shares = {label: error / nominal for label, error in errors.items()}
    weak = [f"{label} ({share:.1f} times)" for label, share in shares.items() if not STURDY.check(share).holds]
    return conclude(
        f"nominal {nominal:.2f} m/s; in brackets PID + preview: {cells}; {WHERE_MOVING}",
        [STURDY.check(worst(shares.values())), NOMINAL.check(nominal)],
        "the errors do not double in any of them",
        otherwise=f"more than twice the nominal error: {', '.join(weak) or 'none'} (the loop has no T-filter)",
    )
