"""Judges of what becomes of paper 000 with lag 0.4 s and delay 0.8 s, and of the goals set for our own parts there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from train_ato.reproduce.claims import Claim, Judgement, Results
from train_ato.reproduce.heavy_haul_cases import LAGGED_TRAINS, LIMIT_DELAYS
from train_ato.reproduce.heavy_haul_series import speed_error
from train_ato.reproduce.judges import history, judged, largest, rms, variation, within

LIMIT = 184e3 * 1.0 / (10_684e3 * 0.1)
"""Total lag from which the printed law is unstable, m_0 l1/(M l2) [s]."""


def limit(results: Results) -> Judgement:
    """Judge that the printed law is unstable beyond a total lag of 0.17 s and calm well below."""
    late = {delay: _late(results, f"smc delay {delay}") for delay in LIMIT_DELAYS}
    text = ", ".join(f"{delay:g} s: {value:.3f}" for delay, value in late.items()) + " km/h rms in the last 200 s"
    calm = max(value for delay, value in late.items() if delay < 0.5 * LIMIT)
    lost = min(value for delay, value in late.items() if delay > LIMIT)
    reason = (
        f"M T p³ + m_0 (p² + l1 p + l2) has roots in the right half plane for T > {LIMIT:.3f} s: from there on a limit "
        "cycle that the force limits hold. It is the rigid train's limit: the flexible one swings in its first mode, "
        "24 s, from about 0.1 s on, growing slowly"
    )
    return judged(text, lost > 2.0 * calm and lost > 0.05, reason)


def _late(results: Results, key: str) -> float:
    series = history(results[key])
    part = series.time > series.time[-1] - 200.0
    return float(np.sqrt(np.mean(speed_error(series)[part] ** 2)))


def printed_lost(results: Results) -> Judgement:
    """Judge whether a printed law survives lag 0.4 s and delay 0.8 s."""
    keys = {"smc lagged": "SMC", "rbf_ndo lagged": "RBFNN + NDO", "rbf_ks_ndo lagged": "with ks + NDO 20"}
    text = ", ".join(
        f"{label} {rms(results[key]):.2f} (at most {largest(results[key]):.1f})" for key, label in keys.items()
    )
    pid = f"PID {rms(results['pid lagged']):.2f}, {rms(results['pid lag']):.3f} with the lag alone"
    saturated = results["smc lagged"].summary["saturated_s"]
    reason = (
        f"a limit cycle that grows until the force limits hold it (SMC {saturated:.0f} s at a limit; the others over "
        "600 s from the start). An independent implementation has 20-28 km/h on another driver's run; lost all the same"
    )
    holds = all(largest(results[key]) > 0.15 and rms(results[key]) > 0.1 for key in keys)
    return judged(f"{text}; {pid} km/h", not holds, reason)


def needs_train(results: Results) -> Judgement:
    """Judge that a rigid feed-forward is not enough."""
    rigid, twin = results["preview_pid nominal"], results["twin_pid nominal"]
    text = (
        f"rigid preview {rms(rigid):.3f} km/h and {variation(rigid):.0f} kN/s, "
        f"twin {rms(twin):.4f} and {variation(twin):.0f}"
    )
    return judged(text, rms(twin) < 0.2 * rms(rigid), "same PID; the long train's own waves are in the twin's force")


def predicted(results: Results) -> Judgement:
    """Judge that a printed law on a full-train prediction works on the nominal train and is lost on another."""
    runs = [results[f"predicted {train}"] for train in LAGGED_TRAINS]
    text = ", ".join(f"{label} {rms(run):.3f}" for (label, _), run in zip(LAGGED_TRAINS.values(), runs, strict=True))
    works, beyond, lost = rms(runs[0]) <= 0.02, rms(runs[-1]) > STRONG_GOAL, rms(runs[-1]) > LOST
    reason = (
        "a Smith predictor of all 106 masses, the lag taken as delay: what it does not know, the disturbance included, "
        "acts for 1.2 s before the printed gains answer it, so it falls behind twin + PID as soon as there is any"
    )
    if works and beyond and not lost:
        reason += f"; with strong mismatch it does not diverge here, but is beyond the goal of {STRONG_GOAL:g} km/h"
    return judged(f"{text} km/h", works and lost, reason, works and beyond)


def observer_adds(results: Results) -> Judgement:
    """Judge whether the observer contributes anything with lag and delay."""
    parts = []
    for train, (label, _) in LAGGED_TRAINS.items():
        without, observed = rms(results[f"twin_smc {train}"]), rms(results[f"twin_smc_ndo {train}"])
        parts.append(f"{label} {without:.3f} -> {observed:.3f}")
    helps = all(rms(results[f"twin_smc_ndo {train}"]) < rms(results[f"twin_smc {train}"]) for train in LAGGED_TRAINS)
    reason = (
        "no: behind 1.2 s and a train whose first mode takes 24 s the NDO (.01 1/s, over the whole train) is one more "
        "slow integral beside l2; it costs damping and finds nothing the surface does not"
    )
    return judged("; ".join(parts) + " km/h", helps, reason)


def coupler_goal(results: Results) -> Judgement:
    """Judge that couplers stay within +-600 kN with `twin` and PID on every train."""
    high = max(result.summary["coupler_draft_max_kn"] for result in results.values())
    low = min(result.summary["coupler_buff_max_kn"] for result in results.values())
    reason = (
        "nominal to strong mismatch; the draft force is the one that the reference itself asks for (0.72 of the "
        "traction at 7 km/h), draft gears with 1e5 N s/m of structural damping"
    )
    return judged(f"{low:.0f} ... {high:+.0f} kN", high <= 600 and low >= -600, reason)


def variation_goal(results: Results) -> Judgement:
    """Judge that the command varies by at most 15 kN/s, with speed noise 100."""
    noisy, raw = variation(results["twin_pid noise"]), variation(results["raw_pid noise"])
    calm = max(variation(result) for key, result in results.items() if "noise" not in key)
    text = f"{calm:.1f} kN/s at most, {noisy:.0f} with 0.02 m/s of noise (unfiltered, kp .09: {raw:.0f})"
    reason = "the speed error passes a filter of 0.5 s, which this train does not feel"
    return judged(text, calm <= 15 and noisy <= 100, reason)


STRONG_GOAL = 0.12
"""Goal for the rms with strong mismatch [km/h]."""
LOST = 1.0
"""Rms beyond which a run is taken for lost [km/h]."""
GOALS: tuple[tuple[str, float, float, str], ...] = (
    ("nominal", 0.02, 0.30, "gains were chosen on this train and on strong mismatch without disturbance"),
    ("disturbed", 0.02, 0.30, "held out: not used for tuning"),
    ("mismatch", 0.06, 0.6, "held out: not used for tuning; with disturbance (40)"),
    ("strong", STRONG_GOAL, 0.8, "chosen on the same mismatch without disturbance; here with (40)"),
)
"""Train, goals for rms and largest error [km/h], and how the gains relate to it."""


def _goal(train: str, bound: float, worst: float, reason: str) -> Claim:
    key = f"twin_pid {train}"
    judge: Callable[[Results], Judgement] = within(key, bound, worst, reason)
    label = LAGGED_TRAINS[train][0]
    return Claim(
        f"goal with lag .4 s and delay .8 s, twin + PID: {label}",
        f"rms <= {bound:g}, largest <= {worst:g} km/h",
        (key,),
        judge,
    )


TWIN_KEYS = tuple(f"twin_pid {train}" for train in LAGGED_TRAINS)
CLAIMS: tuple[Claim, ...] = (
    Claim(
        "the printed law is unstable beyond a total lag of m_0 l1/(M l2) (derived from the model, not in the paper)",
        "0.17 s",
        tuple(f"smc delay {delay}" for delay in LIMIT_DELAYS),
        limit,
    ),
    Claim(
        "the method suits a real locomotive: it tracks with lag .4 s and delay .8 s (the paper has neither)",
        "+-0.15 km/h",
        ("smc lagged", "rbf_ndo lagged", "rbf_ks_ndo lagged", "pid lagged", "pid lag"),
        printed_lost,
    ),
    Claim(
        "a twin of the whole train is needed, a rigid feed-forward is not enough",
        ".012 against .22-.32 km/h (independent)",
        ("preview_pid nominal", "twin_pid nominal"),
        needs_train,
    ),
    Claim(
        "a printed law works on a prediction of the full train, and is lost with strong mismatch",
        ".015, .019, .086 km/h, diverges (independent)",
        tuple(f"predicted {train}" for train in LAGGED_TRAINS),
        predicted,
    ),
    *(_goal(*goal) for goal in GOALS),
    Claim("goal: coupler forces with twin + PID", "within +-600 kN", TWIN_KEYS, coupler_goal),
    Claim(
        "goal: command variation with twin + PID",
        "<= 15 kN/s, <= 100 with 0.02 m/s of noise",
        (*TWIN_KEYS, "twin_pid noise", "raw_pid noise"),
        variation_goal,
    ),
    Claim(
        "with lag and delay the NDO still improves the tracking",
        "28.9 % in the ideal setting",
        tuple(f"twin_smc{suffix} {train}" for suffix in ("", "_ndo") for train in LAGGED_TRAINS),
        observer_adds,
    ),
)
