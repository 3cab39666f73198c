"""Constants of a train for a predictive law: pole of the loop, time of a wave, drag and tables of the force limits."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from plant_sim.gears import LinearGear
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
    dead = max(float(model.delay.max()), float(model.delay_brake.max())) + model.lag
    omega = min(MAX_OMEGA, 0.9 / dead if dead > 0.0 else MAX_OMEGA)
    if len(model.consist.vehicles) > model.n_units:
        omega = min(omega, model.n_units * model.mass / (3.0 * model.inertia * wave_time(model)))
    return omega


def wave_time(model: TrainModel) -> float:
    """Return the time of a wave through all couplers of a train [s]; mass over it is the wave impedance."""
    count = len(model.consist.vehicles)
    return math.sqrt(model.mass * count / min(map(mean_stiffness, model.consist.gears)))


def mean_stiffness(gear: Any) -> float:
    """Return the mean stiffness of a draft gear up to its stroke [N/m]."""
    if isinstance(gear, LinearGear):
        return gear.stiffness
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


def starting_resistance(model: TrainModel) -> float:
    """Return the running resistance at the begin of a motion on a level line [N], before it fades out at standstill."""
    slope, curvature = drag_slope(model)
    return model.running_resistance(10.0) - 10.0 * slope - 100.0 * curvature
