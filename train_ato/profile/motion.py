"""Motion in pieces of constant jerk, sampled to the knots of a profile.

A change of speed within a speed-dependent acceleration limit is solved in the plane of speed and ``y = a²/2``. There a
jerk limit is a limit on the slope of y, because dy/dv = da/dt. The fastest change is the largest curve below
``a_max(v)²/2`` with that slope. One pass in each direction finds it. Between two grid points y is linear in v, so that
every cell is a piece of constant jerk and is integrated exactly.

Profiles from phases: accelerate, cruise, brake, stop at a place.

Phases define a trapezoidal speed curve.  The profile is limited in jerk, in acceleration and, if configured, to a
fraction of the train's traction and brake envelopes on level track.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from plant_sim.consist import Consist
from plant_sim.elementary import plain_sum
from plant_sim.si_model import SiModel, option
from plant_sim.traction import Envelope
from plant_sim.units import Acceleration, Jerk, Number, Place, Speed, Time, Usual
from train_ato.messages.types import Array
from train_ato.profile.profile import Profile, knot_count

CELLS = 1000
"""Number of speed cells of a change of speed."""
SAMPLED_AT_ONCE = 65536
"""Number of knots that are sampled at once: a day has 1.7 million."""
MIN_SPEED_CHANGE = 1e-9
"""Changes of speed below this are ignored [m/s]."""


@dataclass(frozen=True, slots=True)
class Piece:
    """Duration [s], initial acceleration [m/s²] and constant jerk [m/s³] of one piece."""

    duration: float
    acceleration: float
    jerk: float


def _advance(x: float, v: float, t: float, a: float, j: float) -> tuple[float, float]:
    return x + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2)


@dataclass
class Motion:
    """A motion built from pieces of constant jerk.

    Attributes
    ----------
    time, position, velocity, acceleration : float
        State at its present end: s, m, m/s, m/s².
    pieces : array of float
        Duration [s], initial acceleration [m/s²] and jerk [m/s³] of every piece so far, one after the other.
    """

    time: float
    position: float
    velocity: float = 0.0
    acceleration: float = 0.0
    pieces: array[float] = field(default_factory=lambda: array("d"))

    def __post_init__(self) -> None:
        self.begin = (self.time, self.position, self.velocity)

    def add(self, pieces: list[Piece]) -> None:
        """Append pieces."""
        for piece in pieces:
            numbers = piece.duration, piece.acceleration, piece.jerk
            self.position, self.velocity = _advance(self.position, self.velocity, *numbers)
            self.time += piece.duration
            self.acceleration = piece.acceleration + piece.jerk * piece.duration
            self.pieces.extend(numbers)

    def hold(self, duration: float) -> None:
        """Append constant speed for a duration [s]."""
        if duration > 0:
            self.add([Piece(duration, 0.0, 0.0)])
            self.acceleration = 0.0

    def settle(self, jerk: float | None) -> None:
        """Append a piece that reduces the acceleration to 0 within the jerk limit [m/s³]."""
        if self.acceleration and jerk:
            duration = abs(self.acceleration) / jerk
            self.add([Piece(duration, self.acceleration, -math.copysign(jerk, self.acceleration))])
        self.acceleration = 0.0

    def sampled(self, period: float) -> Profile:
        """Return the profile of the motion with knots every ``period`` seconds; the last knot may be after its end."""
        time, x, v = self.begin
        pieces = len(self.pieces) // 3
        states = np.empty((pieces + 1, 5))
        for row, (duration, a, j) in zip(states, zip(*[iter(self.pieces)] * 3, strict=True), strict=False):
            row[:] = time, x, v, a, j
            x, v = _advance(x, v, duration, a, j)
            v = 0.0 if abs(v) < MIN_SPEED_CHANGE else v
            time += duration
        states[-1] = time, x, v, self.acceleration, 0.0
        count = knot_count(max(2.0, float(np.ceil((time - self.begin[0]) / period - 1e-9)) + 1))
        found = np.empty((3, count))
        for first in range(0, count, SAMPLED_AT_ONCE):
            part = found[:, first : first + SAMPLED_AT_ONCE]
            knots = self.begin[0] + period * np.arange(first, first + part.shape[1])
            index = np.clip(np.searchsorted(states[:, 0], knots + 1e-12, side="right") - 1, 0, pieces)
            t0, x0, v0, a0, j0 = states[index].T
            s = np.maximum(knots - t0, 0.0)
            part[0] = x0 + s * (v0 + s * (a0 / 2 + s * j0 / 6))
            part[1] = v0 + s * (a0 + s * j0 / 2)
            part[2] = a0 + s * j0
            if abs(v) < MIN_SPEED_CHANGE:
                part[:, index == pieces] = [[x], [0.0], [0.0]]
        return Profile.uniform(self.begin[0], period, *found)


def change_of_speed(start: float, target: float, limit: Callable[[Array], Array], jerk: float | None) -> list[Piece]:
    """Return the fastest change from one speed to another, with zero acceleration at both ends.

    Parameters
    ----------
    start, target
        Speeds [m/s] of one sign (0 counts as either).
    limit
        Function of the speed magnitude [m/s] that returns the acceleration limit [m/s²].
    jerk
        Jerk limit [m/s³]; None: the acceleration may step.

    Raises
    ------
    ValueError
        If the limit is zero at a speed between them.
    """
    if abs(target - start) < MIN_SPEED_CHANGE:
        return []
    speed = np.linspace(abs(start), abs(target), CELLS + 1)
    largest = np.asarray(limit(speed), dtype=np.float64)
    none_left = np.flatnonzero(largest <= 0)
    if none_left.size:
        raise ValueError(
            f"{3.6 * abs(target):.1f} km/h cannot be reached: no acceleration available at "
            f"{3.6 * speed[none_left[0]]:.1f} km/h; choose a speed below it"
        )
    y = _under_slope(largest**2 / 2, abs(target - start) / CELLS, jerk)
    a = np.sqrt(2 * y) * math.copysign(1.0, target - start)
    with np.errstate(divide="ignore"):  # an acceleration that is 0 in floating point: endless, refused by knot_count
        duration = 2 * abs(target - start) / CELLS / np.abs(a[:-1] + a[1:])
    slope = (a[1:] - a[:-1]) / duration
    return [Piece(*row) for row in zip(duration.tolist(), a[:-1].tolist(), slope.tolist(), strict=True)]


def _under_slope(y: Array, step: float, jerk: float | None) -> Array:
    """Return the largest curve below ``y`` with a slope within the jerk limit, 0 at both ends."""
    if jerk is None:
        return y
    y = y.copy()
    y[0] = y[-1] = 0.0
    rise = min(jerk * step, float(y.max()))  # a steeper ramp limits nothing else and would cancel y by rounding
    ramp = rise * np.arange(y.size)
    y = np.minimum.accumulate(y - ramp) + ramp
    y = (np.minimum.accumulate(y[::-1] - ramp) + ramp)[::-1]
    return np.maximum(y, 0.0)


class SpeedPoint(SiModel):
    """One point of an acceleration limit over the speed."""

    speed: Speed = Field(ge=0, description="speed of the point", examples=[20.0])
    acceleration: Acceleration = Field(gt=0, description="largest acceleration at this speed", examples=[0.5])


class MotionLimits(SiModel):
    """Limits of a profile from phases or points."""

    jerk: Annotated[Jerk | None, Usual(2e-4, 100)] = option(0.5, "largest jerk; null: no limit", gt=0)
    jerk_braking: Jerk | None = option(None, "largest jerk in braking; default: jerk", example=0.3, gt=0)
    acceleration: Annotated[Acceleration, Usual(1e-3, 10)] = option(0.8, "largest acceleration", gt=0)
    deceleration: Annotated[Acceleration, Usual(1e-3, 10)] = option(0.8, "largest deceleration, a positive value", gt=0)
    acceleration_over_speed: tuple[SpeedPoint, ...] = option(
        (), "further limit of the acceleration, linear between its points"
    )
    deceleration_over_speed: tuple[SpeedPoint, ...] = option(
        (), "further limit of the deceleration, linear between its points"
    )
    traction_fraction: Number | None = option(
        None, "largest used part of the traction envelope; default: no limit", example=0.9, gt=0, le=1
    )
    brake_fraction: Number | None = option(
        None, "largest used part of the brake envelope; default: no limit", example=0.9, gt=0, le=1
    )

    @model_validator(mode="after")
    def _rising(self) -> MotionLimits:
        for name in ("acceleration_over_speed", "deceleration_over_speed"):
            speeds = [point.speed for point in getattr(self, name)]
            if any(np.diff(speeds) <= 0):
                raise ValueError(f"{name} is not in order of speed; sort it by increasing speed")
        return self


KINDS = ("accelerate_to", "brake_to", "stop_at", "cruise_for", "cruise_until", "cruise_to")


class Phase(SiModel):
    """One phase of exactly one kind. Places are those of the train's front."""

    accelerate_to: Speed | None = option(None, "speed that the phase rises to; < 0: backwards", example=20.0)
    brake_to: Speed | None = option(None, "speed that the phase falls to", example=10.0)
    stop_at: Place | None = option(
        None, "place of the front at which the phase ends at rest, by cruising and braking", example=1200.0
    )
    cruise_for: Time | None = option(
        None, "duration of a phase of constant speed; at rest: of waiting", example=60.0, ge=0
    )
    cruise_until: Time | None = option(
        None, "time of the run at which a phase of constant speed ends", example=60.0, ge=0
    )
    cruise_to: Place | None = option(None, "place of the front at which a phase of constant speed ends", example=1200.0)
    at: Place | None = option(None, "place of the front at the end of accelerate_to or brake_to", example=1200.0)
    acceleration: Acceleration | None = option(
        None, "largest acceleration and deceleration of this phase; default: as in limits", example=0.5, gt=0
    )
    jerk: Annotated[Jerk | None, Usual(2e-4, 100)] = option(
        None, "largest jerk of this phase; default: as in limits", example=0.3, gt=0
    )

    @model_validator(mode="after")
    def _one_kind(self) -> Phase:
        given = [kind for kind in KINDS if getattr(self, kind) is not None]
        if len(given) != 1:
            raise ValueError(f"a phase has {', '.join(given) or 'no kind'}; give exactly one of {', '.join(KINDS)}")
        if self.at is not None and given[0] not in ("accelerate_to", "brake_to"):
            raise ValueError(f"'at' has no effect with {given[0]}; use it with accelerate_to or brake_to")
        return self


class PhaseBuilder:
    """Conversion of phases of one train to pieces of a motion."""

    def __init__(self, limits: MotionLimits, consist: Consist) -> None:
        vehicles = consist.vehicles
        self.limits = limits
        self.half = vehicles[0].length / 2
        self.inertia = plain_sum(vehicle.mass * vehicle.rotating_mass_factor for vehicle in vehicles)
        self.traction = [Envelope(vehicle.traction) for vehicle in vehicles if vehicle.traction]
        self.brake = [Envelope(vehicle.brake) for vehicle in vehicles if vehicle.brake]
        polynomials = [vehicle.resistance.polynomial(vehicle.mass, consist.gravity) for vehicle in vehicles]
        self.resistance = np.sum(np.array(polynomials), axis=0)

    def append_phases(self, motion: Motion, phases: tuple[Phase, ...]) -> None:
        """Append the phases to the motion.

        Raises
        ------
        ValueError
            If a phase is not possible; the message has its number.
        """
        for number, phase in enumerate(phases):
            try:
                self._append(motion, phase)
            except ValueError as error:
                raise ValueError(f"phase {number}: {error}") from None

    def _append(self, motion: Motion, phase: Phase) -> None:
        motion.settle(phase.jerk or self.limits.jerk)
        if phase.cruise_for is not None:
            motion.hold(phase.cruise_for)
        elif phase.cruise_until is not None:
            if phase.cruise_until < motion.time - 1e-9:
                raise ValueError(
                    f"cruise_until = {phase.cruise_until:g} s is before the begin of the phase at {motion.time:.2f} s; "
                    "increase it"
                )
            motion.hold(phase.cruise_until - motion.time)
        elif phase.cruise_to is not None:
            self._cruise_to(motion, phase.cruise_to, "cruise_to")
        elif phase.stop_at is not None:
            self._change(motion, phase, 0.0, phase.stop_at)
        elif phase.accelerate_to is not None:
            if abs(phase.accelerate_to) < abs(motion.velocity):
                raise ValueError(f"accelerate_to is below the present {3.6 * motion.velocity:.1f} km/h; use brake_to")
            self._change(motion, phase, phase.accelerate_to, phase.at)
        else:
            assert phase.brake_to is not None
            if abs(phase.brake_to) > abs(motion.velocity):
                raise ValueError(f"brake_to is above the present {3.6 * motion.velocity:.1f} km/h; use accelerate_to")
            self._change(motion, phase, phase.brake_to, phase.at)

    def _cruise_to(self, motion: Motion, place: float, name: str, reserve: float = 0.0) -> None:
        distance = place - self.half - reserve - motion.position
        if abs(distance) < 1e-9:
            return
        if distance * motion.velocity <= 0:
            front = (motion.position + self.half + reserve) / 1000
            raise ValueError(f"{name} = km {place / 1000:.3f} cannot be reached; the earliest place is km {front:.3f}")
        motion.hold(distance / motion.velocity)

    def _change(self, motion: Motion, phase: Phase, target: float, place: float | None) -> None:
        pieces = self._pieces(motion.velocity, target, phase)
        if place is not None:
            trial = Motion(0.0, 0.0, motion.velocity)
            trial.add(pieces)
            self._cruise_to(motion, place, "stop_at" if phase.stop_at is not None else "at", trial.position)
        motion.add(pieces)
        motion.velocity = target  # without the rounding errors of the pieces
        if place is not None:
            motion.position = place - self.half
        motion.acceleration = 0.0

    def _pieces(self, start: float, target: float, phase: Phase) -> list[Piece]:
        if start * target < 0:
            return self._pieces(start, 0.0, phase) + self._pieces(0.0, target, phase)
        rising = abs(target) > abs(start)
        jerk = phase.jerk or (None if rising else self.limits.jerk_braking) or self.limits.jerk
        return change_of_speed(start, target, self._limit(rising=rising, own=phase.acceleration), jerk)

    def _limit(self, *, rising: bool, own: float | None) -> Callable[[Array], Array]:
        limits = self.limits
        constant = own or (limits.acceleration if rising else limits.deceleration)
        table = limits.acceleration_over_speed if rising else limits.deceleration_over_speed
        fraction = limits.traction_fraction if rising else limits.brake_fraction
        envelopes = self.traction if rising else self.brake

        def limit(speed: Array) -> Array:
            result = np.full(speed.size, constant)
            if table:
                points = np.array([(point.speed, point.acceleration) for point in table])
                result = np.minimum(result, np.interp(speed, points[:, 0], points[:, 1]))
            if fraction is not None:
                force = np.array([plain_sum(envelope.force(float(v)) for envelope in envelopes) for v in speed])
                resistance = self.resistance[0] + self.resistance[1] * speed + self.resistance[2] * speed**2
                net = fraction * force + (-resistance if rising else resistance)
                result = np.minimum(result, net / self.inertia)
            return result

        return limit
