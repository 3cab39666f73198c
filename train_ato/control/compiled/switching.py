"""Compiled step of the sliding mode with a learnt switching term, with the operations of the Python law in order."""

# mypy: allow-untyped-defs

from __future__ import annotations

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp, libm_tanh
from train_ato.control.algorithms.sliding import clamped, saturation

CENTRES = 5
"""Number of centres of both networks."""
RBF, TANH, RELAY = range(3)
"""Kinds of the switching term."""
# Entries of `constant`; the centres, then the masses of the units are last. R_RATE to R_REACH: identification.
(
    R_C, R_K_W, R_PHI, R_SWITCHING, R_WIDTH, R_ETA, R_ALPHA, R_WEIGHT_LIMIT, R_CLIP, R_ANTI_WINDUP, R_IDENTIFY,
    R_USES_VALUE, R_LITERAL, R_LITERAL_INPUT, R_PERIOD, R_RATE, R_FOUND_LIMIT, R_FOUND_WIDTH, R_UNEXPLAINED, R_REACH,
    R_CENTRES,
) = range(21)  # fmt: skip
R_MASS = R_CENTRES + CENTRES
# Entries of `state`: a flag, then for every unit weights and their last moves of both networks, and single values.
WEIGHTS, MOVES, FOUND_WEIGHTS, FOUND_MOVES, SINGLE = range(0, 5 * CENTRES, CENTRES)
BEFORE, SECOND_BEFORE, SIZE, MISSING, SLOPE, PULL, LAST_RATE = range(SINGLE, SINGLE + 7)
UNIT_ENTRIES = SINGLE + 7


@compiled
def _learn(weights, moves, hidden, rate, momentum, bound):
    """Move the weights, as :meth:`train_ato.control.algorithms.rbf.Weights.learn`."""
    for j in range(CENTRES):
        old = weights[j]
        new = old + rate * hidden[j]
        if momentum != 0.0:
            new = new + momentum * moves[j]
        if not -bound <= new <= bound:
            new = clamped(new, -bound, bound)
        if momentum != 0.0:
            moves[j] = new - old
        weights[j] = new


@compiled
def _output(weights, hidden):
    total = 0.0
    for j in range(CENTRES):
        total += weights[j] * hidden[j]
    return total


@compiled
def _identify(constant, own, hidden, command, acceleration):
    """Return the sign of ds/du, as :class:`train_ato.control.laws.rbf_switching_smc.Identification`."""
    reach, width = constant[R_REACH], constant[R_FOUND_WIDTH]
    x = clamped(command, -reach, reach)
    y, z = clamped(own[BEFORE], -reach, reach), clamped(own[SECOND_BEFORE], -reach, reach)
    scale = -0.5 / (width * width)
    for j in range(CENTRES):
        c = constant[R_CENTRES + j]
        hidden[j] = libm_exp(scale * ((x - c) * (x - c) + (y - c) * (y - c) + (z - c) * (z - c)))
    weights = own[FOUND_WEIGHTS : FOUND_WEIGHTS + CENTRES]
    miss = clamped(acceleration, -reach, reach) - _output(weights, hidden)
    moves = own[FOUND_MOVES : FOUND_MOVES + CENTRES]
    _learn(weights, moves, hidden, constant[R_RATE] * miss, constant[R_ALPHA], constant[R_FOUND_LIMIT])
    own[SECOND_BEFORE] = own[BEFORE]
    own[BEFORE] = acceleration
    own[SIZE] += 0.01 * (acceleration * acceleration - own[SIZE])
    own[MISSING] += 0.01 * (miss * miss - own[MISSING])
    slope = 0.0
    for j in range(CENTRES):
        slope += weights[j] * hidden[j] * (constant[R_CENTRES + j] - x)
    own[SLOPE] = slope / (width * width)
    return -1.0 if own[MISSING] < constant[R_UNEXPLAINED] * own[SIZE] and slope < 0.0 else 1.0


@compiled
def _switching(constant, own, hidden, held, surface, command, acceleration):
    """Return the switching term [m/s²]; its weights learn."""
    if constant[R_SWITCHING] == RELAY:
        return -constant[R_K_W] * saturation(surface, 0.0)
    if constant[R_SWITCHING] == TANH:
        return -constant[R_K_W] * libm_tanh(surface / constant[R_PHI])
    gain = 1.0
    if constant[R_IDENTIFY] > 0.0:
        gain = _identify(constant, own, hidden, command, acceleration)
        if constant[R_USES_VALUE] > 0.0:
            gain = own[SLOPE]
    literal = constant[R_LITERAL] > 0.0
    aim, push = (acceleration, acceleration) if literal else (surface / constant[R_PHI], surface)
    if constant[R_CLIP] > 0.0:
        aim = clamped(aim, -1.0, 1.0)
    scale = -0.5 / (constant[R_WIDTH] * constant[R_WIDTH])
    for j in range(CENTRES):
        c = constant[R_CENTRES + j]
        hidden[j] = libm_exp(scale * (aim - c) * (aim - c))
    weights, moves = own[WEIGHTS : WEIGHTS + CENTRES], own[MOVES : MOVES + CENTRES]
    if not held:
        rate = -constant[R_ETA] * constant[R_PERIOD] * push * gain
        _learn(weights, moves, hidden, rate, constant[R_ALPHA], constant[R_WEIGHT_LIMIT])
    return _output(weights, hidden)


@compiled
def rbf_switching_smc_step(constant, state, inputs, now, force):
    """Compute the demand of :class:`train_ato.control.laws.rbf_switching_smc.RbfSwitchingSmc` [N]."""
    hidden = constant[R_CENTRES:R_MASS].copy()
    for unit in range(inputs.size):
        own = state[1 + UNIT_ENTRIES * unit : 1 + UNIT_ENTRIES * (unit + 1)]
        error = inputs[unit].position - inputs[unit].reference_position
        rate, mass = inputs[unit].velocity - inputs[unit].reference_velocity, constant[R_MASS + unit]
        acceleration = (rate - own[LAST_RATE]) / constant[R_PERIOD] if state[0] > 0.0 else 0.0
        command = inputs[unit].force / mass if constant[R_LITERAL_INPUT] > 0.0 else own[PULL]
        held = inputs[unit].saturated and constant[R_ANTI_WINDUP] > 0.0
        surface = constant[R_C] * error + rate
        own[PULL] = _switching(constant, own, hidden, held, surface, command, acceleration)
        own[LAST_RATE] = rate
        known = inputs[unit].feedforward - inputs[unit].disturbance
        force[unit] = known + mass * (own[PULL] - constant[R_C] * rate)
    state[0] = 1.0
