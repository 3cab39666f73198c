"""What the plant is besides train and line: start, actuators, sensors, disturbances, mismatch, jumps.

This is the scenario's ``plant:`` block without the names of train and line.  What the laws believe stands in another
block; a mismatch therefore changes this one only.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from plant_sim.disturbances import Disturbance
from plant_sim.gears import DraftGear
from plant_sim.units import Force, ForceRate, Length, Ratio, SiModel, Speed, Time

FASTEST = 300.0
"""No train starts faster [m/s]."""


class Start(SiModel):
    """State at time 0: couplers unstretched behind vehicle 0, one speed, unless given for every vehicle."""

    position: Length = Field(0.0, description="centre of vehicle 0; in a scenario by default where the profile begins")
    speed: Speed = Field(0.0, ge=-FASTEST, le=FASTEST)
    positions: tuple[Length, ...] | None = Field(None, description="centre of every vehicle instead")
    speeds: tuple[Speed, ...] | None = Field(None, description="speed of every vehicle instead")
    any_order: bool = Field(False, description="vehicles are points: also an order that no track allows")

    @model_validator(mode="after")
    def _front_first(self) -> Start:
        if self.positions is None or self.any_order:
            return self
        if any(b >= a for a, b in zip(self.positions, self.positions[1:], strict=False)):
            raise ValueError("start.positions must fall from the front to the rear; any_order: true lets them not")
        return self


class ConstantAdhesion(SiModel):
    """One wheel-rail adhesion coefficient at every speed."""

    kind: Literal["constant"]
    coefficient: float = Field(gt=0, le=1)


class SpeedAdhesion(SiModel):
    """Adhesion after Curtius and Kniffler: factor (0.161 + 7.5/(V + 44)), V in km/h."""

    kind: Literal["curtius_kniffler"]
    factor: float = Field(1.0, gt=0, description="1 dry, about 0.7 wet")


Adhesion = Annotated[ConstantAdhesion | SpeedAdhesion, Field(discriminator="kind")]


class Freeze(SiModel):
    """A measurement of one unit that stands still for a while."""

    unit: int = Field(0, ge=0)
    begin: Time
    end: Time
    quantity: Literal["position", "velocity", "both"] = "both"

    @model_validator(mode="after")
    def _order(self) -> Freeze:
        if self.end <= self.begin:
            raise ValueError("a frozen measurement must end after its begin")
        return self


class WheelSlip(SiModel):
    """Wheels of one unit that turn faster (> 0, slip) or slower (< 0, slide) than the train; the odometer errs."""

    unit: int = Field(0, ge=0)
    begin: Time
    end: Time
    slip: Ratio = Field(ge=-1, le=100, description="measured speed is (1 + slip) v; -1: the wheels are locked")

    @model_validator(mode="after")
    def _order(self) -> WheelSlip:
        if self.end <= self.begin:
            raise ValueError("wheel slip must end after its begin")
        return self


class Sensors(SiModel):
    """What stands between the truth and the measurement."""

    position_noise: Length = Field(0.0, ge=0, description="rms")
    velocity_noise: Speed = Field(0.0, ge=0, description="rms")
    position_quantum: Length = Field(0.0, ge=0, description="resolution; 0: none")
    velocity_quantum: Speed = Field(0.0, ge=0, description="resolution; 0: none")
    position_bias: Length = 0.0
    velocity_bias: Speed = 0.0
    freeze: tuple[Freeze, ...] = ()
    wheel_slip: tuple[WheelSlip, ...] = ()
    couplers: tuple[int, ...] = Field((), description="vehicles that have a coupler sensor behind them")
    deflection_noise: Length = Field(0.0, ge=0, description="rms")
    force_noise: Force = Field(0.0, ge=0, description="rms")


class Mismatch(SiModel):
    """How the true train differs from its data sheet."""

    mass_scale: float = Field(1.0, gt=0)
    resistance_scale: float = Field(1.0, ge=0, description="running resistance")
    traction_scale: float = Field(1.0, ge=0, description="traction envelope")
    electric_brake_scale: float = Field(1.0, ge=0, description="electric brake envelope")
    brake_scale: float = Field(1.0, ge=0, description="shoe forces of the air brake")
    actuator_gain: float = Field(1.0, ge=0, description="force over command, every unit")
    gears: dict[str, DraftGear | str] = Field(
        default_factory=dict,
        description="draft gears by name that are others: a gear, or the name of one of the consist",
    )


class Jump(SiModel):
    """A parameter that changes during the run, once, at a time or when vehicle 0 passes a place.

    Jumps of a delay belong to the links.  A jump at a time acts from the next plant step on, one at a place from the
    next tick on.
    """

    at: Time | None = Field(None, ge=0)
    place: Length | None = None
    what: Literal["mass", "gain", "lag", "resistance", "adhesion", "brake"]
    factor: float = Field(ge=0, description="on the present value")
    vehicles: tuple[int, ...] | None = Field(
        None, description="vehicles of a mass, resistance or brake jump; default all"
    )
    units: tuple[int, ...] | None = Field(None, description="units of a gain, lag or adhesion jump; default all")

    @model_validator(mode="after")
    def _one_trigger(self) -> Jump:
        if (self.at is None) == (self.place is None):
            raise ValueError("a jump needs exactly one of 'at' (a time) and 'place'")
        if self.what == "mass" and self.factor <= 0:
            raise ValueError("a jump of mass needs a factor above 0")
        by_vehicle = self.what in ("mass", "resistance", "brake")
        if (self.units if by_vehicle else self.vehicles) is not None:
            wrong, right = ("units", "vehicles") if by_vehicle else ("vehicles", "units")
            raise ValueError(f"a jump of {self.what} acts on {right}, not on {wrong}; list {right} or leave both out")
        return self


class PlantSetup(SiModel):
    """The plant block of a scenario, without the names of train and line."""

    start: Start = Start()
    lag: Time | tuple[Time, ...] = Field(0.0, description="time constant of the actuators; one, or one per unit")
    rate_limit: ForceRate | None = Field(None, gt=0, description="of each unit's force; default: none")
    dead_band: Force = Field(0.0, ge=0, description="commands below it give no force")
    force_limit: Force | None = Field(None, gt=0, description="of the whole train, shared by the units' masses")
    unlimited: bool = Field(False, description="the papers' ideal actuator: no envelope, no limit")
    reversing: bool = Field(False, description="a negative force also drives backwards (paper 002)")
    adhesion: Adhesion | None = None
    holding_speed: Speed = Field(
        0.05, ge=0, description="mean speed of the train below which, with no demand, the holding brake acts"
    )
    holding: Ratio = Field(0.1, ge=0, description="capacity of the holding brake over the weight, every vehicle")
    grade_over_length: bool = Field(
        False, description="grades, curves and tunnels averaged over each vehicle's length (trains taken as one mass)"
    )
    sensors: Sensors = Sensors()
    disturbances: tuple[Disturbance, ...] = ()
    mismatch: Mismatch = Mismatch()
    jumps: tuple[Jump, ...] = ()

    @model_validator(mode="after")
    def _lags_and_jumps(self) -> PlantSetup:
        lags = self.lag if isinstance(self.lag, tuple) else (self.lag,)
        if any(lag < 0 for lag in lags):
            raise ValueError("lag must not be negative")
        for jump in self.jumps:
            if jump.what == "lag" and not any(lags):
                raise ValueError("a jump of lag multiplies the lag, which is 0; give a lag")
            if jump.what == "adhesion" and self.adhesion is None:
                raise ValueError("a jump of adhesion multiplies the adhesion, which is not there; give an adhesion")
        return self
