"""A smooth driver who drives the nominal multi-mass train: the reference of a long train.

A plan made for a rigid train cannot be followed by a long one: couplers and slack make the locomotive ask for forces
that are not there.  So the reference of the heavy-haul scenario is a run of the nominal train itself, driven with
little force change, its speed averaged (paper 000 uses a recorded run of an expert driver instead).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plant_sim.consist import Consist
from plant_sim.line import Line
from plant_sim.plant_setup import PlantSetup
from plant_sim.traction import Envelope
from plant_sim.train import Train
from train_ato.brake.policy import BrakeSpec, make_brake_policy
from train_ato.model import TrainModel
from train_ato.profile.profile import Profile
from train_ato.types import Array


@dataclass(frozen=True)
class Driver:
    """How the driver drives.

    Attributes
    ----------
    speed : float
        Speed held [m/s].
    gain : float
        Acceleration asked for per speed error [1/s].
    slew : float
        Largest change of force [N/s].
    traction, brake : float
        Part of the envelopes that is used.
    average : float
        Window of the moving average, applied three times [s].
    """

    speed: float = 70 / 3.6
    gain: float = 0.02
    slew: float = 8e3
    traction: float = 0.72
    brake: float = 0.75
    average: float = 5.0


@dataclass(frozen=True)
class Drive:
    """A driven run: knots of vehicle 0 at ``period``, and the brake-pipe events on the way as (time, reduction)."""

    period: float
    position: Array
    velocity: Array
    force: Array
    events: tuple[tuple[float, float], ...]


def drive(
    consist: Consist,
    line: Line,
    until: float,
    driver: Driver,
    *,
    brake: BrakeSpec | None = None,
    report: Callable[[float], None] | None = None,
) -> Drive:
    """Drive the nominal train from rest at the line's begin until vehicle 0 reaches ``until`` [m].

    Parameters
    ----------
    consist, line
        The nominal train and line; the actuators are ideal.
    until
        Place at which the run ends.
    driver
        How it is driven.
    brake
        Rules of the air brake; default: those of paper 000.
    report
        Called every 100 simulated seconds with the place reached.

    Raises
    ------
    ValueError
        If the train does not get there: it stands still for a minute.
    """
    period, step = 0.1, 0.005
    train = Train(consist, line, PlantSetup(), round(step * 1e9), round(period * 1e9), seed=0)
    model = TrainModel(consist, line, np.zeros(train_units(consist)), np.zeros(train_units(consist)), 0.0, period)
    policy = make_brake_policy(brake or BrakeSpec(policy="trigger"), model, line)
    traction = [Envelope(consist.vehicles[unit].traction) for unit in consist.power_units]
    electric = [Envelope(consist.vehicles[unit].brake) for unit in consist.power_units]
    substeps = round(period / step)
    force, events, standing = 0.0, [], 0
    charged = pressure = consist.air_brake.charged if consist.air_brake else 0.0
    positions, velocities, forces = [], [], []
    while True:
        cars = train.observe().cars
        position, velocity = float(cars.position[0]), float(cars.velocity[0])
        positions.append(position)
        velocities.append(velocity)
        forces.append(force)
        if position >= until:
            break
        standing = standing + 1 if velocity < 1e-3 else 0
        if standing * period > 60:
            raise ValueError(f"the train does not get beyond {position:.0f} m: too heavy for this grade")
        tick = len(positions) - 1
        demanded = policy.step(tick * period, position, velocity, force)
        if demanded != pressure:
            events.append((tick * period, charged - demanded))
            pressure = demanded
        wanted = model.inertia * driver.gain * (driver.speed - velocity)
        wanted += model.running_resistance(velocity) + model.line_force(position)
        high = driver.traction * sum(envelope.force(velocity) for envelope in traction)
        low = -driver.brake * sum(envelope.force(velocity) for envelope in electric)
        wanted = min(max(wanted, low), high)
        force = min(max(wanted, force - driver.slew * period), force + driver.slew * period)
        train.advance(np.tile(force * model.share, (substeps, 1)), pressure if consist.air_brake else None)
        if report is not None and tick % 1000 == 0:
            report(position)
    return Drive(period, np.array(positions), np.array(velocities), np.array(forces), tuple(events))


def train_units(consist: Consist) -> int:
    """Return the number of power units."""
    return len(consist.power_units)


def reference(run: Drive, driver: Driver, spacing: float) -> Profile:
    """Return the profile of a driven run: averaged speed, place integrated from it, knots every ``spacing`` s."""
    speed = averaged(run.velocity, run.period, driver.average)
    speed[0] = 0.0
    acceleration = np.gradient(speed, run.period)
    acceleration[0] = 0.0
    steps = run.period * (speed[1:] + speed[:-1]) / 2 - run.period**2 * np.diff(acceleration) / 12
    position = run.position[0] + np.concatenate(([0.0], np.cumsum(steps)))
    every = round(spacing / run.period)
    last = (speed.size - 1) // every * every
    knots = slice(0, last + 1, every)
    # A micrometre and a nanometre per second are more than enough, and keep the file short.
    return Profile.uniform(0.0, spacing, position[knots].round(6), speed[knots].round(9), acceleration[knots].round(9))


def averaged(speed: Array, period: float, window: float) -> Array:
    """Return the speed averaged three times over a window [s], the ends held."""
    width = max(1, round(window / period)) | 1
    kernel = np.full(width, 1.0 / width)
    result = speed
    for _ in range(3):
        padded = np.pad(result, width // 2, mode="edge")
        result = np.convolve(padded, kernel, mode="valid")
    return result
