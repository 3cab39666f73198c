"""Data model of the plant without train and line: start, actuators, sensors, disturbances, mismatch, jumps.

This is the block ``plant:`` of the scenario without the names of train and line. The data of the laws are in the block
``model:``, so a mismatch changes this block only.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from plant_sim.disturbances import DisturbanceSource
from plant_sim.gears import DraftGear
from plant_sim.si_model import SiModel
from plant_sim.units import Force, ForceRate, Length, Ratio, Speed, Time

MAX_START_SPEED = 300.0
"""Largest initial speed [m/s]."""
MAX_ODOMETER_ERROR = 0.05
"""Largest relative error of an odometer: SUBSET-041, 5.3.1.1."""


class Start(SiModel):
    """Initial state: by default one speed, and couplers unstretched behind vehicle 0."""

    position: Length = Field(
        0.0, description="centre of vehicle 0; default in a scenario: the beginning of the profile"
    )
    speed: Speed = Field(0.0, ge=-MAX_START_SPEED, le=MAX_START_SPEED)
    positions: tuple[Length, ...] | None = Field(None, description="centre of every vehicle, in place of position")
    speeds: tuple[Speed, ...] | None = Field(None, description="speed of every vehicle, in place of speed")
    any_order: bool = Field(False, description="accept any order of the vehicles, as points without length")

    @model_validator(mode="after")
    def _front_first(self) -> Start:
        if self.positions is None or self.any_order:
            return self
        if any(b >= a for a, b in zip(self.positions, self.positions[1:], strict=False)):
            raise ValueError(
                "start.positions must fall from the front to the rear; correct them or set any_order: true"
            )
        return self


class ConstantAdhesion(SiModel):
    """Wheel-rail adhesion coefficient that does not depend on the speed."""

    kind: Literal["constant"]
    coefficient: float = Field(gt=0, le=1)


class SpeedAdhesion(SiModel):
    """Adhesion after Curtius and Kniffler: factor (0.161 + 7.5/(V + 44)), V in km/h."""

    kind: Literal["curtius_kniffler"]
    factor: float = Field(1.0, gt=0, description="1 dry, about 0.7 wet")


Adhesion = Annotated[ConstantAdhesion | SpeedAdhesion, Field(discriminator="kind")]


class Freeze(SiModel):
    """Measurement of one unit that is constant for an interval."""

    unit: int = Field(0, ge=0)
    begin: Time
    end: Time
    quantity: Literal["position", "velocity", "both"] = "both"

    @model_validator(mode="after")
    def _order(self) -> Freeze:
        if self.end <= self.begin:
            raise ValueError(f"freeze: end {self.end:g} s must be after begin {self.begin:g} s")
        return self


class WheelSlip(SiModel):
    """Wheel slip (> 0) or slide (< 0) of one unit, with the error of its odometer."""

    unit: int = Field(0, ge=0)
    begin: Time
    end: Time
    slip: Ratio = Field(ge=-1, le=100, description="measured speed is (1 + slip) v; -1 for locked wheels")

    @model_validator(mode="after")
    def _order(self) -> WheelSlip:
        if self.end <= self.begin:
            raise ValueError(f"wheel_slip: end {self.end:g} s must be after begin {self.begin:g} s")
        return self


class Sensors(SiModel):
    """Errors of the sensors, and couplers with a sensor."""

    position_noise: Length = Field(0.0, ge=0, description="rms")
    velocity_noise: Speed = Field(0.0, ge=0, description="rms")
    position_quantum: Length = Field(0.0, ge=0, description="resolution; 0 for none")
    velocity_quantum: Speed = Field(0.0, ge=0, description="resolution; 0 for none")
    position_bias: Length = 0.0
    velocity_bias: Speed = 0.0
    freeze: tuple[Freeze, ...] = ()
    wheel_slip: tuple[WheelSlip, ...] = ()
    couplers: tuple[int, ...] = Field((), description="vehicles with a coupler sensor behind them")
    deflection_noise: Length = Field(0.0, ge=0, description="rms")
    force_noise: Force = Field(0.0, ge=0, description="rms")


class OdometrySpec(SiModel):
    """Odometers of the supervisor."""

    wheel_error: Ratio = Field(
        0.003, ge=0, le=MAX_ODOMETER_ERROR, description="largest relative error of the wheel odometer"
    )
    radar_error: Ratio = Field(0.003, ge=0, le=MAX_ODOMETER_ERROR, description="largest relative error of the radar")
    balise_spacing: Length = Field(500.0, ge=1, description="distance of the balises")


class Mismatch(SiModel):
    """Difference between the plant and the data of the train."""

    mass_scale: float = Field(1.0, gt=0)
    resistance_scale: float = Field(1.0, ge=0, description="running resistance")
    traction_scale: float = Field(1.0, ge=0, description="traction envelope")
    electric_brake_scale: float = Field(1.0, ge=0, description="electric brake envelope")
    brake_scale: float = Field(1.0, ge=0, description="forces of the shoes or of the friction emergency brake")
    actuator_gain: float = Field(1.0, ge=0, description="force over command, every unit")
    gears: dict[str, DraftGear | str] = Field(
        default_factory=dict,
        description="draft gears by name and their replacements: a gear, or the name of one of the consist",
    )


class _Sudden(SiModel):
    """Change at a time or at a position of vehicle 0."""

    at: Time | None = Field(None, ge=0)
    place: Length | None = None

    @model_validator(mode="after")
    def _one_trigger(self) -> _Sudden:
        if (self.at is None) == (self.place is None):
            raise ValueError("a jump has exactly one of 'at' (a time) and 'place'; give one")
        return self


class Jump(_Sudden):
    """Change of a parameter during the run, once, at a time or at a position of vehicle 0.

    Jumps of a delay belong to the links. A jump at a time acts from the next plant step on, one at a position from the
    next tick on.
    """

    what: Literal["mass", "gain", "lag", "resistance", "adhesion", "brake"]
    factor: float = Field(ge=0, description="factor on the present value")
    vehicles: tuple[int, ...] | None = Field(
        None, description="vehicles of a mass, resistance or brake jump; default all"
    )
    units: tuple[int, ...] | None = Field(None, description="units of a gain, lag or adhesion jump; default all")

    @model_validator(mode="after")
    def _listed(self) -> Jump:
        if self.what == "mass" and self.factor <= 0:
            raise ValueError("a jump of mass needs a factor above 0; correct it")
        by_vehicle = self.what in ("mass", "resistance", "brake")
        if (self.units if by_vehicle else self.vehicles) is not None:
            wrong, right = ("units", "vehicles") if by_vehicle else ("vehicles", "units")
            raise ValueError(f"a jump of {self.what} acts on {right}, not on {wrong}; list {right} or remove both")
        return self


class TrainSeparation(_Sudden):
    """Parting of couplers during the run, for its rest: no force, and the emergency brake on all parts of the train."""

    what: Literal["coupler"]
    vehicles: tuple[int, ...] = Field(min_length=1, description="vehicles in front of the parting couplers, from 0")


class PlantSetup(SiModel):
    """Block ``plant:`` of a scenario, without the names of train and line."""

    start: Start = Start()
    lag: Time | tuple[Time, ...] = Field(0.0, description="time constant of the actuators: one, or one per unit")
    rate_limit: ForceRate | None = Field(
        None, gt=0, description="largest rate of the force of each unit; default: none"
    )
    dead_band: Force = Field(0.0, ge=0, description="commands below this have no effect")
    force_limit: Force | None = Field(
        None, gt=0, description="limit of the force of the train, split by the masses of the units"
    )
    ideal_actuator: bool = Field(False, description="ideal actuator of the papers, without envelope and limit")
    reversing: bool = Field(False, description="a negative force also drives backwards (paper 002)")
    adhesion: Adhesion | None = None
    holding_speed: Speed = Field(
        0.05, ge=0, description="mean speed of the train below which, with no demand, the holding brake acts"
    )
    holding_brake_ratio: Ratio = Field(
        0.1, ge=0, description="capacity of the holding brake over the weight of every vehicle"
    )
    grade_over_length: bool = Field(
        False,
        description="average grades, curves and tunnels over the length of each vehicle (for a train as one mass)",
    )
    sensors: Sensors = Sensors()
    odometry: OdometrySpec = OdometrySpec()
    disturbances: tuple[DisturbanceSource, ...] = ()
    mismatch: Mismatch = Mismatch()
    jumps: tuple[Annotated[Jump | TrainSeparation, Field(discriminator="what")], ...] = ()

    @model_validator(mode="after")
    def _lags_and_jumps(self) -> PlantSetup:
        lags = self.lag if isinstance(self.lag, tuple) else (self.lag,)
        if any(lag < 0 for lag in lags):
            raise ValueError(f"lag {min(lags):g} s is negative; give 0 or more")
        for jump in self.jumps:
            if jump.what == "lag" and not any(lags):
                raise ValueError("a jump of lag multiplies the lag, which is 0; give a lag")
            if jump.what == "adhesion" and self.adhesion is None:
                raise ValueError("a jump of adhesion multiplies the adhesion, which is missing; give an adhesion")
        return self
