"""Policies of the air brake: none, planned events, trigger (paper 000, section 1.2), blend, trip, or predictive.

A policy computes the brake-pipe pressure demanded at the head from time, position, speed and measured force. It
depends on the measurement only, so that the copies in the controller and in the observer make the same events.

Blending: the air brake is applied near the limit of the electric brake and released well below it.

The policy uses the measured force of the power units, so it works with any law and needs no plan. The rule is not from
a paper; paper 000 uses position and speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Annotated, Literal

from pydantic import Field, model_validator

from plant_sim.compiled import compiled
from plant_sim.line import Line
from plant_sim.record import Records, quantity
from plant_sim.si_model import SiModel, option
from plant_sim.units import Place, Ratio, Reduction, Slope, Speed, Time, Usual
from train_ato.control.air_brake.predictive_policy import PredictiveBrake, PredictiveRules
from train_ato.control.air_brake.record_policy import (
    BrakeNow,
    BrakePolicy,
    NoRules,
    PolicyForm,
    departs,
    lasts,
    used_share,
)
from train_ato.control.air_brake.trip_policy import PlannedApplication, TripBrake, TripRules
from train_ato.control.contract import ProfileLike
from train_ato.control.train_model import TrainModel


class BlendRules(SiModel):
    """Conditions for the air brake beside the electric brake."""

    reduction: Reduction = option(50e3, "reduction of the brake pipe for an application", gt=0)
    call: Ratio = option(0.9, "used part of the electric brake from which the air brake is applied", gt=0, le=1)
    call_after: Time = option(5.0, "time above call before an application", ge=0)
    ease: Ratio = option(0.35, "used part of the electric brake up to which the air brake is released", ge=0, lt=1)
    ease_after: Time = option(5.0, "time below ease before a release", ge=0)
    pause: Time = option(
        60.0, "least time from a release to the next application, in which the reservoirs recharge", ge=0
    )
    never_below: Annotated[Speed, Usual(0.3, 40)] = option(
        35 / 3.6, "speed below which no release occurs, except for a departure from standstill", ge=0
    )

    @model_validator(mode="after")
    def _apart(self) -> BlendRules:
        if self.ease >= self.call:
            raise ValueError(f"ease {self.ease:g} must be below call {self.call:g}, or the brake cycles; lower ease")
        return self


@dataclass
class BlendState:
    """State of :func:`blend_reduction`."""

    applied: bool = quantity("", "the brake is applied")
    rest: float = quantity("s", "begin of the standstill with applied brakes")
    since: float = quantity("s", "begin of the condition of the next change")
    released_at: float = quantity("s", "time of the last release")


@compiled
def blend_reduction(p: BlendRules, state: BlendState, rows: Records[NoRules], now: BrakeNow) -> float:
    """Return the reduction by the used part of the electric brake [Pa]."""
    share = used_share(now)
    if state.applied:
        eased = share <= p.ease and now.velocity >= p.never_below
        wanted, after = departs(state, now.t, now.velocity, now.applied) or eased, p.ease_after
    else:
        rested = now.t - state.released_at >= p.pause
        wanted, after = share >= p.call and rested and now.velocity >= p.never_below, p.call_after
    if lasts(state, wanted, now.t, after):
        state.applied = not state.applied
        state.rest, state.since = inf, inf
        state.released_at = state.released_at if state.applied else now.t
    return p.reduction if state.applied else 0.0


class BlendedBrake(BrakePolicy):
    """Policy that applies and releases by the used part of the electric brake."""

    form = PolicyForm(blend_reduction, BlendRules, BlendState, NoRules)

    def __init__(self, charged: float, rules: BlendRules, model: TrainModel) -> None:
        super().__init__(charged, rules, model=model)
        self.state["rest"], self.state["since"], self.state["released_at"] = inf, inf, -inf


class BrakeEvent(SiModel):
    """Reduction of the brake pipe from a time or a position of vehicle 0's centre on; 0 releases."""

    time: Time | None = option(None, "time of the reduction", example=60.0, ge=0)
    place: Place | None = option(None, "position of vehicle 0's centre at the reduction", example=1200.0)
    reduction: Reduction = Field(ge=0, description="reduction of the brake pipe; 0 releases", examples=[50e3])

    @model_validator(mode="after")
    def _one(self) -> BrakeEvent:
        if (self.time is None) == (self.place is None):
            raise ValueError("a brake event has exactly one of time and place; give one")
        return self


class TriggerRules(SiModel):
    """Rules of paper 000, section 1.2: application before long falling grades, release at a lower speed."""

    reduction: Reduction = option(50e3, "reduction of the brake pipe for an application", gt=0)
    min_speed: Annotated[Speed, Usual(0.3, 40)] = option(60 / 3.6, "speed below which no application occurs", ge=0)
    lookahead: Place = option(2500.0, "length of line ahead in which steep segments are counted", gt=0)
    segments: int = option(4, "least number of steep segments for an application", ge=1)
    grade_below: Slope = option(-8e-3, "grade below which a segment is steep", lt=0)
    min_length: Place = option(500.0, "least length of a segment inside the lookahead", ge=0)
    pause: Time = option(160.0, "least time between two applications", ge=0)
    release_drop: Speed = option(
        10 / 3.6, "amount below the speed of the application at which the brake is released", ge=0
    )
    release_margin: Speed = option(0.5 / 3.6, "tolerance of the release speed", ge=0)
    never_below: Annotated[Speed, Usual(0.3, 40)] = option(35 / 3.6, "speed below which no release occurs", ge=0)


class BrakeSpec(SiModel):
    """Service braking by the air brake, from a policy with its rules."""

    policy: Literal["none", "planned", "trigger", "blend", "trip", "predictive"] = option(
        "none", "origin of the applications of the air brake"
    )
    events: tuple[BrakeEvent, ...] = option(
        (), "applications and releases of policy planned", example=[{"place": 1200.0, "reduction": 50e3}]
    )
    trigger: TriggerRules = TriggerRules()
    blend: BlendRules = BlendRules()
    applications: tuple[PlannedApplication, ...] = option((), "applications of policy trip")
    trip: TripRules = TripRules()
    predictive: PredictiveRules = PredictiveRules()

    @model_validator(mode="after")
    def _fits(self) -> BrakeSpec:
        for policy, key, rows, remedy in (
            ("planned", "events", self.events, "give a list of {time or place, reduction}"),
            ("trip", "applications", self.applications, "take those of `train-ato plan LINE TRAIN --trip`"),
        ):
            if self.policy == policy and not rows:
                raise ValueError(f"policy {policy} needs {key}; {remedy}")
            if self.policy != policy and rows:
                raise ValueError(
                    f"{key} need policy {policy}, here {self.policy}; set brake.policy: {policy} or brake.{key}: []"
                )
        return self

    @property
    def deepest(self) -> float:
        """Largest reduction of the brake pipe by the policy [Pa]."""
        if self.policy == "planned":
            return max(event.reduction for event in self.events)
        if self.policy == "trip":
            return max(application.reduction for application in self.applications)
        if self.policy == "predictive":
            return self.predictive.reductions[-1]
        return {"none": 0.0, "trigger": self.trigger.reduction, "blend": self.blend.reduction}[self.policy]


@dataclass
class EventRow:
    """Reduction from a time or a place on; the other one is infinite."""

    time: float = quantity("s", "time")
    place: float = quantity("m", "position of vehicle 0's centre")
    reduction: float = quantity("Pa", "reduction of the brake pipe")


@dataclass
class PlannedState:
    """State of :func:`planned_reduction`."""

    following: int = quantity("1", "number of the next event")
    reduction: float = quantity("Pa", "reduction of the last event")


@compiled
def planned_reduction(p: NoRules, state: PlannedState, rows: Records[EventRow], now: BrakeNow) -> float:
    """Return the reduction of the last event that is due [Pa]."""
    while state.following < rows.size:
        event = rows[state.following]
        if not (now.t >= event.time or now.position >= event.place):
            break
        state.reduction = event.reduction
        state.following += 1
    return state.reduction


class PlannedBrake(BrakePolicy):
    """Policy with events at fixed times or positions, in the order of the list; released without events."""

    form = PolicyForm(planned_reduction, NoRules, PlannedState, EventRow)

    def __init__(self, charged: float, events: tuple[BrakeEvent, ...] = ()) -> None:
        rows = [(inf if e.time is None else e.time, inf if e.place is None else e.place, e.reduction) for e in events]
        super().__init__(charged, NoRules(), rows)


@dataclass
class SteepSegment:
    """Segment of the line below the grade of the rules."""

    begin: float = quantity("m", "begin")
    end: float = quantity("m", "end")


@dataclass
class TriggerState:
    """State of :func:`trigger_reduction`; V_set of the paper is the speed at the application."""

    applied: bool = quantity("", "the brake is applied")
    applied_at: float = quantity("s", "time of the last application")
    release_below: float = quantity("m/s", "largest speed of the release")


@compiled
def trigger_reduction(p: TriggerRules, state: TriggerState, rows: Records[SteepSegment], now: BrakeNow) -> float:
    """Return the reduction by the rules of paper 000, section 1.2 [Pa]."""
    if state.applied:
        state.applied = not p.never_below <= now.velocity <= state.release_below
    elif now.t - state.applied_at >= p.pause and now.velocity > p.min_speed:
        steep = 0
        for segment in rows:
            inside = min(segment.end, now.position + p.lookahead) - max(segment.begin, now.position)
            steep += inside > p.min_length
        if steep >= p.segments:
            state.applied, state.applied_at = True, now.t
            state.release_below = now.velocity - p.release_drop + p.release_margin
    return p.reduction if state.applied else 0.0


class TriggeredBrake(BrakePolicy):
    """Policy of paper 000, section 1.2."""

    form = PolicyForm(trigger_reduction, TriggerRules, TriggerState, SteepSegment)

    def __init__(self, charged: float, rules: TriggerRules, line: Line) -> None:
        places = [grade.at for grade in line.grades] + [line.end]
        steep = [
            (begin, end)
            for grade, begin, end in zip(line.grades, places, places[1:], strict=False)
            if grade.grade < rules.grade_below and end - begin > rules.min_length
        ]
        super().__init__(charged, rules, steep)
        self.state["applied_at"] = -inf


def make_brake_policy(
    spec: BrakeSpec, model: TrainModel, line: Line, profile: ProfileLike | None = None
) -> BrakePolicy:
    """Return a new policy; ``profile`` is that of the run, which the policy ``predictive`` needs.

    Raises
    ------
    ValueError
        If the train lacks a brake of the policy, or a reduction exceeds the charged pressure or the table of the train.
    """
    brake = model.consist.air_brake
    if brake is None:
        if spec.policy != "none":
            raise ValueError(f"brake.policy: {spec.policy}: the consist has no air_brake; set brake.policy: none")
        return PlannedBrake(0.0)
    if spec.policy in ("planned", "trip"):
        if spec.deepest > brake.charged:
            key = "events" if spec.policy == "planned" else "applications"
            raise ValueError(
                f"brake.{key}: a reduction of {spec.deepest:g} Pa exceeds the charged {brake.charged:g} Pa; lower it"
            )
        if spec.policy == "trip":
            return TripBrake(brake.charged, spec.applications, spec.trip, model)
        return PlannedBrake(brake.charged, spec.events)
    if spec.policy == "trigger":
        return TriggeredBrake(brake.charged, spec.trigger, line)
    if spec.policy == "blend":
        if not any(each.rows.size for each in model.brake):
            raise ValueError(
                f"brake.policy: blend: train '{model.consist.name}' has no electric brake, whose use calls the air "
                "brake; set brake.policy: predictive or planned"
            )
        return BlendedBrake(brake.charged, spec.blend, model)
    if spec.policy == "predictive":
        assert profile is not None
        if spec.deepest > brake.reduction[-1]:
            raise ValueError(
                f"brake.predictive.reductions: {spec.deepest:g} Pa is deeper than the table of train "
                f"'{model.consist.name}', which ends at {brake.reduction[-1]:g} Pa; lower it"
            )
        return PredictiveBrake(brake.charged, spec.predictive, model, profile)
    return PlannedBrake(brake.charged)
