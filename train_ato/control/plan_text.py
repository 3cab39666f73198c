"""Plan of a law as texts of the diagnostics of the controller, once a second."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from train_ato.control.contract import LawPlan
from train_ato.messages.types import Array

STATUS = "plan.status"
"""Key of the result of the solver."""
PASSES = "passes the stop by"
"""Part of the status of a plan that cannot stop in front of its target, before the distance."""
ARRAYS = {f"plan.{name}": name for name in ("times", "position", "speed", "force", "slack")}
"""Arrays of a plan by their keys; the times are simulation times."""
MAX_POINTS = 200
"""Largest number of points in a text; a longer plan has the first ones."""
HELD = "held"
"""Status of a plan while the last command is repeated."""


class TimedPlan(NamedTuple):
    """Plan of a law and the simulation time of its measurement [s]."""

    t: float
    plan: LawPlan


def plan_to_text(timed: TimedPlan, *, held: bool = False) -> dict[str, str]:
    """Return a plan as texts by key: numbers with nine digits in SI, between blanks; times in simulation time.

    Parameters
    ----------
    timed
        The plan.
    held
        True while the last command is repeated, in place of the status of the plan.
    """
    found = {STATUS: HELD if held else " ".join(str(timed.plan.status).split())}
    for key, name in ARRAYS.items():
        values = np.asarray(getattr(timed.plan, name), dtype=np.float64).ravel()[:MAX_POINTS]
        shifted = values + timed.t if name == "times" else values
        found[key] = " ".join(f"{value:.9g}" for value in shifted.tolist())
    return found


def plan_from_text(values: Mapping[str, str | None]) -> TimedPlan | None:
    """Return the plan in the values of a diagnostics message; None without one, or with invalid numbers.

    The times are those of the run: ``t`` is 0.
    """
    if values.get(STATUS) is None:
        return None
    arrays: dict[str, Array] = {}
    for key, name in ARRAYS.items():
        try:
            arrays[name] = np.array([float(text) for text in (values.get(key) or "").split()])
        except ValueError:
            return None
    sizes = {array.size for array in arrays.values()}
    if len(sizes) != 1 or not all(math.isfinite(value) for array in arrays.values() for value in array.tolist()):
        return None
    return TimedPlan(0.0, LawPlan(**arrays, status=str(values[STATUS])))
