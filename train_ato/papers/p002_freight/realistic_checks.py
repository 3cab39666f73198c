"""Judges of the law of paper 002 on a realistic train: limited force, lag and delay."""

from __future__ import annotations

from collections.abc import Iterable

from train_ato.papers.bounds import Bound, worst
from train_ato.papers.checks import GOAL, conclude
from train_ato.papers.checks import recording as series_of
from train_ato.papers.claims import THREE, Claims, Judgement, Results
from train_ato.papers.p002_freight.cases import DELAYS, LAWS, RATIOS
from train_ato.papers.p002_freight.checks import OFFSETS, STIFFNESS_KN
from train_ato.papers.tracking import mean_speed_error, position_error, rms, written

CLAIMS = Claims()
UNDER_WAY = 5.0
"""Begin of the evaluation [s]."""
LOAD = "it depends on the shape of the travelling load, a choice here: 0.1 m/s² for 20 s on each car"
ROBUST = Bound("largest rms position error, gain 2", 0.27, "m", GOAL)
ROBUST_PREDICTED = Bound("largest rms position error, gain 0.3, predictor", 0.27, "m", GOAL)
UNIT, UNIT_COUPLER = Bound("per car: rms", 0.20, "m", GOAL), Bound("per car: coupler", 0.43, "m", GOAL, note=LOAD)
SLOW, SLOW_SPEED = Bound("slow: rms", 0.27, "m", GOAL), Bound("slow: mean speed", 0.08, "m/s", GOAL)
COMMON, COMMON_COUPLER = Bound("common: rms", 0.27, "m", GOAL), Bound("common: coupler", 0.6, "m", GOAL, note=LOAD)
STILL = Bound("undisturbed: rms", 0.02, "m", GOAL)
ONE, ONE_SPEED = Bound("rms", 0.20, "m", GOAL), Bound("mean speed", 0.08, "m/s", GOAL)
ONE_COUPLER = Bound("coupler", 0.43, "m", GOAL, note=LOAD)
ONE_OFF = Bound("rms, other delay", 0.27, "m", GOAL)
ONE_OFF_COUPLER = Bound("coupler, other delay", 0.6, "m", GOAL, note=LOAD)


def _worst(results: Results, keys: Iterable[str]) -> tuple[float, float, float]:
    """Return the largest of every figure of :func:`realistic` over some runs."""
    place, speed, coupler = (worst(column) for column in zip(*(realistic(results, key) for key in keys), strict=True))
    return place, speed, coupler


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
    THREE,
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
    return conclude(
        measured,
        [ROBUST.check(worst(found["print"]))],
        "the paper's gains hold on a real train",
        elsewhere=[ROBUST_PREDICTED.check(worst(found["scaled predicted"]))],
        changed="only with gains of 0.3 and a prediction of the state over the delay; the paper has no actuator model",
        otherwise="beyond the goal of the realistic version, at any gain",
    )


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
    unit = _worst(results, (f"unit {delay}" for delay in DELAYS))
    slow = _worst(results, (f"unit slow {delay}" for delay in DELAYS))
    common = _worst(results, (f"common x{ratio}" for ratio in RATIOS))
    still = realistic(results, "unit undisturbed")[0]
    measured = (
        f"per car: {unit[0]:.2f} m rms, coupler {unit[2]:.3f} m; per car, slow: mean speed {slow[1]:.3f} m/s, "
        f"{slow[0]:.2f} m; common, true/model delay 0.75 ... 1.25: coupler {common[2]:.3f} m, {common[0]:.2f} m; "
        f"undisturbed {still:.3f} m"
    )
    checks = [
        UNIT.check(unit[0]),
        UNIT_COUPLER.check(unit[2]),
        SLOW.check(slow[0]),
        SLOW_SPEED.check(slow[1]),
        COMMON.check(common[0]),
        COMMON_COUPLER.check(common[2]),
        STILL.check(still),
    ]
    missed = ", ".join(check.bound.quantity for check in checks if not check.holds)
    reason = f"every goal of the realistic version is reached; where a stretch is close to its goal, {LOAD}"
    return conclude(measured, checks, reason, otherwise=f"not reached: {missed}")


@CLAIMS.judged_by(
    "one law that reaches the three goals together",
    "all three (goal)",
    (*(f"common damped {delay}" for delay in DELAYS), *(f"common damped x{ratio}" for ratio in RATIOS)),
)
def all_at_once(results: Results) -> Judgement:
    """Judge the three goals with one law."""
    place, speed, coupler = _worst(results, (f"common damped {delay}" for delay in DELAYS))
    off_place, _, off_coupler = _worst(results, (f"common damped x{ratio}" for ratio in RATIOS))
    measured = (
        f"delays up to 1.0 s: {place:.2f} m rms, mean speed {speed:.3f} m/s, coupler {coupler:.3f} m; true/model delay "
        f"0.75 ... 1.25: {off_place:.2f} m, coupler {off_coupler:.3f} m"
    )
    checks = [
        ONE.check(place),
        ONE_SPEED.check(speed),
        ONE_COUPLER.check(coupler),
        ONE_OFF.check(off_place),
        ONE_OFF_COUPLER.check(off_coupler),
    ]
    missed = ", ".join(check.bound.quantity for check in checks if not check.holds)
    reason = "one command for the train and a differential damping of 0.5 1/s reach all three goals"
    return conclude(measured, checks, reason, otherwise=f"not reached: {missed}")
