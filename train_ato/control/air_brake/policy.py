"""When the air brake is applied and released: by a plan, or by the rules of paper 000, section 1.2.

A policy turns time, place and speed into the brake-pipe pressure demanded at the head. It is a function of the
measurement alone, so that the controller and the observer, each with its own copy, know of the same events.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Protocol

from pydantic import Field, model_validator

from plant_sim.line import Line
from plant_sim.units import Length, Pressure, SiModel, Slope, Speed, Time
from train_ato.brake.blending import Blended, BlendRules

if TYPE_CHECKING:
    from train_ato.model import TrainModel


class BrakeEvent(SiModel):
    """From a time, or from a place of vehicle 0's centre, on: the reduction of the brake pipe; 0 releases."""

    time: Time | None = Field(None, ge=0)
    place: Length | None = None
    reduction: Pressure = Field(ge=0)

    @model_validator(mode="after")
    def _one(self) -> BrakeEvent:
        if (self.time is None) == (self.place is None):
            raise ValueError("give exactly one of time and place")
        return self


class TriggerRules(SiModel):
    """Rules of paper 000, section 1.2: apply before long falls, release when slow enough."""

    reduction: Pressure = Field(50e3, gt=0, description="of an application")
    above: Speed = Field(60 / 3.6, ge=0, description="no application below this speed")
    ahead: Length = Field(2500.0, gt=0, description="stretch of line that is looked at")
    segments: int = Field(4, ge=1, description="so many steep segments in it")
    steeper: Slope = Field(-8e-3, lt=0, description="a segment is steep below this grade")
    longer: Length = Field(500.0, ge=0, description="so much of the segment inside the stretch")
    pause: Time = Field(160.0, ge=0, description="least time between two applications")
    drop: Speed = Field(10 / 3.6, ge=0, description="release so much below the speed at the application")
    margin: Speed = Field(0.5 / 3.6, ge=0, description="a release does not wait for the last bit of it")
    never_below: Speed = Field(35 / 3.6, ge=0, description="no release below this speed")


class BrakeSpec(SiModel):
    """The scenario's ``brake:`` block."""

    policy: Literal["none", "planned", "trigger", "blend"] = "none"
    events: tuple[BrakeEvent, ...] = ()
    trigger: TriggerRules = TriggerRules()
    blend: BlendRules = BlendRules()

    @model_validator(mode="after")
    def _fits(self) -> BrakeSpec:
        if self.policy == "planned" and not self.events:
            raise ValueError("policy planned needs events: a list of {time or place, reduction}")
        if self.policy != "planned" and self.events:
            raise ValueError(f"events are there but the policy is {self.policy}; set policy: planned or leave them out")
        return self

    @property
    def deepest(self) -> float:
        """Deepest reduction of the brake pipe that the policy makes [Pa]."""
        if self.policy == "planned":
            return max(event.reduction for event in self.events)
        return {"none": 0.0, "trigger": self.trigger.reduction, "blend": self.blend.reduction}[self.policy]


class BrakePolicy(Protocol):
    """Decides the brake-pipe pressure."""

    def step(self, t: float, position: float, velocity: float, applied: float = 0.0) -> float:
        """Return the pressure demanded [Pa, absolute].

        Parameters
        ----------
        t, position, velocity, applied
            Time [s], vehicle 0's centre [m], speed [m/s], force that all power units apply now [N].
        """


class Charged:
    """The air brake stays released."""

    def __init__(self, charged: float) -> None:
        self._charged = charged

    def step(self, t: float, position: float, velocity: float, applied: float = 0.0) -> float:
        """Return the charged pressure."""
        return self._charged


class Planned:
    """Events at fixed times or places, in the order in which they are listed."""

    def __init__(self, charged: float, events: tuple[BrakeEvent, ...]) -> None:
        self._charged = charged
        self._events = events
        self._next = 0
        self._pressure = charged

    def step(self, t: float, position: float, velocity: float, applied: float = 0.0) -> float:
        """Return the pressure after every event that is due."""
        while self._next < len(self._events):
            event = self._events[self._next]
            due = t >= event.time if event.time is not None else position >= (event.place or 0.0)
            if not due:
                break
            self._pressure = self._charged - event.reduction
            self._next += 1
        return self._pressure


class Triggered:
    """Paper 000's rules; V_set is the speed at the application."""

    def __init__(self, charged: float, rules: TriggerRules, line: Line) -> None:
        self._charged = charged
        self._rules = rules
        places = [grade.at for grade in line.grades] + [line.end]
        self._steep = [
            (begin, end)
            for grade, begin, end in zip(line.grades, places, places[1:], strict=False)
            if grade.grade < rules.steeper and end - begin > rules.longer
        ]
        self._applied_at: float | None = None
        self._release_below: float | None = None

    def step(self, t: float, position: float, velocity: float, applied: float = 0.0) -> float:
        """Return the pressure the rules demand."""
        rules = self._rules
        if self._release_below is not None:
            if rules.never_below <= velocity <= self._release_below:
                self._release_below = None
        elif self._may_apply(t, velocity) and self._falls_ahead(position):
            self._applied_at = t
            self._release_below = velocity - rules.drop + rules.margin
        return self._charged if self._release_below is None else self._charged - rules.reduction

    def _may_apply(self, t: float, velocity: float) -> bool:
        rested = self._applied_at is None or t - self._applied_at >= self._rules.pause
        return rested and velocity > self._rules.above

    def _falls_ahead(self, position: float) -> bool:
        horizon = position + self._rules.ahead
        inside = (min(end, horizon) - max(begin, position) for begin, end in self._steep)
        return sum(length > self._rules.longer for length in inside) >= self._rules.segments


def make_brake_policy(spec: BrakeSpec, model: TrainModel, line: Line) -> BrakePolicy:
    """Return a fresh policy.

    Raises
    ------
    ValueError
        If the train has no air brake to apply.
    """
    brake = model.consist.air_brake
    if brake is None:
        if spec.policy != "none":
            raise ValueError(f"brake.policy: {spec.policy}: the consist has no air_brake; set policy: none")
        return Charged(0.0)
    if spec.policy == "planned":
        if spec.deepest > brake.charged:
            raise ValueError(
                f"brake.events: a reduction of {spec.deepest:g} Pa exceeds the charged {brake.charged:g} Pa"
            )
        return Planned(brake.charged, spec.events)
    if spec.policy == "trigger":
        return Triggered(brake.charged, spec.trigger, line)
    if spec.policy == "blend":
        return Blended(brake.charged, spec.blend, model)
    return Charged(brake.charged)
