"""Compiled steps of the sliding-mode laws, with the operations of the Python laws in the same order."""

# mypy: allow-untyped-defs

from __future__ import annotations

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_pow
from train_ato.control.algorithms.sliding import sig

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
