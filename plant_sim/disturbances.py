"""Data models of the outside disturbances of a train; :mod:`plant_sim.disturbances` adds them up.

Every kind computes a whole tick in one call: force F [N], force per speed G [N s/m], drift speed [m/s] and force per
cube of the speed H [N s³/m³] of its vehicles. The force is F + (G + H v_0²) v with the speed v_0 at the begin of the
tick. Accelerations are multiplied by the inertial mass.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from plant_sim.elementary import cos_each, sin_each, tanh_each
from plant_sim.line import LineSection, check_grade
from plant_sim.si_model import SiModel, option
from plant_sim.states import Array
from plant_sim.units import Acceleration, Force, Number, Slope, Time, Unit, Usual

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

    vehicles: Vehicles | None = option(None, "numbers of the vehicles, from 0; default: all", example=(0, 1))

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

    shift: Time | None = option(None, "delay of the whole disturbance; < 0: it acts earlier; default: 0", example=30.0)

    def local(self, t: Array) -> Array:
        """Return the times of the function for times of the run [s]."""
        return t if self.shift is None else t - self.shift


class Equation40(_TimeFunction):
    """Disturbance of paper 000, eq. (40): m {.002 + .001 sin(t+1) + .0003 v [sin(2t+2) + cos(3t+1)]}.

    Printed is the third power of the speed: 400-600 kN on the locomotive, more than its largest brake force.
    """

    kind: Literal["eq40"]
    speed_power: Literal[1, 3] = option(1, "power of the speed; 3 as printed")
    vehicles: Vehicles | None = option(
        tuple(range(0, 101, 10)), "numbers of the vehicles, 0, 10, ..., 100 in the paper"
    )
    scale: Number = option(1.0, "factor on the printed disturbance")

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

    acceleration: Acceleration = option(0.0, "amplitude as acceleration of each listed vehicle", example=0.02)
    force: Annotated[Force, Usual(10, 5e6)] = option(0.0, "amplitude as force on each listed vehicle", example=2e3)
    omega: Annotated[float, Unit("rad/s")] = Field(ge=0, description="angular frequency", examples=[0.5])
    phase: Annotated[float, Unit("rad")] = option(0.0, "phase at time 0", example=1.57)


class Harmonic(_TimeFunction):
    """Sum of sines."""

    kind: Literal["harmonic"]
    terms: tuple[Term, ...] = Field(
        min_length=1, description="sines that are added", examples=[[{"acceleration": 0.02, "omega": 0.5}]]
    )

    def tick(self, t: Array, mass: Array) -> OutsideForce:
        """Return the forces of a tick."""
        force = np.zeros((len(t), len(mass)))
        for term in self.terms:
            force += sin_each(term.omega * t + term.phase)[:, None] * (term.acceleration * mass + term.force)
        return OutsideForce(force)


def _window(t: Array, begin: float, end: float, ramp: float) -> Array:
    """Return a trapezoid of height 1 between begin and end with ramps inside, each at most a half; 0 is a step."""
    if ramp <= 0.0:
        return np.where((t >= begin) & (t < end), 1.0, 0.0)
    return np.clip(np.minimum(t - begin, end - t) / min(ramp, (end - begin) / 2.0), 0.0, 1.0)


class Interval(SiModel):
    """Interval of a run."""

    begin: Time = Field(description="begin of the interval", examples=[60.0])
    end: Time = Field(description="end of the interval", examples=[70.0])

    @model_validator(mode="after")
    def _order(self) -> Interval:
        if self.end <= self.begin:
            raise ValueError(f"end {self.end:g} s must be after begin {self.begin:g} s; correct it")
        return self


class Gust(Interval, _TimeFunction):
    """Wind gust as a trapezoid in time; > 0 acts forward."""

    kind: Literal["gust"]
    begin: Time = Field(description="begin of the gust, with its ramp", examples=[60.0])
    end: Time = Field(description="end of the gust, with its ramp", examples=[80.0])
    ramp: Time = option(1.0, "time of rise and of fall, inside the interval, at most half of it", ge=0)
    acceleration: Acceleration = option(0.0, "acceleration of each listed vehicle", example=-0.05)
    force: Annotated[Force, Usual(10, 5e6)] = option(0.0, "force on each listed vehicle", example=-3e3)

    def tick(self, t: Array, mass: Array) -> OutsideForce:
        """Return the forces of a tick."""
        shape = _window(t, self.begin, self.end, self.ramp)
        return OutsideForce(shape[:, None] * (self.acceleration * mass + self.force))


class ExtraGrade(LineSection):
    """Section with a grade that is not in the model; > 0 uphill, added to that of the line."""

    grade: Slope = Field(description="additional grade", examples=[0.002])

    @model_validator(mode="after")
    def _plausible(self) -> ExtraGrade:
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
    scale: Number = option(1.0, "factor on the disturbance")

    def tick(self, t: Array, mass: Array) -> OutsideForce:
        """Return the forces of a tick."""
        d = 0.10 * _window(t, 60.0, 80.0, 0.0) - 0.12 * _window(t, 300.0, 312.0, 0.0) + 0.03 * sin_each(0.5 * t)
        return OutsideForce((-self.scale * d)[:, None] * mass)


class Paper002(_TimeFunction):
    """Disturbances of paper 002 on five vehicles: drift speeds d_i1 (unmatched), accelerations d_i2 (matched)."""

    kind: Literal["paper002"]
    vehicles: Vehicles | None = option((0, 1, 2, 3, 4), "numbers of the five vehicles")
    unmatched_scale: Number = option(
        1.0, "factor on the drift speeds, 1 in the paper and 0.05 in the realistic version"
    )
    matched_scale: Number = option(1.0, "factor on the accelerations, 1 in the paper and 0.02 in the realistic version")

    @model_validator(mode="after")
    def _five(self) -> Paper002:
        if self.vehicles is None or len(self.vehicles) != 5:
            raise ValueError("the disturbances of paper 002 need exactly five vehicles; list five")
        return self

    def tick(self, t: Array, mass: Array) -> OutsideForce:
        """Return the forces and drift speeds of a tick; the last part of d21 continues beyond 30 s."""
        sine, cosine = sin_each(t), cos_each(t)
        fast = 6.0 * sin_each(3.0 * t) * cosine
        d21 = np.where(t < 10.0, fast, np.where(t < 20.0, -fast, sine * tanh_each(t)))
        unmatched = (3.0 * sin_each(t + np.pi / 6.0), d21, sine * cosine, tanh_each(sine), 2.0 * tanh_each(t) * sine)
        matched = (d21, fast, 5.0 * sin_each(3.0 * t), 3.0 * cos_each(4.0 * t), 6.0 * sin_each(cosine))
        force = self.matched_scale * np.array(matched).T * mass
        return OutsideForce(force, drift=self.unmatched_scale * np.array(unmatched).T)


class TravellingLoad(_TimeFunction):
    """Load that moves from vehicle to vehicle, like a short grade under a moving train.

    On each vehicle it is a raised cosine in time.
    """

    kind: Literal["travelling_load"]
    acceleration: Acceleration = Field(description="largest acceleration; < 0 opposes the motion", examples=[-0.05])
    begin: Time = Field(description="time at which the load reaches the first listed vehicle", examples=[60.0])
    duration: Time = Field(gt=0, description="time of the load on each vehicle", examples=[20.0])
    interval: Time = option(0.0, "time from one listed vehicle to the next", example=2.0, ge=0)
    period: Time | None = option(None, "period of its repetition; default: once", example=120.0, gt=0)

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
    acceleration_rms: Acceleration = Field(
        ge=0, description="root mean square of the acceleration of each vehicle", examples=[0.01]
    )
    correlation: Time = option(5.0, "time constant of the correlation", gt=0)


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


BLOCK = 16
"""Number of ticks for which the disturbances are computed at once: 7 instead of 21 us per tick for equation (40)."""


Columns = slice | list[int]
"""Columns of an array: a slice if their distances are equal, which numpy adds in place without a copy."""


def _columns(numbers: Sequence[int]) -> Columns:
    """Return the columns of these numbers."""
    if not numbers:
        return []
    step = numbers[1] - numbers[0] if len(numbers) > 1 else 1
    even = range(numbers[0], numbers[-1] + 1, step) if step > 0 else ()
    return slice(numbers[0], numbers[-1] + 1, step) if list(even) == list(numbers) else list(numbers)


class _Wind:
    """Ornstein-Uhlenbeck sequence of one :class:`Turbulence`, sampled at the tick."""

    def __init__(self, source: Turbulence, vehicles: int, tick: float, random: np.random.Generator) -> None:
        self._decay = math.exp(-tick / source.correlation)
        self._gain = source.acceleration_rms * float(np.sqrt(1.0 - self._decay**2))
        self._value = np.zeros(vehicles)
        self._random = random

    def tick(self, t: Array, mass: Array) -> OutsideForce:
        """Return the forces of the next :data:`BLOCK` ticks, shape (ticks, vehicles)."""
        values = self._gain * self._random.standard_normal((BLOCK, self._value.size))
        for value in values:
            value += self._decay * self._value
            self._value = value
        self._value = values[-1].copy()
        return OutsideForce(values * mass)


class OutsideForces:
    """Sum of all disturbances of a run on the vehicles that they list.

    Parameters
    ----------
    disturbances
        Disturbances of the scenario; grades belong to the line.
    mass : Array, shape (n,)
        Inertial masses [kg].
    step_ns, tick_ns : int
        Plant step and tick [ns].
    streams
        One generator per disturbance, in the same order.

    Attributes
    ----------
    vehicles : Array, shape (listed vehicles,)
        Numbers of the vehicles with a disturbance.
    listed : slice or list of int
        The same numbers.
    mean : Array, shape (2, listed vehicles)
        Means of force [N] and force per speed [N s/m] over the last tick.
    acts : bool
        True if there is a vehicle with a disturbance.
    sum : Array, shape (3, steps, listed vehicles)
        Place of the forces of a tick.
    added_gusts : list of Gust
        Gusts that are not in the scenario and have not ended.
    planned_columns : list of int
        Columns of the vehicles of the scenario.
    """

    def __init__(
        self,
        disturbances: Sequence[DisturbanceSource],
        mass: Array,
        step_ns: int,
        tick_ns: int,
        streams: Sequence[np.random.Generator],
    ) -> None:
        self._mass = mass.copy()  # initial masses: a later jump of mass does not change the disturbances
        self._tick_ns, self._steps = tick_ns, tick_ns // step_ns
        self._offsets: Array = np.arange(self._steps) * np.float64(step_ns * 1e-9)
        acting = [
            (source, random)
            for source, random in zip(disturbances, streams, strict=True)
            if not isinstance(source, UnmodelledGrade)
        ]
        self.has_drift = any(isinstance(source, Paper002) for source, _ in acting)
        self.has_cubes = any(isinstance(source, Equation40) and source.speed_power == 3 for source, _ in acting)
        self._planned = sorted({i for source, _ in acting for i in source.listed(len(mass))})
        self._sources: list[tuple[Any, Columns, Array]] = []
        for source, random in acting:
            listed = list(source.listed(len(mass)))
            kind = _Wind(source, len(listed), tick_ns * 1e-9, random) if isinstance(source, Turbulence) else source
            self._sources.append((kind, _columns([self._planned.index(i) for i in listed]), self._mass[listed]))
        self._buffer: Array = np.zeros((BLOCK, 3, self._steps, len(self._planned)))
        self._block: Array = np.zeros(0)
        self._cubes: Array = np.zeros(0)
        self._means: Array = np.zeros(0)
        self._block_begin = -BLOCK * tick_ns
        self.added_gusts: list[Gust] = []
        self._arrange()

    def _arrange(self) -> None:
        """Assign a column to every listed vehicle."""
        added = [gust.listed(len(self._mass)) for gust in self.added_gusts]
        listed = sorted({*self._planned, *(i for vehicles in added for i in vehicles)})
        self.vehicles = np.array(listed, dtype=np.int64)
        self.listed = _columns(listed)
        self.planned_columns = [listed.index(i) for i in self._planned]
        self._gusts = [
            (gust, [listed.index(i) for i in vehicles], self._mass[list(vehicles)])
            for gust, vehicles in zip(self.added_gusts, added, strict=True)
        ]
        self.acts = bool(listed)
        self.sum = np.zeros((3, self._steps, len(listed)))
        self.mean = np.zeros((2, len(listed)))

    def add(self, gust: Gust) -> None:
        """Add a gust that is not in the scenario; it is removed after its end."""
        gust.listed(len(self._mass))
        self.added_gusts.append(gust)
        self._arrange()

    def drop_over(self, now: float) -> bool:
        """Remove the added gusts that ended before a time [s]; return True if the columns changed."""
        remaining = [gust for gust in self.added_gusts if now < gust.end + (gust.shift or 0.0)]
        if len(remaining) == len(self.added_gusts):
            return False
        self.added_gusts = remaining
        self._arrange()
        return True

    def tick(self, stamp: int, speed: Array) -> Array:
        """Return force [N], force per speed [N s/m] and drift speed [m/s] of the tick from a stamp on, if any acts.

        Parameters
        ----------
        stamp : int
            Begin of the tick [ns]; every tick follows the one before.
        speed : Array, shape (n,)
            Speed of every vehicle at that time [m/s].

        Returns
        -------
        Array, shape (3, steps, listed vehicles)
            Valid until the next call.
        """
        index = self._index_at(stamp) if self._planned else 0
        if not (self._gusts or self._cubes.size):
            self.mean = self._means[index]
            block: Array = self._block[index]
            return block
        self.sum[:] = 0.0
        if self._planned:
            self.sum[:, :, self.planned_columns] = self._block[index]
        if self._cubes.size:
            self.sum[1][:, self.planned_columns] += self._cubes[index] * speed[self._planned] ** 2
        self._add_gusts(stamp * 1e-9 + self._offsets, self.sum)
        self.mean = np.add.reduce(self.sum[:2], axis=1) / self._steps
        return self.sum

    def _add_gusts(self, t: Array, forces: Array) -> None:
        """Add the gusts at the times of the plant steps of a tick [s] to its forces [N]."""
        for gust, columns, mass in self._gusts:
            forces[0][:, columns] += gust.tick(gust.local(t), mass).force

    def rest_of_block(self, stamp: int, count: int) -> Array:
        """Return the forces of at most ``count`` ticks from a stamp [ns] on, without added gusts and cubes.

        Shape (ticks, 3, steps, listed vehicles) as in :meth:`ahead`, without a copy; valid until the next call. The
        attribute ``mean`` becomes that of the last of these ticks.
        """
        if not self.acts:
            return np.broadcast_to(self.sum, (count, *self.sum.shape))
        index = self._index_at(stamp)
        block: Array = self._block[index : index + count]
        self.mean = self._means[index + len(block) - 1]
        return block

    def ahead(self, stamp: int, count: int) -> tuple[Array, Array, Array]:
        """Return the forces of the ticks from a stamp on, up to the end of the next added gust.

        Parameters
        ----------
        stamp : int
            Begin of the first tick [ns]; the tick before has been taken.
        count : int
            Number of ticks.

        Returns
        -------
        forces : Array, shape (ticks, 3, steps, listed vehicles)
            A copy of force [N], force per speed [N s/m] and drift speed [m/s].
        cubes : Array, shape (ticks, steps, planned columns)
            Force per third power of the speed [N s³/m³]; its part is not in ``forces``.
        means : Array, shape (ticks, 2, listed vehicles)
            Means over the ticks, without the cubes.
        """
        if not self.acts:
            none = np.zeros((count, self._steps, 0))
            return np.zeros((count, *self.sum.shape)), none, np.zeros((count, 2, 0))
        index = self._index_at(stamp)
        while index + count > len(self._block):
            kept = (self._block[index:], self._means[index:], self._cubes[index:])
            more = self._block_from(stamp + len(kept[0]) * self._tick_ns, np.zeros(self._buffer.shape))
            self._keep(stamp, *(np.concatenate(parts) for parts in zip(kept, more, strict=True)))
            index = 0
        part = slice(index, index + count)
        forces, means = self._block[part].copy(), self._means[part]
        cubes = self._cubes[part] if self._cubes.size else np.zeros((count, self._steps, 0))
        if self._gusts:
            planned, forces = forces, np.zeros((count, *self.sum.shape))
            forces[..., self.planned_columns] = planned
            for t, force in zip((stamp + self._tick_ns * np.arange(count)) * 1e-9, forces, strict=True):
                self._add_gusts(t + self._offsets, force)
            means = np.add.reduce(forces[:, :2], axis=2) / self._steps
        return forces, cubes, means

    def _keep(self, begin: int, block: Array, means: Array, cubes: Array) -> None:
        self._block_begin, self._block, self._means, self._cubes = begin, block, means, cubes

    def _index_at(self, stamp: int) -> int:
        """Return the number of the tick from a stamp on in the block; without it the next block is computed."""
        index = (stamp - self._block_begin) // self._tick_ns
        if 0 <= index < len(self._block):
            return index
        self._buffer[:] = 0.0
        self._keep(stamp, *self._block_from(stamp, self._buffer))
        return 0

    def _block_from(self, begin: int, block: Array) -> tuple[Array, Array, Array]:
        """Return forces, their means, and cubes of the scenario for :data:`BLOCK` ticks from a stamp [ns] on.

        ``block`` has zeros, shape (ticks, 3, steps, listed vehicles); the forces are written into it. One block for
        the whole run saves the memory pages of a new one: 25 us per tick for 106 vehicles.
        """
        starts = (begin + self._tick_ns * np.arange(BLOCK)) * 1e-9
        t = np.add.outer(starts, self._offsets).ravel()
        cubes: Array = np.zeros(0)
        for source, columns, mass in self._sources:
            outside = source.tick(t if isinstance(source, _Wind) else source.local(t), mass)
            for row, part in enumerate(outside[:3]):
                if part is not None:
                    block[:, row][:, :, columns] += part.reshape(BLOCK, -1, len(mass))
            if outside.per_cube is not None:
                cubes = cubes if cubes.size else np.zeros((BLOCK, self._steps, len(self._planned)))
                cubes[:, :, columns] += outside.per_cube.reshape(BLOCK, -1, len(mass))
        means = np.add.reduce(block[:, :2], axis=2) / self._steps
        return block, means, cubes
