"""Horizon of a predictive law: response of the train to a command through delay and lag, cost, and constraints.

Errors are measured against the reference, e_p [m] and e_v [m/s]. The decision z(s) [m/s²] is the acceleration demanded
beside the feed-forward and the disturbance, linear between nodes s_j after the time of sending, constant after the
last. Through unit i (share g_i of the force, delay tau_i) and the lag Ta the response to a ramp t is, for t > 0::

    force t - Ta (1 - E),  speed t²/2 - Ta t + Ta² (1 - E),  position t³/6 - Ta t²/2 + Ta² t - Ta³ (1 - E),
    E = e^(-t/Ta)

and the response to a step is its derivative. z is a step at the first node and a change of slope at every node, so all
responses are closed forms, exact for any delay.

Cost, with trapezoidal weights of the times y_k = tau_max + s_k and of the nodes, the last one with 1/omega more::

    J = sum_k W_k [(a omega²)² e_p² + (4 - 2a) omega² e_v²] + sum_j w_j z_j²

The largest position error beyond a band B has a cost of its own, (a omega²)² s_n b² in J with |e_p| <= B + b: in the
dual, b is a block of equal entries in the matrix. A force limit that cannot be met then divides its error over the
horizon.

Without constraints and over an infinite horizon this is the linear-quadratic regulator z = -2 omega e_v - a omega² e_p
on the state at the time of effect.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp
from train_ato.control.algorithms.quadratic_program import inverse, matrix_product
from train_ato.messages.types import Array

SOFT_FORCE = 1e-6
"""Softness of force and jerk limits, over the diagonal of the dual matrix."""
SOFT_SPEED = 1e-2
"""The same for speed limits, which a disturbance can make impossible to keep."""
SOFT_PEAK = 3e-2
"""The same for the largest position error."""
PEAK_WEIGHT = 1.0
"""Weight of the square of the largest position error, over that of the same error through the whole horizon."""


def node_times(first: float, last: float, count: int) -> Array:
    """Return ``count`` times from 0 on at geometrically growing distances, the first and the last given [s]."""
    low, high = 1.0, 4.0
    for _ in range(80):
        growth = 0.5 * (low + high)
        total = 0.0
        for _ in range(count - 1):
            total = total * growth + first
        low, high = (growth, high) if total < last else (low, growth)
    times = [0.0]
    step = first
    for _ in range(count - 1):
        times.append(times[-1] + step)
        step *= low
    return np.array(times)


def trapezoid_weights(times: Array) -> Array:
    """Return the weights of the trapezoidal rule [s], shape (n,)."""
    steps = np.diff(times)
    weights = np.zeros(times.size)
    weights[:-1] += 0.5 * steps
    weights[1:] += 0.5 * steps
    return weights


@compiled
def ramp_response(t, lag):
    """Return force, speed and position after a unit ramp through a lag, and the force after a unit step.

    Parameters
    ----------
    t
        Time since the begin of the ramp [s]; before it the response is 0.
    lag
        Time constant [s].
    """
    if t <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    if lag <= 0.0:
        return t, 0.5 * t * t, t * t * t / 6.0, 1.0
    left = 1.0 - libm_exp(-t / lag)
    force = t - lag * left
    speed = 0.5 * t * t - lag * force
    return force, speed, t * t * t / 6.0 - lag * speed, left


@dataclass(frozen=True)
class HorizonModel:
    """Matrices of the quadratic programme for one set of delays.

    Attributes
    ----------
    gradient_position, gradient_velocity : Array, shape (nodes, nodes)
        Gradient of the cost for unit errors e_p, e_v of the free motion.
    response_position, response_velocity : Array, shape (nodes, nodes)
        Errors at the times y_k for unit decisions.
    inverse : Array, shape (nodes, nodes)
        Inverse of the Hessian.
    limited : Array, shape (nodes, rows)
        H⁻¹ A', change of the decision with the multipliers.
    dual : Array, shape (rows, rows)
        A H⁻¹ A' and the softness.
    """

    gradient_position: Array
    gradient_velocity: Array
    response_position: Array
    response_velocity: Array
    inverse: Array
    constraints: Array
    limited: Array
    dual: Array


def horizon_model(
    nodes: Array, delays: Array, share: Array, lag: float, longest: float, omega: float, position_share: float
) -> HorizonModel:
    """Return the matrices for nodes at times after sending [s].

    Parameters
    ----------
    nodes : Array, shape (nodes,)
        Times after sending [s].
    delays, share : Array, shape (units,)
        Delay [s] and part of the force of every unit.
    lag
        Lag of the actuators [s].
    longest
        Delay after which the errors are weighted [s].
    omega
        Half of the gain on the speed error [rad/s].
    position_share
        a, gain on the position error over omega².
    """
    position, velocity = responses(nodes, delays, share, lag, longest)
    weights = trapezoid_weights(nodes)
    weights[-1] += 1.0 / omega
    weighted_position = (position_share * omega**2) ** 2 * weights[:, None] * position
    weighted_velocity = (4.0 - 2.0 * position_share) * omega**2 * weights[:, None] * velocity
    hessian = matrix_product(np.ascontiguousarray(position.T), weighted_position)
    hessian = hessian + matrix_product(np.ascontiguousarray(velocity.T), weighted_velocity)
    hessian[np.arange(nodes.size), np.arange(nodes.size)] += weights
    inverted = inverse(hessian)
    constraints, softness = constraint_rows(position, velocity)
    limited = matrix_product(inverted, np.ascontiguousarray(constraints.T))
    dual = matrix_product(constraints, limited)
    diagonal = np.diag(dual).copy()
    dual[np.arange(diagonal.size), np.arange(diagonal.size)] += softness * diagonal + 1e-12
    dual[5 * nodes.size :, 5 * nodes.size :] += 1.0 / (PEAK_WEIGHT * (position_share * omega**2) ** 2 * nodes[-1])
    return HorizonModel(
        np.ascontiguousarray(weighted_position.T), np.ascontiguousarray(weighted_velocity.T), position, velocity,
        inverted, constraints, limited, dual,
    )  # fmt: skip


@compiled
def responses(nodes, delays, share, lag, longest):
    """Return the errors of position and speed at ``longest + nodes`` for unit decisions, shape (times, nodes)."""
    count = nodes.size
    position, velocity = np.zeros((count, count)), np.zeros((count, count))
    for i in range(delays.size):
        for k in range(count):
            since = nodes[k] + longest - delays[i]
            force, speed, _, _ = ramp_response(since, lag)
            velocity[k, 0] += share[i] * force
            position[k, 0] += share[i] * speed
            for j in range(count - 1):
                slope = share[i] / (nodes[j + 1] - nodes[j])
                _, speed, place, _ = ramp_response(since - nodes[j], lag)
                _, later_speed, later_place, _ = ramp_response(since - nodes[j + 1], lag)
                velocity[k, j] -= slope * (speed - later_speed)
                velocity[k, j + 1] += slope * (speed - later_speed)
                position[k, j] -= slope * (place - later_place)
                position[k, j + 1] += slope * (place - later_place)
    return position, velocity


def constraint_rows(position: Array, velocity: Array) -> tuple[Array, Array]:
    """Return the rows A of upper and lower force limits, jerk limits, speed limits, upper and lower position error.

    The second result is their softness.

    Parameters
    ----------
    position, velocity : Array, shape (nodes, nodes)
        Response of position and speed.
    """
    count = velocity.shape[0]
    unit = np.eye(count)
    change = unit.copy()
    change[1:] -= unit[:-1]
    rows = np.vstack((unit, -unit, change, -change, velocity, position, -position))
    softness = np.repeat([SOFT_FORCE, SOFT_SPEED, SOFT_PEAK], [4 * count, count, 2 * count])
    return rows, softness
