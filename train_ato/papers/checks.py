"""Figures of results, and verdicts from bounds, for the judges of all papers."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from train_ato.loop.recording import Recording
from train_ato.papers.bounds import Bound, Check
from train_ato.papers.claims import Judgement, Result, Results, Verdict

GOAL = "goal of this project"


def rms_kmh(result: Result) -> float:
    """Return the rms speed error [km/h]."""
    return float(result.summary["speed_rmse_kmh"])


def largest_kmh(result: Result) -> float:
    """Return the largest speed error [km/h]."""
    return float(result.summary["speed_error_max_kmh"])


def variation(result: Result) -> float:
    """Return the variation of the command [kN/s]."""
    return float(result.summary["command_variation_kn_per_s"])


def recording(result: Result) -> Recording:
    """Return the series of a run.

    Raises
    ------
    ValueError
        If the run has no recording.
    """
    if result.recording is None:
        raise ValueError("the run has no series")
    return result.recording


def gain(better: Result, than: Result) -> float:
    """Return the reduction of the rms speed error from one run to another [%]."""
    return 100.0 * (1.0 - rms_kmh(better) / rms_kmh(than))


def conclude(
    measured: str,
    reproduced: Iterable[Check],
    reason: str,
    *,
    elsewhere: Iterable[Check] = (),
    changed: str = "",
    otherwise: str = "",
) -> Judgement:
    """Return the judgement from the bounds of the claim and from those of the changed setting.

    Parameters
    ----------
    measured
        Measured figures as text.
    reproduced
        Bounds of the claim as stated.
    reason
        Reason if they hold, and of the other verdicts without a reason of their own.
    elsewhere
        Bounds in the changed setting; without any there is no such verdict.
    changed, otherwise
        Reasons for "only in another setting" and "not reproduced".
    """
    here, there = tuple(reproduced), tuple(elsewhere)
    checks = (*here, *(check for check in there if check not in here))
    if all(check.holds for check in here):
        return Judgement(measured, Verdict.REPRODUCED, reason, checks)
    if there and all(check.holds for check in there):
        return Judgement(measured, Verdict.OTHER_SETTING, changed or reason, checks)
    return Judgement(measured, Verdict.NOT_REPRODUCED, otherwise or reason, checks)


def within(key: str, bound_rms: float, bound_largest: float, reason: str) -> Callable[[Results], Judgement]:
    """Return a judge of the goals for rms and largest speed error of a case [km/h]."""
    bounds = (Bound("rms", bound_rms, "km/h", GOAL), Bound("largest", bound_largest, "km/h", GOAL))

    def judge(results: Results) -> Judgement:
        found = (rms_kmh(results[key]), largest_kmh(results[key]))
        checks = [bound.check(value) for bound, value in zip(bounds, found, strict=True)]
        return conclude(f"rms {found[0]:.4f}, largest {found[1]:.2f} km/h", checks, reason)

    return judge
