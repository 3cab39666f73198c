"""Profiles from phases: accelerate, cruise, brake, stop at a place.

Phases define a trapezoidal speed curve.  The profile is limited in jerk, in acceleration and, if configured, to a
fraction of the train's traction and brake envelopes on level track.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pydantic import Field, model_validator

from plant_sim.consist import Consist
from plant_sim.si_model import SiModel
from plant_sim.summation import plain_sum
from plant_sim.traction import Envelope
from plant_sim.units import Acceleration, Jerk, Length, Speed, Time
from train_ato.messages.types import Array
from train_ato.profile.motion import Motion, Piece, change_of_speed


class SpeedPoint(SiModel):
    """One point of an acceleration limit over the speed."""

    speed: Speed = Field(ge=0)
    acceleration: Acceleration = Field(gt=0)


class MotionLimits(SiModel):
    """Limits of a profile from phases or points."""

    jerk: Jerk | None = Field(0.5, gt=0, description="limit; null: none")
    jerk_braking: Jerk | None = Field(None, gt=0, description="jerk limit while braking; default: jerk")
    acceleration: Acceleration = Field(0.8, gt=0)
    deceleration: Acceleration = Field(0.8, gt=0)
    acceleration_over_speed: tuple[SpeedPoint, ...] = Field((), description="further limit, linear between its points")
    deceleration_over_speed: tuple[SpeedPoint, ...] = Field((), description="further limit, linear between its points")
    traction_fraction: float | None = Field(
        None, gt=0, le=1, description="of the traction envelope; default: not limited by it"
    )
    brake_fraction: float | None = Field(
        None, gt=0, le=1, description="of the brake envelope; default: not limited by it"
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

    accelerate_to: Speed | None = Field(None, description="increase the speed to this value; < 0: backwards")
    brake_to: Speed | None = Field(None, description="decrease the speed to this value")
    stop_at: Length | None = Field(None, description="cruise, then brake to a stop of the front at this place")
    cruise_for: Time | None = Field(None, ge=0, description="constant speed for this time; at rest: wait")
    cruise_until: Time | None = Field(None, ge=0, description="constant speed until this time of the run")
    cruise_to: Length | None = Field(None, description="constant speed until the front reaches this place")
    at: Length | None = Field(None, description="of accelerate_to and brake_to: place at which the front has the speed")
    acceleration: Acceleration | None = Field(None, gt=0, description="limit of this phase only, for both signs")
    jerk: Jerk | None = Field(None, gt=0, description="limit of this phase only")

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
        return change_of_speed(start, target, self._limit(rising, phase.acceleration), jerk)

    def _limit(self, rising: bool, own: float | None) -> Callable[[Array], Array]:
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
