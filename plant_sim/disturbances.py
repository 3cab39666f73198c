"""Disturbances that act on the train from outside, as data; :mod:`plant_sim.outside_forces` adds them up.

Every kind answers for a whole tick at once: force F [N], force per speed G [N s/m] (the force is F + G v) and
drift speed [m/s] of the vehicles it lists.  Accelerations are turned into forces by the inertial mass.
"""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from plant_sim.line import check_grade
from plant_sim.states import Array
from plant_sim.units import Acceleration, Force, Length, SiModel, Slope, Time

Vehicles = tuple[int, ...]


class Outside(NamedTuple):
    """Force [N], force per speed [N s/m] and drift speed [m/s], each of shape (steps, vehicles); None: none."""

    force: Array
    per_speed: Array | None = None
    drift: Array | None = None


class _Source(SiModel):
    """What all kinds share; ``vehicles`` left out means all of them."""

    vehicles: Vehicles | None = Field(None, description="numbers of the vehicles, 0 the first; default: all")

    def listed(self, count: int) -> Vehicles:
        """Return the vehicles it acts on in a train of so many; raise ValueError for a number outside it."""
        chosen = tuple(range(count)) if self.vehicles is None else self.vehicles
        wrong = [i for i in chosen if not 0 <= i < count]
        if wrong:
            raise ValueError(f"a disturbance lists vehicle {wrong[0]}: the train has 0 ... {count - 1}")
        if len(set(chosen)) < len(chosen):
            raise ValueError(f"a disturbance lists a vehicle twice in {list(chosen)[:20]}; list every one once")
        return chosen

    def tick(self, t: Array, mass: Array, draws: Array) -> Outside:
        """Return what acts at the times t (shape (steps,)) on vehicles of these masses; draws are N(0, 1)."""
        raise TypeError(f"{type(self).__name__} acts through the line, not through forces")


class Equation40(_Source):
    """Paper 000, eq. (40): m {.002 + .001 sin(t+1) + .0003 v [sin(2t+2) + cos(3t+1)]}.

    The first power of the speed instead of the printed third, which would be 400-600 kN on the locomotive.
    """

    kind: Literal["eq40"]
    vehicles: Vehicles | None = Field(tuple(range(0, 101, 10)), description="paper: 0, 10, ..., 100")
    scale: float = 1.0

    def tick(self, t: Array, mass: Array, draws: Array) -> Outside:
        """See the class."""
        steady = self.scale * (0.002 + 0.001 * np.sin(t + 1.0))
        speed = self.scale * 0.0003 * (np.sin(2.0 * t + 2.0) + np.cos(3.0 * t + 1.0))
        return Outside(np.outer(steady, mass), per_speed=np.outer(speed, mass))


class Term(SiModel):
    """One sine: amplitude sin(omega t + phase)."""

    acceleration: Acceleration = 0.0
    force: Force = 0.0
    omega: float = Field(ge=0, description="rad/s")
    phase: float = Field(0.0, description="rad")


class Harmonic(_Source):
    """Sum of sines."""

    kind: Literal["harmonic"]
    terms: tuple[Term, ...] = Field(min_length=1)

    def tick(self, t: Array, mass: Array, draws: Array) -> Outside:
        """See the class."""
        force = np.zeros((len(t), len(mass)))
        for term in self.terms:
            force += np.outer(np.sin(term.omega * t + term.phase), term.acceleration * mass + term.force)
        return Outside(force)


def _window(t: Array, begin: float, end: float, ramp: float) -> Array:
    """Trapezoid of height 1 between begin and end with ramps inside; a ramp of 0 is a step."""
    if ramp <= 0.0:
        return np.where((t >= begin) & (t < end), 1.0, 0.0)
    return np.clip(np.minimum(t - begin, end - t) / ramp, 0.0, 1.0)


class Gust(_Source):
    """A wind gust as a trapezoid in time; > 0 pushes forward."""

    kind: Literal["gust"]
    begin: Time
    end: Time
    ramp: Time = Field(1.0, ge=0, description="time of rise and of fall, inside the window")
    acceleration: Acceleration = 0.0
    force: Force = Field(0.0, description="on each listed vehicle")

    @model_validator(mode="after")
    def _order(self) -> Gust:
        if self.end <= self.begin:
            raise ValueError("a gust must end after its begin")
        return self

    def tick(self, t: Array, mass: Array, draws: Array) -> Outside:
        """See the class."""
        return Outside(np.outer(_window(t, self.begin, self.end, self.ramp), self.acceleration * mass + self.force))


class ExtraGrade(SiModel):
    """A stretch of grade that no model knows of; > 0 uphill, added to the line's."""

    begin: Length
    end: Length
    grade: Slope

    @model_validator(mode="after")
    def _order(self) -> ExtraGrade:
        if self.end <= self.begin:
            raise ValueError("a stretch of grade must end beyond its begin")
        check_grade(self.grade)
        return self


class UnmodelledGrade(_Source):
    """Grade that the plant has and the model does not; acts through the line, on every vehicle at its own place."""

    kind: Literal["grade"]
    pieces: tuple[ExtraGrade, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _all(self) -> UnmodelledGrade:
        if self.vehicles is not None:
            raise ValueError("a grade lies under every vehicle: leave 'vehicles' out")
        return self


class Paper001(_Source):
    """Paper 001's disturbance, its numbers chosen here: D > 0 opposes the motion.

    +0.10 m/s² at 60-80 s, -0.12 m/s² at 300-312 s, and 0.03 sin 0.5 t m/s².
    """

    kind: Literal["paper001"]
    scale: float = 1.0

    def tick(self, t: Array, mass: Array, draws: Array) -> Outside:
        """See the class."""
        d = 0.10 * _window(t, 60.0, 80.0, 0.0) - 0.12 * _window(t, 300.0, 312.0, 0.0) + 0.03 * np.sin(0.5 * t)
        return Outside(np.outer(-self.scale * d, mass))


class Paper002(_Source):
    """Paper 002's set on five vehicles: drift speeds d_i1 (unmatched) and accelerations d_i2 (matched)."""

    kind: Literal["paper002"]
    vehicles: Vehicles | None = (0, 1, 2, 3, 4)
    unmatched_scale: float = Field(1.0, description="1 in print; 0.05 in the realistic version")
    matched_scale: float = Field(1.0, description="1 in print; 0.02 in the realistic version")

    @model_validator(mode="after")
    def _five(self) -> Paper002:
        if self.vehicles is None or len(self.vehicles) != 5:
            raise ValueError("the set of paper 002 is for exactly five vehicles")
        return self

    def tick(self, t: Array, mass: Array, draws: Array) -> Outside:
        """See the class; beyond 30 s the last stretch of d21 goes on."""
        sine, cosine = np.sin(t), np.cos(t)
        fast = 6.0 * np.sin(3.0 * t) * cosine
        d21 = np.where(t < 10.0, fast, np.where(t < 20.0, -fast, sine * np.tanh(t)))
        unmatched = (3.0 * np.sin(t + np.pi / 6.0), d21, sine * cosine, np.tanh(sine), 2.0 * np.tanh(t) * sine)
        matched = (d21, fast, 5.0 * np.sin(3.0 * t), 3.0 * np.cos(4.0 * t), 6.0 * np.sin(cosine))
        force = self.matched_scale * np.column_stack(matched) * mass
        return Outside(force, drift=self.unmatched_scale * np.column_stack(unmatched))


class TravellingLoad(_Source):
    """A load that passes from vehicle to vehicle, as a short grade under a moving train does.

    On each vehicle it is a raised cosine in time.
    """

    kind: Literal["travelling_load"]
    acceleration: Acceleration = Field(description="peak; < 0 opposes the motion")
    begin: Time = Field(description="when it reaches the first listed vehicle")
    duration: Time = Field(gt=0, description="time on each vehicle")
    interval: Time = Field(0.0, ge=0, description="from one listed vehicle to the next")
    period: Time | None = Field(None, gt=0, description="time after which it comes again")

    def tick(self, t: Array, mass: Array, draws: Array) -> Outside:
        """See the class."""
        local = t[:, None] - self.begin - self.interval * np.arange(len(mass))
        if self.period is not None:
            local = np.where(local >= 0.0, np.mod(local, self.period), local)
        inside = (local > 0.0) & (local < self.duration)
        shape = np.where(inside, 0.5 - 0.5 * np.cos(2.0 * np.pi * local / self.duration), 0.0)
        return Outside(self.acceleration * shape * mass)


class Turbulence(_Source):
    """Random wind: one Gaussian acceleration for each listed vehicle and tick, correlated over a time."""

    kind: Literal["turbulence"]
    acceleration_rms: Acceleration = Field(ge=0)
    correlation: Time = Field(5.0, gt=0, description="time constant of the correlation")


Disturbance = Annotated[
    Equation40 | Harmonic | Gust | UnmodelledGrade | Paper001 | Paper002 | TravellingLoad | Turbulence,
    Field(discriminator="kind"),
]


__all__ = [
    "Disturbance",
    "Equation40",
    "ExtraGrade",
    "Gust",
    "Harmonic",
    "Outside",
    "Paper001",
    "Paper002",
    "Term",
    "TravellingLoad",
    "Turbulence",
    "UnmodelledGrade",
]
