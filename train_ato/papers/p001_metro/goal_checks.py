"""Judges of the goals of this project on the train of paper 001, with lag and delay."""

from __future__ import annotations

from train_ato.papers.checks import judged
from train_ato.papers.claims import Claims, Judgement, Results
from train_ato.papers.p001_metro.cases import SWEEP
from train_ato.papers.p001_metro.checks import largest_ms, pair, rms_ms

CLAIMS = Claims()


@CLAIMS.judged_by(
    "goal: disturbed, predictor and observer", "rms <= 0.03, largest <= 0.13 m/s", ("tanh_predictor disturbed",)
)
def goal_disturbed(results: Results) -> Judgement:
    """Judge rms <= 0.03 and largest <= 0.13 m/s on the disturbed train."""
    result = results["tanh_predictor disturbed"]
    return judged(
        f"{pair(result)} m/s",
        rms_ms(result) <= 0.03 and largest_ms(result) <= 0.13,
        "tanh(s/1.2), predictor, ESO at 3 1/s",
    )


@CLAIMS.judged_by("goal: disturbed, rbf_switching_smc", "rms <= 0.045 m/s", ("rbf disturbed",))
def goal_rbf(results: Results) -> Judgement:
    """Judge rms <= 0.045 m/s for `rbf_switching_smc` on the disturbed train."""
    result = results["rbf disturbed"]
    return judged(f"{rms_ms(result):.4f} m/s", rms_ms(result) <= 0.045, "with preview alone, no observer")


@CLAIMS.judged_by("goal: nominal", "rms <= 0.003 m/s", ("tanh_predictor nominal",))
def goal_nominal(results: Results) -> Judgement:
    """Judge rms <= 0.003 m/s on the nominal train."""
    result = results["tanh_predictor nominal"]
    reason = "the largest error is at the end of the stop, where the electric brake has faded"
    return judged(f"{pair(result)} m/s", rms_ms(result) <= 0.003, reason)


@CLAIMS.judged_by(
    "goal: delays up to 1.0 s",
    "rms <= 0.05 m/s",
    (
        *(f"sweep {delay}" for delay in SWEEP),
        "tanh_predictor disturbed",
        "tanh_predictor long_delay",
        "rbf long_delay",
    ),
)
def goal_delay(results: Results) -> Judgement:
    """Judge rms <= 0.05 m/s up to a delay of 1.0 s."""
    runs = {float(key.split()[1]): rms_ms(result) for key, result in results.items() if key.startswith("sweep")}
    runs |= {0.3: rms_ms(results["tanh_predictor disturbed"]), 1.0: rms_ms(results["tanh_predictor long_delay"])}
    text = ", ".join(f"{delay:g} s {value:.4f}" for delay, value in sorted(runs.items())) + " m/s"
    reason = (
        "gains as for 0.3 s, disturbed and with noise; without predictor "
        f"RBF + preview has {rms_ms(results['rbf long_delay']):.2f} at 1.0 s"
    )
    return judged(text, max(runs.values()) <= 0.05, reason)


@CLAIMS.judged_by(
    "held out: mismatch and slower actuator",
    "0.043 / 0.41 and 0.036 / 0.16 m/s (independent)",
    ("tanh_predictor mismatch", "tanh_predictor slower"),
)
def goal_mismatch(results: Results) -> Judgement:
    """Judge the held-out trains against the figures of an independent implementation."""
    gain, slower = results["tanh_predictor mismatch"], results["tanh_predictor slower"]
    text = f"gain 0.9, resistance x10 {pair(gain)}; slower actuator {pair(slower)} m/s"
    reason = (
        "judged by the rms, within a fifth of the independent 0.043 and 0.036; at gain 0.9 the largest error is due to "
        f"saturated traction, under any law; that of the slower actuator is {largest_ms(slower) / 0.16:.1f} times the "
        "independent one"
    )
    return judged(text, rms_ms(gain) <= 1.2 * 0.043 and rms_ms(slower) <= 1.2 * 0.036, reason)


@CLAIMS.judged_by(
    "goal: stop and limit",
    "within 0.05 m, overspeed < 0.5 km/h",
    ("tanh_predictor nominal", "tanh_predictor disturbed"),
)
def goal_stop(results: Results) -> Judgement:
    """Judge stop error, 0.05 m, and overspeed, 0.5 km/h."""
    stops = {key.removeprefix("tanh_predictor "): result.summary["stop_error_m"] for key, result in results.items()}
    overspeed = max(result.summary["overspeed_max_kmh"] for result in results.values())
    text = ", ".join(f"{train} {'-' if stop is None else f'{stop:+.3f}'}" for train, stop in stops.items())
    holds = all(stop is not None and abs(stop) <= 0.05 for stop in stops.values()) and overspeed < 0.5
    return judged(
        f"{text} m; overspeed {overspeed:.2f} km/h", holds, "the limit is the reference's own 80 km/h, disturbed"
    )
