"""Settings of the trip planner: stops, weights, limits of drives and couplers, rules of the air brake."""

from typing import Annotated

from pydantic import model_validator

from plant_sim.si_model import SiModel, option
from plant_sim.units import Acceleration, Force, ForceRate, Length, Pressure, Ratio, Speed, Time, Usual


class AirBrakeRules(SiModel):
    """Rules for the applications of the air brake."""

    reductions: tuple[Pressure, ...] = option(
        (), "reductions of the brake pipe that a plan may use; default: the deepest one of the train"
    )
    pause: Time = option(60.0, "minimum time from a release to the next application (recharge)", ge=0)
    min_application: Time = option(25.0, "minimum time from an application to its release", ge=0)
    min_release_speed: Speed = option(35 / 3.6, "no release below this speed", ge=0)


class TripSettings(SiModel):
    """Journey, weights and limits of a trip plan; places are those of the train's front."""

    begin: Length | None = option(None, "start of the front; default: begin of the line plus half a vehicle")
    end: Length | None = option(None, "stop of the front; default: the last stop, or the end of the line")
    time: Time | None = option(None, "running time; default: the time is free and has its weight", gt=0)
    time_weight: float = option(0.5, "energy that a second is worth without running time [kWh/s]", ge=0)
    fatigue_weight: float = option(
        0.0,
        "energy that a unit of coupler damage is worth [kWh]. A unit is one force cycle of 1 MN of one "
        "coupler. Above 0 the plan decreases traction and slew while this pays",
        ge=0,
    )
    recovered: Ratio = option(0.0, "share of the electric brake's work that counts as gained", ge=0, le=1)
    traction: Ratio = option(0.75, "used part of the traction envelope", gt=0, le=1)
    brake: Ratio = option(0.8, "used part of the electric brake", gt=0, le=1)
    traction_max: Annotated[Force | None, Usual(5e3, 50e6)] = option(None, "largest traction force of the train", gt=0)
    slew: Annotated[ForceRate, Usual(500, 100e6)] = option(
        16e3, "largest change of the force of the train per second", gt=0
    )
    speed_margin: Speed = option(1.3 / 3.6, "distance from the speed limits", ge=0)
    coupler_max: Annotated[Force, Usual(20e3, 20e6)] = option(600e3, "largest coupler force on the nominal train", gt=0)
    independent_units: bool = option(
        True, "several power units: shares of the force by place that lower the coupler forces"
    )
    final_speed: Speed = option(4.5 / 3.6, "speed from which the train brakes to the stop", gt=0)
    final_deceleration: Acceleration | None = option(
        None,
        "approximate deceleration of this last part. The default is 1.1 times that of the running "
        "resistance, and at least a quarter of that of the electric brake at the final speed, which fades",
        gt=0,
    )
    air_brake: AirBrakeRules = AirBrakeRules()

    @model_validator(mode="after")
    def _places(self) -> "TripSettings":
        if self.begin is not None and self.end is not None and self.end <= self.begin:
            raise ValueError(f"end = {self.end:g} m must lie beyond begin = {self.begin:g} m; move end on")
        return self
