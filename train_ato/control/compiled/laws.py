"""Compiled steps of laws, with the operations of the Python laws in the same order.

Every function has the form ``law(constant, state, inputs, force)``: it writes the force demand of every unit and
changes the state. The caller restores the state if a demand is not usable.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

from math import copysign, sqrt

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp, libm_pow, libm_tanh

PID, FUNNEL, SMC = range(3)
"""Laws with a compiled step."""
# Rows of `inputs`, one column per unit.
# OPPOSING: couplers, resistance and shoes against the motion of the unit's vehicle. LAST_FORCE, SATURATED: of the law.
(
    POSITION, VELOCITY, APPLIED, REFERENCE_POSITION, FEEDFORWARD, FORCE_MIN, FORCE_MAX, OPPOSING, SHARE, SATURATED,
    LAST_FORCE,
) = range(11)  # fmt: skip
INPUT_ROWS = 11
# Entries of `now`, values of the step for all units.
# LINE_FORCE, TRAIN_SHOE_FORCE: forces against the motion of the train.
REFERENCE_VELOCITY, REFERENCE_ACCELERATION, ACCELERATION_AT_EFFECT, LINE_FORCE, TRAIN_SHOE_FORCE = range(5)
NOW_ENTRIES = 5
# Entries of `constant` of pid, and its first gain; three gains per unit.
OF_POSITION, INTEGRAL_LIMIT, FILTER_DECAY, DERIVATIVE_DECAY, PERIOD, USES_FEEDFORWARD, PID_GAINS = range(7)
# Entries of `state` of pid: two flags, then four values per unit.
HAS_BEFORE, HAS_FILTERED, PID_UNITS = range(3)
# Entries of `constant` of the funnel.
(
    F_PRINTED, F_K10, F_K20, F_BETA2, F_LEAK, F_DECAY, F_CHARGE, F_CLIP, F_NEGATIVE, F_NARROW, F_INERTIA, F_PERIOD,
    F_DELAY_STATE, F_GAMMA_W, F_BIAS_RATE, F_WEIGHT_LIMIT, F_FIXED, F_DYNAMIC, F_PRINTED_KAPPA, F_DELTA, F_WIDTH,
    F_TWO, F_CENTRES, F_A1, F_A2, F_BETA1, F_P1, F_MAX_FUNNEL, F_IOTA, F_GAMMA_M, F_FILTER_STEPS,
    F_USES_MODEL, F_USES_NETWORK, F_C0, F_C1, F_C2, F_FADING_SPEED,
) = range(37)  # fmt: skip
FUNNEL_CONSTANTS = 37
# Entries of `state` of the funnel; the weights are from H_WEIGHTS on, then the excess as a queue.
(
    H_BIAS, H_PHI1, H_PHI2, H_H, H_BOUND, H_T, H_HAS_ALPHA, H_ALPHA, H_HAS_WANTED, H_WANTED, H_EXCESS_COUNT,
    H_EXCESS_ROOM, H_WEIGHTS,
) = range(13)  # fmt: skip
# Entries of `constant` of smc; the masses of the units are last. Its state: flag, error and integral of every unit.
(
    S_L1, S_L2, S_XI, S_ALPHA, S_KAPPA, S_KS, S_PHI, S_MODEL_FACTOR, S_INTEGRAL_LIMIT, S_ANTI_WINDUP, S_MEASURED,
    S_PERIOD, S_MASS,
) = range(13)  # fmt: skip


@compiled
def clamped(value, low, high):
    """Return ``min(max(value, low), high)``, with the results of Python for equal values."""
    raised = low if low > value else value
    return high if high < raised else raised


@compiled
def pid_step(constant, state, inputs, now, force):
    """Compute the demand of :class:`train_ato.control.laws.pid.Pid` [N]."""
    n, limit, decay = inputs.shape[1], constant[INTEGRAL_LIMIT], constant[FILTER_DECAY]
    integral = state[PID_UNITS : PID_UNITS + n]
    rate = state[PID_UNITS + n : PID_UNITS + 2 * n]
    before = state[PID_UNITS + 2 * n : PID_UNITS + 3 * n]
    filtered = state[PID_UNITS + 3 * n : PID_UNITS + 4 * n]
    for unit in range(n):
        error = inputs[VELOCITY, unit] - now[REFERENCE_VELOCITY]
        if decay != 0.0:
            old = filtered[unit] if state[HAS_FILTERED] > 0.0 else error
            error = error + decay * (old - error)
            filtered[unit] = error
        if constant[OF_POSITION] > 0.0:
            total = inputs[POSITION, unit] - inputs[REFERENCE_POSITION, unit]
            if not -limit <= total <= limit:
                total = copysign(limit, total)
        else:
            if not (inputs[SATURATED, unit] > 0.0 and (inputs[LAST_FORCE, unit] > 0) == (error < 0)):
                integral[unit] = clamped(integral[unit] + error * constant[PERIOD], -limit, limit)
            total = integral[unit]
        gain = PID_GAINS + 3 * unit
        found = constant[gain] * error + constant[gain + 1] * total
        if constant[gain + 2] != 0.0:
            if state[HAS_BEFORE] > 0.0:
                raw = (error - before[unit]) / constant[PERIOD]
                keep = constant[DERIVATIVE_DECAY]
                rate[unit] = keep * rate[unit] + (1.0 - keep) * raw
            found += constant[gain + 2] * rate[unit]
        known = inputs[FEEDFORWARD, unit] if constant[USES_FEEDFORWARD] > 0.0 else 0.0
        force[unit] = known - 0.0 - found
        before[unit] = error
    state[HAS_BEFORE] = 1.0
    if decay != 0.0:
        state[HAS_FILTERED] = 1.0


@compiled
def _mean(share, values, n):
    if n == 1:
        return values[0]
    total = 0.0
    for unit in range(n):
        total += share[unit] * values[unit]
    return total


@compiled
def _total(values):
    total = 0.0
    for value in values:
        total += value
    return total


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
    sent, acting = _total(inputs[LAST_FORCE]), _total(inputs[APPLIED])
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
    for unit in range(inputs.shape[1]):
        free &= inputs[SATURATED, unit] == 0.0
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
    if constant[F_USES_MODEL] > 0.0:
        size = abs(speed)
        running = (constant[F_C0] + constant[F_C1] * size + constant[F_C2] * size * size) * libm_tanh(
            speed / constant[F_FADING_SPEED]
        )
        force = running + now[LINE_FORCE] + now[TRAIN_SHOE_FORCE]
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
    low, high = _total(inputs[FORCE_MIN]), _total(inputs[FORCE_MAX])
    printed = constant[F_PRINTED_KAPPA] > 0.0
    if constant[F_DYNAMIC] > 0.0 and (printed or not low <= wanted <= high):
        possible = _total(inputs[APPLIED]) if printed else clamped(wanted, low, high)
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
    n = inputs.shape[1]
    place_error = _mean(inputs[SHARE], inputs[POSITION] - inputs[REFERENCE_POSITION], n)
    speed = _mean(inputs[SHARE], inputs[VELOCITY], n)
    target, pull = now[REFERENCE_VELOCITY], now[REFERENCE_ACCELERATION]
    if n > 1:
        target = _mean(inputs[SHARE], inputs[VELOCITY] * 0.0 + target, n)
        pull = _mean(inputs[SHARE], inputs[VELOCITY] * 0.0 + pull, n)
    _delay_state(constant, state, inputs)
    k1 = _gain(constant, constant[F_K10], place_error, state[H_PHI1])
    alpha, rate = _surface(constant, state, target - k1 * place_error, pull - k1 * (speed - target))
    error = speed - alpha - state[H_H]
    k2 = _gain(constant, constant[F_K20], error, state[H_PHI2])
    wanted = constant[F_INERTIA] * (rate - k2 * error - constant[F_LEAK] * state[H_H])
    wanted += _resistance(constant, state, inputs, now, speed, error)
    wanted -= 0.0
    _widen(constant, state, inputs, wanted, error)
    state[H_WANTED], state[H_HAS_WANTED] = wanted, 1.0
    for unit in range(n):
        force[unit] = wanted * inputs[SHARE, unit]


@compiled
def _sign(value, width):
    if width <= 0.0:
        return 1.0 if value > 0.0 else -1.0 if value < 0.0 else 0.0
    return clamped(value / width, -1.0, 1.0)


@compiled
def smc_step(constant, state, inputs, now, force):
    """Compute the demand of :class:`train_ato.control.laws.smc.Smc` [N]."""
    n, limit = inputs.shape[1], constant[S_INTEGRAL_LIMIT]
    for unit in range(n):
        error = inputs[POSITION, unit] - inputs[REFERENCE_POSITION, unit]
        rate = inputs[VELOCITY, unit] - now[REFERENCE_VELOCITY]
        mass, own = constant[S_MASS + unit], state[3 * unit : 3 * unit + 3]
        if constant[S_MEASURED] > 0.0:
            against = inputs[OPPOSING, unit] * constant[S_MODEL_FACTOR]
            equivalent = mass * now[ACCELERATION_AT_EFFECT] + against
        else:
            equivalent = inputs[FEEDFORWARD, unit]
        if not (inputs[SATURATED, unit] > 0.0 and constant[S_ANTI_WINDUP] > 0.0) and own[0] > 0.0:
            own[2] = clamped(own[2] + 0.5 * (error + own[1]) * constant[S_PERIOD], -limit, limit)
        own[0], own[1] = 1.0, error
        surface = rate + constant[S_L1] * error + constant[S_L2] * own[2]
        switching = constant[S_KAPPA] * libm_tanh(abs(error) / 2.0) * _sign(surface, constant[S_PHI])
        power = 0.0 if surface == 0.0 else copysign(libm_pow(abs(surface), constant[S_ALPHA]), surface)
        pull = constant[S_L1] * rate + constant[S_L2] * error + constant[S_KS] * surface
        pull = pull + constant[S_XI] * power + switching
        force[unit] = equivalent - 0.0 - mass * (pull + 0.0)


@compiled
def demand(law, constant, state, inputs, now, force):
    """Compute the demand of a law by its number [N], shape (units,)."""
    if law == PID:
        pid_step(constant, state, inputs, now, force)
    elif law == FUNNEL:
        funnel_step(constant, state, inputs, now, force)
    else:
        smc_step(constant, state, inputs, now, force)
