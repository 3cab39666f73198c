"""Policies of the air brake: none, planned events, trigger (paper 000, section 1.2), blend, trip, or predictive.

A policy computes the brake-pipe pressure demanded at the head from time, position, speed and measured force. It
depends on the measurement only, so that the copies in the controller and in the observer make the same events.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Protocol

from pydantic import Field, model_validator

from plant_sim.line import Line
from plant_sim.units import Length, Pressure, SiModel, Slope, Speed, Time
from train_ato.control.air_brake.blending import BlendedBrake, BlendRules
from train_ato.control.air_brake.predictive_policy import PredictiveBrake, SpeedProfile
from train_ato.control.air_brake.predictive_rules import PredictiveRules
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


class BrakePolicy(Protocol):
    """Policy of the air brake."""

    def step(self, t: float, position: float, velocity: float, applied: float = 0.0) -> float:
        """Return the pressure demanded [Pa, absolute].

        Parameters
        ----------
        t, position, velocity, applied
            Time [s], position of vehicle 0's centre [m], speed [m/s], measured force of all power units [N].
        """


class ReleasedBrake:
    """Policy without application of the air brake."""

    def __init__(self, charged: float) -> None:
        self._charged = charged

    def step(self, t: float, position: float, velocity: float, applied: float = 0.0) -> float:
        """Return the charged pressure [Pa]."""
        return self._charged

    @property
    def next_event(self) -> BrakeEvent | None:
        """None: no event changes the pressure."""
        return None


class PlannedBrake:
    """Policy with events at fixed times or positions, in the order of the list."""

    def __init__(self, charged: float, events: tuple[BrakeEvent, ...]) -> None:
        self._charged = charged
        self._events = events
        self._next = 0
        self._pressure = charged

    def step(self, t: float, position: float, velocity: float, applied: float = 0.0) -> float:
        """Return the pressure of the last event that is due [Pa]."""
        while self._next < len(self._events):
            event = self._events[self._next]
            due = t >= event.time if event.time is not None else position >= (event.place or 0.0)
            if not due:
                break
            self._pressure = self._charged - event.reduction
            self._next += 1
        return self._pressure

    @property
    def next_event(self) -> BrakeEvent | None:
        """The next event that changes the pressure, None after the last one."""
        return self._events[self._next] if self._next < len(self._events) else None


class TriggeredBrake:
    """Policy of paper 000, section 1.2; V_set is the speed at the application."""

    def __init__(self, charged: float, rules: TriggerRules, line: Line) -> None:
        self._charged = charged
        self._rules = rules
        places = [grade.at for grade in line.grades] + [line.end]
        self._steep = [
            (begin, end)
            for grade, begin, end in zip(line.grades, places, places[1:], strict=False)
            if grade.grade < rules.grade_below and end - begin > rules.min_length
        ]
        self._applied_at: float | None = None
        self._release_below: float | None = None

    def step(self, t: float, position: float, velocity: float, applied: float = 0.0) -> float:
        """Return the pressure demanded by the rules [Pa]."""
        rules = self._rules
        if self._release_below is not None:
            if rules.never_below <= velocity <= self._release_below:
                self._release_below = None
        elif self._may_apply(t, velocity) and self._falls_ahead(position):
            self._applied_at = t
            self._release_below = velocity - rules.release_drop + rules.release_margin
        return self._charged if self._release_below is None else self._charged - rules.reduction

    def _may_apply(self, t: float, velocity: float) -> bool:
        rested = self._applied_at is None or t - self._applied_at >= self._rules.pause
        return rested and velocity > self._rules.min_speed

    def _falls_ahead(self, position: float) -> bool:
        horizon = position + self._rules.lookahead
        inside = (min(end, horizon) - max(begin, position) for begin, end in self._steep)
        return sum(length > self._rules.min_length for length in inside) >= self._rules.segments


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
        return ReleasedBrake(0.0)
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
    return ReleasedBrake(brake.charged)
