"""Judges of paper 001 on the networks: chattering, learning, contribution."""

from __future__ import annotations

import math

from train_ato.papers.bounds import BETTER, REMOVED, Bound, ratio, worst
from train_ato.papers.checks import conclude
from train_ato.papers.claims import THREE, Claims, Judgement, Results
from train_ato.papers.p001_metro.cases import FAST_PHI, RATE
from train_ato.papers.p001_metro.checks import CORRECTED, pair, rms_check, rms_ms, shaking

CLAIMS = Claims()
SHAKING = ratio("variation as printed over sgn(s), 50 ms", REMOVED, "paper: removed")
SHAKING_RBF = ratio("variation corrected over sgn(s)", REMOVED, "paper: removed")
KEPT = ratio("rms as printed over sgn(s), 50 ms", 1.0, "tracking kept")
KEPT_RBF = ratio("rms corrected over sgn(s)", 1.0, "tracking kept")
FACTOR_2 = "independent, disturbed without noise, within a factor of 2"
SLOW_TICK, FAST_TICK = Bound("rms, 50 ms", 0.0022, "m/s", FACTOR_2), Bound("rms, 10 ms", 0.0008, "m/s", FACTOR_2)
SLOW_TICK_FAST = Bound("rms, 50 ms, rate of the paper", 0.0022, "m/s", FACTOR_2)
FAST_TICK_FAST = Bound("rms, 10 ms, rate of the paper", 0.0008, "m/s", FACTOR_2)
DRIFT = Bound("largest position error", 5.0, "m", "convention for lost control")
CHATTERING_GONE = ratio("variation as printed over sgn(s)", REMOVED, "paper: to 0")
USEFUL = ratio("rms RBF over tanh, predictor and ESO", BETTER, "implied: improves")
USEFUL_ALONE = ratio("rms RBF over tanh, preview alone", BETTER, "implied: improves")
IDENTIFIES = ratio("rms with over without", BETTER, "implied: improves")


@CLAIMS.judged_by(
    "the network removes the chattering of the sliding mode and keeps the tracking",
    "figure 7",
    ("ideal sign", "ideal rbf", "ideal tanh", "ideal literal", "ideal sign 10 ms", "ideal rbf 10 ms"),
    THREE,
)
def chattering(results: Results) -> Judgement:
    """Judge the chattering and the tracking with the network."""
    parts, there = [], []
    for label, suffix in (("50 ms", ""), ("10 ms", " 10 ms")):
        sign, rbf = results[f"ideal sign{suffix}"], results[f"ideal rbf{suffix}"]
        parts.append(
            f"{label}: {shaking(sign):.1f} -> {shaking(rbf):.3f} m/s² per s, rms {rms_ms(sign):.4f} -> "
            f"{rms_ms(rbf):.4f} m/s"
        )
        there += [SHAKING_RBF.check(shaking(rbf) / shaking(sign)), rms_check(KEPT_RBF, rbf, sign)]
    sign, literal = results["ideal sign"], results["ideal literal"]
    parts.append(f"as printed, 50 ms: {shaking(literal):.3f} m/s² per s, rms {rms_ms(literal):.3g} m/s")
    reason = (
        f"{CORRECTED}. tanh(s/phi) has the same effect "
        f"({shaking(results['ideal tanh']):.3f} m/s² per s, {rms_ms(results['ideal tanh']):.4f} m/s). The force limits "
        "saturate the relay here, so it varies less than 2 k_w/Tc"
    )
    here = [SHAKING.check(shaking(literal) / shaking(sign)), rms_check(KEPT, literal, sign)]
    return conclude("; ".join(parts), here, "as printed", elsewhere=there, changed=reason)


@CLAIMS.judged_by(
    "corrected network, ideal actuator, disturbed without noise (independent)",
    "0.0004 m/s rms at 10 ms, 0.0011 at 50 ms, within a factor of 2",
    (
        *(f"ideal {key} no noise{suffix}" for key in ("rbf", "rbf fast") for suffix in ("", " 10 ms")),
        *("ideal rbf", "ideal rbf 10 ms"),
    ),
    THREE,
)
def ideal_figures(results: Results) -> Judgement:
    """Judge the rms of the corrected network against an independent implementation on the same disturbed line."""
    found = {
        key: [rms_ms(results[f"ideal {key} no noise{suffix}"]) for suffix in (" 10 ms", "")]
        for key in ("rbf", "rbf fast")
    }
    (fast, slow), (quick_fast, quick_slow) = found.values()
    text = (
        f"{fast:.4f} m/s at 10 ms, {slow:.4f} at 50 ms; with phi {FAST_PHI:g} m/s and the rate of the paper, {RATE:g} "
        f"per sample, {quick_fast:.4f} and {quick_slow:.4f}; undisturbed {rms_ms(results['ideal rbf 10 ms']):.4f} and "
        f"{rms_ms(results['ideal rbf']):.4f}"
    )
    return conclude(
        text,
        [FAST_TICK.check(fast), SLOW_TICK.check(slow)],
        "with the gains for lag and delay",
        elsewhere=[FAST_TICK_FAST.check(quick_fast), SLOW_TICK_FAST.check(quick_slow)],
        changed="the gains of the other rows are for lag and delay and reject the disturbance far less; with the "
        "learning rate of the paper as in the independent runs the figures are alike",
        otherwise="beyond the independent figures, with any of the gains",
    )


@CLAIMS.judged_by(
    "the networks learn by (11)-(14) as printed",
    "chattering goes to 0",
    ("ideal literal", "ideal literal disturbed", "literal nominal", "ideal sign"),
    takes_failures=True,
)
def literal(results: Results) -> Judgement:
    """Judge the learning of the networks as printed."""
    labels = {
        "ideal literal": "ideal",
        "ideal literal disturbed": "ideal, disturbed",
        "literal nominal": "lag, delay",
    }
    drifts = {key: float(results[key].summary.get("position_error_max_m", math.inf)) for key in labels}
    parts = [f"{label} {results[key].failure or f'{drifts[key]:.0f} m'}" for key, label in labels.items()]
    failed = any(results[key].failure for key in labels)
    checks = [DRIFT.check(math.inf if failed else worst(drifts.values()))]
    if not failed:
        checks.append(CHATTERING_GONE.check(shaking(results["ideal literal"]) / shaking(results["ideal sign"])))
    reason = (
        "objective and input are e'' instead of s: the weights do not depend on the position or speed error, so the "
        "switching term drifts in one direction (`objective: printed_acceleration`, with the missing sign and h_j "
        "restored). A literal version of the independent implementation drifts 16-23 m and diverges with lag and "
        "delay: control is lost in both"
    )
    return conclude("position error " + "; ".join(parts), checks, "as printed", otherwise=reason)


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
    THREE,
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
    return conclude(
        text,
        [rms_check(USEFUL, rbf_p, tanh_p), rms_check(USEFUL_ALONE, rbf, tanh)],
        "with and without predictor and observer",
        elsewhere=[rms_check(USEFUL_ALONE, rbf, tanh)],
        changed=f"only with preview alone: {reason}",
        otherwise=reason,
    )


@CLAIMS.judged_by(
    "the identification network (14) improves the tracking", "implied", ("rbf disturbed", "rbf unidentified disturbed")
)
def identification(results: Results) -> Judgement:
    """Judge the contribution of the identification network."""
    used, unused = results["rbf disturbed"], results["rbf unidentified disturbed"]
    text = f"with {pair(used)}, without {pair(unused)} m/s"
    reason = "its only purpose is the sign of ds/du, which is + on every train and needs no network"
    return conclude(text, [rms_check(IDENTIFIES, used, unused)], reason)
