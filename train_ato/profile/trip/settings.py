"""Settings of the trip planner: stops, weights, limits of drives and couplers, rules of the air brake."""

from typing import Annotated

from pydantic import Field, model_validator

from plant_sim.si_model import SiModel
from plant_sim.units import Acceleration, Force, ForceRate, Length, Pressure, Ratio, Speed, Time, Usual


class AirBrakeRules(SiModel):
    """Rules for the applications of the air brake."""

    reductions: tuple[Pressure, ...] = Field(
        (), description="reductions of the brake pipe that a plan may use; default: the deepest one of the train"
    )
    pause: Time = Field(60.0, ge=0, description="minimum time from a release to the next application (recharge)")
    min_application: Time = Field(25.0, ge=0, description="minimum time from an application to its release")
    min_release_speed: Speed = Field(35 / 3.6, ge=0, description="no release below this speed")


class TripSettings(SiModel):
    """Journey, weights and limits of a trip plan; places are those of the train's front."""

    begin: Length | None = Field(None, description="start of the front; default: begin of the line plus half a vehicle")
    end: Length | None = Field(None, description="stop of the front; default: the last stop, or the end of the line")
    time: Time | None = Field(None, gt=0, description="running time; default: the time is free and has its weight")
    time_weight: float = Field(0.5, ge=0, description="energy that a second is worth without running time [kWh/s]")
    fatigue_weight: float = Field(
        0.0,
        ge=0,
        description="energy that a unit of coupler damage is worth [kWh]. A unit is one force cycle of 1 MN of one "
        "coupler. Above 0 the plan decreases traction and slew while this pays",
    )
    recovered: Ratio = Field(0.0, ge=0, le=1, description="share of the electric brake's work that counts as gained")
    traction: Ratio = Field(0.75, gt=0, le=1, description="used part of the traction envelope")
    brake: Ratio = Field(0.8, gt=0, le=1, description="used part of the electric brake")
    traction_max: Annotated[Force | None, Usual(5e3, 50e6)] = Field(
        None, gt=0, description="largest traction force of the train"
    )
    slew: Annotated[ForceRate, Usual(500, 100e6)] = Field(
        16e3, gt=0, description="largest change of the force of the train per second"
    )
    speed_margin: Speed = Field(1.3 / 3.6, ge=0, description="distance from the speed limits")
    coupler_max: Annotated[Force, Usual(20e3, 20e6)] = Field(
        600e3, gt=0, description="largest coupler force on the nominal train"
    )
    independent_units: bool = Field(
        True, description="several power units: shares of the force by place that lower the coupler forces"
    )
    final_speed: Speed = Field(4.5 / 3.6, gt=0, description="speed from which the train brakes to the stop")
    final_deceleration: Acceleration | None = Field(
        None,
        gt=0,
        description="approximate deceleration of this last part. The default is 1.1 times that of the running "
        "resistance, because the electric brake fades before standstill",
    )
    air_brake: AirBrakeRules = AirBrakeRules()

    @model_validator(mode="after")
    def _places(self) -> "TripSettings":
        if self.begin is not None and self.end is not None and self.end <= self.begin:
            raise ValueError(f"end = {self.end:g} m must lie beyond begin = {self.begin:g} m; move end on")
        return self
