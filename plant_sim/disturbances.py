"""Data models of the outside disturbances of a train; :mod:`plant_sim.outside_forces` adds them up.

Every kind computes a whole tick in one call: force F [N], force per speed G [N s/m], drift speed [m/s] and force per
cube of the speed H [N s³/m³] of its vehicles. The force is F + (G + H v_0²) v with the speed v_0 at the begin of the
tick. Accelerations are multiplied by the inertial mass.
"""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from plant_sim.elementary import cos_each, sin_each
from plant_sim.line import check_grade
from plant_sim.si_model import SiModel
from plant_sim.states import Array
from plant_sim.units import Acceleration, Force, Length, Slope, Time

Vehicles = tuple[int, ...]


class OutsideForce(NamedTuple):
    """Force [N], force per speed [N s/m], drift speed [m/s] and force per cube of the speed [N s³/m³].

    Each of shape (steps, vehicles); None is 0.
    """

    force: Array
    per_speed: Array | None = None
    drift: Array | None = None
    per_cube: Array | None = None


class _Source(SiModel):
    """Base of all kinds; without ``vehicles`` the disturbance acts on all of them."""

    vehicles: Vehicles | None = Field(None, description="numbers of the vehicles, from 0; default: all")

    def listed(self, count: int) -> Vehicles:
        """Return the numbers of its vehicles in a train of ``count`` vehicles.

        Raises
        ------
        ValueError
            For a number outside the train or a number listed twice.
        """
        chosen = tuple(range(count)) if self.vehicles is None else self.vehicles
        wrong = [i for i in chosen if not 0 <= i < count]
        if wrong:
            raise ValueError(f"a disturbance lists vehicle {wrong[0]}: not in the train; give 0 ... {count - 1}")
        if len(set(chosen)) < len(chosen):
            raise ValueError(f"a disturbance lists a vehicle twice in {list(chosen)[:20]}; list each one once")
        return chosen

    def tick(self, t: Array, mass: Array) -> OutsideForce:
        """Return the forces of a tick.

        Parameters
        ----------
        t : Array, shape (steps,)
            Times of the plant steps [s].
        mass : Array, shape (vehicles,)
            Inertial masses of its vehicles [kg].
        """
        raise TypeError(f"{type(self).__name__} acts through the line and has no forces")


class _TimeFunction(_Source):
    """Base of the kinds that are functions of time."""

    shift: Time | None = Field(None, description="time by which it acts later; < 0 earlier; default: 0")

    def local(self, t: Array) -> Array:
        """Return the times of the function for times of the run [s]."""
        return t if self.shift is None else t - self.shift


class Equation40(_TimeFunction):
    """Disturbance of paper 000, eq. (40): m {.002 + .001 sin(t+1) + .0003 v [sin(2t+2) + cos(3t+1)]}.

    Printed is the third power of the speed: 400-600 kN on the locomotive, more than its largest brake force.
    """

    kind: Literal["eq40"]
    speed_power: Literal[1, 3] = Field(1, description="power of the speed; 3 as printed")
    vehicles: Vehicles | None = Field(tuple(range(0, 101, 10)), description="0, 10, ..., 100 in the paper")
    scale: float = 1.0

    def tick(self, t: Array, mass: Array) -> OutsideForce:
        """Return the forces of a tick."""
        steady = self.scale * (0.002 + 0.001 * sin_each(t + 1.0))
        speed = self.scale * 0.0003 * (sin_each(2.0 * t + 2.0) + cos_each(3.0 * t + 1.0))
        force, growing = steady[:, None] * mass, speed[:, None] * mass
        if self.speed_power == 3:
            return OutsideForce(force, per_cube=growing)
        return OutsideForce(force, per_speed=growing)


class Term(SiModel):
    """Sine: amplitude sin(omega t + phase)."""

    acceleration: Acceleration = 0.0
    force: Force = 0.0
    omega: float = Field(ge=0, description="rad/s")
    phase: float = Field(0.0, description="rad")


class Harmonic(_TimeFunction):
    """Sum of sines."""

    kind: Literal["harmonic"]
    terms: tuple[Term, ...] = Field(min_length=1)

    def tick(self, t: Array, mass: Array) -> OutsideForce:
        """Return the forces of a tick."""
        force = np.zeros((len(t), len(mass)))
        for term in self.terms:
            force += sin_each(term.omega * t + term.phase)[:, None] * (term.acceleration * mass + term.force)
        return OutsideForce(force)


def _window(t: Array, begin: float, end: float, ramp: float) -> Array:
    """Return a trapezoid of height 1 between begin and end with ramps inside; a ramp of 0 is a step."""
    if ramp <= 0.0:
        return np.where((t >= begin) & (t < end), 1.0, 0.0)
    return np.clip(np.minimum(t - begin, end - t) / ramp, 0.0, 1.0)


class Gust(_TimeFunction):
    """Wind gust as a trapezoid in time; > 0 acts forward."""

    kind: Literal["gust"]
    begin: Time
    end: Time
    ramp: Time = Field(1.0, ge=0, description="time of rise and of fall, inside the interval")
    acceleration: Acceleration = 0.0
    force: Force = Field(0.0, description="on each listed vehicle")

    @model_validator(mode="after")
    def _order(self) -> Gust:
        if self.end <= self.begin:
            raise ValueError(f"gust: end {self.end:g} s must be after begin {self.begin:g} s")
        return self

    def tick(self, t: Array, mass: Array) -> OutsideForce:
        """Return the forces of a tick."""
        shape = _window(t, self.begin, self.end, self.ramp)
        return OutsideForce(shape[:, None] * (self.acceleration * mass + self.force))


class ExtraGrade(SiModel):
    """Section with a grade that is not in the model; > 0 uphill, added to that of the line."""

    begin: Length
    end: Length
    grade: Slope

    @model_validator(mode="after")
    def _order(self) -> ExtraGrade:
        if self.end <= self.begin:
            raise ValueError(f"grade: end {self.end:g} m must be beyond begin {self.begin:g} m")
        check_grade(self.grade)
        return self


class UnmodelledGrade(_Source):
    """Grade of the plant that is not in the model; it acts on every vehicle at its own position."""

    kind: Literal["grade"]
    pieces: tuple[ExtraGrade, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _all(self) -> UnmodelledGrade:
        if self.vehicles is not None:
            raise ValueError("a grade acts on every vehicle; remove 'vehicles'")
        return self


class Paper001(_TimeFunction):
    """Disturbance of paper 001 with values chosen here; D > 0 opposes the motion.

    +0.10 m/s² at 60-80 s, -0.12 m/s² at 300-312 s, and 0.03 sin 0.5 t m/s².
    """

    kind: Literal["paper001"]
    scale: float = 1.0

    def tick(self, t: Array, mass: Array) -> OutsideForce:
        """Return the forces of a tick."""
        d = 0.10 * _window(t, 60.0, 80.0, 0.0) - 0.12 * _window(t, 300.0, 312.0, 0.0) + 0.03 * sin_each(0.5 * t)
        return OutsideForce((-self.scale * d)[:, None] * mass)


class Paper002(_TimeFunction):
    """Disturbances of paper 002 on five vehicles: drift speeds d_i1 (unmatched), accelerations d_i2 (matched)."""

    kind: Literal["paper002"]
    vehicles: Vehicles | None = (0, 1, 2, 3, 4)
    unmatched_scale: float = Field(1.0, description="1 in the paper; 0.05 in the realistic version")
    matched_scale: float = Field(1.0, description="1 in the paper; 0.02 in the realistic version")

    @model_validator(mode="after")
    def _five(self) -> Paper002:
        if self.vehicles is None or len(self.vehicles) != 5:
            raise ValueError("the disturbances of paper 002 need exactly five vehicles; list five")
        return self

    def tick(self, t: Array, mass: Array) -> OutsideForce:
        """Return the forces and drift speeds of a tick; the last part of d21 continues beyond 30 s."""
        sine, cosine = sin_each(t), cos_each(t)
        fast = 6.0 * sin_each(3.0 * t) * cosine
        d21 = np.where(t < 10.0, fast, np.where(t < 20.0, -fast, sine * np.tanh(t)))
        unmatched = (3.0 * sin_each(t + np.pi / 6.0), d21, sine * cosine, np.tanh(sine), 2.0 * np.tanh(t) * sine)
        matched = (d21, fast, 5.0 * sin_each(3.0 * t), 3.0 * cos_each(4.0 * t), 6.0 * sin_each(cosine))
        force = self.matched_scale * np.array(matched).T * mass
        return OutsideForce(force, drift=self.unmatched_scale * np.array(unmatched).T)


class TravellingLoad(_TimeFunction):
    """Load that moves from vehicle to vehicle, like a short grade under a moving train.

    On each vehicle it is a raised cosine in time.
    """

    kind: Literal["travelling_load"]
    acceleration: Acceleration = Field(description="peak; < 0 opposes the motion")
    begin: Time = Field(description="time at which it reaches the first listed vehicle")
    duration: Time = Field(gt=0, description="time on each vehicle")
    interval: Time = Field(0.0, ge=0, description="from one listed vehicle to the next")
    period: Time | None = Field(None, gt=0, description="period of its repetition; default: once")

    def tick(self, t: Array, mass: Array) -> OutsideForce:
        """Return the forces of a tick."""
        local = t[:, None] - self.begin - self.interval * np.arange(len(mass))
        if self.period is not None:
            local = np.where(local >= 0.0, np.mod(local, self.period), local)
        inside = (local > 0.0) & (local < self.duration)
        shape = np.zeros(local.shape)
        shape[inside] = 0.5 - 0.5 * cos_each(2.0 * np.pi * local[inside] / self.duration)
        return OutsideForce(self.acceleration * shape * mass)


class Turbulence(_Source):
    """Random wind: a Gaussian acceleration for each listed vehicle and tick, correlated in time."""

    kind: Literal["turbulence"]
    acceleration_rms: Acceleration = Field(ge=0)
    correlation: Time = Field(5.0, gt=0, description="time constant of the correlation")


def shifted(sources: tuple[DisturbanceSource, ...], shift: float) -> tuple[DisturbanceSource, ...]:
    """Return disturbances of which every function of time acts later by ``shift`` [s]; < 0 earlier."""
    return tuple(
        source.model_copy(update={"shift": (source.shift or 0.0) + shift})
        if isinstance(source, _TimeFunction)
        else source
        for source in sources
    )


DisturbanceSource = Annotated[
    Equation40 | Harmonic | Gust | UnmodelledGrade | Paper001 | Paper002 | TravellingLoad | Turbulence,
    Field(discriminator="kind"),
]
