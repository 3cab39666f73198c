"""A train as data: vehicle types, their order, the draft gears between them, the brakes.

A consist file (YAML, ``schema: train_ato/consist/1``) is the only place where facts about a train stand.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

from pydantic import Field, model_validator

from plant_sim.gears import DraftGear
from plant_sim.units import GRAVITY, Force, Length, Mass, Power, Pressure, Ratio, SiModel, Speed, Time

SCHEMA = "train_ato/consist/1"
LIGHTEST = 500.0
"""Mass below which no vehicle runs on rails: tonnes were written without their suffix [kg]."""


class EnvelopeSegment(SiModel):
    """Largest force up to a speed: ``force + slope v + power / v`` in SI, v in m/s.

    Segments are listed by rising speed; each reaches from the end of the one before; beyond the last the force is 0.
    """

    to: Speed = Field(gt=0, description="speed at which the segment ends")
    force: Force = Field(0.0, description="constant part")
    slope_kn_per_kmh: float = Field(0.0, description="change of force with speed, kN per km/h")
    power: Power = Field(0.0, ge=0, description="constant-power part, force = power / v")

    def at(self, speed: float) -> float:
        """Return force + slope v + power / v at a speed above 0 [N]."""
        return self.force + self.slope_kn_per_kmh * 3600.0 * speed + self.power / speed


class Resistance(SiModel):
    """Running resistance of one vehicle as a polynomial of speed, in exactly one of three customary forms.

    The gravity that turns N/kN into N is that of the consist.
    """

    n_per_kn: tuple[float, float, float] | None = Field(
        None, description="A + B V + C V², V in km/h, N per kN of weight"
    )
    n: tuple[float, float, float] | None = Field(None, description="a + b v + c v², v in m/s, N")
    n_per_kg: tuple[float, float, float] | None = Field(None, description="a + b v + c v², v in m/s, N per kg of mass")

    @model_validator(mode="after")
    def _one_form(self) -> Resistance:
        given = [form for form in (self.n_per_kn, self.n, self.n_per_kg) if form is not None]
        if len(given) != 1:
            raise ValueError("give exactly one of n_per_kn, n, n_per_kg")
        if min(given[0]) < 0:
            raise ValueError("coefficients of the running resistance must not be negative")
        return self

    def polynomial(self, mass: float, gravity: float) -> tuple[float, float, float]:
        """Return (c0, c1, c2) with force = c0 + c1 |v| + c2 v² in N, v in m/s."""
        if self.n is not None:
            return self.n
        if self.n_per_kg is not None:
            a, b, c = self.n_per_kg
            return a * mass, b * mass, c * mass
        assert self.n_per_kn is not None
        a, b, c = self.n_per_kn
        weight = mass * gravity * 1e-3
        return a * weight, b * weight * 3.6, c * weight * 3.6**2


class Shoes(SiModel):
    """Air-brake shoes (or pads) of one vehicle: paper 000, eqs. (10)-(15) and table 1."""

    count: int = Field(gt=0, description="shoes or pads of the vehicle")
    force: Force = Field(gt=0, description="force K of one shoe at full cylinder pressure")
    friction: float = Field(gt=0, description="factor of the friction coefficient: .481 (C80), .441 (HXD1)")


class VehicleType(SiModel):
    """One kind of vehicle. A type with a traction or brake envelope is a power unit."""

    mass: Mass = Field(gt=0, description="mass on the rails")
    length: Length = Field(gt=0, description="length over couplers")
    rotating_mass_factor: float = Field(1.0, ge=1.0, description="inertial mass over mass")
    resistance: Resistance
    traction: tuple[EnvelopeSegment, ...] = Field((), description="largest traction force over speed")
    brake: tuple[EnvelopeSegment, ...] = Field((), description="largest electric brake force over speed, positive")
    shoes: Shoes | None = None
    adhesive_mass: Mass | None = Field(None, gt=0, description="mass on driven axles; default: all of it")

    @model_validator(mode="after")
    def _meant(self) -> VehicleType:
        if self.mass < LIGHTEST:
            raise ValueError(f"mass {self.mass:g} kg is less than any vehicle's; if tonnes are meant write mass_t")
        for name, segments in (("traction", self.traction), ("brake", self.brake)):
            _check_envelope(name, segments)
        if self.adhesive_mass is not None and self.adhesive_mass > self.mass:
            raise ValueError(f"adhesive_mass {self.adhesive_mass:g} kg exceeds the mass of {self.mass:g} kg")
        return self


def _check_envelope(name: str, segments: tuple[EnvelopeSegment, ...]) -> None:
    """Raise for an envelope that cannot be meant: speeds that fall, a force below 0, no force anywhere."""
    begin = 0.0
    largest = 0.0
    for number, segment in enumerate(segments):
        if segment.to <= begin:
            raise ValueError(
                f"{name}[{number}] ends at {segment.to:g} m/s, the one before at {begin:g}: list them by rising speed"
            )
        ends = (segment.at(max(begin, 1e-3)), segment.at(segment.to))
        if min(ends) < -1.0:
            raise ValueError(f"{name}[{number}] falls to {min(ends):g} N: both envelopes are written as forces above 0")
        begin, largest = segment.to, max(largest, *ends)
    if segments and largest <= 0.0:
        raise ValueError(f"{name} gives no force at any speed: write force, slope_kn_per_kmh or power, or leave it out")


class AirBrake(SiModel):
    """Brake pipe and cylinders of the whole train: paper 000, section 1.1.4, and what it leaves open."""

    charged: Pressure = Field(600e3, gt=0, description="absolute pressure of the charged brake pipe")
    apply_wave: Speed = Field(200.0, gt=0, description="speed of the application wave along the train")
    release_wave: Speed = Field(36.0, gt=0, description="speed of the release wave along the train")
    apply_time: Time = Field(4.0, gt=0, description="time constant of the cylinders filling")
    release_time: Time = Field(6.0, gt=0, description="time constant of the cylinders emptying")
    reduction: tuple[Pressure, ...] = Field(
        (0.0, 50e3), description="brake-pipe reductions of the braking factor's table"
    )
    braking_factor: tuple[Ratio, ...] = Field((0.0, 0.17), description="beta_c at those reductions")
    reservoir_use: Ratio = Field(0.0, ge=0, le=1, description="share of a reservoir that one full application takes")
    recharge_time: Time = Field(60.0, gt=0, description="time constant of the reservoirs recharging while released")

    @model_validator(mode="after")
    def _table(self) -> AirBrake:
        if len(self.reduction) != len(self.braking_factor) or len(self.reduction) < 2:
            raise ValueError("reduction and braking_factor need the same length, at least 2")
        if any(b <= a for a, b in pairwise(self.reduction)):
            raise ValueError("reduction must rise")
        if any(b < a for a, b in pairwise(self.braking_factor)) or not 0 < self.braking_factor[-1] <= 1:
            raise ValueError("braking_factor must rise with the reduction, at last above 0 and not beyond 1")
        if self.reduction[0] != 0 or self.braking_factor[0] != 0:
            raise ValueError("reduction and braking_factor must begin at 0: a charged pipe does not brake")
        if self.reduction[-1] > self.charged:
            raise ValueError(
                f"reduction reaches {self.reduction[-1]:g} Pa, the charged pipe has {self.charged:g} Pa: both are "
                "absolute, in Pa or with a suffix (_kpa)"
            )
        return self


MOST_VEHICLES = 5000
"""Seven times the longest train that ever ran; a larger count is a slip of the pen."""


class TrainPart(SiModel):
    """A run of equal vehicles."""

    type: str
    count: int = Field(1, gt=0)


class Coupling(SiModel):
    """Draft gear behind the named vehicles instead of the default one."""

    behind: tuple[int, ...] = Field(description="numbers of the vehicles in front of the coupling, 0 the first")
    gear: str


class Consist(SiModel):
    """A whole train, front first."""

    schema_: Literal["train_ato/consist/1"] = Field(alias="schema")
    name: str
    summary: str = ""
    source: str = ""
    gravity: float = Field(GRAVITY, gt=0, description="m/s²; the papers use 9.8, 9.80665 and 9.81")
    vehicle_types: dict[str, VehicleType]
    train: tuple[TrainPart, ...] = Field(min_length=1)
    draft_gears: dict[str, DraftGear] = Field(default_factory=dict)
    default_gear: str | None = None
    couplings: tuple[Coupling, ...] = ()
    air_brake: AirBrake | None = None

    @model_validator(mode="after")
    def _references(self) -> Consist:
        for part in self.train:
            if part.type not in self.vehicle_types:
                raise ValueError(f"train names the type '{part.type}', vehicle_types has {sorted(self.vehicle_types)}")
        gears = {self.default_gear, *(coupling.gear for coupling in self.couplings)} - {None}
        for gear in sorted(str(name) for name in gears):
            if gear not in self.draft_gears:
                raise ValueError(f"draft gear '{gear}' is not in draft_gears: {sorted(self.draft_gears)}")
        count = sum(part.count for part in self.train)
        if count > MOST_VEHICLES:
            raise ValueError(f"train has {count} vehicles, at most {MOST_VEHICLES} are computed; correct 'count'")
        for coupling in self.couplings:
            if any(not 0 <= vehicle < count - 1 for vehicle in coupling.behind):
                raise ValueError(f"couplings name a vehicle outside 0 ... {count - 2}")
        named = [vehicle for coupling in self.couplings for vehicle in coupling.behind]
        if len(set(named)) < len(named):
            twice = next(vehicle for vehicle in named if named.count(vehicle) > 1)
            raise ValueError(f"couplings name the one behind vehicle {twice} twice: keep one draft gear for it")
        if count > 1 and self.default_gear is None:
            overridden = {vehicle for coupling in self.couplings for vehicle in coupling.behind}
            if len(overridden) < count - 1:
                raise ValueError("a train of several vehicles needs a default_gear")
        return self

    @property
    def vehicles(self) -> tuple[VehicleType, ...]:
        """Every vehicle's type, front first."""
        return tuple(self.vehicle_types[part.type] for part in self.train for _ in range(part.count))

    @property
    def gear_names(self) -> tuple[str, ...]:
        """Name of the draft gear behind every vehicle but the last."""
        names = [str(self.default_gear)] * (len(self.vehicles) - 1)
        for coupling in self.couplings:
            for vehicle in coupling.behind:
                names[vehicle] = coupling.gear
        return tuple(names)

    @property
    def gears(self) -> tuple[DraftGear, ...]:
        """Draft gear behind every vehicle but the last."""
        return tuple(self.draft_gears[name] for name in self.gear_names)

    @property
    def power_units(self) -> tuple[int, ...]:
        """Numbers of the vehicles that have a traction or electric-brake envelope."""
        return tuple(i for i, vehicle in enumerate(self.vehicles) if vehicle.traction or vehicle.brake)

    @property
    def mass(self) -> float:
        """Mass of the whole train [kg]."""
        return sum(vehicle.mass for vehicle in self.vehicles)

    @property
    def length(self) -> float:
        """Length of the whole train over couplers [m]."""
        return sum(vehicle.length for vehicle in self.vehicles)

    @property
    def offsets(self) -> tuple[float, ...]:
        """Distance of every vehicle's centre behind vehicle 0's centre, couplers unstretched [m]."""
        offsets, behind = [], 0.0
        vehicles = self.vehicles
        for i, vehicle in enumerate(vehicles):
            if i:
                behind += (vehicles[i - 1].length + vehicle.length) / 2
            offsets.append(behind)
        return tuple(offsets)
