"""Reference profile of a long train: a simulated driver on the nominal multi-mass train.

A long train cannot follow a plan for a rigid train, because couplers and slack need forces that the locomotive does not
have. The reference of the heavy-haul scenario is therefore a simulated run of the nominal train with small force
changes. Its speed is averaged over time (paper 000 uses a recorded run of an expert driver).
"""

import math
from collections.abc import Callable

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


GAIN = 0.02
"""Acceleration of the driver per speed error [1/s]."""
SLEW = 8e3
"""Limit of the force rate [N/s]."""
TRACTION, BRAKE = 0.72, 0.75
"""Used fractions of the envelopes."""
AVERAGE = 5.0
"""Window of the moving average of the speed, applied three times [s]."""


def simulate_driver(
    consist: Consist, line: Line, until: float, target: float, spacing: float, report: Callable[[float], None]
) -> tuple[Profile, list[tuple[float, float]]]:
    """Return the averaged run of the nominal train from rest at the begin of the line, and its brake events.

    An event has a time [s] and a brake-pipe reduction [Pa]. The air brake has the rules of paper 000; a train without
    one brakes electrically only.

    Parameters
    ----------
    consist, line
        Nominal train and line; the actuators are ideal.
    until
        Position of vehicle 0 at which the run ends [m].
    target
        Target speed of the driver [m/s].
    spacing
        Time between the knots of the profile [s].
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
    force, standstill, velocities = 0.0, 0, list[float]()
    events: list[tuple[float, float]] = []
    charged = pressure = consist.air_brake.charged if consist.air_brake else 0.0
    while True:
        cars = train.observe().vehicles
        position, velocity = float(cars.position[0]), float(cars.velocity[0])
        velocities.append(velocity)
        if position >= until:
            break
        standstill = standstill + 1 if velocity < 1e-3 else 0
        if standstill * PERIOD > MAX_STANDSTILL:
            raise ValueError(f"the train stops at {position:.0f} m: too heavy for the grade; reduce its mass")
        tick = len(velocities) - 1
        demanded = policy.step(tick * PERIOD, position, velocity, force)
        if demanded != pressure:
            events.append((tick * PERIOD, charged - demanded))
            pressure = demanded
        force = _next_force(model, position, velocity, force, target)
        units: list[float] = (force * model.share).tolist()
        if model.uneven:
            units = shares.forces(position, units, *model.limits_of_units([velocity] * model.n_units))
        train.advance(np.tile(units, (substeps, 1)), pressure if consist.air_brake else None)
        if tick % 1000 == 0:
            report(position)
    return _averaged_profile(line.begin, np.array(velocities), PERIOD, spacing), events


def _next_force(model: TrainModel, position: float, velocity: float, force: float, target: float) -> float:
    """Return the next force of the train [N] from position [m], speed [m/s], present force [N] and target speed [m/s].

    The control is proportional, with a feed-forward and limits of force and rate.
    """
    demand = model.inertia * GAIN * (target - velocity)
    demand += model.running_resistance(velocity) + model.line_force(position)
    high = TRACTION * plain_sum(envelope.force(velocity) for envelope in model.traction)
    low = -BRAKE * plain_sum(envelope.force(velocity) for envelope in model.brake)
    demand = min(max(demand, low), high)
    return min(max(demand, force - SLEW * PERIOD), force + SLEW * PERIOD)


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
    return _averaged_profile(start, np.array(velocities), period, period)


def _averaged_profile(start: float, velocity: Array, period: float, spacing: float) -> Profile:
    """Return the profile of a simulated run: averaged speed, integrated position, knots every ``spacing`` s."""
    speed = average_speed(velocity, period, AVERAGE)
    speed[0] = velocity[0]
    acceleration = np.gradient(speed, period)
    acceleration[0] = 0.0
    steps = period * (speed[1:] + speed[:-1]) / 2 - period**2 * np.diff(acceleration) / 12
    position = start + np.concatenate(([0.0], np.cumsum(steps)))
    every = round(spacing / period)
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
