"""Judges of the claims of paper 003."""

from __future__ import annotations

from train_ato.papers.bounds import MUCH_BETTER, ROBUST, Bound, ratio, worst
from train_ato.papers.checks import GOAL, conclude, variation
from train_ato.papers.checks import recording as series_of
from train_ato.papers.claims import THREE, Claims, Judgement, Result, Results
from train_ato.papers.tracking import MOVING, late_cruise, moving, position_error, rms, speed_error, written
from train_ato.papers.tracking import largest_position_error as place
from train_ato.papers.tracking import largest_speed_error as fastest

CLAIMS = Claims()
WHERE_MOVING = f"speed errors only where v_ref > {MOVING:g} m/s"
PLACE = Bound("largest position error, printed", 0.1, "m", "paper: centimetres")
SPEED = Bound("rms speed error, printed", 0.01, "m/s", "paper: millimetres per second")
PLACE_CORRECTED = Bound("largest position error, corrected", 0.1, "m", "paper: centimetres")
SPEED_CORRECTED = Bound("rms speed error, corrected", 0.01, "m/s", "paper: millimetres per second")
CONVERGES = Bound("rms position error late at constant speed, printed", 2.5e-3, "m", "paper: 0, to the goal")
CONVERGES_CORRECTED = Bound("rms position error late at constant speed, corrected", 2.5e-3, "m", GOAL)
PLACE_GOAL = Bound("largest position error, corrected", 0.025, "m", GOAL)
SPEED_GOAL = Bound(
    "rms speed error, corrected",
    1e-3,
    "m/s",
    GOAL,
    note="the goals are close to the figures of an independent implementation of this law",
)
EFFECTIVE = ratio("position error with over without the delay state, printed", MUCH_BETTER, "paper: effective")
EFFECTIVE_CORRECTED = ratio("the same, corrected", MUCH_BETTER, "paper: effective")
NOMINAL = Bound("nominal position error", 0.5, "m", "usual stopping accuracy of main lines")
STURDY = ratio("largest position error over the nominal one", ROBUST, "robust: at most doubled")
QUIET = Bound("variation, quiet", 60.0, "kN/s", GOAL)
QUIET_PLACE = Bound("largest position error, quiet", 0.5, "m", "usual stopping accuracy of main lines")


def place_rms(result: Result) -> float:
    """Return the rms position error while moving [m]."""
    recording = series_of(result)
    return rms(position_error(recording)[moving(recording)])


def cruise_rms(result: Result) -> float:
    """Return the rms position error in the last half of the longest interval at constant speed [m]."""
    recording = series_of(result)
    return rms(position_error(recording)[late_cruise(recording)])


def moving_speed_rms(result: Result) -> float:
    """Return the rms speed error while moving [m/s]."""
    recording = series_of(result)
    return rms(speed_error(recording)[moving(recording)])


@CLAIMS.judged_by(
    "tracking without saturation",
    "position to centimetres, speed to millimetres per second",
    ("printed long", "corrected long"),
    THREE,
)
def centimetres(results: Results) -> Judgement:
    """Judge the tracking without saturation."""
    printed, corrected = results["printed long"], results["corrected long"]
    slow, slow_corrected = moving_speed_rms(printed), moving_speed_rms(corrected)
    measured = (
        f"position {written(place(printed), 'm')} at most, {written(place_rms(printed), 'm')} rms; speed "
        f"{written(fastest(printed), 'm/s')} at most, {written(slow, 'm/s')} rms ({WHERE_MOVING})"
    )
    return conclude(
        measured,
        [PLACE.check(place(printed)), SPEED.check(slow)],
        "with f known, at a tick of 0.05 s over the 286 km; the speed is judged by its rms",
        elsewhere=[PLACE_CORRECTED.check(place(corrected)), SPEED_CORRECTED.check(slow_corrected)],
        changed="only corrected",
        otherwise="neither printed nor corrected",
    )


@CLAIMS.judged_by(
    "Theorem 1: the errors converge to 0 without saturation", "0", ("printed long", "corrected long"), THREE
)
def asymptotic(results: Results) -> Judgement:
    """Judge the convergence of Theorem 1, with the goals of the corrected law."""
    printed, corrected = results["printed long"], results["corrected long"]
    slow = moving_speed_rms(corrected)
    left, left_corrected = cruise_rms(printed), cruise_rms(corrected)
    measured = (
        f"late at constant speed printed {written(left, 'm')} rms, corrected {written(left_corrected, 'm')} rms; "
        f"corrected over the run {written(place_rms(corrected), 'm')} rms, {written(place(corrected), 'm')} at most, "
        f"speed {written(slow, 'm/s')} rms ({WHERE_MOVING})"
    )
    return conclude(
        measured,
        [CONVERGES.check(left)],
        "the limit is judged in the last half of the longest interval at constant speed; the printed law converges",
        elsewhere=[
            CONVERGES_CORRECTED.check(left_corrected),
            PLACE_GOAL.check(place(corrected)),
            SPEED_GOAL.check(slow),
        ],
        changed="printed, lambda h/m leaks with a time constant of 24 hours and e1 follows -h/k1, which (11) and (30) "
        "leave out; with lambda in 1/s the goals are reached",
        otherwise="the error is beyond the goals, printed and corrected",
    )


@CLAIMS.judged_by(
    "the delay state takes the delay's influence away",
    "effective",
    (
        *(f"{law} {case}" for law in ("printed", "corrected") for case in ("nominal", "no delay state")),
        *("pid nominal", "pid alone"),
    ),
    THREE,
)
def delay(results: Results) -> Judgement:
    """Judge the contribution of the delay state, printed and corrected."""
    found = {
        law: [place(results[f"{law} {case}"]) for case in ("nominal", "no delay state")]
        for law in ("printed", "corrected")
    }
    preview, plain = place(results["pid nominal"]), place(results["pid alone"])
    texts = [f"{law} {written(kept, 'm')}, without it {written(out, 'm')}" for law, (kept, out) in found.items()]
    measured = (
        f"{'; '.join(texts)}; PID + preview {written(preview, 'm')}, PID without feed-forward {written(plain, 'm')}"
    )
    shares = {law: kept / left_out for law, (kept, left_out) in found.items()}
    return conclude(
        measured,
        [EFFECTIVE.check(shares["printed"])],
        "printed",
        elsewhere=[EFFECTIVE_CORRECTED.check(shares["corrected"])],
        changed="only corrected",
        otherwise=f"the error with the delay state is {shares['printed']:.2f} (printed) and {shares['corrected']:.2f} "
        "(corrected) of the one without; a PID with preview over the mean delay has "
        f"{preview / found['corrected'][0]:.2f} of the corrected error",
    )


@CLAIMS.judged_by(
    "robust to the train's parameters",
    "good",
    (
        *(f"printed {key}" for key in ("nominal", "half_more", "later", "lagging", "light")),
        "printed position noise",
        "corrected position noise",
    ),
)
def mismatch(results: Results) -> Judgement:
    """Judge the robustness to mismatch and noise: at most twice the nominal error."""
    trains = (("half_more", "delay x1.5"), ("later", "+0.6 s"), ("lagging", "lag 0.4 s"), ("light", "mass -20 %"))
    runs = [(label, results[f"printed {key}"]) for key, label in trains]
    cells = [f"{label} {written(place(run), 'm', 2)}" for label, run in runs]
    noisy, repaired = results["printed position noise"], results["corrected position noise"]
    nominal = place(results["printed nominal"])
    measured = (
        f"nominal {written(nominal, 'm', 2)}, {', '.join(cells)}; 0.1 m of position noise "
        f"{written(place(noisy), 'm', 2)} and {variation(noisy):.0f} kN/s (corrected "
        f"{written(place(repaired), 'm', 2)}, {variation(repaired):.0f} kN/s)"
    )
    shares = {label: place(run) / nominal for label, run in (*runs, ("position noise", noisy))}
    weak = [f"{label} ({share:.1f} times)" for label, share in shares.items() if not STURDY.check(share).holds]
    return conclude(
        measured,
        [STURDY.check(worst(shares.values())), NOMINAL.check(nominal)],
        "at most twice the nominal error in all of them",
        otherwise=f"more than twice the nominal error: {', '.join(weak) or 'none'}; the 5 ms filter turns noise of "
        "the position into full force",
    )


@CLAIMS.judged_by(
    "goal with 0.05 m/s of noise: variation of the command",
    "60 kN/s (goal)",
    (f"{key} noise" for key in ("printed", "corrected", "pid", "predictor", "quiet")),
)
def quiet(results: Results) -> Judgement:
    """Judge the goal for the command variation with noise."""
    found = {key: variation(results[f"{key} noise"]) for key in ("printed", "corrected", "pid", "predictor", "quiet")}
    measured = ", ".join(f"{key} {value:.0f}" for key, value in found.items()) + " kN/s"
    error = place(results["quiet noise"])
    return conclude(
        measured,
        [QUIET.check(found["quiet"]), QUIET_PLACE.check(error)],
        f"with low gains and a period of 0.2 s under predictor and eso; position {written(error, 'm')}",
        otherwise=f"beyond the goal; position {written(error, 'm')}",
    )
