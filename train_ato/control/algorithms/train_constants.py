"""Constants of a train for a predictive law: pole of the loop, time of a wave, drag and tables of the force limits."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from plant_sim.gears import LinearGear, RigidGear, TableGear
from train_ato.control.algorithms.force_shares import mean_over_units
from train_ato.control.algorithms.predictive_plan import SPEED_STEP
from train_ato.messages.types import Array
from train_ato.messages.validity import MAX_FORCE

if TYPE_CHECKING:
    from train_ato.control.train_model import TrainModel

MAX_TABLE_SPEED = 140.0
"""Last speed of the tables of force limits [m/s]."""
MAX_OMEGA = 1.5
"""Largest default pole of the closed loop [rad/s]."""


def default_omega(model: TrainModel) -> float:
    """Return the pole of the closed loop from delay, lag and the wave impedance of the couplers [rad/s]."""
    dead = dead_time(model)
    omega = min(MAX_OMEGA, 0.9 / dead if dead > 0.0 else MAX_OMEGA)
    longest = wave_time(model)
    if longest > 0.0:
        for share, sides in hauling_groups(model):
            omega = min(omega, sides * model.mass / (3.0 * share * model.inertia * longest))
    return omega


def dead_time(model: TrainModel) -> float:
    """Return the time from a measurement to the effect of its command, largest delay and lag [s]."""
    return max(float(model.delay.max()), float(model.delay_brake.max())) + model.lag


def hauling_groups(model: TrainModel) -> list[tuple[float, int]]:
    """Return share of the force and number of hauled neighbours of each group of adjacent power units.

    The groups without a hauled neighbour have no entry.
    """
    shares = dict(zip(model.units, model.share.tolist(), strict=True))
    found, share, before = [], 0.0, 0
    for number in range(len(model.consist.vehicles) + 1):
        if number in shares:
            share += shares[number]
            continue
        after = int(number < len(model.consist.vehicles))
        if share > 0.0 and before + after > 0:
            found.append((share, before + after))
        share, before = 0.0, 1
    return found


def wave_time(model: TrainModel) -> float:
    """Return the time of a wave through all couplers of a train [s]; mass over it is the wave impedance.

    It is 0 for a train with rigid couplers only.
    """
    count = len(model.consist.vehicles)
    softest = min(map(mean_stiffness, model.consist.gears), default=math.inf)
    return math.sqrt(model.mass * count / softest)


def mean_stiffness(gear: Any) -> float:
    """Return the mean stiffness of a draft gear up to its stroke [N/m]; infinite for a rigid coupler."""
    if isinstance(gear, RigidGear):
        return math.inf
    if isinstance(gear, LinearGear):
        return gear.stiffness
    if isinstance(gear, TableGear):
        return float(gear.loading[-1] / gear.deflection[-1])
    return float(gear.force_at_stroke / gear.stroke)


def force_tables(model: TrainModel) -> Array:
    """Return the largest brake and traction force of the train over the speed [N], shape (2, speeds).

    The brake force of a train with an air brake has no limit here: the air brake adds to the electric brake, and its
    later applications are not in the input of a law.
    """
    speeds = SPEED_STEP * np.arange(round(MAX_TABLE_SPEED / SPEED_STEP))
    tables = np.empty((2, speeds.size))
    for row, envelopes in enumerate((model.brake, model.traction)):
        for column, speed in enumerate(speeds.tolist()):
            tables[row, column] = mean_over_units([1.0] * model.n_units, [each.force(speed) for each in envelopes])
    if model.air_brake is not None:
        tables[0] = MAX_FORCE
    return tables


def drag_slope(model: TrainModel) -> tuple[float, float]:
    """Return the slope of the running resistance at speed 0 [N s/m] and its increase with the speed [N s²/m²]."""
    low, middle, high = map(model.running_resistance, (10.0, 20.0, 30.0))
    curvature = (high - 2.0 * middle + low) / 100.0
    return (high - low) / 20.0 - 20.0 * curvature, curvature
