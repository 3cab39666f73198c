"""Compiled forecast of a rigid train under a schedule of the air brake, and its cost.

The train follows the reference with the force of its power units, at most ``ELECTRIC_USE`` of the electric brake::

    F = clamp(M (dv_ref/dt + G (v_ref - v)) + R(v) + L(x) + S - d, -use B(v), T(v)),   M dv/dt = F - R - L - S + d

R is the running resistance, L the line force, S the shoe force of the schedule, d the unknown force. The force behind
vehicle i is quasi-static: electric and shoe force of vehicles 0 ... i less their share M_i / M of the total.
"""

# mypy: allow-untyped-defs

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.railway import running_resistance, shoe_force

# Entries of `constant`.
(
    INERTIA, C0, C1, C2, LINE_BEGIN, STEP, GAIN, ELECTRIC_USE, LOWEST_RELEASE, ERROR, COUPLER_MAX, SPEED_STEP,
    HAS_ELECTRIC,
) = range(13)  # fmt: skip
# Entries of `now`: place of vehicle 0 [m], speed [m/s], unknown force [N], step up to which the profile comes to rest.
AT, SPEED, UNKNOWN, REST = range(4)
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
def _coupler_load(constant, vehicles, slow, factor, shoes, force):
    """Return the fourth power of the largest quasi-static coupler force over the permitted one."""
    total, behind, largest = force - shoes, 0.0, 0.0
    for i in range(len(slow) - 1):
        behind += vehicles[FORCE_SHARE, i] * force - factor * slow[i] - vehicles[INERTIA_SHARE, i] * total
        largest = max(largest, abs(behind))
    ratio = largest / constant[COUPLER_MAX]
    return ratio * ratio * ratio * ratio


@compiled
def schedule_cost(constant, now, reference, track, forces, vehicles, slow, applied, released):
    """Return the mean cost per time of a schedule; infinite if it releases below the lowest speed.

    Parameters
    ----------
    constant : Array
        Constants by the names of this module.
    now : Array, shape (4,)
        Present place, speed and unknown force, and the step of the last stop, up to which applied brakes may stop.
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
    place, speed = now[AT], now[SPEED]
    h, inertia = constant[STEP], constant[INERTIA]
    fast = True
    for step in range(steps):
        if released[step] and speed < constant[LOWEST_RELEASE]:
            return np.inf
        if applied[step] and (step == 0 or not applied[step - 1]):
            fast = speed >= constant[LOWEST_RELEASE] or constant[HAS_ELECTRIC] == 0.0
        factor, shoes = shoe_force(1.0, speed), 0.0
        for force in slow[step]:
            shoes += force
        shoes *= factor
        at = min(max(int((place - constant[LINE_BEGIN]) + 0.5), 0), last)
        against = running_resistance(constant[C0], constant[C1], constant[C2], speed) + track[LINE_FORCE, at]
        against += shoes - now[UNKNOWN]
        row = min(int(speed / constant[SPEED_STEP] + 0.5), forces.shape[1] - 1)
        rise = (reference[step + 1] - reference[step]) / h
        wanted = inertia * (rise + constant[GAIN] * (reference[step] - speed)) + against
        force = min(max(wanted, -constant[ELECTRIC_USE] * forces[BRAKE, row]), forces[TRACTION, row])
        faster = max(speed + h * (force - against) / inertia, 0.0)
        place += 0.5 * h * (speed + faster)
        speed = faster
        error = (speed - reference[step + 1]) / constant[ERROR]
        excess = max(speed - track[LIMIT, at], 0.0) / constant[ERROR]
        cost += error * error + LIMIT_WEIGHT * excess * excess
        if applied[step] and speed < constant[LOWEST_RELEASE] and (step >= now[REST] or not fast):
            cost += TRAPPED_COST
        if shoes > 0.0 and reference[step + 1] > REST_SPEED:
            braking = max(forces[BRAKE, row], 1.0) if constant[HAS_ELECTRIC] else shoes
            cost += TRACTION_WEIGHT * max(min(force, shoes), 0.0) / braking
        if shoes > 0.0 or force < 0.0:
            cost += _coupler_load(constant, vehicles, slow[step], factor, shoes, force)
    return cost / steps
