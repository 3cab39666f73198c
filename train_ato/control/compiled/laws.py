"""Compiled steps of laws, with the operations of the Python laws in the same order.

Every function has the form ``law(constant, state, inputs, force)``: it writes the force demand of every unit and
changes the state. The caller restores the state if a demand is not usable.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

from math import sqrt

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp, libm_pow
from plant_sim.railway import fading_resistance
from train_ato.control.algorithms.sliding import clamped
from train_ato.control.compiled.entries import (
    mean_of_units,
    ordered_total,
)

FUNNEL, CALLED = range(2)
"""Laws with arrays of their own; the last number is that of every law that is called."""
# Entries of `constant` of the funnel.
(
    F_PRINTED, F_K10, F_K20, F_BETA2, F_LEAK, F_DECAY, F_CHARGE, F_CLIP, F_NEGATIVE, F_NARROW, F_INERTIA, F_PERIOD,
    F_DELAY_STATE, F_GAMMA_W, F_BIAS_RATE, F_WEIGHT_LIMIT, F_FIXED, F_DYNAMIC, F_PRINTED_KAPPA, F_DELTA, F_WIDTH,
    F_TWO, F_CENTRES, F_A1, F_A2, F_BETA1, F_P1, F_MAX_FUNNEL, F_IOTA, F_GAMMA_M, F_FILTER_STEPS,
    F_USES_MODEL, F_USES_NETWORK, F_C0, F_C1, F_C2, F_FEEDFORWARD,
) = range(37)  # fmt: skip
FUNNEL_CONSTANTS = 37
# Entries of `state` of the funnel; the weights are from H_WEIGHTS on, then the excess as a queue.
(
    H_BIAS, H_PHI1, H_PHI2, H_H, H_BOUND, H_T, H_HAS_ALPHA, H_ALPHA, H_HAS_WANTED, H_WANTED, H_EXCESS_COUNT,
    H_EXCESS_ROOM, H_WEIGHTS,
) = range(13)  # fmt: skip


@compiled
def _gain(constant, gain, error, boundary):
    inside = libm_pow(error / boundary, constant[F_TWO])
    if constant[F_NEGATIVE] > 0.0:
        return gain / (1.0 - inside) if abs(1.0 - inside) > 1e-9 else gain * 1e9
    return gain / (1.0 - (constant[F_CLIP] if constant[F_CLIP] < inside else inside))


@compiled
def _delay_state(constant, state, inputs):
    if state[H_HAS_WANTED] == 0.0 or constant[F_DELAY_STATE] == 0.0:
        return
    sent, acting = ordered_total(inputs.force), ordered_total(inputs.applied)
    if constant[F_PRINTED] > 0.0:
        room, queue = int(state[H_EXCESS_ROOM]), state[H_WEIGHTS + int(constant[F_CENTRES]) :]
        if state[H_EXCESS_COUNT] < room:
            queue[int(state[H_EXCESS_COUNT])] = state[H_WANTED] - sent
            state[H_EXCESS_COUNT] += 1.0
        else:
            for entry in range(room - 1):
                queue[entry] = queue[entry + 1]
            queue[room - 1] = state[H_WANTED] - sent
        sent, acting = state[H_WANTED], acting + queue[0]
    missing = (acting - sent) / constant[F_INERTIA]
    state[H_H] = constant[F_DECAY] * state[H_H] + constant[F_CHARGE] * missing


@compiled
def _surface(constant, state, aim, slope):
    if constant[F_PRINTED] == 0.0:
        return aim, slope
    fresh = state[H_HAS_ALPHA] == 0.0
    if fresh:
        state[H_ALPHA], state[H_HAS_ALPHA] = aim, 1.0
    count, two = int(constant[F_FILTER_STEPS]), constant[F_TWO]
    h, before = constant[F_PERIOD] / count, state[H_ALPHA]
    for _ in range(count):
        z = state[H_ALPHA] - aim
        sigma = 1e-3 * libm_exp(-1e-3 * state[H_T]) + 1e-4
        bound = state[H_BOUND]
        rate = -z / constant[F_IOTA] - libm_pow(bound, two) * z / sqrt(libm_pow(bound * z, two) + sigma * sigma)
        grown = bound + h * constant[F_GAMMA_M] * abs(z)
        state[H_BOUND] = constant[F_MAX_FUNNEL] if constant[F_MAX_FUNNEL] < grown else grown
        state[H_ALPHA] += h * rate
        state[H_T] += h
    return state[H_ALPHA], slope if fresh else (state[H_ALPHA] - before) / constant[F_PERIOD]


@compiled
def _network(constant, state, inputs, speed, error):
    centres, width, limit = int(constant[F_CENTRES]), constant[F_WIDTH], constant[F_WEIGHT_LIMIT]
    scale, weights = -0.5 / (width * width), state[H_WEIGHTS:]
    found = 0.0
    for j in range(centres):
        found += weights[j] * libm_exp(scale * (speed - j * width) * (speed - j * width))
    found += state[H_BIAS]
    free = True
    for unit in range(inputs.size):
        free &= not inputs[unit].saturated
    if constant[F_PRINTED] > 0.0 or free:
        rate = -constant[F_GAMMA_W] * error * constant[F_PERIOD]
        for j in range(centres):
            new = weights[j] + rate * libm_exp(scale * (speed - j * width) * (speed - j * width))
            weights[j] = new if -limit <= new <= limit else clamped(new, -limit, limit)
        bias = state[H_BIAS] - constant[F_BIAS_RATE] * error * constant[F_PERIOD]
        state[H_BIAS] = clamped(bias, -limit, limit)
    return constant[F_INERTIA] * found


@compiled
def _resistance(constant, state, inputs, now, speed, error):
    force = 0.0
    if constant[F_FEEDFORWARD] > 0.0:
        force = ordered_total(inputs.feedforward)
    elif constant[F_USES_MODEL] > 0.0:
        running = fading_resistance(constant[F_C0], constant[F_C1], constant[F_C2], speed)
        force = running + now.line_force + now.train_shoe_force
    if constant[F_USES_NETWORK] == 0.0:
        return force
    return force + _network(constant, state, inputs, speed, error)


@compiled
def _widen(constant, state, inputs, wanted, error):
    if constant[F_FIXED] > 0.0:
        return
    h, beta2, before = constant[F_PERIOD], constant[F_BETA2], state[H_PHI2]
    rest = beta2 / constant[F_A2]
    wide = (before - rest) * constant[F_NARROW] + rest
    low, high = ordered_total(inputs.force_min), ordered_total(inputs.force_max)
    printed = constant[F_PRINTED_KAPPA] > 0.0
    if constant[F_DYNAMIC] > 0.0 and (printed or not low <= wanted <= high):
        possible = ordered_total(inputs.applied) if printed else clamped(wanted, low, high)
        excess = abs(wanted - possible) / constant[F_INERTIA]
        size = abs(error)
        grow = excess / (constant[F_DELTA] if constant[F_DELTA] > size else size)
        wide *= libm_exp(20.0 if grow * h > 20.0 else grow * h)
    most = constant[F_MAX_FUNNEL]
    state[H_PHI2] = most if most < wide else wide
    slope = constant[F_P1] * before - constant[F_A1] * state[H_PHI1] + constant[F_BETA1]
    slope -= constant[F_P1] * beta2 / constant[F_A2]
    state[H_PHI1] = clamped(state[H_PHI1] + h * slope, constant[F_BETA1] / constant[F_A1], most)


@compiled
def funnel_step(constant, state, inputs, now, force):
    """Compute the demand of :class:`train_ato.control.laws.funnel.Funnel` [N]."""
    n = inputs.size
    place_error = mean_of_units(inputs.share, inputs.position - inputs.reference_position, n)
    speed = mean_of_units(inputs.share, inputs.velocity, n)
    target = mean_of_units(inputs.share, inputs.reference_velocity, n)
    pull = mean_of_units(inputs.share, inputs.reference_acceleration, n)
    if constant[F_FEEDFORWARD] > 0.0:
        pull = 0.0
    _delay_state(constant, state, inputs)
    k1 = _gain(constant, constant[F_K10], place_error, state[H_PHI1])
    alpha, rate = _surface(constant, state, target - k1 * place_error, pull - k1 * (speed - target))
    error = speed - alpha - state[H_H]
    k2 = _gain(constant, constant[F_K20], error, state[H_PHI2])
    wanted = constant[F_INERTIA] * (rate - k2 * error - constant[F_LEAK] * state[H_H])
    wanted += _resistance(constant, state, inputs, now, speed, error)
    wanted -= ordered_total(inputs.disturbance)
    _widen(constant, state, inputs, wanted, error)
    state[H_WANTED], state[H_HAS_WANTED] = wanted, 1.0
    for unit in range(n):
        force[unit] = wanted * inputs[unit].share


@compiled(alone=False)
def demand(law, constant, state, inputs, now, force):
    """Compute the demand of a law by its number [N], shape (units,)."""
    funnel_step(constant, state, inputs, now, force)
