"""Judges of paper 002 on the cascaded observer."""

from train_ato.papers.checks import conclude
from train_ato.papers.claims import REMOVED, THREE, Bound, Claims, Judgement, Results, worst
from train_ato.papers.p002_freight.cases import OBSERVER_TICKS
from train_ato.papers.p002_freight.checks import time_text
from train_ato.papers.p002_freight.observer_trials import FORMS

CLAIMS = Claims()
CASCADES = ("implicit", "levant")
"""Other forms of the cascade with the same structure."""
ON_BOARD = ("10 ms", "50 ms")
"""Sampling times of onboard computers."""
FOUND = Bound("time to 10 %, printed, 1 ms", 0.5, "s", "paper")
FOUND_ELSEWHERE = Bound("time to 10 %, implicit signs, 1 ms", 0.5, "s", "paper")
ACCURATE = Bound("largest error of d1 and d2, printed, 10 and 50 ms", REMOVED, "", "paper: accurate")
ACCURATE_CASCADE = Bound("the same, best other form of the cascade", REMOVED, "", "paper: accurate")
RATE = Bound("error of d1', printed, 1 ms", REMOVED, "", "paper: accurate")
RATE_CASCADE = Bound("error of d1', best other form of the cascade, 1 ms", REMOVED, "", "paper: accurate")
AGAIN = Bound("time to 10 % after the jump, printed", 0.5, "s", "paper, as at the start")
AGAIN_CASCADE = Bound("time to 10 % after the jump, the same form", 0.5, "s", "paper, as at the start")


def percent(value: float) -> str:
    """Return a fraction in per cent as text; ``useless`` from a factor of 10 on."""
    return f"{100 * value:.2g} %" if abs(value) < 10 else "useless"


@CLAIMS.judged_by(
    "the cascaded observer finds matched and unmatched disturbances",
    "within about 0.5 s",
    ("observers 0.01 ms", "observers 1 ms"),
    THREE,
)
def disturbances_found(results: Results) -> Judgement:
    """Judge the settling time of the estimates of d1 and d2."""
    fine, coarse = results["observers 0.01 ms"].summary, results["observers 1 ms"].summary
    print_fine, print_coarse = fine["printed settling"], coarse["printed settling"]
    measured = (
        f"as printed: within 10 % after {time_text(print_fine)} at a 0.01 ms step, {time_text(print_coarse)} at 1 ms "
        f"(error {percent(max(coarse['printed d1'], coarse['printed d2']))}); with implicit signs after "
        f"{time_text(coarse['implicit settling'])}"
    )
    left = worst((coarse["implicit d1"], coarse["implicit d2"]))
    return conclude(
        measured,
        [FOUND.check(print_coarse)],
        "the printed form works at a practical step",
        elsewhere=[FOUND_ELSEWHERE.check(coarse["implicit settling"])],
        changed="explicit sign functions suit continuous time only: the observer finds the disturbances at steps of "
        f"about 0.01 ms or with implicit signs; its filter of 0.02 s leaves {percent(left)}",
        otherwise="not within 0.5 s at 1 ms, printed or with implicit signs",
    )


def _largest_part(results: Results, form: str) -> float:
    """Return the largest error of d1 and d2 of a form at the sampling times on board."""
    return worst(results[f"observers {key}"].summary[f"{form} {part}"] for key in ON_BOARD for part in ("d1", "d2"))


@CLAIMS.judged_by(
    "the observer is ready for use on board",
    "accurate estimates",
    (f"observers {key}" for key in OBSERVER_TICKS),
    THREE,
)
def observer_sampling(results: Results) -> Judgement:
    """Judge the accuracy of the observer at the sampling times on board."""
    cells = []
    for key in OBSERVER_TICKS:
        figures = results[f"observers {key}"].summary
        best = min(FORMS, key=lambda name: figures[f"{name} d1"] + figures[f"{name} d2"])
        cells.append(f"{key}: printed {percent(max(figures['printed d1'], figures['printed d2']))}, best {best}")
    other = {form: _largest_part(results, form) for form in CASCADES}
    best = min(CASCADES, key=lambda form: other[form])
    return conclude(
        "; ".join(cells),
        [ACCURATE.check(_largest_part(results, "printed"))],
        "the printed form is accurate at 10 and 50 ms",
        elsewhere=[ACCURATE_CASCADE.check(other[best])],
        changed=f"an onboard computer samples at 10 ms and above: there the printed form fails, the form {best} works",
        otherwise="an onboard computer samples at 10 ms and above: there the printed form fails; the best other form "
        f"of the cascade, {best}, has up to {percent(other[best])}",
    )


@CLAIMS.judged_by(
    "the derivative of the unmatched disturbance is found, again after its jumps",
    "accurate",
    ("observers 1 ms",),
    THREE,
)
def derivative(results: Results) -> Judgement:
    """Judge the estimate of d1', also after the jumps of d21."""
    figures, rate = results["observers 1 ms"].summary, "d1'"
    parts = [f"{name} {percent(figures[f'{name} {rate}'])}" for name in FORMS]
    best = min(CASCADES, key=lambda name: figures[f"{name} {rate}"])
    again = figures[f"{best} again"]
    measured = (
        f"rms error of d1' at 1 ms: {', '.join(parts)}; after the jump again within 10 % in {time_text(again)} ({best})"
    )
    reason = (
        "as printed, the switching of k4 = 100 m/s² is in the estimate (its condition on k4 requires 278, and its e3 "
        f"contains the unknown d1); the best other form of the cascade, {best}, has "
        f"{percent(figures[f'{best} {rate}'])}"
    )
    return conclude(
        measured,
        [RATE.check(figures[f"printed {rate}"]), AGAIN.check(figures["printed again"])],
        "the derivative is found as printed",
        elsewhere=[RATE_CASCADE.check(figures[f"{best} {rate}"]), AGAIN_CASCADE.check(again)],
        changed=reason,
        otherwise=reason,
    )
