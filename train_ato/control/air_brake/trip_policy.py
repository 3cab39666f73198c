"""Policy of a planned trip: applications at planned places, moved by the measured use of the electric brake.

A plan is for the nominal train. On the real train the use of the electric brake differs, because the controller keeps
the planned speed with it. A heavier train or weaker shoes need more of the electric brake than planned, and more
resistance needs less. The share of the electric brake in use therefore moves an application by up to ``shift``:

* apply earlier if the electric brake is nearly used up; later while it is used clearly less than planned;
* release earlier if the drives pull against the shoes, or before the speed falls below the minimum release speed; later
  while the electric brake is used clearly more than planned;
* apply without a plan if the electric brake is used up and the recharge pause has passed.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Annotated

from pydantic import Field, model_validator

from plant_sim.compiled import compiled
from plant_sim.record import Records, quantity
from plant_sim.si_model import SiModel, option
from plant_sim.units import Place, Ratio, Reduction, Speed, Time, Usual
from train_ato.control.air_brake.record_policy import BrakeNow, BrakePolicy, PolicyForm, departs, lasts, used_share
from train_ato.control.train_model import TrainModel


class PlannedApplication(SiModel):
    """Application of the air brake in a plan; places are those of vehicle 0's centre."""

    apply: Place = Field(description="place of the application", examples=[5000.0])
    release: Place = Field(description="place of the release", examples=[9000.0])
    reduction: Reduction = option(50e3, "reduction of the brake pipe", gt=0)
    electric_at_apply: Ratio = option(
        0.0, "planned use of the electric brake at the application", example=0.9, ge=-1, le=1
    )
    electric_at_release: Ratio = option(
        0.0, "planned use of the electric brake at the release", example=0.3, ge=-1, le=1
    )

    @model_validator(mode="after")
    def _in_order(self) -> PlannedApplication:
        if self.release <= self.apply:
            raise ValueError(f"release {self.release:g} m must lie beyond apply {self.apply:g} m; exchange them")
        return self


class TripRules(SiModel):
    """Rules that move the planned applications."""

    shift: Place = option(300.0, "largest distance by which an application or a release moves", ge=0)
    call: Ratio = option(0.92, "use of the electric brake from which the air brake is applied", gt=0, le=1)
    ease: Ratio = option(0.35, "use of the electric brake up to which an unplanned application is released", ge=0, lt=1)
    after: Time = option(4.0, "time above call before an application, and below ease before a release", ge=0)
    tolerance: Ratio = option(0.15, "difference from the planned use that moves a place", ge=0, le=1)
    pause: Time = option(60.0, "least time from a release to an unplanned application", ge=0)
    never_below: Annotated[Speed, Usual(0.3, 40)] = option(
        35 / 3.6, "speed below which no release occurs, except for a departure", ge=0
    )
    release_margin: Speed = option(0.5 / 3.6, "distance from never_below at which a planned release comes early", ge=0)


@dataclass
class TripState:
    """State of :func:`trip_reduction`."""

    following: int = quantity("1", "number of the present or next planned application")
    reduction: float = quantity("Pa", "present reduction")
    planned: bool = quantity("", "the present application is that of the plan")
    rest: float = quantity("s", "begin of the standstill with applied brakes")
    since: float = quantity("s", "begin of the condition of the next change")
    released_at: float = quantity("s", "time of the last release")


@compiled
def _decide_application(p: TripRules, state: TripState, rows: Records[PlannedApplication], now: BrakeNow) -> None:
    """Apply if the electric brake is used up, or at the place of the plan."""
    share = used_share(now)
    full = lasts(state, share >= p.call, now.t, p.after)
    while state.following < rows.size and now.position >= rows[state.following].release:
        state.following += 1  # passed without need, or within an unplanned application
    if state.following < rows.size and now.position >= rows[state.following].apply - p.shift:
        plan = rows[state.following]
        spared = share < plan.electric_at_apply - p.tolerance
        late = now.position >= plan.apply + (p.shift if spared else 0.0)
        if full or late:
            state.reduction, state.planned, state.rest, state.since = plan.reduction, True, inf, inf
    elif full and now.t - state.released_at >= p.pause and now.velocity >= p.never_below:
        state.reduction, state.planned, state.rest, state.since = 0.0, False, inf, inf
        for plan in rows:
            state.reduction = max(state.reduction, plan.reduction)


@compiled
def _release_due(p: TripRules, state: TripState, rows: Records[PlannedApplication], now: BrakeNow) -> bool:
    """Return True if the present application ends now."""
    share = used_share(now)
    if now.velocity < p.never_below:
        return False
    if not state.planned:
        return bool(lasts(state, share <= p.ease, now.t, p.after))
    plan = rows[state.following]
    pulling = lasts(state, share < 0.0, now.t, p.after)
    if now.position < plan.release - p.shift:
        return False
    slow = now.velocity <= p.never_below + p.release_margin
    strained = share > plan.electric_at_release + p.tolerance
    return pulling or slow or now.position >= plan.release + (p.shift if strained else 0.0)


@compiled
def trip_reduction(p: TripRules, state: TripState, rows: Records[PlannedApplication], now: BrakeNow) -> float:
    """Return the reduction by plan and used part of the electric brake [Pa]."""
    if state.reduction == 0.0:
        _decide_application(p, state, rows, now)
    else:
        leaves = departs(state, now.t, now.velocity, now.applied)
        if _release_due(p, state, rows, now) or leaves:
            state.following += state.planned
            state.reduction, state.since, state.released_at = 0.0, inf, now.t
    return state.reduction


class TripBrake(BrakePolicy):
    """Policy with the applications of a plan in the order of the line, moved by the use of the electric brake."""

    form = PolicyForm(trip_reduction, TripRules, TripState, PlannedApplication)

    def __init__(
        self, charged: float, applications: tuple[PlannedApplication, ...], rules: TripRules, model: TrainModel
    ) -> None:
        super().__init__(charged, rules, [tuple(dict(entry).values()) for entry in applications], model)
        self.state["since"], self.state["released_at"] = inf, -inf
