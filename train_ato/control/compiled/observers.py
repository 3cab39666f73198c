"""Compiled steps of the observers, with the operations of the Python observers in the same order.

The state of an observer begins with the flag and the state of its force balance before: speed, drive and resistance of
every body. The caller restores the state if an estimate is not usable.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

from math import sqrt

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_pow
from train_ato.control.algorithms.sliding import clamped, saturation
from train_ato.control.compiled.entries import (
    TRAIN_ENTRIES,
    TRAIN_INERTIA,
    ordered_total,
    resisting_force,
)

NO_OBSERVER, ESO, NDO, CASCADED_EXPLICIT, CASCADED_IMPLICIT, CASCADED_LEVANT = range(6)
"""Observers with a compiled step."""
# Entries of `constant`: those of the train, of the balance, then own ones and the masses of the units.
O_WHOLE_TRAIN, O_MODEL_FACTOR, O_WEIGHT, O_PERIOD = range(TRAIN_ENTRIES, TRAIN_ENTRIES + 4)
OWN = TRAIN_ENTRIES + 4
E_GAIN, E_RATE_GAIN = range(OWN, OWN + 2)
N_DECAY = OWN
C_K1, C_K2, C_K3, C_K4, C_DECAY, C_UNMATCHED = range(OWN, OWN + 6)
# Levant's differentiators: bound, exponents, layers, and gains of the paper times period and powers of the bounds.
(
    V_BOUND, V_TWO_THIRDS, V_THIRD, V_LAYER, V_FAST_LAYER, V_PLACE_GAIN, V_OFFSET_GAIN, V_RATE_GAIN, V_SPEED_GAIN,
    V_DISTURBANCE_GAIN,
) = range(OWN + 6, OWN + 16)  # fmt: skip
O_MASS = OWN + 16
# State of a body of the balance, and entries of every body behind the balance, by observer.
SPEED, DRIVE, RESISTING = range(3)
BALANCE_ENTRIES = 3
BODY_ENTRIES = (0, 3, 1, 7, 7, 7)
# Entries of a cascade. C_OFFSET: filtered signal of the printed forms; C_MEASURED: speed before, of Levant's.
C_HAS_X, C_X, C_V, C_D1, C_D1_RATE, C_D2, C_OFFSET = range(7)
C_MEASURED = C_OFFSET


# State of `eso` for a body.
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
def _balance(constant, inputs, now, body):
    """Return speed [m/s], driving and resisting acceleration [m/s²] of a body of the balance."""
    n = inputs.size
    if constant[O_WHOLE_TRAIN] > 0.0:
        speed, inertia = 0.0, constant[TRAIN_INERTIA]
        for unit in range(n):
            speed += inputs[unit].share * inputs[unit].velocity
        resisting = resisting_force(constant, speed, now.line_force, now.train_shoe_force)
        return speed, ordered_total(inputs.applied) / inertia, resisting / inertia
    mass = constant[O_MASS + body]
    against = inputs[body].coupler_force + inputs[body].resistance + inputs[body].shoe_force
    return inputs[body].velocity, inputs[body].applied / mass, against * constant[O_MODEL_FACTOR] / mass


@compiled
def _printed_cascade(constant, own, x, v, acceleration, implicit):
    """Update a cascade of the paper, as :class:`train_ato.control.observers.cascade.ExplicitCascade` or Implicit."""
    h, decay = constant[O_PERIOD], constant[C_DECAY]
    k1, k2, k3, k4 = constant[C_K1], constant[C_K2], constant[C_K3], constant[C_K4]
    if implicit:
        phi2 = clamped((v - own[C_V]) / h - acceleration, -k2, k2)
        mean = own[C_V] + 0.5 * h * (acceleration + phi2)
        phi1 = clamped((x - own[C_X]) / h - mean, -k1, k1)
        own[C_X] += h * (mean + phi1)
    else:
        phi1, phi2 = k1 * saturation(x - own[C_X], 0.0), k2 * saturation(v - own[C_V], 0.0)
        own[C_X] += h * (own[C_V] + phi1)
    own[C_V] += h * (acceleration + phi2)
    own[C_OFFSET] = decay * own[C_OFFSET] + (1.0 - decay) * phi1
    own[C_D2] = decay * own[C_D2] + (1.0 - decay) * phi2
    if implicit:
        free = own[C_D1] + h * k3 * (phi1 - own[C_D1])
        off = free - own[C_OFFSET]
        beyond = abs(off) - h * k4
        found = own[C_OFFSET] + (beyond if beyond > 0.0 else 0.0) * saturation(off, 0.0)
        rate = (found - own[C_D1]) / h
        own[C_D1] = found
    else:
        rate = k3 * (phi1 - own[C_D1]) - k4 * saturation(own[C_D1] - own[C_OFFSET], 0.0)
        own[C_D1] += h * rate
    own[C_D1_RATE] = decay * own[C_D1_RATE] + (1.0 - decay) * rate


@compiled
def _levant_cascade(constant, own, x, v, acceleration):
    """Update a cascade of Levant, as :class:`train_ato.control.observers.cascade.LevantCascade`."""
    h = constant[O_PERIOD]
    mean = 0.5 * (v + own[C_MEASURED])
    own[C_MEASURED] = v
    own[C_X] += h * (mean + own[C_D1] + 0.5 * h * own[C_D1_RATE])
    own[C_D1] += h * own[C_D1_RATE]
    miss = x - own[C_X]
    size, direction = abs(miss), saturation(miss, constant[V_LAYER])
    own[C_X] += constant[V_PLACE_GAIN] * libm_pow(size, constant[V_TWO_THIRDS]) * direction
    own[C_D1] += constant[V_OFFSET_GAIN] * libm_pow(size, constant[V_THIRD]) * direction
    own[C_D1_RATE] += constant[V_RATE_GAIN] * direction
    own[C_V] += h * (acceleration + own[C_D2])
    miss = v - own[C_V]
    direction = saturation(miss, constant[V_FAST_LAYER])
    own[C_V] += constant[V_SPEED_GAIN] * sqrt(constant[V_BOUND] * abs(miss)) * direction
    own[C_D2] += constant[V_DISTURBANCE_GAIN] * direction


@compiled
def _cascade(observer, constant, own, x, v, acceleration):
    """Return the unexplained acceleration by the cascade of a body [m/s²]."""
    if own[C_HAS_X] == 0.0:
        own[C_HAS_X], own[C_X], own[C_V] = 1.0, x, v
        if observer == CASCADED_LEVANT:
            own[C_MEASURED] = v
    elif observer == CASCADED_LEVANT:
        _levant_cascade(constant, own, x, v, acceleration)
    else:
        _printed_cascade(constant, own, x, v, acceleration, observer == CASCADED_IMPLICIT)
    return own[C_D2] + constant[C_UNMATCHED] * own[C_D1_RATE]


@compiled
def estimate(observer, constant, state, inputs, now, found):
    """Compute the estimate of an observer by its number [N], shape (units,), from measured values.

    Parameters
    ----------
    observer
        Number of the observer; not :data:`NO_OBSERVER`.
    constant, state
        Arrays of :class:`train_ato.control.compiled.observer_packing.CompiledObserver`.
    inputs, now
        Measured position, speed and force, and forces against the motion, by the rows of
        :mod:`train_ato.control.compiled.entries`.
    found
        Estimate of every unit.
    """
    n = inputs.size
    bodies = 1 if constant[O_WHOLE_TRAIN] > 0.0 else n
    weight, period, known = constant[O_WEIGHT], constant[O_PERIOD], state[0] > 0.0
    each = BODY_ENTRIES[observer]
    for body in range(bodies):
        before = state[1 + BALANCE_ENTRIES * body : 1 + BALANCE_ENTRIES * (body + 1)]
        first = 1 + BALANCE_ENTRIES * bodies + each * body
        own = state[first : first + each]
        speed, drive, resistance = _balance(constant, inputs, now, body)
        before_drive = before[DRIVE] if known else drive
        before_resistance = before[RESISTING] if known else resistance
        driven = weight * before_drive + (1.0 - weight) * drive
        rate = driven - 0.5 * (before_resistance + resistance)
        if observer == ESO:
            value = luenberger_step(own, period, constant[E_GAIN], constant[E_RATE_GAIN], speed, rate)
        elif observer == NDO:
            if known:
                unexplained = (speed - before[SPEED]) / period - driven + before_resistance
                own[0] = constant[N_DECAY] * own[0] + (1.0 - constant[N_DECAY]) * unexplained
            value = own[0]
        else:
            value = _cascade(observer, constant, own, inputs[body].position, speed, rate if known else 0.0)
        before[SPEED], before[DRIVE], before[RESISTING] = speed, drive, resistance
        found[body] = value
    state[0] = 1.0
    if constant[O_WHOLE_TRAIN] > 0.0:
        total = found[0] * constant[TRAIN_INERTIA]
        for unit in range(n):
            found[unit] = total * inputs[unit].share
    else:
        for unit in range(n):
            found[unit] = constant[O_MASS + unit] * found[unit]
