"""One step of the bank of Kalman filters of a train as one mass, compiled; equations in `motion_observer.py`."""

# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp
from train_ato.control.algorithms.disturbance_filters import RAMP_TIME

SPEED_FLOOR = 0.01
"""Standard deviation of the speed up to which the bandwidth is that at the smallest noise [m/s]."""
NOISE_FLOOR = 0.002
"""Smallest standard deviation of the speed [m/s]."""
POSITION_FLOOR = 0.0002
"""Smallest standard deviation of the position [m]: the force changes at an unknown time of a tick."""
MAX_NOISE = 1.0
"""Largest standard deviation [m, m/s]."""
MAX_MASS_ERROR = 0.35
"""Largest error of the mass."""
STATES = 5
"""States of a filter."""


@compiled
def mix(states, covariances, chances, chain):
    """Mix states and covariances of the filters for a change from one to another; return nothing.

    Parameters
    ----------
    states : Array, shape (filters, states)
        Position error [m], speed error [m/s], disturbance [m/s²], and others; here error of the mass and rate of the
        disturbance [m/s³].
    covariances : Array, shape (filters, states, states)
        Their covariances.
    chances : Array, shape (filters,)
        Probability of every filter; receives that before the next measurement.
    chain : Array, shape (filters, filters)
        Probability of a change in a period, from filter to filter.
    """
    count, size = states.shape
    former_states, former, before = states.copy(), covariances.copy(), chances.copy()
    for j in range(count):
        total = 0.0
        for i in range(count):
            total += before[i] * chain[i, j]
        chances[j] = total
        for a in range(size):
            states[j, a] = 0.0
            for i in range(count):
                weight = before[i] * chain[i, j] / total
                states[j, a] += weight * former_states[i, a]
        covariances[j] = 0.0
        for i in range(count):
            weight = before[i] * chain[i, j] / total
            for a in range(size):
                for b in range(size):
                    spread = (former_states[i, a] - states[j, a]) * (former_states[i, b] - states[j, b])
                    covariances[j, a, b] += weight * (former[i, a, b] + spread)


@compiled
def predict_motion(state, p, drifts, period, pull, regressor):
    """Advance state and covariance of one filter by a period; arguments as in :func:`filter_step`."""
    h = period
    fade = libm_exp(-h / RAMP_TIME)
    kept = RAMP_TIME * (1.0 - fade)
    risen = kept * state[4]
    total = pull + state[2] + 0.5 * risen + state[3] * regressor
    state[0] += (state[1] + 0.5 * total * h) * h
    state[1] += total * h
    state[2] += risen
    state[4] *= fade
    for j in range(STATES):
        risen = kept * p[4, j]
        gained = h * (p[2, j] + 0.5 * risen + regressor * p[3, j])
        p[0, j] += h * (p[1, j] + 0.5 * gained)
        p[1, j] += gained
        p[2, j] += risen
        p[4, j] *= fade
    for i in range(STATES):
        risen = kept * p[i, 4]
        gained = h * (p[i, 2] + 0.5 * risen + regressor * p[i, 3])
        p[i, 0] += h * (p[i, 1] + 0.5 * gained)
        p[i, 1] += gained
        p[i, 2] += risen
        p[i, 4] *= fade
    for i in range(STATES - 1):
        p[i + 1, i + 1] += drifts[i]


@compiled
def correct(state, p, noise, miss_position, miss_speed):
    """Correct one filter by its innovations; return half of their squared size and the root of their determinant."""
    a, b, c = p[0, 0] + noise[0], p[0, 1], p[1, 1] + noise[1]
    size = a * c - b * b
    row0, row1 = p[0].copy(), p[1].copy()
    for i in range(state.size):
        first = (row0[i] * c - row1[i] * b) / size
        second = (row1[i] * a - row0[i] * b) / size
        state[i] += first * miss_position + second * miss_speed
        for j in range(state.size):
            p[i, j] -= first * row0[j] + second * row1[j]
    for i in range(state.size):
        for j in range(i):
            p[i, j] = p[j, i]
    squared = (c * miss_position - 2.0 * b * miss_speed) * miss_position + a * miss_speed * miss_speed
    return 0.5 * squared / size, math.sqrt(size)


@compiled
def weigh(states, chances, exponents, roots, mean):
    """Multiply the probabilities by the likelihoods of the innovations; ``mean`` receives the mean of the states."""
    least = 1e300
    for j in range(chances.size):
        least = min(least, exponents[j])
    total = 0.0
    for j in range(chances.size):
        chances[j] *= libm_exp(max(least - exponents[j], -100.0)) / roots[j]
        total += chances[j]
    mean[:] = 0.0
    for j in range(chances.size):
        chances[j] /= total
        for a in range(mean.size):
            mean[a] += chances[j] * states[j, a]


@compiled
def filter_step(
    states, covariances, chances, noise, before, drifts, chain, period, weight, position, speed, pull, regressor, mean,
    floor_ratio,
):  # fmt: skip
    """Advance all filters by a period and correct them.

    Parameters
    ----------
    states, covariances
        As in :func:`mix`, before them those of the filter of the mass.
    chances, chain
        As in :func:`mix`.
    noise : Array, shape (2,)
        Variances of the measurements.
    before : Array, shape (2,)
        Last innovations.
    drifts : Array, shape (1 + filters, 4)
        Variance of the change of speed, disturbance, error of the mass and rate of the disturbance in a period.
    period, weight
        Period [s] and weight of the newest sample in the noise.
    position, speed, pull, regressor
        Measured errors [m, m/s], modelled relative acceleration and x [m/s²].
    mean : Array, shape (5,)
        Result: mean of the states of the filters, weighted by their probabilities.
    floor_ratio
        Smallest standard deviation of the position over that of the speed [s].
    """
    mix(states[1:], covariances[1:], chances, chain)
    count = chances.size
    predict_motion(states[0], covariances[0], drifts[0], period, pull, regressor)
    correct(states[0], covariances[0], noise, position - states[0, 0], speed - states[0, 1])
    states[0, 3] = min(max(states[0, 3], -MAX_MASS_ERROR), MAX_MASS_ERROR)
    states[1:, 3] = states[0, 3]
    exponents, roots = np.empty(count), np.empty(count)
    mean_position, mean_speed = 0.0, 0.0
    for j in range(count):
        state, covariance = states[1 + j], covariances[1 + j]
        predict_motion(state, covariance, drifts[1 + j], period, pull, regressor)
        miss_position, miss_speed = position - state[0], speed - state[1]
        mean_position += chances[j] * miss_position
        mean_speed += chances[j] * miss_speed
        exponents[j], roots[j] = correct(state, covariance, noise, miss_position, miss_speed)
    weigh(states[1:], chances, exponents, roots, mean)
    match(noise, before, weight, mean_position, mean_speed, floor_ratio)


@compiled
def match(noise, before, weight, miss_position, miss_speed, floor_ratio):
    """Add a pair of innovations [m, m/s] to the variances of the noise."""
    for i in range(2):
        miss = miss_speed if i == 0 else miss_position
        place = 1 - i
        change = miss - before[place]
        found = noise[place] + weight * (0.5 * change * change - noise[place])
        floor = NOISE_FLOOR if i == 0 else max(floor_ratio * min(math.sqrt(noise[1]), SPEED_FLOOR), POSITION_FLOOR)
        noise[place] = min(max(found, floor * floor), MAX_NOISE * MAX_NOISE)
        before[place] = miss
