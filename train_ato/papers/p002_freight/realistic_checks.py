"""Judges of the law of paper 002 on a realistic train: limited force, lag and delay."""

from __future__ import annotations

from train_ato.papers.checks import BAD, FAIR, GOOD
from train_ato.papers.checks import recording as series_of
from train_ato.papers.claims import Claims, Judgement, Results
from train_ato.papers.p002_freight.cases import DELAYS, LAWS, RATIOS
from train_ato.papers.p002_freight.checks import OFFSETS, STIFFNESS_KN
from train_ato.papers.tracking import mean_speed_error, position_error, rms, written

CLAIMS = Claims()
UNDER_WAY = 5.0
"""Begin of the evaluation [s]."""


def realistic(results: Results, key: str) -> tuple[float, float, float]:
    """Return rms position error of all cars [m], rms of the mean speed error [m/s] and largest coupler stretch [m]."""
    result = results[key]
    recording = series_of(result)
    scored = recording.time > UNDER_WAY
    couplers = max(result.summary["coupler_draft_max_kn"], -result.summary["coupler_buff_max_kn"]) / STIFFNESS_KN
    return rms(position_error(recording, OFFSETS)[scored]), rms(mean_speed_error(recording)[scored]), couplers


@CLAIMS.judged_by(
    "especially suited to matched and unmatched disturbances together (here: on a train with limits, lag and delay)",
    "strong robustness",
    tuple(f"{key} {delay}" for key in ("print", "scaled", "scaled predicted") for delay in DELAYS),
)
def real_train(results: Results) -> Judgement:
    """Judge the law of the paper on a train with limits, lag and delay."""
    found = {
        key: [realistic(results, f"{key} {delay}")[0] for delay in DELAYS]
        for key in ("print", "scaled", "scaled predicted")
    }
    measured = "; ".join(
        f"{LAWS[key][0]}: {', '.join(written(value, 'm', 2) for value in values)}" for key, values in found.items()
    )
    delays = ", ".join(f"{delay:g}" for delay in DELAYS)
    measured = f"position rms at delays of {delays} s: {measured}"
    if max(found["print"]) < 1.0:
        return Judgement(measured, GOOD, "the paper's gains hold on a real train")
    if max(found["scaled predicted"]) < 1.0:
        return Judgement(
            measured,
            FAIR,
            "only with gains of 0.3 and a prediction of the state over the delay; the paper has no actuator model",
        )
    return Judgement(measured, BAD, "control is lost with delay, at any gain")


@CLAIMS.judged_by(
    "goals of the realistic version: lag_smc, eso, predictor",
    "per car 0.20 m and coupler 0.43 m; slow 0.08 m/s, 0.27 m; common 0.6 m, 0.27 m; undisturbed 0.02 m (goal)",
    (
        *(f"{key} {delay}" for key in ("unit", "unit slow") for delay in DELAYS),
        *(f"common x{ratio}" for ratio in RATIOS),
        "unit undisturbed",
    ),
)
def goals(results: Results) -> Judgement:
    """Judge the goals of the realistic setting."""
    unit = [realistic(results, f"unit {delay}") for delay in DELAYS]
    slow = [realistic(results, f"unit slow {delay}") for delay in DELAYS]
    common = [realistic(results, f"common x{ratio}") for ratio in RATIOS]
    still = realistic(results, "unit undisturbed")[0]
    worst = [tuple(max(column) for column in zip(*rows, strict=True)) for rows in (unit, slow, common)]
    measured = (
        f"per car: {worst[0][0]:.2f} m rms, coupler {worst[0][2]:.2f} m; per car, slow: mean speed "
        f"{worst[1][1]:.3f} m/s, {worst[1][0]:.2f} m; common, true/model delay 0.75 ... 1.25: coupler "
        f"{worst[2][2]:.2f} m, {worst[2][0]:.2f} m; undisturbed {still:.3f} m"
    )
    met = {
        "per car": worst[0][0] <= 0.20 and worst[0][2] <= 0.43,
        "per car, slow": worst[1][1] <= 0.08 and worst[1][0] <= 0.27,
        "common": worst[2][2] <= 0.6 and worst[2][0] <= 0.27,
        "undisturbed": still <= 0.02,
    }
    missed = [name for name, reached in met.items() if not reached]
    if not missed:
        return Judgement(measured, GOOD, "every goal of the realistic version is reached")
    if worst[0][0] <= 0.25 and worst[0][2] <= 0.5 and missed == ["per car"]:
        return Judgement(
            measured,
            FAIR,
            "all goals but the coupler of the per-car law, which depends on the shape of the travelling load (here "
            "0.1 m/s² for 20 s on each car); the common command with more damping reaches it",
        )
    return Judgement(measured, BAD, f"not reached: {', '.join(missed)}")


@CLAIMS.judged_by(
    "one law that reaches the three goals together",
    "not reached before (goal)",
    (*(f"common damped {delay}" for delay in DELAYS), *(f"common damped x{ratio}" for ratio in RATIOS)),
)
def all_at_once(results: Results) -> Judgement:
    """Judge the three goals with one law."""
    known = [realistic(results, f"common damped {delay}") for delay in DELAYS]
    wrong = [realistic(results, f"common damped x{ratio}") for ratio in RATIOS]
    place, speed, coupler = (max(column) for column in zip(*known, strict=True))
    off_place, _, off_coupler = (max(column) for column in zip(*wrong, strict=True))
    measured = (
        f"delays up to 1.0 s: {place:.2f} m rms, mean speed {speed:.3f} m/s, coupler {coupler:.2f} m; true/model delay "
        f"0.75 ... 1.25: {off_place:.2f} m, coupler {off_coupler:.2f} m"
    )
    if place <= 0.20 and speed <= 0.08 and coupler <= 0.43 and off_coupler <= 0.6 and off_place <= 0.27:
        return Judgement(
            measured, GOOD, "one command for the train and a differential damping of 0.5 1/s reach all three goals"
        )
    if place <= 0.27 and off_place <= 0.27:
        return Judgement(measured, FAIR, "positions hold, the couplers or the speed do not")
    return Judgement(measured, BAD, "not at once")
