"""Settings of the planner: the keys of a scenario's blocks ``profile: plan:`` and ``replan:``."""

from __future__ import annotations

from pydantic import Field, model_validator

from plant_sim.si_model import SiModel
from plant_sim.units import Acceleration, Jerk, Length, Power, Speed, Time
from train_ato.profile.planner.timing_points import TimingPoint, check_points


class PlanSettings(SiModel):
    """Service limits, force margin, stops and timetable of a plan; places are those of the train's front."""

    begin: Length | None = Field(
        None, description="start of the front; default: the first of several stops, or the begin of the line"
    )
    end: Length | None = Field(None, description="end of the front; default: the last stop, or the end of the line")
    calling: bool = Field(True, description="stop at the intermediate stops of the line")
    departure: Time | None = Field(
        None,
        ge=0,
        description="time of the first movement; default: 0, in a scenario with a start from rest the time at which "
        "the first command takes effect, delay and lag",
    )
    dwell: Time | None = Field(
        None, ge=0, description="dwell time at every intermediate stop; default: that of the stop"
    )
    time: Time | None = Field(
        None,
        gt=0,
        description="timetable: running time from departure to arrival, dwell times included; default: minimum time",
    )
    points: tuple[TimingPoint, ...] | None = Field(
        None, description="timing points of a journey with their windows; in place of begin, end, calling and time"
    )
    acceleration: Acceleration | None = Field(1.0, gt=0, description="service limit; null: limited by the train only")
    deceleration: Acceleration | None = Field(0.8, gt=0, description="service limit; null: limited by the train only")
    jerk: Jerk | None = Field(0.5, gt=0, description="limit; null: none")
    force_margin: float = Field(
        0.1, ge=0, lt=1, description="fraction of traction and brake envelopes reserved for the controller"
    )
    speed_max: Speed | None = Field(
        None,
        gt=0,
        description="of the train; default: end of the traction envelope, at most 98 % of that of the brakes",
    )
    efficiency: float = Field(
        1.0, gt=0, le=1, description="of traction: energy taken from the line is the traction work over it"
    )
    recovered: float = Field(
        0.0, ge=0, le=1, description="share of the electric-brake work that returns to the line; 0: traction only"
    )
    auxiliary: Power = Field(0.0, ge=0, description="auxiliary power, part of the net energy at all times")
    begin_speed: Speed = Field(0.0, ge=0, description="speed at the begin")
    end_speed: Speed = Field(0.0, ge=0, description="speed at the end")
    air_brake: bool = Field(
        True, description="use the air brake if the train has one; in a scenario up to the reduction of brake.policy"
    )
    point_mass: bool = Field(
        False, description="point mass at the front: speed limits, grades and curves end where the front leaves them"
    )

    grade_over_length: bool = Field(
        False, description="average grades, curves and tunnels over the length of each vehicle, as in the plant"
    )

    @model_validator(mode="after")
    def _places(self) -> PlanSettings:
        if self.begin is not None and self.end is not None and self.end <= self.begin:
            raise ValueError(
                f"end = {self.end:g} m must lie beyond begin = {self.begin:g} m; exchange them or move end on"
            )
        if self.points is not None:
            check_points(self.points)
            for key in ("begin", "end", "time", "dwell"):
                if getattr(self, key) is not None:
                    raise ValueError(f"{key} with points: the timing points have it; remove {key}")
            if self.begin_speed > 0 or self.end_speed > 0:
                raise ValueError("begin_speed or end_speed with points: a journey begins and ends at rest; remove it")
        if self.point_mass and self.grade_over_length:
            raise ValueError(
                "grade_over_length = true with point_mass = true: a point mass has no length to average over; set one "
                "of them to false"
            )
        return self


class ReplanSpec(SiModel):
    """Re-planning during the run after a lack of force; ``replan: {}`` uses the defaults."""

    speed_error: Speed = Field(0.2, gt=0, description="speed error that starts the detection, averaged over the window")
    position_error: Length = Field(1.0, gt=0, description="position error that starts the detection if it still grows")
    confirmation_time: Time = Field(
        1.0,
        gt=0,
        le=60,
        description="duration of constant force at growing error; at least delay + 3 lag",
    )
    lead: Time = Field(
        1.0, ge=0, le=60, description="time from the decision to the start of the new profile; at least delay + lag"
    )
    interval: Time = Field(5.0, ge=0, description="minimum time between two decisions; doubled after each refused one")
    both_ways: bool = Field(
        True, description="a lack of traction also reduces the brake force counted on, and vice versa"
    )
    retry: Time | None = Field(
        None, gt=0, description="time after which the full traction is assumed again; default: never"
    )
    catch_up: bool = Field(
        False,
        description="return to the timetable or the timing points of the profile's plan at the least net energy; "
        "false: run at no place faster than the first profile",
    )
    lateness: Time | None = Field(
        None,
        gt=0,
        description="with catch_up: time late or early after which the rest is planned again, also without a lack of "
        "force; default: never",
    )
    plan: PlanSettings | None = Field(
        None, description="service limits and force_margin of the new plan; default: those of the profile's own plan"
    )

    @model_validator(mode="after")
    def _lateness_with_catch_up(self) -> ReplanSpec:
        if self.lateness is not None and not self.catch_up:
            raise ValueError("lateness without catch_up: the rest would have the same times; add catch_up: true")
        return self

    def settings(self, own: PlanSettings | None) -> PlanSettings:
        """Return the settings of the new plan; ``own`` are those of the scenario's plan, if there is one."""
        return self.plan or own or PlanSettings(force_margin=0.05)
