"""Reference profile of a long train: a simulated driver on the nominal multi-mass train.

A long train cannot follow a plan for a rigid train, because couplers and slack need forces that the locomotive does not
have. The reference of the heavy-haul scenario is therefore a simulated run of the nominal train with small force
changes. Its speed is averaged over time (paper 000 uses a recorded run of an expert driver).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plant_sim.consist import Consist
from plant_sim.elementary import plain_sum, total_of_units
from plant_sim.line import Line
from plant_sim.plant_setup import PlantSetup
from plant_sim.train import Train
from train_ato.control.air_brake.policy import BrakeSpec, make_brake_policy
from train_ato.control.force_distribution import ForceDistribution
from train_ato.control.open_loop import DriverAction, OpenLoopDriver, actions_text, driver_reductions
from train_ato.control.train_model import TrainModel
from train_ato.messages.types import Array
from train_ato.profile.profile import Profile

PERIOD, STEP = 0.1, 0.005
"""Period of the driver and step of the simulated train [s]."""
MAX_STANDSTILL = 60.0
"""Standstill after which the train is unable to continue [s]."""


def nominal_train_model(consist: Consist, line: Line, tick: float = 0.1) -> TrainModel:
    """Return the nominal model of a train with ideal actuators."""
    none = np.zeros(len(consist.power_units))
    return TrainModel(consist, line, none, none, 0.0, tick)


@dataclass(frozen=True)
class Driver:
    """Parameters of the simulated driver.

    Attributes
    ----------
    speed : float
        Target speed [m/s].
    gain : float
        Acceleration per speed error [1/s].
    slew : float
        Limit of the force rate [N/s].
    traction, brake : float
        Used fraction of the envelopes.
    average : float
        Window of the moving average, applied three times [s].
    """

    speed: float = 70 / 3.6
    gain: float = 0.02
    slew: float = 8e3
    traction: float = 0.72
    brake: float = 0.75
    average: float = 5.0

    def next_force(self, model: TrainModel, position: float, velocity: float, force: float) -> float:
        """Return the next force of the train [N] from position [m], speed [m/s] and present force [N].

        The control is proportional, with a feed-forward and limits of force and rate.
        """
        demand = model.inertia * self.gain * (self.speed - velocity)
        demand += model.running_resistance(velocity) + model.line_force(position)
        high = self.traction * plain_sum(envelope.force(velocity) for envelope in model.traction)
        low = -self.brake * plain_sum(envelope.force(velocity) for envelope in model.brake)
        demand = min(max(demand, low), high)
        return min(max(demand, force - self.slew * PERIOD), force + self.slew * PERIOD)


@dataclass(frozen=True)
class DrivenRun:
    """A simulated run.

    Attributes
    ----------
    period : float
        Time between samples [s].
    position, velocity, force : Array, shape (n,)
        Vehicle 0's centre [m], its speed [m/s], commanded force of the train [N].
    events : tuple of (float, float)
        Time [s] and brake-pipe reduction [Pa] of every brake event.
    """

    period: float
    position: Array
    velocity: Array
    force: Array
    events: tuple[tuple[float, float], ...]


def simulate_driver(
    consist: Consist, line: Line, until: float, driver: Driver, *, report: Callable[[float], None] | None = None
) -> DrivenRun:
    """Simulate the nominal train from rest at the begin of the line until vehicle 0 reaches ``until`` [m].

    The air brake has the rules of paper 000; a train without one brakes electrically only.

    Parameters
    ----------
    consist, line
        Nominal train and line; the actuators are ideal.
    until
        Position at which the run ends [m].
    driver
        Parameters of the driver.
    report
        Called every 100 simulated seconds with the position [m].

    Raises
    ------
    ValueError
        If the train is at rest for 60 s before ``until``.
    """
    setup = PlantSetup.model_validate({"start": {"position": line.begin}})
    train = Train(consist, line, setup, step_ns=round(STEP * 1e9), tick_ns=round(PERIOD * 1e9), seed=0)
    model = nominal_train_model(consist, line, PERIOD)
    policy = make_brake_policy(BrakeSpec(policy="trigger" if consist.air_brake else "none"), model, line)
    substeps, shares = round(PERIOD / STEP), ForceDistribution((), model.share.tolist())
    force, events, standstill = 0.0, [], 0
    charged = pressure = consist.air_brake.charged if consist.air_brake else 0.0
    positions, velocities, forces = [], [], []
    while True:
        cars = train.observe().vehicles
        position, velocity = float(cars.position[0]), float(cars.velocity[0])
        positions.append(position)
        velocities.append(velocity)
        forces.append(force)
        if position >= until:
            break
        standstill = standstill + 1 if velocity < 1e-3 else 0
        if standstill * PERIOD > MAX_STANDSTILL:
            raise ValueError(f"the train stops at {position:.0f} m: too heavy for the grade; reduce its mass")
        tick = len(positions) - 1
        demanded = policy.step(tick * PERIOD, position, velocity, force)
        if demanded != pressure:
            events.append((tick * PERIOD, charged - demanded))
            pressure = demanded
        force = driver.next_force(model, position, velocity, force)
        units: list[float] = (force * model.share).tolist()
        if model.uneven:
            units = shares.forces(position, units, *model.limits_of_units([velocity] * model.n_units))
        train.advance(np.tile(units, (substeps, 1)), pressure if consist.air_brake else None)
        if report is not None and tick % 1000 == 0:
            report(position)
    return DrivenRun(PERIOD, np.array(positions), np.array(velocities), np.array(forces), tuple(events))


def simulate_actions(
    actions: tuple[DriverAction, ...],
    consist: Consist,
    line: Line,
    period: float,
    start: float,
    duration: float,
    speed: float,
) -> Profile:
    """Return the averaged speed of the nominal train on the actions of a driver, open loop.

    Parameters
    ----------
    actions
        Notches and brake-pipe reductions.
    consist, line
        Nominal train and line; the actuators are ideal.
    period
        Time between the knots [s].
    start, duration, speed
        Place of vehicle 0's centre [m], duration [s] and speed at the begin [m/s].

    Raises
    ------
    ValueError
        As :meth:`OpenLoopDriver.bind`.
    """
    step = period / max(1, math.ceil(period / STEP - 1e-9))
    setup = PlantSetup.model_validate({"start": {"position": start, "speed": speed}})
    train = Train(consist, line, setup, step_ns=round(step * 1e9), tick_ns=round(period * 1e9), seed=0)
    model = nominal_train_model(consist, line, period)
    driver = OpenLoopDriver(actions=actions_text(actions))
    driver.bind(model, period)
    events = driver_reductions(actions)
    policy = make_brake_policy(BrakeSpec(policy="planned", events=events) if events else BrakeSpec(), model, line)
    velocities, units = [], list(train.units)
    for tick in range(max(2, round(duration / period)) + 1):
        velocity = train.velocity
        velocities.append(float(velocity[0]))
        position = float(train.position[0])
        force = np.array(driver.forces(tick * period, position, velocity[units].tolist()))
        pressure = policy.step(tick * period, position, float(velocity[0]), total_of_units(force))
        train.advance(np.tile(force, (train.substeps, 1)), pressure if consist.air_brake else None)
    averaged = DrivenRun(period, np.array([start]), np.array(velocities), np.zeros(0), ())
    return averaged_profile(averaged, Driver(), period)


def averaged_profile(run: DrivenRun, driver: Driver, spacing: float) -> Profile:
    """Return the profile of a simulated run: averaged speed, integrated position, knots every ``spacing`` s."""
    speed = average_speed(run.velocity, run.period, driver.average)
    speed[0] = run.velocity[0]
    acceleration = np.gradient(speed, run.period)
    acceleration[0] = 0.0
    steps = run.period * (speed[1:] + speed[:-1]) / 2 - run.period**2 * np.diff(acceleration) / 12
    position = run.position[0] + np.concatenate(([0.0], np.cumsum(steps)))
    every = round(spacing / run.period)
    last = (speed.size - 1) // every * every
    knots = slice(0, last + 1, every)
    # Rounded to 1 µm and 1 nm/s: a short file without a loss of accuracy.
    return Profile.uniform(0.0, spacing, position[knots].round(6), speed[knots].round(9), acceleration[knots].round(9))


def average_speed(speed: Array, period: float, window: float) -> Array:
    """Return a speed averaged three times over a window [s]; the end values are extended."""
    width = max(1, round(window / period)) | 1
    return window_mean(window_mean(window_mean(speed, width), width), width)


def window_mean(values: Array, width: int) -> Array:
    """Return the moving average over an odd number of values; the end values are extended."""
    padded = np.pad(values, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
