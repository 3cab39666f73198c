"""What judges are made of: figures of results, and verdicts from bounds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from train_ato.history import History
from train_ato.reproduce.claims import Judgement, Result, Results, Verdict

__all__ = ["gain", "history", "judged", "largest", "rms", "variation", "within"]


def rms(result: Result) -> float:
    """Return the rms speed error [km/h]."""
    return float(result.summary["speed_rmse_kmh"])


def largest(result: Result) -> float:
    """Return the largest speed error [km/h]."""
    return float(result.summary["speed_error_max_kmh"])


def variation(result: Result) -> float:
    """Return the variation of the command [kN/s]."""
    return float(result.summary["command_variation_kn_per_s"])


def history(result: Result) -> History:
    """Return the series of a run.

    Raises
    ------
    ValueError
        If the run left none.
    """
    if result.history is None:
        raise ValueError("the run left no series")
    return result.history


def gain(better: Result, than: Result) -> float:
    """Return by how many per cent the rms speed error of one run is below that of another."""
    return 100.0 * (1.0 - rms(better) / rms(than))


def judged(measured: str, holds: bool, reason: str, elsewhere: bool = False) -> Judgement:
    """Return a judgement: reproduced if it holds, else whether it does in another setting."""
    if holds:
        return Judgement(measured, Verdict.REPRODUCED, reason)
    return Judgement(measured, Verdict.OTHER_SETTING if elsewhere else Verdict.NOT_REPRODUCED, reason)


def within(key: str, bound_rms: float, bound_largest: float, reason: str) -> Callable[[Results], Judgement]:
    """Return a judge that holds if rms and largest speed error of a case are within bounds [km/h]."""

    def judge(results: Results) -> Judgement:
        result = results[key]
        finite = bool(np.isfinite(rms(result)))
        holds = finite and rms(result) <= bound_rms and largest(result) <= bound_largest
        return judged(f"rms {rms(result):.4f}, largest {largest(result):.2f} km/h", holds, reason)

    return judge
