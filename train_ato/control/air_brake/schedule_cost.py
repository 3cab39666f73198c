"""Compiled forecast of a rigid train under a schedule of the air brake, and its cost.

The train follows the reference with the force of its power units, at most ``ELECTRIC_USE`` of the electric brake::

    F = clamp(M (dv_ref/dt + G (v_ref - v)) + R(v) + L(x) + S - d, -use B(v), T(v)),   M dv/dt = F - R - L - S + d

R is the running resistance, L the line force, S the shoe force of the schedule, d the unknown force. The force behind
vehicle i is quasi-static: electric and shoe force of vehicles 0 ... i less their share M_i / M of the total.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from plant_sim.compiled import compiled
from plant_sim.railway import running_resistance, shoe_force
from plant_sim.record import Records, quantity
from train_ato.messages.types import Array


@dataclass
class ForecastConstants:
    """Constants of the forecast of one train."""

    inertia: float = quantity("kg", "mass with the rotating masses")
    c0: float = quantity("N", "constant running resistance")
    c1: float = quantity("N/(m/s)", "running resistance per speed")
    c2: float = quantity("N/(m/s)²", "running resistance per squared speed")
    line_begin: float = quantity("m", "first place of the track")
    step: float = quantity("s", "step of the forecast")
    gain: float = quantity("1/s", "gain on the speed error")
    electric_use: float = quantity("", "part of the electric brake that is used")
    lowest_release: float = quantity("m/s", "speed below which no release occurs")
    error: float = quantity("m/s", "speed error with the cost 1")
    coupler_max: float = quantity("N", "permitted coupler force")
    speed_step: float = quantity("m/s", "spacing of the largest forces")
    has_electric: bool = quantity("", "the train has an electric brake")


@dataclass
class ForecastNow:
    """State of the train at a decision."""

    place: float = quantity("m", "place of vehicle 0's centre")
    speed: float = quantity("m/s", "speed")
    unknown: float = quantity("N", "unknown force, > 0 forward")
    rest: int = quantity("", "step of the last stop, up to which applied brakes may stop the train")


LIMIT_WEIGHT = 100.0
"""Weight of the squared excess over the speed limit, relative to that of the squared speed error."""
TRACTION_WEIGHT = 10.0
"""Weight of traction against the shoes, as a part of the electric brake, or of the shoe force without one."""
TRAPPED_COST = 1e3
"""Cost per time of applied brakes below the lowest speed of a release, unless they last to a stop of the profile."""
REST_SPEED = 0.01
"""Speed of the profile below which the train is at rest [m/s]."""
# Rows of `track`: line force on the train and speed limit, on the grid of the model.
LINE_FORCE, LIMIT = range(2)
# Rows of `forces`: largest electric brake and traction over the speed.
BRAKE, TRACTION = range(2)
# Rows of `vehicles`: share in the inertia of the train and in the force of the power units.
INERTIA_SHARE, FORCE_SHARE = range(2)


@compiled
def _coupler_load(coupler_max: float, vehicles: Array, slow: Array, factor: float, shoes: float, force: float) -> float:
    """Return the fourth power of the largest quasi-static coupler force over the permitted one."""
    total, behind, largest = force - shoes, 0.0, 0.0
    for i in range(len(slow) - 1):
        behind += vehicles[FORCE_SHARE, i] * force - factor * slow[i] - vehicles[INERTIA_SHARE, i] * total
        largest = max(largest, abs(behind))
    ratio = largest / coupler_max
    return ratio * ratio * ratio * ratio


@compiled
def schedule_cost(
    constants: Records[ForecastConstants], state: Records[ForecastNow], reference: Array, track: Array, forces: Array,
    vehicles: Array, slow: Array, applied: NDArray[np.bool_], released: NDArray[np.bool_],
) -> float:  # fmt: skip
    """Return the mean cost per time of a schedule; infinite if it releases below the lowest speed.

    Parameters
    ----------
    constants : Records of ForecastConstants, shape (1,)
        Constants of the train.
    state : Records of ForecastNow, shape (1,)
        Present state of the train.
    reference : Array, shape (steps + 1,)
        Reference speed from the present place on [m/s].
    track : Array, shape (2, places)
        Line force [N] and speed limit [m/s].
    forces : Array, shape (2, speeds)
        Largest electric brake and traction of the train [N].
    vehicles : Array, shape (2, vehicles)
        Shares of every vehicle.
    slow : Array, shape (steps, vehicles)
        Shoe forces at standstill of the schedule [N].
    applied, released : Array of bool, shape (steps,)
        The brake pipe is reduced in the step; it is charged from the step on.

    Returns
    -------
    cost : float
        Mean over the steps of the squared speed error in units of ``ERROR``, excess over the speed limit, traction
        against the shoes, coupler force, and applied brakes at low speed.
    """
    steps, cost, last = len(slow), 0.0, track.shape[1] - 1
    train, now = constants[0], state[0]
    place, speed = now.place, now.speed
    h, inertia = train.step, train.inertia
    fast = True
    for step in range(steps):
        if released[step] and speed < train.lowest_release:
            return np.inf
        if applied[step] and (step == 0 or not applied[step - 1]):
            fast = speed >= train.lowest_release or not train.has_electric
        factor, shoes = shoe_force(1.0, speed), 0.0
        for force in slow[step]:
            shoes += force
        shoes *= factor
        at = min(max(int((place - train.line_begin) + 0.5), 0), last)
        against = running_resistance(train.c0, train.c1, train.c2, speed) + track[LINE_FORCE, at]
        against += shoes - now.unknown
        row = min(int(speed / train.speed_step + 0.5), forces.shape[1] - 1)
        rise = (reference[step + 1] - reference[step]) / h
        wanted = inertia * (rise + train.gain * (reference[step] - speed)) + against
        force = min(max(wanted, -train.electric_use * forces[BRAKE, row]), forces[TRACTION, row])
        faster = max(speed + h * (force - against) / inertia, 0.0)
        place += 0.5 * h * (speed + faster)
        speed = faster
        error = (speed - reference[step + 1]) / train.error
        excess = max(speed - track[LIMIT, at], 0.0) / train.error
        cost += error * error + LIMIT_WEIGHT * excess * excess
        if applied[step] and speed < train.lowest_release and (step >= now.rest or not fast):
            cost += TRAPPED_COST
        if shoes > 0.0 and reference[step + 1] > REST_SPEED:
            braking = max(forces[BRAKE, row], 1.0) if train.has_electric else shoes
            cost += TRACTION_WEIGHT * max(min(force, shoes), 0.0) / braking
        if shoes > 0.0 or force < 0.0:
            cost += _coupler_load(train.coupler_max, vehicles, slow[step], factor, shoes, force)
    return cost / steps
