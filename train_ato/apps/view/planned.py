"""Plan of the law for the page: planned speed over the place, and status of the solver as text."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from plant_sim.units import KMH
from train_ato.apps.view.facts import Facts
from train_ato.control.contract import LawPlan
from train_ato.control.plan_text import ARRAYS, STATUS, plan_from_text
from train_ato.loop.series import DiagnosticSeries
from train_ato.messages.types import Array

PLAN_LASTS = 2.0
"""Time from the first point of a plan on after which it is not drawn [s]: twice the time between two plans."""
LEAST_SLACK = 0.05
"""Smallest excess of the permitted speed that is shown [km/h]: half of the last digit."""


def reported_plan(values: Mapping[str, str | None]) -> LawPlan | None:
    """Return the plan in the diagnostics of the controller, with simulation times; None without one."""
    found = plan_from_text(values)
    return None if found is None else found.plan


def plan_of_row(series: DiagnosticSeries, row: int) -> LawPlan | None:
    """Return the plan in a row of the diagnostics of the controller; None without one."""
    if STATUS not in series.values:
        return None
    return reported_plan({key: series.texts(key)[row] for key in (STATUS, *ARRAYS)})


def is_current(plan: LawPlan, time: float) -> bool:
    """Return True if a plan holds at a simulated time [s]."""
    return bool(plan.times.size) and plan.times[0] + PLAN_LASTS > time


def plan_columns(plan: LawPlan | None, time: float, facts: Facts) -> dict[str, Array]:
    """Return place of the front of the train [km] and planned speed [km/h]; empty without a plan at this time [s]."""
    if plan is None or not is_current(plan, time):
        return {"place": np.zeros(0), "speed": np.zeros(0)}
    return {"place": (plan.position + facts.nose) / 1e3, "speed": KMH * plan.speed}


def plan_words(plan: LawPlan | None, time: float) -> str:
    """Return status of the solver and largest excess of the permitted speed as text; "" without a plan."""
    if plan is None or not is_current(plan, time):
        return ""
    excess = KMH * float(plan.slack.max())
    return f"plan {plan.status}" + (f", {excess:.1f} km/h above the limit" if excess > LEAST_SLACK else "")
