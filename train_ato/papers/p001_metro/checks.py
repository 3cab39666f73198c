"""Judges of paper 001: accuracy, chattering, disturbance, delay compensation, the networks, and the goals."""

from __future__ import annotations

import numpy as np

from train_ato.papers.checks import judged, largest_kmh, recording, rms_kmh, variation
from train_ato.papers.claims import Claims, Judgement, Result, Results
from train_ato.papers.p001_metro.cases import INERTIA

CLAIMS = Claims()
DRIFT = 5.0
"""Position error from which control is lost [m]."""


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


@CLAIMS.judged_by(
    "tracks the recommended speed more accurately than PID",
    "figures 4-7",
    ("ideal pid", "ideal pid_known", "ideal rbf", "pid nominal", "pid_preview nominal", "rbf nominal"),
)
def accuracy(results: Results) -> Judgement:
    """Judge the tracking against PID."""
    pid, known, rbf = results["ideal pid"], results["ideal pid_known"], results["ideal rbf"]
    text = (
        f"ideal: PID {pair(pid)}, RBF {pair(rbf)}; with lag and delay {pair(results['pid nominal'])}, "
        f"{pair(results['rbf nominal'])} m/s"
    )
    reason = (
        f"against the paper's PID, which has no feed-forward; a PID with the same feed-forward has {pair(known)} "
        f"(ideal) and {pair(results['pid_preview nominal'])} (lag, delay): the advantage is that of the equivalent "
        "control"
    )
    holds = rms_kmh(rbf) < 0.5 * rms_kmh(pid) and rms_kmh(results["rbf nominal"]) < 0.5 * rms_kmh(
        results["pid nominal"]
    )
    return judged(text, holds, reason)


@CLAIMS.judged_by(
    "no overshoot where the regime changes", "figures 4-7", ("ideal pid", "ideal rbf", "pid nominal", "rbf nominal")
)
def overshoot(results: Results) -> Judgement:
    """Judge the overshoot at changes of the driving regime."""
    pid, rbf = (_overshoot(results[key]) for key in ("pid nominal", "rbf nominal"))
    ideal_pid, ideal_rbf = (_overshoot(results[key]) for key in ("ideal pid", "ideal rbf"))
    text = f"ideal {ideal_pid:.3f} -> {ideal_rbf:.4f}, with lag and delay {pid:.3f} -> {rbf:.4f} m/s"
    return judged(text, rbf < 0.2 * pid, "largest v - v_d in the 10 s after an acceleration or a braking ends")


def _overshoot(result: Result) -> float:
    """Return the largest error beyond the cruising speed in the 10 s after it is reached [m/s]."""
    run = recording(result)
    accelerating = np.sign(np.round(run.reference_acceleration, 6))
    ends = np.flatnonzero((accelerating[:-1] != 0) & (accelerating[1:] == 0) & (run.reference_velocity[1:] > 1.0))
    span = round(10.0 / (run.time[1] - run.time[0]))
    error = run.front_velocity - run.reference_velocity
    return max(float((accelerating[end] * error[end : end + span]).max()) for end in ends)


@CLAIMS.judged_by(
    "the network removes the chattering of the sliding mode and keeps the tracking",
    "figure 7",
    ("ideal sign", "ideal rbf", "ideal tanh", "ideal sign 10 ms", "ideal rbf 10 ms"),
)
def chattering(results: Results) -> Judgement:
    """Judge the chattering and the tracking with the network."""
    parts, holds = [], True
    for label, suffix in (("50 ms", ""), ("10 ms", " 10 ms")):
        sign, rbf = results[f"ideal sign{suffix}"], results[f"ideal rbf{suffix}"]
        parts.append(
            f"{label}: {shaking(sign):.1f} -> {shaking(rbf):.3f} m/s² per s, rms {rms_ms(sign):.4f} -> "
            f"{rms_ms(rbf):.4f} m/s"
        )
        holds = holds and shaking(rbf) < 0.01 * shaking(sign) and rms_kmh(rbf) <= rms_kmh(sign)
    reason = (
        "with an ideal actuator and the corrected network; tanh(s/phi) does the same "
        f"({shaking(results['ideal tanh']):.3f} m/s² per s, {rms_ms(results['ideal tanh']):.4f} m/s). The force limits "
        "saturate the relay here, so it varies less than 2 k_w/Tc"
    )
    return judged("; ".join(parts), holds, reason)


@CLAIMS.judged_by(
    "corrected network, ideal actuator (independent)",
    "0.0004 m/s rms at 10 ms, 0.0011 at 50 ms, within a factor of 2",
    ("ideal rbf", "ideal rbf 10 ms"),
)
def ideal_figures(results: Results) -> Judgement:
    """Judge the rms of the corrected network against an independent implementation, within a factor of 2."""
    fast, slow = rms_ms(results["ideal rbf 10 ms"]), rms_ms(results["ideal rbf"])
    text = f"{fast:.4f} m/s at 10 ms, {slow:.4f} at 50 ms"
    reason = (
        "the remaining error is in the last 0.05 m/s, where the holding brake stops the train before the end of the "
        "reference"
    )
    return judged(text, fast <= 0.0008 and slow <= 0.0022, reason)


@CLAIMS.judged_by(
    "rejects disturbances better than PID",
    "significantly",
    (
        "ideal pid disturbed",
        "ideal rbf disturbed",
        "pid disturbed",
        "pid_preview disturbed",
        "rbf disturbed",
    ),
)
def disturbance(results: Results) -> Judgement:
    """Judge the disturbance rejection against PID."""
    pid, known, rbf = results["pid disturbed"], results["pid_preview disturbed"], results["rbf disturbed"]
    ideal = f"ideal: PID {pair(results['ideal pid disturbed'])}, RBF {pair(results['ideal rbf disturbed'])}"
    text = f"{ideal}; lag and delay: PID {pair(pid)}, PID + preview {pair(known)}, RBF {pair(rbf)} m/s"
    reason = (
        "grades up to 24 per mille, gusts and noise are not in the nominal model; better than both PIDs, by a higher "
        "gain"
    )
    return judged(text, rms_kmh(rbf) < min(rms_kmh(pid), rms_kmh(known)), reason)


@CLAIMS.judged_by(
    "the compensation of the delay by (4), (5) keeps the accuracy",
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
    return judged(text, rms_kmh(pade) < 0.5 * rms_kmh(none), reason)


@CLAIMS.judged_by(
    "the sliding mode (9) with sgn(s) controls a train with lag and delay", "stable", ("sign nominal", "ideal sign")
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
    holds = rms_ms(result) < 0.05
    reason = (
        f"a limit cycle of lag and delay, with an ideal actuator {pair(results['ideal sign'])} m/s; "
        "tanh(s/phi) is usable"
    )
    return judged(text, holds, reason, rms_ms(results["ideal sign"]) < 0.05)


@CLAIMS.judged_by(
    "the networks learn by (11)-(14) as printed",
    "chattering goes to 0",
    ("ideal literal", "ideal literal disturbed", "literal nominal"),
    takes_failures=True,
)
def literal(results: Results) -> Judgement:
    """Judge the learning of the networks as printed."""
    parts = []
    lost = True
    for label, key in (
        ("ideal", "ideal literal"),
        ("ideal, disturbed", "ideal literal disturbed"),
        ("lag, delay", "literal nominal"),
    ):
        result = results[key]
        drift = result.summary.get("position_error_max_m", float("inf"))
        lost = lost and bool(result.failure or not drift < DRIFT)
        parts.append(f"{label} {result.failure or f'{drift:.0f} m'}")
    reason = (
        "objective and input are e'' instead of s: the weights do not depend on the position or speed error, so the "
        "switching term drifts in one direction (`objective: printed_acceleration`, with the missing sign and h_j "
        "restored). A literal version of the independent implementation drifts 16-23 m and diverges with lag and "
        "delay: control is lost in both"
    )
    return judged("position error " + "; ".join(parts), not lost, reason)


@CLAIMS.judged_by(
    "with lag and delay the network improves on a smooth switching term",
    "implied",
    (
        "rbf disturbed",
        "tanh disturbed",
        "pid_preview disturbed",
        "rbf_predictor disturbed",
        "tanh_predictor disturbed",
        "rbf slower",
        "tanh slower",
    ),
)
def network_use(results: Results) -> Judgement:
    """Judge the contribution of the network with lag and delay."""
    rbf, tanh, pid = (results[f"{key} disturbed"] for key in ("rbf", "tanh", "pid_preview"))
    rbf_p, tanh_p = results["rbf_predictor disturbed"], results["tanh_predictor disturbed"]
    text = (
        f"disturbed: PID + preview {pair(pid)}, tanh {pair(tanh)}, RBF {pair(rbf)}; "
        f"with predictor and ESO tanh {pair(tanh_p)}, RBF {pair(rbf_p)} m/s"
    )
    reason = (
        "its weights only grow: the effect is a rising gain, as of a smaller phi of tanh; with lag and delay longer "
        f"than modelled this has a cost ({pair(results['rbf slower'])} against {pair(results['tanh slower'])} m/s). "
        "The improvement comes from preview, predictor and observer"
    )
    return judged(text, rms_kmh(rbf_p) < 0.8 * rms_kmh(tanh_p), reason)


@CLAIMS.judged_by(
    "the identification network (14) improves the tracking", "implied", ("rbf disturbed", "rbf unidentified disturbed")
)
def identification(results: Results) -> Judgement:
    """Judge the contribution of the identification network."""
    used, unused = results["rbf disturbed"], results["rbf unidentified disturbed"]
    text = f"with {pair(used)}, without {pair(unused)} m/s"
    reason = "its only purpose is the sign of ds/du, which is + on every train and needs no network"
    return judged(text, rms_kmh(used) < 0.95 * rms_kmh(unused), reason)
