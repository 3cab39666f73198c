"""Judges of paper 001: accuracy, chattering, disturbance, delay compensation, the networks, and the goals."""

from __future__ import annotations

import numpy as np

from train_ato.papers.bounds import MUCH_BETTER, ROBUST, Bound, Check, ratio
from train_ato.papers.checks import conclude, largest_kmh, recording, rms_kmh, variation
from train_ato.papers.claims import THREE, Claims, Judgement, Result, Results
from train_ato.papers.p001_metro.cases import INERTIA

CLAIMS = Claims()
CORRECTED = "only with the corrected network (objective s²/2, input s, clipped); as printed it drifts"
LITERAL_SETTINGS = ("ideal literal", "literal nominal")
"""Runs of the network as printed: ideal actuator; lag and delay."""
PRECISE = ratio("rms as printed over PID", MUCH_BETTER, "paper: significantly")
PRECISE_RBF = ratio("rms corrected over PID", MUCH_BETTER, "paper: significantly")
OVERSHOOT = ratio("overshoot as printed over PID", MUCH_BETTER, "paper: clearly improved")
OVERSHOOT_RBF = ratio("overshoot corrected over PID", MUCH_BETTER, "paper: clearly improved")
REJECTS = ratio("rms disturbed as printed over PID, ideal", MUCH_BETTER, "paper: significantly")
REJECTS_RBF = ratio("rms disturbed corrected over PID, lag and delay", MUCH_BETTER, "paper: significantly")
UNSTEADY, UNSTEADY_IDEAL = (
    Bound(f"rms of PID disturbed over undisturbed, {actuator}", ROBUST, "", "paper: not robust", least=True)
    for actuator in ("lag and delay", "ideal")
)
"""A loop that loses its stability exceeds them as well."""
COMPENSATED = ratio("rms with Padé over none", MUCH_BETTER, "paper: compensated")
USABLE = Bound("rms with lag and delay", 0.05, "m/s", "goal of this project at any delay")
USABLE_IDEAL = Bound("rms with an ideal actuator", 0.05, "m/s", "goal of this project at any delay")


def rms_ms(result: Result) -> float:
    """Return the rms speed error [m/s]."""
    return rms_kmh(result) / 3.6


def largest_ms(result: Result) -> float:
    """Return the largest speed error [m/s]."""
    return largest_kmh(result) / 3.6


def shaking(result: Result) -> float:
    """Return the variation of the command per inertial mass [m/s² per s]."""
    return variation(result) * 1e3 / INERTIA


def pair(result: Result) -> str:
    """Return rms and largest speed error as text [m/s]."""
    return f"{rms_ms(result):.4f} / {largest_ms(result):.3f}"


def rms_check(bound: Bound, result: Result, other: Result) -> Check:
    """Return the check of the ratio of two rms errors."""
    return bound.check(rms_kmh(result) / rms_kmh(other))


@CLAIMS.judged_by(
    "tracks the recommended speed more accurately than PID",
    "figures 4-7",
    (
        *("ideal pid", "ideal pid_known", "ideal rbf", "pid nominal", "pid_preview nominal", "rbf nominal"),
        *LITERAL_SETTINGS,
    ),
    THREE,
)
def accuracy(results: Results) -> Judgement:
    """Judge the tracking against PID, ideal and with lag and delay."""
    pid, known, rbf, literal = (results[f"ideal {key}"] for key in ("pid", "pid_known", "rbf", "literal"))
    slow_pid, slow_rbf, slow_literal = (results[f"{key} nominal"] for key in ("pid", "rbf", "literal"))
    text = (
        f"ideal: PID {pair(pid)}, RBF {pair(rbf)}, as printed {pair(literal)}; with lag and delay {pair(slow_pid)}, "
        f"{pair(slow_rbf)}, {pair(slow_literal)} m/s"
    )
    reason = (
        f"{CORRECTED}. Against the paper's PID, which has no feed-forward; a PID with the same feed-forward has "
        f"{pair(known)} (ideal) and {pair(results['pid_preview nominal'])} (lag, delay): the advantage is that of the "
        "equivalent control"
    )
    return conclude(
        text,
        [rms_check(PRECISE, literal, pid), rms_check(PRECISE, slow_literal, slow_pid)],
        "as printed",
        elsewhere=[rms_check(PRECISE_RBF, rbf, pid), rms_check(PRECISE_RBF, slow_rbf, slow_pid)],
        changed=reason,
        otherwise="not half of the error of PID",
    )


@CLAIMS.judged_by(
    "overshoot clearly improved where the regime changes",
    "figures 4-7",
    ("ideal pid", "ideal rbf", "pid nominal", "rbf nominal", *LITERAL_SETTINGS),
    THREE,
)
def overshoot(results: Results) -> Judgement:
    """Judge the overshoot at changes of the driving regime, ideal and with lag and delay."""
    pid, rbf, literal = (_overshoot(results[f"{key} nominal"]) for key in ("pid", "rbf", "literal"))
    ideal = [_overshoot(results[f"ideal {key}"]) for key in ("pid", "rbf", "literal")]
    text = (
        f"ideal {ideal[0]:.3f} -> {ideal[1]:.4f}, as printed {ideal[2]:.3g}; with lag and delay {pid:.3f} -> "
        f"{rbf:.4f}, as printed {literal:.3g} m/s"
    )
    return conclude(
        text,
        [OVERSHOOT.check(ideal[2] / ideal[0]), OVERSHOOT.check(literal / pid)],
        "largest v - v_d in the 10 s after an acceleration or a braking ends",
        elsewhere=[OVERSHOOT_RBF.check(ideal[1] / ideal[0]), OVERSHOOT_RBF.check(rbf / pid)],
        changed=f"{CORRECTED}; largest v - v_d in the 10 s after an acceleration or a braking ends",
    )


def _overshoot(result: Result) -> float:
    """Return the largest error beyond the cruising speed in the 10 s after it is reached [m/s]."""
    run = recording(result)
    accelerating = np.sign(np.round(run.reference_acceleration, 6))
    ends = np.flatnonzero((accelerating[:-1] != 0) & (accelerating[1:] == 0) & (run.reference_velocity[1:] > 1.0))
    span = round(10.0 / (run.time[1] - run.time[0]))
    error = run.front_velocity - run.reference_velocity
    return max(float((accelerating[end] * error[end : end + span]).max()) for end in ends)


@CLAIMS.judged_by(
    "rejects disturbances better than PID",
    "significantly",
    (
        *("ideal pid disturbed", "ideal rbf disturbed", "ideal literal disturbed"),
        *("pid disturbed", "pid_preview disturbed", "rbf disturbed"),
    ),
    THREE,
)
def disturbance(results: Results) -> Judgement:
    """Judge the disturbance rejection against PID."""
    pid, known, rbf = results["pid disturbed"], results["pid_preview disturbed"], results["rbf disturbed"]
    ideal_pid, ideal_rbf, literal = (results[f"ideal {key} disturbed"] for key in ("pid", "rbf", "literal"))
    text = (
        f"ideal: PID {pair(ideal_pid)}, RBF {pair(ideal_rbf)}, as printed {pair(literal)}; lag and delay: PID "
        f"{pair(pid)}, PID + preview {pair(known)}, RBF {pair(rbf)} m/s"
    )
    reason = (
        f"{CORRECTED}; with lag and delay. Grades up to 24 per mille, gusts and noise are not in the nominal model. "
        f"Against a PID with the same preview {rms_kmh(rbf) / rms_kmh(known):.2f} of the rms, by a higher gain; with "
        f"an ideal actuator {rms_kmh(ideal_rbf) / rms_kmh(ideal_pid):.2f} of that of PID"
    )
    here, there = [rms_check(REJECTS, literal, ideal_pid)], [rms_check(REJECTS_RBF, rbf, pid)]
    return conclude(text, here, "as printed", elsewhere=there, changed=reason)


@CLAIMS.judged_by(
    "PID loses its stability easily under a strong disturbance",
    "figures 4, 5",
    ("ideal pid", "ideal pid disturbed", "pid nominal", "pid disturbed"),
)
def instability(results: Results) -> Judgement:
    """Judge the growth of the error of PID by the disturbance."""
    ideal, ideal_disturbed = results["ideal pid"], results["ideal pid disturbed"]
    slow, slow_disturbed = results["pid nominal"], results["pid disturbed"]
    return conclude(
        f"ideal {pair(ideal)}, disturbed {pair(ideal_disturbed)}; with lag and delay {pair(slow)}, disturbed "
        f"{pair(slow_disturbed)} m/s",
        [rms_check(UNSTEADY_IDEAL, ideal_disturbed, ideal), rms_check(UNSTEADY, slow_disturbed, slow)],
        "at these gains; grades up to 24 per mille, gusts and noise",
        otherwise="our runs contradict the paper: PID keeps its error under grades up to 24 per mille, gusts and "
        "noise, with gains of an independent optimisation; the paper gives neither its gains nor its disturbance",
    )


@CLAIMS.judged_by(
    "the corrected compensation of the delay by (4), (5) is effective",
    "compensated",
    ("rbf none", "rbf pade", "rbf nominal", "rbf_predictor nominal"),
)
def delay_compensation(results: Results) -> Judgement:
    """Judge the accuracy with the delay compensation of (4), (5)."""
    none, pade, preview, predictor = (
        results[key] for key in ("rbf none", "rbf pade", "rbf nominal", "rbf_predictor nominal")
    )
    text = f"none {pair(none)}, Padé {pair(pade)}, preview {pair(preview)}, predictor {pair(predictor)} m/s"
    reason = (
        "Padé of the *reference* with the corrected b1 = -tau/lam and the dot on a_s; with the printed signs "
        "and measured "
        "derivatives the loop is unstable. The exact preview is better, the predictor best"
    )
    return conclude(text, [rms_check(COMPENSATED, pade, none)], reason)


@CLAIMS.judged_by(
    "the sliding mode (9) with sgn(s) controls a train with lag and delay",
    "stable",
    ("sign nominal", "ideal sign"),
    THREE,
)
def relay(results: Results) -> Judgement:
    """Judge the relay of (9) with lag and delay."""
    result = results["sign nominal"]
    run = recording(result)
    part = (run.time > 330) & (run.time < 400)
    error = (run.front_velocity - run.reference_velocity)[part]
    crossings = run.time[part][1:][np.diff(error > error.mean())]
    period = 2.0 * float(np.ptp(crossings)) / max(1, crossings.size - 1)
    text = f"{pair(result)} m/s, period {period:.1f} s"
    reason = (
        f"a limit cycle of lag and delay, with an ideal actuator {pair(results['ideal sign'])} m/s; "
        "tanh(s/phi) is usable"
    )
    there = [USABLE_IDEAL.check(rms_ms(results["ideal sign"]))]
    return conclude(text, [USABLE.check(rms_ms(result))], reason, elsewhere=there)
