"""Compiled steps of the sliding-mode laws, with the operations of the Python laws in the same order."""

# mypy: allow-untyped-defs

from __future__ import annotations

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_pow
from train_ato.control.algorithms.sliding import sig
from train_ato.control.compiled.entries import (
    TRAIN_ENTRIES,
    TRAIN_INERTIA,
    mean_of_units,
    ordered_total,
    resisting_force,
)

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
def _alternating(constant, error):
    """Return the auxiliary surface [m/s] and its slope [1/s] for an error [m]."""
    gain, size = constant[T_SURFACE], abs(error)
    size = size if size >= constant[T_MIN_ERROR] else constant[T_MIN_ERROR]
    if abs(error) > constant[T_BRANCH_ERROR]:
        slope = gain * (constant[T_LARGE] * libm_pow(size, constant[T_LARGE_SLOPE]) + 1.0)
        return gain * (sig(error, constant[T_LARGE]) + error), slope
    slope = gain * (1.0 + constant[T_SMALL] * libm_pow(size, constant[T_SMALL_SLOPE]))
    return gain * (error + sig(error, constant[T_SMALL])), slope


@compiled
def fixed_time_smc_step(constant, state, inputs, now, force):
    """Compute the demand of :class:`train_ato.control.laws.fixed_time_smc.FixedTimeSmc` with measured states [N]."""
    for unit in range(inputs.size):
        x, v = inputs[unit].position, inputs[unit].velocity
        own = state[T_ENTRIES * unit : T_ENTRIES * (unit + 1)]
        offset = 0.0
        if constant[T_UNMATCHED] > 0.0:
            before = own[T_SPEED] if own[T_HAS_SPEED] > 0.0 else v
            own[T_HAS_SPEED], own[T_SPEED] = 1.0, v
            gains = (constant[T_PERIOD], constant[T_GAIN], constant[T_RATE_GAIN])
            offset = luenberger_step(own[T_OBSERVER:], gains[0], gains[1], gains[2], x, 0.5 * (v + before))
        rate = v + offset - inputs[unit].reference_velocity
        auxiliary, slope = _alternating(constant, x - inputs[unit].reference_position)
        surface = rate + auxiliary
        reached = sig(surface, constant[T_SMALL]) + sig(surface, constant[T_LARGE])
        pull = -slope * rate - constant[T_REACHING] * reached
        if constant[T_MEASURED] > 0.0:
            equivalent = inputs[unit].coupler_force + inputs[unit].resistance + inputs[unit].shoe_force
            pull += now.acceleration_at_effect
        else:
            equivalent = inputs[unit].feedforward
        force[unit] = equivalent - inputs[unit].disturbance + constant[T_MASS + unit] * pull


@compiled
def _actuator_jerk(constant, now, error, rate, net):
    """Return the wanted rate of the actuator acceleration [m/s³]."""
    off = net - now.acceleration_at_effect
    surface = off + constant[L_C1] * rate + constant[L_C0] * error
    switching = constant[L_K] * surface / (abs(surface) + constant[L_PHI])
    pull = now.jerk_at_effect - constant[L_C1] * off - constant[L_C0] * rate
    return pull - switching - constant[L_KI] * surface


@compiled
def lag_smc_step(constant, state, inputs, now, force):
    """Compute the demand of :class:`train_ato.control.laws.lag_smc.LagSmc` [N]."""
    n, lag = inputs.size, constant[L_LAG]
    errors, rates = inputs.position - inputs.reference_position, inputs.velocity - inputs.reference_velocity
    if constant[L_COMMON] == 0.0:
        for unit in range(n):
            mass, applied = constant[L_MASS + unit], inputs[unit].applied
            net = applied + inputs[unit].disturbance - inputs[unit].coupler_force
            net = (net - inputs[unit].resistance - inputs[unit].shoe_force) / mass
            force[unit] = applied + mass * lag * _actuator_jerk(constant, now, errors[unit], rates[unit], net)
        return
    mean, total = mean_of_units(inputs.share, rates, n), ordered_total(inputs.applied)
    speed, inertia = mean_of_units(inputs.share, inputs.velocity, n), constant[TRAIN_INERTIA]
    resisting = resisting_force(constant, speed, now.line_force, now.train_shoe_force)
    net = (total + ordered_total(inputs.disturbance) - resisting) / inertia
    error = mean_of_units(inputs.share, errors, n)
    wanted = total + inertia * lag * _actuator_jerk(constant, now, error, mean, net)
    for unit in range(n):
        damped = constant[L_MASS + unit] * constant[L_DAMPING] * (rates[unit] - mean)
        force[unit] = inputs[unit].share * wanted - damped
