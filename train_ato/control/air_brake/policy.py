"""Policies of the air brake: none, planned events, trigger (paper 000, section 1.2), blend, trip, or predictive.

A policy computes the brake-pipe pressure demanded at the head from time, position, speed and measured force. It
depends on the measurement only, so that the copies in the controller and in the observer make the same events.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Literal

from pydantic import Field, model_validator

from plant_sim.compiled import compiled
from plant_sim.line import Line
from plant_sim.record import Records, quantity
from plant_sim.si_model import SiModel
from plant_sim.units import Length, Pressure, Slope, Speed, Time
from train_ato.control.air_brake.blending import BlendedBrake, BlendRules
from train_ato.control.air_brake.predictive_policy import PredictiveBrake, SpeedProfile
from train_ato.control.air_brake.predictive_rules import PredictiveRules
from train_ato.control.air_brake.record_policy import BrakeNow, BrakePolicy, NoRules, PolicyForm
from train_ato.control.air_brake.trip_policy import PlannedApplication, TripBrake, TripRules

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel


class BrakeEvent(SiModel):
    """Reduction of the brake pipe from a time or a position of vehicle 0's centre on; 0 releases."""

    time: Time | None = Field(None, ge=0)
    place: Length | None = None
    reduction: Pressure = Field(ge=0)

    @model_validator(mode="after")
    def _one(self) -> BrakeEvent:
        if (self.time is None) == (self.place is None):
            raise ValueError("a brake event has exactly one of time and place; give one")
        return self


class TriggerRules(SiModel):
    """Rules of paper 000, section 1.2: application before long falling grades, release at a lower speed."""

    reduction: Pressure = Field(50e3, gt=0, description="reduction of the brake pipe of an application")
    min_speed: Speed = Field(60 / 3.6, ge=0, description="no application below this speed")
    lookahead: Length = Field(2500.0, gt=0, description="length of line ahead that is searched for steep segments")
    segments: int = Field(4, ge=1, description="minimum number of steep segments in it")
    grade_below: Slope = Field(-8e-3, lt=0, description="a segment is steep below this grade")
    min_length: Length = Field(500.0, ge=0, description="minimum length of a segment inside the searched length")
    pause: Time = Field(160.0, ge=0, description="minimum time between two applications")
    release_drop: Speed = Field(10 / 3.6, ge=0, description="release at this amount below the speed of the application")
    release_margin: Speed = Field(0.5 / 3.6, ge=0, description="tolerance of the release speed")
    never_below: Speed = Field(35 / 3.6, ge=0, description="no release below this speed")


class BrakeSpec(SiModel):
    """The scenario's ``brake:`` block."""

    policy: Literal["none", "planned", "trigger", "blend", "trip", "predictive"] = "none"
    events: tuple[BrakeEvent, ...] = ()
    trigger: TriggerRules = TriggerRules()
    blend: BlendRules = BlendRules()
    applications: tuple[PlannedApplication, ...] = Field((), description="planned applications of policy trip")
    trip: TripRules = TripRules()
    predictive: PredictiveRules = PredictiveRules()

    @model_validator(mode="after")
    def _fits(self) -> BrakeSpec:
        if self.policy == "planned" and not self.events:
            raise ValueError("policy planned needs events; give a list of {time or place, reduction}")
        if self.policy != "planned" and self.events:
            raise ValueError(
                f"events need policy planned, here {self.policy}; set brake.policy: planned or remove brake.events"
            )
        if (self.policy == "trip") != bool(self.applications):
            raise ValueError(
                f"policy {self.policy} with {len(self.applications)} applications; policy trip needs some, the others "
                "have none"
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
    spec: BrakeSpec, model: TrainModel, line: Line, profile: SpeedProfile | None = None
) -> BrakePolicy:
    """Return a new policy; ``profile`` is that of the run, which the policy ``predictive`` needs.

    Raises
    ------
    ValueError
        If the train has no air brake, or a reduction exceeds the charged pressure or the table of the train.
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
        return BlendedBrake(brake.charged, spec.blend, model)
    if spec.policy == "predictive":
        if profile is None:
            raise ValueError("brake.policy: predictive: needs the speed profile of a run; set another policy")
        if spec.deepest > brake.reduction[-1]:
            raise ValueError(
                f"brake.predictive.reductions: {spec.deepest:g} Pa is deeper than the table of train "
                f"'{model.consist.name}', which ends at {brake.reduction[-1]:g} Pa; lower it"
            )
        return PredictiveBrake(brake.charged, spec.predictive, model, profile)
    return PlannedBrake(brake.charged)
