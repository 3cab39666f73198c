"""Compiled steps of the sliding-mode laws, with the operations of the Python laws in the same order."""

# mypy: allow-untyped-defs

from __future__ import annotations

from math import copysign

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp, libm_pow, libm_tanh
from train_ato.control.compiled.entries import (
    ACCELERATION_AT_EFFECT,
    APPLIED,
    COUPLERS,
    DISTURBANCE,
    FEEDFORWARD,
    JERK_AT_EFFECT,
    LINE_FORCE,
    POSITION,
    REFERENCE_POSITION,
    REFERENCE_VELOCITY,
    RESISTANCE,
    SATURATED,
    SHARE,
    SHOES,
    TRAIN_ENTRIES,
    TRAIN_INERTIA,
    TRAIN_SHOE_FORCE,
    VELOCITY,
    clamped,
    mean_of_units,
    ordered_total,
    resisting_force,
    sign_of,
)

CENTRES = 5
"""Number of centres of the network of rbf_smc."""
# Entries of `constant` of smc and rbf_smc; the centres of the network, then the masses of the units are last.
(
    S_L1, S_L2, S_XI, S_ALPHA, S_KAPPA, S_KS, S_PHI, S_MODEL_FACTOR, S_INTEGRAL_LIMIT, S_ANTI_WINDUP, S_MEASURED,
    S_PERIOD, S_NETWORK, S_GAMMA, S_SPREAD, S_WIDTH, S_CLIP, S_OBSERVER_DECAY, S_WEIGHT_LIMIT, S_CENTRES,
) = range(20)  # fmt: skip
S_MASS = S_CENTRES + CENTRES
# Columns of `state` of smc: flag, error and integral of every unit. Those of the network are weights, then the filtered
# and the last output.
SURFACE_ENTRIES, NETWORK_ENTRIES = 3, CENTRES + 2
# Entries of `constant` of fixed_time_smc; the masses of the units are last.
(
    T_SURFACE, T_REACHING, T_UNMATCHED, T_LARGE, T_SMALL, T_LARGE_SLOPE, T_SMALL_SLOPE, T_BRANCH_ERROR, T_MIN_ERROR,
    T_PERIOD, T_GAIN, T_RATE_GAIN, T_MEASURED, T_MASS,
) = range(14)  # fmt: skip
# Entries of `state` of fixed_time_smc, for every unit: speed before with its flag, then those of a Luenberger observer.
T_HAS_SPEED, T_SPEED, T_OBSERVER = range(3)
T_ENTRIES = 5
# Entries of `state` of a Luenberger observer.
L_HAS_VALUE, L_VALUE, L_RATE = range(3)
# Entries of `constant` of lag_smc: those of the train, own ones, and the masses of the units.
L_C1, L_C0, L_K, L_PHI, L_KI, L_COMMON, L_DAMPING, L_LAG, L_MASS = range(TRAIN_ENTRIES, TRAIN_ENTRIES + 9)


@compiled
def luenberger_step(state, period, gain, rate_gain, measured, known):
    """Return the unknown rate, as :meth:`train_ato.control.algorithms.luenberger.LuenbergerObserver.step`."""
    if state[L_HAS_VALUE] == 0.0:
        state[L_HAS_VALUE], state[L_VALUE] = 1.0, measured
        return state[L_RATE]
    predicted = state[L_VALUE] + period * (known + state[L_RATE])
    miss = measured - predicted
    state[L_VALUE] = predicted + gain * miss
    state[L_RATE] += rate_gain * miss
    return state[L_RATE]


@compiled
def _power(value, exponent):
    return 0.0 if value == 0.0 else copysign(libm_pow(abs(value), exponent), value)


@compiled
def _learnt(constant, network, held, error, rate, surface):
    """Return the output of the network of :class:`train_ato.control.laws.rbf_smc.RbfSmc` [m/s²]; it learns."""
    if constant[S_CLIP] > 0.0:
        reach = constant[S_SPREAD]
        error, rate = clamped(error, -reach, reach), clamped(rate, -reach, reach)
    width, limit = constant[S_WIDTH], constant[S_WEIGHT_LIMIT]
    scale, speed = -0.5 / (width * width), constant[S_GAMMA] * surface * constant[S_PERIOD]
    found = 0.0
    for j in range(CENTRES):
        c = constant[S_CENTRES + j]
        hidden = libm_exp(scale * ((error - c) * (error - c) + (rate - c) * (rate - c)))
        found += network[j] * hidden
        if not held:
            new = network[j] + speed * hidden
            network[j] = new if -limit <= new <= limit else clamped(new, -limit, limit)
    decay = constant[S_OBSERVER_DECAY]
    filtered = decay * network[CENTRES] + (1.0 - decay) * network[CENTRES + 1]
    network[CENTRES], network[CENTRES + 1] = filtered, found
    return found - filtered


@compiled
def smc_step(constant, state, inputs, now, force):
    """Compute the demand of :class:`train_ato.control.laws.smc.Smc` or of its form with a network [N]."""
    n, limit = inputs.shape[1], constant[S_INTEGRAL_LIMIT]
    networks = state[SURFACE_ENTRIES * n :]
    for unit in range(n):
        error = inputs[POSITION, unit] - inputs[REFERENCE_POSITION, unit]
        rate = inputs[VELOCITY, unit] - now[REFERENCE_VELOCITY]
        mass, own = constant[S_MASS + unit], state[SURFACE_ENTRIES * unit : SURFACE_ENTRIES * (unit + 1)]
        if constant[S_MEASURED] > 0.0:
            against = inputs[COUPLERS, unit] + inputs[RESISTANCE, unit] + inputs[SHOES, unit]
            equivalent = mass * now[ACCELERATION_AT_EFFECT] + against * constant[S_MODEL_FACTOR]
        else:
            equivalent = inputs[FEEDFORWARD, unit]
        held = inputs[SATURATED, unit] > 0.0 and constant[S_ANTI_WINDUP] > 0.0
        if not held and own[0] > 0.0:
            own[2] = clamped(own[2] + 0.5 * (error + own[1]) * constant[S_PERIOD], -limit, limit)
        own[0], own[1] = 1.0, error
        surface = rate + constant[S_L1] * error + constant[S_L2] * own[2]
        switching = constant[S_KAPPA] * libm_tanh(abs(error) / 2.0) * sign_of(surface, constant[S_PHI])
        pull = constant[S_L1] * rate + constant[S_L2] * error + constant[S_KS] * surface
        pull = pull + constant[S_XI] * _power(surface, constant[S_ALPHA]) + switching
        learnt = 0.0
        if constant[S_NETWORK] > 0.0:
            network = networks[NETWORK_ENTRIES * unit : NETWORK_ENTRIES * (unit + 1)]
            learnt = _learnt(constant, network, held, error, rate, surface)
        force[unit] = equivalent - inputs[DISTURBANCE, unit] - mass * (pull + learnt)


@compiled
def _alternating(constant, error):
    """Return the auxiliary surface [m/s] and its slope [1/s] for an error [m]."""
    gain, size = constant[T_SURFACE], abs(error)
    size = size if size >= constant[T_MIN_ERROR] else constant[T_MIN_ERROR]
    if abs(error) > constant[T_BRANCH_ERROR]:
        slope = gain * (constant[T_LARGE] * libm_pow(size, constant[T_LARGE_SLOPE]) + 1.0)
        return gain * (_power(error, constant[T_LARGE]) + error), slope
    slope = gain * (1.0 + constant[T_SMALL] * libm_pow(size, constant[T_SMALL_SLOPE]))
    return gain * (error + _power(error, constant[T_SMALL])), slope


@compiled
def fixed_time_smc_step(constant, state, inputs, now, force):
    """Compute the demand of :class:`train_ato.control.laws.fixed_time_smc.FixedTimeSmc` with measured states [N]."""
    for unit in range(inputs.shape[1]):
        x, v = inputs[POSITION, unit], inputs[VELOCITY, unit]
        own = state[T_ENTRIES * unit : T_ENTRIES * (unit + 1)]
        offset = 0.0
        if constant[T_UNMATCHED] > 0.0:
            before = own[T_SPEED] if own[T_HAS_SPEED] > 0.0 else v
            own[T_HAS_SPEED], own[T_SPEED] = 1.0, v
            gains = (constant[T_PERIOD], constant[T_GAIN], constant[T_RATE_GAIN])
            offset = luenberger_step(own[T_OBSERVER:], gains[0], gains[1], gains[2], x, 0.5 * (v + before))
        rate = v + offset - now[REFERENCE_VELOCITY]
        auxiliary, slope = _alternating(constant, x - inputs[REFERENCE_POSITION, unit])
        surface = rate + auxiliary
        reached = _power(surface, constant[T_SMALL]) + _power(surface, constant[T_LARGE])
        pull = -slope * rate - constant[T_REACHING] * reached
        if constant[T_MEASURED] > 0.0:
            equivalent = inputs[COUPLERS, unit] + inputs[RESISTANCE, unit] + inputs[SHOES, unit]
            pull += now[ACCELERATION_AT_EFFECT]
        else:
            equivalent = inputs[FEEDFORWARD, unit]
        force[unit] = equivalent - inputs[DISTURBANCE, unit] + constant[T_MASS + unit] * pull


@compiled
def _actuator_jerk(constant, now, error, rate, net):
    """Return the wanted rate of the actuator acceleration [m/s³]."""
    off = net - now[ACCELERATION_AT_EFFECT]
    surface = off + constant[L_C1] * rate + constant[L_C0] * error
    switching = constant[L_K] * surface / (abs(surface) + constant[L_PHI])
    pull = now[JERK_AT_EFFECT] - constant[L_C1] * off - constant[L_C0] * rate
    return pull - switching - constant[L_KI] * surface


@compiled
def lag_smc_step(constant, state, inputs, now, force):
    """Compute the demand of :class:`train_ato.control.laws.lag_smc.LagSmc` [N]."""
    n, lag = inputs.shape[1], constant[L_LAG]
    errors, rates = inputs[POSITION] - inputs[REFERENCE_POSITION], inputs[VELOCITY] - now[REFERENCE_VELOCITY]
    if constant[L_COMMON] == 0.0:
        for unit in range(n):
            mass, applied = constant[L_MASS + unit], inputs[APPLIED, unit]
            net = applied + inputs[DISTURBANCE, unit] - inputs[COUPLERS, unit]
            net = (net - inputs[RESISTANCE, unit] - inputs[SHOES, unit]) / mass
            force[unit] = applied + mass * lag * _actuator_jerk(constant, now, errors[unit], rates[unit], net)
        return
    mean, total = mean_of_units(inputs[SHARE], rates, n), ordered_total(inputs[APPLIED])
    speed, inertia = mean_of_units(inputs[SHARE], inputs[VELOCITY], n), constant[TRAIN_INERTIA]
    resisting = resisting_force(constant, speed, now[LINE_FORCE], now[TRAIN_SHOE_FORCE])
    net = (total + ordered_total(inputs[DISTURBANCE]) - resisting) / inertia
    error = mean_of_units(inputs[SHARE], errors, n)
    wanted = total + inertia * lag * _actuator_jerk(constant, now, error, mean, net)
    for unit in range(n):
        damped = constant[L_MASS + unit] * constant[L_DAMPING] * (rates[unit] - mean)
        force[unit] = inputs[SHARE, unit] * wanted - damped
