"""What a plan is asked to keep: the keys of a scenario's ``profile: plan:`` and ``replan:`` blocks."""

from __future__ import annotations

from pydantic import Field, model_validator

from plant_sim.units import Acceleration, Jerk, Length, SiModel, Speed, Time

__all__ = ["PlanSettings", "ReplanSpec"]


class PlanSettings(SiModel):
    """Service limits, margin, journey and timetable of a plan. Places are those of the train's front."""

    begin: Length | None = Field(
        None, description="where the front starts; default: the first of several stops, or the line's begin"
    )
    end: Length | None = Field(None, description="where the front ends; default: the last stop, or the line's end")
    calling: bool = Field(True, description="call at the line's stops on the way")
    departure: Time = Field(0.0, ge=0, description="time of the first movement")
    dwell: Time | None = Field(None, ge=0, description="at every stop on the way; default: that of the stop")
    time: Time | None = Field(
        None, gt=0, description="running time from departure to arrival, stops included; default: least"
    )
    acceleration: Acceleration | None = Field(1.0, gt=0, description="service limit; null: the train's own")
    deceleration: Acceleration | None = Field(0.8, gt=0, description="service limit; null: the train's own")
    jerk: Jerk | None = Field(0.5, gt=0, description="null: unlimited")
    force_margin: float = Field(
        0.1, ge=0, lt=1, description="part of traction and brake envelopes kept for the controller"
    )
    speed_max: Speed | None = Field(
        None, gt=0, description="of the train; default: where traction ends, and a little below where the brakes end"
    )
    begin_speed: Speed = Field(0.0, ge=0, description="speed at the begin")
    end_speed: Speed = Field(0.0, ge=0, description="speed at the end")
    air_brake: bool = Field(
        True, description="count on the air brake where the train has one; in a run as far as brake.policy applies it"
    )
    point_mass: bool = Field(
        False, description="all of the train at its front: no length for limits, grades and curves"
    )

    grade_over_length: bool = Field(
        False, description="average grades, curves and tunnels over each vehicle's length, as the plant's option does"
    )

    @model_validator(mode="after")
    def _places(self) -> PlanSettings:
        if self.begin is not None and self.end is not None and self.end <= self.begin:
            raise ValueError(f"end = {self.end:g} m must lie beyond begin = {self.begin:g} m")
        return self


class ReplanSpec(SiModel):
    """When and how the rest of a profile is planned again while the train runs; ``replan: {}`` takes the defaults."""

    speed_error: Speed = Field(0.2, gt=0, description="a train so far off its profile is looked at, noise averaged")
    position_error: Length = Field(1.0, gt=0, description="the same, where it still falls back")
    sitting: Time = Field(
        1.0,
        gt=0,
        le=60,
        description="for so long the force must not follow the growing error; longer for slow trains and laws",
    )
    lead: Time = Field(1.0, ge=0, le=60, description="from the decision to the new profile; at least delay + lag")
    interval: Time = Field(
        5.0, ge=0, description="least time between two decisions; doubled after each that is refused"
    )
    both_ways: bool = Field(True, description="force that traction lacks is not counted on in braking, and vice versa")
    retry: Time | None = Field(
        None, gt=0, description="after so long traction is counted on again and the rest planned up to the old speeds"
    )
    plan: PlanSettings | None = Field(
        None, description="service limits and force_margin of the rest; default: those of the profile's own plan"
    )

    def settings(self, own: PlanSettings | None) -> PlanSettings:
        """Return what the rest has to keep; ``own`` are the settings that the profile was planned with."""
        return self.plan or own or PlanSettings(force_margin=0.05)
