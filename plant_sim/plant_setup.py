"""Data model of the plant without train and line: start, actuators, sensors, disturbances, mismatch, jumps.

This is the block ``plant:`` of the scenario without the names of train and line. The data of the laws are in the block
``model:``, so a mismatch changes this block only.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from plant_sim.disturbances import DisturbanceSource, Interval
from plant_sim.gears import DraftGear
from plant_sim.si_model import SiModel, option
from plant_sim.units import Force, ForceRate, Length, Number, Place, Ratio, Speed, Time, Usual

MAX_START_SPEED = 300.0
"""Largest initial speed [m/s]."""
MAX_LAG = 600.0
"""Largest time constant of an actuator [s]."""
MAX_ODOMETER_ERROR = 0.05
"""Largest relative error of an odometer: SUBSET-041, 5.3.1.1."""


class Start(SiModel):
    """Initial state: by default one speed, and couplers unstretched behind vehicle 0."""

    position: Place = option(0.0, "centre of vehicle 0; default in a scenario: the begin of the profile", example=150.0)
    speed: Speed = option(0.0, "speed of all vehicles", example=20.0, ge=-MAX_START_SPEED, le=MAX_START_SPEED)
    positions: tuple[Place, ...] | None = option(
        None, "centre of every vehicle, front first, in place of position", example=(150.0, 130.0)
    )
    speeds: tuple[Speed, ...] | None = option(
        None, "speed of every vehicle, front first, in place of speed", example=(20.0, 20.0)
    )
    any_order: bool = option(False, "vehicles are points without length, and a train may begin in any order of them")

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
    coefficient: Number = Field(gt=0, le=1, description="adhesion coefficient", examples=[0.2])


class SpeedAdhesion(SiModel):
    """Adhesion after Curtius and Kniffler: factor (0.161 + 7.5/(V + 44)), V in km/h."""

    kind: Literal["curtius_kniffler"]
    factor: Number = option(1.0, "factor on the adhesion: 1 on dry rails, about 0.7 on wet ones", gt=0)


Adhesion = Annotated[ConstantAdhesion | SpeedAdhesion, Field(discriminator="kind")]


class Freeze(Interval):
    """Measurement of one unit that is constant for an interval."""

    unit: int = option(0, "number of the power unit, from 0", example=1, ge=0)
    quantity: Literal["position", "velocity", "both"] = option("both", "measured quantity that is constant")


class WheelSlip(Interval):
    """Wheel slip (> 0) or slide (< 0) of one unit, with the error of its odometer."""

    unit: int = option(0, "number of the power unit, from 0", example=1, ge=0)
    slip: Ratio = Field(
        ge=-1, le=100, description="slip s in the measured speed (1 + s) v; -1 for locked wheels", examples=[0.1]
    )


class Sensors(SiModel):
    """Errors of the sensors, and couplers with a sensor."""

    position_noise: Annotated[Length, Usual(1e-5, 20)] = option(
        0.0, "root mean square of the noise of the position", example=0.05, ge=0
    )
    velocity_noise: Annotated[Speed, Usual(1e-5, 5)] = option(
        0.0, "root mean square of the noise of the speed", example=0.02, ge=0
    )
    position_quantum: Annotated[Length, Usual(1e-5, 50)] = option(
        0.0, "resolution of the position; 0 for none", example=0.01, ge=0
    )
    velocity_quantum: Annotated[Speed, Usual(1e-5, 5)] = option(
        0.0, "resolution of the speed; 0 for none", example=0.01, ge=0
    )
    position_bias: Annotated[Length, Usual(1e-4, 1e3)] = option(0.0, "constant error of the position", example=0.5)
    velocity_bias: Annotated[Speed, Usual(1e-5, 30)] = option(0.0, "constant error of the speed", example=0.05)
    freeze: tuple[Freeze, ...] = ()
    wheel_slip: tuple[WheelSlip, ...] = ()
    couplers: tuple[int, ...] = option((), "numbers of the vehicles with a coupler sensor behind them", example=(0, 1))
    deflection_noise: Annotated[Length, Usual(1e-6, 0.1)] = option(
        0.0, "root mean square of the noise of a coupler deflection", example=0.001, ge=0
    )
    force_noise: Annotated[Force, Usual(1, 1e6)] = option(
        0.0, "root mean square of the noise of a coupler force", example=1e3, ge=0
    )


class OdometrySpec(SiModel):
    """Odometers of the supervisor."""

    wheel_error: Ratio = option(0.003, "largest relative error of the wheel odometer", ge=0, le=MAX_ODOMETER_ERROR)
    radar_error: Ratio = option(0.003, "largest relative error of the radar", ge=0, le=MAX_ODOMETER_ERROR)
    balise_spacing: Annotated[Place, Usual(5, 20e3)] = option(500.0, "distance between the balises", ge=1)


class Mismatch(SiModel):
    """Difference between the plant and the data of the train."""

    mass_scale: Number = option(1.0, "factor on the mass in the data of the train", example=1.1, gt=0)
    resistance_scale: Number = option(
        1.0, "factor on the running resistance in the data of the train", example=1.1, ge=0
    )
    traction_scale: Number = option(1.0, "factor on the traction envelope in the data of the train", example=1.1, ge=0)
    electric_brake_scale: Number = option(
        1.0, "factor on the electric brake envelope in the data of the train", example=1.1, ge=0
    )
    brake_scale: Number = option(
        1.0,
        "factor on the forces of the shoes or of the friction emergency brake in the data of the train",
        example=1.1,
        ge=0,
    )
    actuator_gain: Number = option(1.0, "factor of every unit from its command to its force", example=1.1, ge=0)
    gears: dict[str, DraftGear | str] = option(
        {},
        "draft gears by name and their replacements: a gear, or the name of one of the consist",
        example={"bar": {"kind": "linear", "stiffness": 15e6}},
    )


class _Sudden(SiModel):
    """Change at a time or at a position of vehicle 0."""

    at: Time | None = option(None, "time of the change", example=60.0, ge=0)
    place: Place | None = option(None, "position of vehicle 0's centre at the change", example=1200.0)

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

    what: Literal["mass", "gain", "lag", "resistance", "adhesion", "brake"] = Field(
        description="quantity that is multiplied"
    )
    factor: Number = Field(ge=0, description="factor on the present value", examples=[0.8])
    vehicles: tuple[int, ...] | None = option(
        None, "numbers of the vehicles of a jump of mass, resistance or brake; default: all", example=(0, 1)
    )
    units: tuple[int, ...] | None = option(
        None, "numbers of the units of a jump of gain, lag or adhesion; default: all", example=(0,)
    )

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
    vehicles: tuple[int, ...] = Field(
        min_length=1, description="numbers of the vehicles in front of the parting couplers, from 0", examples=[(50,)]
    )


class PlantSetup(SiModel):
    """Block ``plant:`` of a scenario, without the names of train and line."""

    start: Start = Start()
    lag: Annotated[Time | tuple[Time, ...], Usual(1e-3, 60)] = option(
        0.0, "time constant of the actuators: one for all units, or one per unit", example=0.3
    )
    rate_limit: Annotated[ForceRate | None, Usual(500, 100e6)] = option(
        None, "largest rate of the force of each unit; default: none", example=200e3, gt=0
    )
    dead_band: Annotated[Force, Usual(1, 100e3)] = option(
        0.0, "force below which a command has no effect", example=500.0, ge=0
    )
    force_limit: Annotated[Force | None, Usual(5e3, 50e6)] = option(
        None, "limit of the force of the train, divided by the masses of the units", example=400e3, gt=0
    )
    ideal_actuator: bool = option(False, "actuator of the papers without envelope and limit")
    reversing: bool = option(False, "backwards motion by a negative force, as in paper 002")
    adhesion: Adhesion | None = option(None, "adhesion between wheel and rail; default: no limit")
    holding_speed: Annotated[Speed, Usual(1e-3, 1)] = option(
        0.05, "mean speed of the train below which, with no demand, the holding brake acts", ge=0
    )
    holding_brake_ratio: Ratio = option(0.1, "capacity of the holding brake over the weight of every vehicle", ge=0)
    grade_over_length: bool = option(
        False, "averages of grades, curves and tunnels over the length of each vehicle, for a train as one mass"
    )
    sensors: Sensors = Sensors()
    odometry: OdometrySpec = OdometrySpec()
    disturbances: tuple[DisturbanceSource, ...] = option(
        (),
        "outside forces that the model does not have",
        example=[{"kind": "gust", "begin": 60.0, "end": 80.0, "acceleration": -0.05}],
    )
    mismatch: Mismatch = Mismatch()
    jumps: tuple[Annotated[Jump | TrainSeparation, Field(discriminator="what")], ...] = option(
        (), "changes of the train during the run", example=[{"at": 60.0, "what": "gain", "factor": 0.8}]
    )

    @model_validator(mode="after")
    def _lags_and_jumps(self) -> PlantSetup:
        lags = self.lag if isinstance(self.lag, tuple) else (self.lag,)
        if wrong := [lag for lag in lags if not 0 <= lag <= MAX_LAG]:
            raise ValueError(f"lag {wrong[0]:g} s: give 0 to {MAX_LAG:g} s; check its unit")
        for jump in self.jumps:
            if jump.what == "lag" and not any(lags):
                raise ValueError("a jump of lag multiplies the lag, which is 0; give a lag")
            if jump.what == "adhesion" and self.adhesion is None:
                raise ValueError("a jump of adhesion multiplies the adhesion, which is missing; give an adhesion")
        return self
