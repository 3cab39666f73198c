"""Figures of results, and verdicts from bounds, for the judges of all papers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from train_ato.loop.recording import Recording
from train_ato.papers.claims import Judgement, Result, Results, Verdict

GOOD, FAIR, BAD = Verdict.REPRODUCED, Verdict.OTHER_SETTING, Verdict.NOT_REPRODUCED


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


def judged(measured: str, holds: bool, reason: str, elsewhere: bool = False) -> Judgement:
    """Return a judgement: reproduced, only in another setting, or not reproduced."""
    if holds:
        return Judgement(measured, Verdict.REPRODUCED, reason)
    return Judgement(measured, Verdict.OTHER_SETTING if elsewhere else Verdict.NOT_REPRODUCED, reason)


def within(key: str, bound_rms: float, bound_largest: float, reason: str) -> Callable[[Results], Judgement]:
    """Return a judge of the bounds of rms and largest speed error of a case [km/h]."""

    def judge(results: Results) -> Judgement:
        result = results[key]
        finite = bool(np.isfinite(rms_kmh(result)))
        holds = finite and rms_kmh(result) <= bound_rms and largest_kmh(result) <= bound_largest
        return judged(f"rms {rms_kmh(result):.4f}, largest {largest_kmh(result):.2f} km/h", holds, reason)

    return judge
