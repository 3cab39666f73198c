"""Judges of the goals of this project on the train of paper 001, with lag and delay."""

from __future__ import annotations

import math

from train_ato.papers.bounds import Bound, worst
from train_ato.papers.checks import GOAL, conclude
from train_ato.papers.claims import Claims, Judgement, Results
from train_ato.papers.p001_metro.cases import SWEEP, TRAINS
from train_ato.papers.p001_metro.checks import largest_ms, pair, rms_ms

CLAIMS = Claims()
DISTURBED, DISTURBED_LARGEST = Bound("rms", 0.03, "m/s", GOAL), Bound("largest", 0.13, "m/s", GOAL)
RBF = Bound("rms", 0.045, "m/s", GOAL)
NOMINAL = Bound("rms", 0.003, "m/s", GOAL)
ANY_DELAY = Bound("largest rms", 0.05, "m/s", GOAL)
INDEPENDENT = "independent"
GAIN, GAIN_LARGEST = Bound("rms, gain 0.9", 0.043, "m/s", INDEPENDENT), Bound("largest", 0.41, "m/s", INDEPENDENT)
SLOWER, SLOWER_LARGEST = Bound("rms, slower", 0.036, "m/s", INDEPENDENT), Bound("largest", 0.16, "m/s", INDEPENDENT)
STOP = Bound("largest stop error", 0.05, "m", GOAL)
OVERSPEED = Bound("largest overspeed", 0.5, "km/h", GOAL)


@CLAIMS.judged_by(
    "goal: disturbed, predictor and observer", "rms <= 0.03, largest <= 0.13 m/s", ("tanh_predictor disturbed",)
)
def goal_disturbed(results: Results) -> Judgement:
    """Judge rms <= 0.03 and largest <= 0.13 m/s on the disturbed train."""
    result = results["tanh_predictor disturbed"]
    checks = [DISTURBED.check(rms_ms(result)), DISTURBED_LARGEST.check(largest_ms(result))]
    return conclude(f"{pair(result)} m/s", checks, "tanh(s/1.2), predictor, ESO at 3 1/s")


@CLAIMS.judged_by("goal: disturbed, rbf_switching_smc", "rms <= 0.045 m/s", ("rbf disturbed",))
def goal_rbf(results: Results) -> Judgement:
    """Judge rms <= 0.045 m/s for `rbf_switching_smc` on the disturbed train."""
    result = results["rbf disturbed"]
    return conclude(f"{rms_ms(result):.4f} m/s", [RBF.check(rms_ms(result))], "with preview alone, no observer")


@CLAIMS.judged_by("goal: nominal", "rms <= 0.003 m/s", ("tanh_predictor nominal",))
def goal_nominal(results: Results) -> Judgement:
    """Judge rms <= 0.003 m/s on the nominal train."""
    result = results["tanh_predictor nominal"]
    reason = "the largest error is at the end of the stop, where the electric brake has faded"
    return conclude(f"{pair(result)} m/s", [NOMINAL.check(rms_ms(result))], reason)


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
    return conclude(text, [ANY_DELAY.check(worst(runs.values()))], reason)


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
        f"gain 0.9: {rms_ms(gain) / GAIN.limit:.2f} times the independent rms; the largest error there is due to "
        f"saturated traction, under any law. Slower actuator: {largest_ms(slower) / SLOWER_LARGEST.limit:.1f} times "
        "the independent largest error"
    )
    checks = [
        GAIN.check(rms_ms(gain)),
        GAIN_LARGEST.check(largest_ms(gain)),
        SLOWER.check(rms_ms(slower)),
        SLOWER_LARGEST.check(largest_ms(slower)),
    ]
    return conclude(text, checks, "at least as accurate as the independent one", otherwise=reason)


@CLAIMS.judged_by(
    "goal: stop and limit on every train",
    "within 0.05 m, overspeed < 0.5 km/h",
    tuple(f"tanh_predictor {train}" for train in TRAINS),
)
def goal_stop(results: Results) -> Judgement:
    """Judge stop error, 0.05 m, and overspeed, 0.5 km/h, on all trains of the table."""
    runs = {train: results[f"tanh_predictor {train}"].summary for train in TRAINS}
    stops = {train: math.nan if run["stop_error_m"] is None else run["stop_error_m"] for train, run in runs.items()}
    fast = {train: run["overspeed_max_kmh"] for train, run in runs.items()}
    text = ", ".join(f"{train} {stops[train]:+.3f} m, {fast[train]:.2f} km/h" for train in TRAINS)
    checks = [STOP.check(worst(abs(stop) for stop in stops.values())), OVERSPEED.check(worst(fast.values()))]
    missed = [train for train in TRAINS if not (STOP.check(abs(stops[train])).holds)]
    over = [train for train in TRAINS if not OVERSPEED.check(fast[train]).holds]
    reason = f"stop missed: {', '.join(missed) or 'none'}; overspeed: {', '.join(over) or 'none'}"
    return conclude(text, checks, "the limit is the reference's own 80 km/h", otherwise=reason)
