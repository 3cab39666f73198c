"""Data model of a train: vehicle types, their order, draft gears and brakes.

A consist file (YAML, ``schema: train_ato/consist/1``) contains all data of a train.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from plant_sim.brake_data import AirBrake, EmergencyBrake, Shoes
from plant_sim.elementary import plain_sum
from plant_sim.gears import DraftGear
from plant_sim.input_error import explain
from plant_sim.line import Rating
from plant_sim.si_model import SiModel, Source, Summary, option
from plant_sim.units import (
    GRAVITY,
    Acceleration,
    Force,
    ForceRate,
    Length,
    Mass,
    Number,
    Power,
    Ratio,
    Speed,
    Time,
    Unit,
    Usual,
    number_text,
)

MIN_VEHICLE_MASS = 500.0
"""Smallest plausible mass of a vehicle [kg]; a smaller one is probably in tonnes without the suffix."""
MAX_VEHICLE_MASS = 1e9
"""Largest accepted mass of a vehicle [kg]; a whole train as one vehicle is far below it."""


class EnvelopeSegment(SiModel):
    """Largest force up to a speed: ``force + slope v + power / v`` in SI, v in m/s.

    Segments are listed by rising speed and begin at the end of the previous one; the force is 0 beyond the last.
    """

    to: Annotated[Speed, Usual(0.05, 2e3)] = Field(gt=0, description="speed at which the segment ends", examples=[10.0])
    force: Force = option(0.0, "constant part of the force", example=60e3)
    slope_kn_per_kmh: Annotated[float, Unit("kN/(km/h)"), Usual(1e-3, 1e3)] = option(
        0.0, "change of the force with speed", example=-0.5
    )
    power: Power = option(0.0, "power of the part power / v of the force", example=600e3, ge=0)

    @property
    def row(self) -> tuple[float, float, float, float]:
        """End [m/s], constant force [N], slope [N s/m] and power [W]."""
        return self.to, self.force, self.slope_kn_per_kmh * 3600.0, self.power

    def at(self, speed: float) -> float:
        """Return force + slope v + power / v at a speed above 0 [N]."""
        _, force, slope, power = self.row
        return force + slope * speed + power / speed


class ForcePoints(SiModel):
    """Force over speed as points, linear between them; below the first speed its force holds."""

    speed: Annotated[tuple[Speed, ...], Usual(0.5, 2e3)] = Field(
        min_length=2, description="rising speeds", examples=[(0.0, 12.0, 40.0)]
    )
    force: tuple[Force, ...] = Field(
        min_length=2, description="largest force at each speed", examples=[(200e3, 200e3, 60e3)]
    )

    @model_validator(mode="after")
    def _as_many(self) -> ForcePoints:
        if len(self.speed) != len(self.force):
            raise ValueError(f"{len(self.speed)} speeds and {len(self.force)} forces; give as many of both")
        if self.speed[0] < 0 or any(b <= a for a, b in pairwise(self.speed)):
            raise ValueError("speeds must rise from 0 or more; correct them")
        if min(self.force) < 0:
            raise ValueError(f"force {number_text(min(self.force))} N is negative; give 0 or more")
        if max(self.force) == 0:
            raise ValueError("no force at any speed; give one above 0, or remove the curve")
        return self

    def segments(self, end: float = 0.0) -> tuple[EnvelopeSegment, ...]:
        """Return the segments between the points; up to a later end [m/s] with the last force."""
        rows = [(self.speed[0], self.force[0], 0.0)] if self.speed[0] > 0 else []
        for (v0, f0), (v1, f1) in pairwise(zip(self.speed, self.force, strict=True)):
            slope = (f1 - f0) / (v1 - v0)
            rows.append((v1, f0 - slope * v0, slope))
        if end > self.speed[-1]:
            rows.append((end, self.force[-1], 0.0))
        return tuple(EnvelopeSegment(to=to, force=force, slope_kn_per_kmh=s / 3600.0) for to, force, s in rows)


class SupplyCurve(ForcePoints):
    """Traction under a power supply, with the conditions under which it holds."""

    mode: str = Field(description="kind of the supply", examples=["25000V"])
    electric: bool = option(True, "power from the line; otherwise as independent_power")
    comfort: str | None = option(None, "comfort of the train", example="AIR_CONDITIONING")
    electrical_level: str | None = option(None, "level of the supply at the train", example="22500V")
    power_restriction: str | None = option(None, "code of a power restriction", example="C1")


PLAIN_SUPPLY = {True: "electric", False: "thermal"}
"""Mode of a traction without supply curves, by electric power."""


def _segments(value: Any) -> Any:
    """Return an envelope given as points as its segments."""
    if not isinstance(value, dict):
        return value
    try:
        return ForcePoints.model_validate(value).segments()
    except ValidationError as error:
        raise ValueError(explain(error, "", ForcePoints, value).lines[0].removeprefix(": ")) from None


EnvelopeOfForce = Annotated[
    tuple[EnvelopeSegment, ...],
    BeforeValidator(_segments, json_schema_input_type=tuple[EnvelopeSegment, ...] | ForcePoints),
]
"""Segments, or points ``{speed_kmh: [...], force_kn: [...]}``."""


class Notches(SiModel):
    """Notches of throttle and dynamic brake, each with its force over speed, and limits of their changes."""

    traction: tuple[EnvelopeOfForce, ...] = option(
        (),
        "force over speed of throttle notch 1, 2, ...",
        example=[[{"to": 30.0, "force": 60e3}], [{"to": 30.0, "force": 120e3}]],
    )
    brake: tuple[EnvelopeOfForce, ...] = option(
        (),
        "force over speed of dynamic-brake notch 1, 2, ..., a positive force",
        example=[[{"to": 30.0, "force": 40e3}], [{"to": 30.0, "force": 80e3}]],
    )
    rise: Annotated[ForceRate | None, Usual(500, 100e6)] = option(
        None, "largest growth of the force in one direction; default: no limit", example=20e3, gt=0
    )
    fall: Annotated[ForceRate | None, Usual(500, 100e6)] = option(
        None, "largest decrease of the force in one direction; default: no limit", example=40e3, gt=0
    )
    notch_time: Annotated[Time, Usual(0.05, 60)] = option(
        0.0, "time from one notch to the next one; 0: any notch at once", example=1.0, ge=0, le=60
    )

    @model_validator(mode="after")
    def _curves(self) -> Notches:
        for name, curves in (("traction", self.traction), ("brake", self.brake)):
            for number, curve in enumerate(curves):
                if not curve:
                    raise ValueError(f"{name}[{number}] has no force over speed; give segments or points")
                _check_envelope(f"{name}[{number}]", curve)
        if not self.traction and not self.brake:
            raise ValueError("no notch; give traction or brake")
        return self


class Resistance(SiModel):
    """Running resistance of one vehicle as a polynomial of speed, in exactly one of three forms.

    N/kN is converted into N with the gravity of the consist. ``n_per_kn_kmh`` has its speed in km/h, as tables of
    railways have.
    """

    n_per_kn_kmh: Annotated[tuple[float, float, float], Unit("N/kN")] | None = option(
        None, "A, B and C of A + B V + C V² per weight, V in km/h", example=(1.5, 0.0, 0.0003)
    )
    n: Annotated[tuple[float, float, float], Unit("N")] | None = option(
        None, "a, b and c of a + b v + c v², v in m/s", example=(560.0, 0.0, 1.4)
    )
    n_per_kg: Annotated[tuple[float, float, float], Unit("N/kg")] | None = option(
        None, "a, b and c of a + b v + c v² per mass, v in m/s", example=(0.0147, 0.0, 3.8e-5)
    )

    @model_validator(mode="after")
    def _one_form(self) -> Resistance:
        given = [form for form in (self.n_per_kn_kmh, self.n, self.n_per_kg) if form is not None]
        if len(given) != 1:
            raise ValueError("resistance has exactly one of n_per_kn_kmh, n, n_per_kg; give one")
        if min(given[0]) < 0:
            raise ValueError(f"coefficient {min(given[0]):g} of the running resistance is negative; give 0 or more")
        return self

    def polynomial(self, mass: float, gravity: float) -> tuple[float, float, float]:
        """Return (c0, c1, c2) with force = c0 + c1 |v| + c2 v² in N, v in m/s."""
        if self.n is not None:
            return self.n
        if self.n_per_kg is not None:
            a, b, c = self.n_per_kg
            return a * mass, b * mass, c * mass
        assert self.n_per_kn_kmh is not None
        a, b, c = self.n_per_kn_kmh
        weight = mass * gravity * 1e-3
        return a * weight, b * weight * 3.6, c * weight * 3.6**2


class TunnelResistance(SiModel):
    """Additional air resistance in a tunnel of a cross section: coefficient times v²."""

    cross_section: Annotated[float, Unit("m²"), Usual(5, 500)] = Field(
        gt=0, description="cross section of the tunnel", examples=[45.0]
    )
    coefficient: Annotated[float, Unit("N s²/m²"), Usual(0.05, 500)] = Field(
        ge=0, description="additional air resistance over v²", examples=[2.5]
    )


class VehicleType(SiModel):
    """Type of vehicle; one with a traction or brake envelope is a power unit."""

    mass: Mass = Field(gt=0, description="mass on the rails", examples=[38e3])
    length: Length = Field(gt=0, description="length over couplers", examples=[19.5])
    rotating_mass_factor: Number = option(1.0, "inertial mass over mass", example=1.08, ge=1.0)
    resistance: Resistance
    traction: EnvelopeOfForce = option((), "largest traction force over speed")
    brake: EnvelopeOfForce = option((), "largest electric brake force over speed, a positive force")
    electric_brake: EnvelopeOfForce = option(
        (), "electric part of brake, which acts before the friction part; default: all of it"
    )
    notches: Notches | None = option(
        None,
        "notches of a driver; their last ones are traction and brake where these are not given",
        example={"traction": [[{"to": 30.0, "force": 60e3}], [{"to": 30.0, "force": 120e3}]]},
    )
    shoes: Shoes | None = None
    adhesive_mass: Annotated[Mass | None, Usual(500, 500e3)] = option(
        None, "mass on driven axles; default: the whole mass", example=20e3, gt=0
    )
    tunnel_resistance: tuple[TunnelResistance, ...] = option(
        (), "air resistance in tunnels by rising cross section, linear between them"
    )
    independent_power: bool = option(
        False, "power without the line, as diesel or battery: neutral sections and power limits have no effect"
    )
    supply_curves: tuple[SupplyCurve, ...] = option(
        (), "traction by power supply; FILE:MODE takes the first curve that holds as traction"
    )

    @property
    def inertia(self) -> float:
        """Inertial mass: mass including the rotating masses [kg]."""
        return self.mass * self.rotating_mass_factor

    @model_validator(mode="before")
    @classmethod
    def _largest_notches(cls, data: Any) -> Any:
        notches = data.get("notches") if isinstance(data, dict) else None
        if not isinstance(notches, dict):
            return data
        curves = {key: notches.get(key) for key in ("traction", "brake") if not data.get(key)}
        return data | {
            key: listed[-1] for key, listed in curves.items() if isinstance(listed, (list, tuple)) and listed
        }

    @model_validator(mode="after")
    def _plausible(self) -> VehicleType:
        if self.mass < MIN_VEHICLE_MASS:
            raise ValueError(
                f"mass {number_text(self.mass)} kg is below {number_text(MIN_VEHICLE_MASS)} kg; write mass_t for tonnes"
            )
        if self.mass > MAX_VEHICLE_MASS:
            raise ValueError(
                f"mass {number_text(self.mass)} kg is above {number_text(MAX_VEHICLE_MASS)} kg; correct it, "
                "mass is in kg"
            )
        for name in ("traction", "brake", "electric_brake"):
            _check_envelope(name, getattr(self, name))
        if self.electric_brake and not self.brake:
            raise ValueError("electric_brake without brake: it is a part of it; add brake")
        if self.adhesive_mass is not None and self.adhesive_mass > self.mass:
            raise ValueError(
                f"adhesive_mass {number_text(self.adhesive_mass)} kg exceeds the mass of "
                f"{number_text(self.mass)} kg; lower it"
            )
        if any(b.cross_section <= a.cross_section for a, b in pairwise(self.tunnel_resistance)):
            raise ValueError("tunnel_resistance must be listed by rising cross_section; sort it")
        return self

    def tunnel_coefficient(self, cross_section: float) -> float:
        """Return the additional air resistance over v² in a tunnel [N s²/m²] of a cross section [m²].

        It is linear between the listed cross sections, and that of the nearest one outside them.
        """
        listed = self.tunnel_resistance
        if not listed:
            return 0.0
        if cross_section <= listed[0].cross_section:
            return listed[0].coefficient
        for low, high in pairwise(listed):
            if cross_section <= high.cross_section:
                part = (cross_section - low.cross_section) / (high.cross_section - low.cross_section)
                return low.coefficient + part * (high.coefficient - low.coefficient)
        return listed[-1].coefficient


def _check_envelope(name: str, segments: tuple[EnvelopeSegment, ...]) -> None:
    """Raise ValueError for an envelope with falling speeds, a negative force or no force."""
    begin = 0.0
    largest = 0.0
    for number, segment in enumerate(segments):
        if segment.to <= begin:
            raise ValueError(
                f"{name}[{number}] ends at {segment.to:g} m/s, the previous one at {begin:g}; list them by rising speed"
            )
        ends = (segment.at(max(begin, 1e-3)), segment.at(segment.to))
        if min(ends) < -1.0:
            raise ValueError(
                f"{name}[{number}] falls to {number_text(min(ends))} N; write forces of both envelopes above 0"
            )
        begin, largest = segment.to, max(largest, *ends)
    if segments and largest <= 0.0:
        raise ValueError(f"{name} has no force at any speed; write force, slope_kn_per_kmh or power, or remove it")


class PlanLimits(SiModel):
    """Limits and efficiencies of a plan that sets none; `train-ato plan` then has no jerk limit and no margin."""

    speed: Speed | None = option(None, "largest speed", example=44.4, gt=0)
    acceleration: Annotated[Acceleration | None, Usual(0.01, 5)] = option(
        None, "largest acceleration", example=0.6, gt=0
    )
    deceleration: Annotated[Acceleration | None, Usual(0.01, 5)] = option(
        None, "service deceleration", example=0.7, gt=0
    )
    traction_efficiency: Annotated[Ratio | None, Usual(0.2, 1)] = option(
        None, "wheel energy over line energy in traction", example=0.85, gt=0, le=1
    )
    recovery_efficiency: Ratio | None = option(
        None, "recovered line energy over wheel energy in braking", example=0.8, ge=0, le=1
    )


MAX_VEHICLES = 5000
"""Largest number of vehicles, seven times that of the longest train on record."""


class TrainPart(SiModel):
    """Consecutive vehicles of one type."""

    type: str = Field(description="name in vehicle_types", examples=["car"])
    count: int = option(1, "number of consecutive vehicles of this type", example=6, gt=0)


class Coupling(SiModel):
    """Draft gear behind some vehicles in place of the default one."""

    behind: tuple[int, ...] = Field(
        description="numbers of the vehicles in front of the couplers, from 0", examples=[(0, 4)]
    )
    gear: str = Field(description="name in draft_gears", examples=["bar"])


class Consist(SiModel):
    """Train, front first."""

    schema_: Literal["train_ato/consist/1"] = Field(alias="schema", description="kind and version of the file")
    name: str = Field(description="name in lists, logs and reports", examples=["metro_6_cars"])
    summary: Summary = ""
    source: Source = ""
    gravity: Acceleration = option(GRAVITY, "gravity of the data; the papers use 9.8, 9.80665 and 9.81", gt=0)
    vehicle_types: dict[str, VehicleType] = Field(
        description="types of vehicle by name",
        examples=[{"car": {"mass": 38e3, "length": 19.5, "resistance": {"n_per_kn_kmh": [1.5, 0.0, 0.0003]}}}],
    )
    train: tuple[TrainPart, ...] = Field(
        min_length=1,
        description="types and numbers of the vehicles, front first",
        examples=[[{"type": "car", "count": 6}]],
    )
    draft_gears: dict[str, DraftGear] = option(
        {}, "draft gears by name", example={"bar": {"kind": "linear", "stiffness": 20e6, "damping": 0.5e6}}
    )
    default_gear: str | None = option(None, "draft gear of every coupler that couplings does not list", example="bar")
    couplings: tuple[Coupling, ...] = option(
        (), "couplers with another draft gear", example=[{"behind": [0], "gear": "bar"}]
    )
    air_brake: AirBrake | None = None
    emergency_brake: EmergencyBrake | None = option(
        None, "friction emergency brake of a train without air_brake; default: its own defaults"
    )
    plan_limits: PlanLimits | None = None
    categories: tuple[str, ...] = option(
        (),
        "categories of the train for category_limits of a line; the first one that the line has",
        example=["D4", "freight"],
    )
    rating: Rating | None = option(None, "figures of the train for category_limits with needs")
    pantographs: tuple[int, ...] = option(
        (),
        "numbers of the vehicles with a raised pantograph, from 0. A power unit takes its power from the "
        "nearest pantograph, and from the front one of two equally near. By default it has its own",
        example=[1, 4],
    )
    kept: dict[str, dict[str, Any]] = option(
        {},
        "keys of a foreign format without effect here, by format; convert writes them back",
        example={"osrd": {"startup_time": 10.0}},
    )

    @model_validator(mode="after")
    def _one_emergency_brake(self) -> Consist:
        if self.air_brake is not None and self.emergency_brake is not None:
            raise ValueError(
                "emergency_brake: the vented pipe of air_brake is the emergency brake of this train; remove one"
            )
        return self

    @model_validator(mode="after")
    def _references(self) -> Consist:
        for part in self.train:
            if part.type not in self.vehicle_types:
                raise ValueError(
                    f"train: type '{part.type}' is not in vehicle_types: {', '.join(self.vehicle_types)}; correct it"
                )
        gears = {self.default_gear, *(coupling.gear for coupling in self.couplings)} - {None}
        for gear in sorted(str(name) for name in gears):
            if gear not in self.draft_gears:
                known = ", ".join(self.draft_gears) or "it has none"
                raise ValueError(f"draft gear '{gear}' is not in draft_gears: {known}; add it or correct it")
        count = sum(part.count for part in self.train)
        if count > MAX_VEHICLES:
            raise ValueError(f"train has {count} vehicles, more than {MAX_VEHICLES}; correct 'count'")
        if any(not 0 <= vehicle < count for vehicle in self.pantographs):
            raise ValueError(f"pantographs: lists a vehicle outside 0 ... {count - 1}; correct it")
        for coupling in self.couplings:
            if any(not 0 <= vehicle < count - 1 for vehicle in coupling.behind):
                raise ValueError(f"couplings: behind lists a vehicle outside 0 ... {count - 2}; correct it")
        named = [vehicle for coupling in self.couplings for vehicle in coupling.behind]
        if len(set(named)) < len(named):
            twice = next(vehicle for vehicle in named if named.count(vehicle) > 1)
            raise ValueError(f"couplings: behind lists vehicle {twice} twice; keep one draft gear for it")
        if self.default_gear is None and len(named) < count - 1:
            raise ValueError("a train of several vehicles needs a draft gear for every coupler; give default_gear")
        return self

    @property
    def vehicles(self) -> tuple[VehicleType, ...]:
        """Type of every vehicle, front first."""
        return tuple(self.vehicle_types[part.type] for part in self.train for _ in range(part.count))

    @property
    def gear_names(self) -> tuple[str, ...]:
        """Name of the draft gear behind every vehicle except the last."""
        names = [str(self.default_gear)] * (len(self.vehicles) - 1)
        for coupling in self.couplings:
            for vehicle in coupling.behind:
                names[vehicle] = coupling.gear
        return tuple(names)

    @property
    def gears(self) -> tuple[DraftGear, ...]:
        """Draft gear behind every vehicle except the last."""
        return tuple(self.draft_gears[name] for name in self.gear_names)

    @property
    def power_units(self) -> tuple[int, ...]:
        """Numbers of the vehicles with a traction or electric-brake envelope."""
        return tuple(i for i, vehicle in enumerate(self.vehicles) if vehicle.traction or vehicle.brake)

    @property
    def supplies(self) -> tuple[int, ...]:
        """Number of the vehicle with the pantograph that feeds every vehicle."""
        if not self.pantographs:
            return tuple(range(len(self.vehicles)))
        at = self.offsets
        return tuple(min(self.pantographs, key=lambda fed: (abs(at[fed] - own), fed)) for own in at)

    @property
    def friction_emergency_brake(self) -> EmergencyBrake | None:
        """Friction emergency brake of a train without air brake; None with an air brake."""
        return None if self.air_brake is not None else self.emergency_brake or EmergencyBrake()

    @property
    def friction_forces(self) -> tuple[float, ...]:
        """Friction-brake force of every vehicle at full application and standstill [N]: shoes, or emergency brake."""
        brake = self.friction_emergency_brake
        if brake is not None:
            return tuple(brake.deceleration * vehicle.inertia for vehicle in self.vehicles)
        return tuple(0.0 if v.shoes is None else v.shoes.standstill_force for v in self.vehicles)

    @property
    def mass(self) -> float:
        """Mass of the train [kg]."""
        return plain_sum(vehicle.mass for vehicle in self.vehicles)

    @property
    def length(self) -> float:
        """Length of the train over couplers [m]."""
        return plain_sum(vehicle.length for vehicle in self.vehicles)

    @property
    def offsets(self) -> tuple[float, ...]:
        """Distance of the centre of every vehicle behind that of vehicle 0, couplers unstretched [m]."""
        offsets, behind = [], 0.0
        vehicles = self.vehicles
        for i, vehicle in enumerate(vehicles):
            if i:
                behind += (vehicles[i - 1].length + vehicle.length) / 2
            offsets.append(behind)
        return tuple(offsets)
