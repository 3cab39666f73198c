"""Compiled control of a tick: policy of the air brake, observer, and law between its inputs and its command."""

# mypy: allow-untyped-defs

from __future__ import annotations

from plant_sim.compiled import compiled
from plant_sim.railway import between_entries, envelope_force, fading_resistance, shoe_force
from train_ato.control.compiled import brake_policies as policies_code
from train_ato.control.compiled import entries as c
from train_ato.control.compiled import laws as laws_code
from train_ato.control.compiled import observers as observers_code
from train_ato.control.compiled import prediction as prediction_code
from train_ato.messages.validity import MAX_FORCE, MAX_POSITION, MAX_SPEED

MAX_DEMAND = 1e300
"""Demand of a law beyond which a step is left to Python [N]."""
VALID_POSITION, VALID_SPEED, VALID_FORCE = 0.9 * MAX_POSITION, 0.9 * MAX_SPEED, 0.9 * MAX_FORCE
"""Sums of the inputs of a law from which a step is left to Python [m, m/s, N]; speeds per unit."""
# Columns of `own`, one row per unit: constants of the vehicle and of the line of the model.
MASS, C0, C1, C2, LINE_BEGIN, LINE_GRID, OFFSET = range(7)


@compiled
def _opposing(measured, beside, springs, own, table, learned, shoes, inputs):
    """Write the forces against the motion of every unit's vehicle [N], for position and speed of the inputs."""
    sensors = len(measured)
    for u in range(len(beside)):
        pull = 0.0
        for side in range(1, -1, -1):  # behind minus in front
            number = beside[u, side]
            force = 0.0
            if number >= sensors:
                spring = springs[number - sensors]
                a, b = int(spring[0]), int(spring[1])
                distance = (inputs[c.POSITION, a] + own[a, OFFSET]) - (inputs[c.POSITION, b] + own[b, OFFSET])
                force = spring[2] * distance + spring[3] * (inputs[c.VELOCITY, a] - inputs[c.VELOCITY, b])
            elif number >= 0:
                force = measured[number]
            pull = force if side == 1 else pull - force
        running = fading_resistance(own[u, C0], own[u, C1], own[u, C2], inputs[c.VELOCITY, u])
        place = (inputs[c.POSITION, u] - own[u, LINE_BEGIN]) / own[u, LINE_GRID]
        inputs[c.COUPLERS, u] = pull
        inputs[c.RESISTANCE, u] = running + own[u, MASS] * between_entries(table, place)
        if len(learned):
            place = (inputs[c.POSITION, u] + own[u, OFFSET] - own[u, LINE_BEGIN]) / own[u, LINE_GRID]
            inputs[c.RESISTANCE, u] += own[u, MASS] * between_entries(learned, place)
        inputs[c.SHOES, u] = shoes[1 + u]


@compiled
def _line_force(inputs, own, table):
    """Return the line force on the train [N] for the position of its first unit."""
    front = inputs[c.POSITION, 0] + own[0, OFFSET]
    return between_entries(table, (front - own[0, LINE_BEGIN]) / own[0, LINE_GRID])


@compiled
def _observed_shoes(slow, vehicles, speed, shoes, forces):
    """Write the shoe force of the train and of every unit's vehicle [N] at a measured speed [m/s]."""
    for i in range(len(slow)):
        forces[i] = shoe_force(slow[i], speed)
    shoes[0] = c.numpy_total(forces)
    for u in range(len(vehicles)):
        shoes[1 + u] = forces[vehicles[u]]


@compiled(alone=False)
def observe(tick, coupler_forces, own, tables, observing, inputs, now):
    """Compute the estimate of a tick [N]; return False for one that is left to Python."""
    observer, constant, state, estimates, (slow, vehicles, shoes, forces), beside, springs = observing
    if observer == observers_code.NO_OBSERVER:
        return True
    if len(slow):
        _observed_shoes(slow[tick], vehicles, inputs[c.VELOCITY, 0], shoes, forces)
    now[c.LINE_FORCE], now[c.TRAIN_SHOE_FORCE] = _line_force(inputs, own, tables[1]), shoes[0]
    _opposing(coupler_forces, beside, springs, own, tables[0], tables[2], shoes, inputs)
    observers_code.estimate(observer, constant, state, inputs, now, estimates[tick])
    for u in range(inputs.shape[1]):
        if not abs(estimates[tick, u]) < MAX_FORCE:
            return False
        inputs[c.DISTURBANCE, u] = estimates[tick, u]
    return True


@compiled(alone=False)
def changes_brake(t, braking, limits, segments, inputs):
    """Return True for a tick at which the policy of the air brake changes the pressure."""
    policy, constant, state, steep = braking
    if policy == policies_code.PLANNED:
        return False
    available, applied, speed = 0.0, 0.0, inputs[c.VELOCITY, 0]
    for u in range(inputs.shape[1]):
        available += envelope_force(limits, segments[u, 0], segments[u, 1], abs(speed))
        applied += inputs[c.APPLIED, u]
    place = inputs[c.POSITION, 0]
    return policies_code.changes_pressure(policy, constant, state, steep, t, place, speed, applied, available)


@compiled
def _is_valid(inputs, now):
    """Return True if the inputs of the law are far inside the bounds of ``train_ato.control.algorithms.guard``."""
    speeds = abs(now[c.ACCELERATION_AT_EFFECT]) + abs(now[c.JERK_AT_EFFECT])
    places, forces, n = 0.0, abs(now[c.TRAIN_SHOE_FORCE]), inputs.shape[1]
    for u in range(n):
        speeds += abs(inputs[c.VELOCITY, u]) + abs(now[c.REFERENCE_VELOCITY]) + abs(now[c.REFERENCE_ACCELERATION])
        places += abs(inputs[c.POSITION, u]) + abs(inputs[c.REFERENCE_POSITION, u])
        forces += abs(inputs[c.FORCE_MIN, u]) + abs(inputs[c.FORCE_MAX, u]) + abs(inputs[c.FEEDFORWARD, u])
        forces += abs(inputs[c.DISTURBANCE, u]) + abs(inputs[c.APPLIED, u]) + abs(inputs[c.SHOES, u])
    return speeds < VALID_SPEED * n and places < VALID_POSITION and forces < VALID_FORCE


@compiled
def _command(inputs, wanted, sent):
    """Limit the demands as law and control stack; return 1 at a limit, 0 inside, -1 for a demand left to Python."""
    for u in range(len(wanted)):
        if not abs(wanted[u]) < MAX_DEMAND:
            return -1
    at_limit = 0
    for u in range(len(wanted)):
        low, high = inputs[c.FORCE_MIN, u], inputs[c.FORCE_MAX, u]
        limited = low if wanted[u] < low else high if wanted[u] > high else wanted[u]
        inputs[c.SATURATED, u], inputs[c.LAST_FORCE, u] = 1.0 if limited != wanted[u] else 0.0, limited
        sent[u] = limited
        if limited != 0.0 and not low < limited < high:
            at_limit = 1
    return at_limit


@compiled(alone=False)
def set_inputs(tick, reference, feedforward, own, limits, segments, inputs, now):
    """Write reference, feed-forward and limits of a step of the law."""
    for u in range(inputs.shape[1]):
        speed = abs(inputs[c.VELOCITY, u])
        inputs[c.REFERENCE_POSITION, u] = reference[0, tick] - own[u, OFFSET]
        inputs[c.FEEDFORWARD, u] = feedforward[tick, u]
        inputs[c.FORCE_MIN, u] = -envelope_force(limits, segments[u, 0], segments[u, 1], speed)
        inputs[c.FORCE_MAX, u] = envelope_force(limits, segments[u, 2], segments[u, 3], speed)
    now[c.REFERENCE_VELOCITY], now[c.REFERENCE_ACCELERATION] = reference[1, tick], reference[2, tick]
    now[c.ACCELERATION_AT_EFFECT], now[c.JERK_AT_EFFECT] = reference[3, tick], reference[4, tick]


@compiled(alone=False)
def law_step(tick, t, coupler_forces, own, tables, shoes, law, predicting, history, inputs, sent):
    """Compute the command of a tick from its inputs; return 1 at a limit, 0 inside, -1 for one left to Python."""
    number, constant, state, now, wanted, call, beside, springs = law
    now[c.TRAIN_SHOE_FORCE] = shoes[tick, 0]
    if len(predicting[0]):
        line_force = _line_force(inputs, own, tables[1])
        prediction_code.predict(
            t, predicting[0], predicting[1], predicting[2], history, line_force, shoes[tick, 0], inputs
        )
    now[c.LINE_FORCE] = _line_force(inputs, own, tables[1])
    _opposing(coupler_forces, beside, springs, own, tables[0], tables[2], shoes[tick], inputs)
    if not _is_valid(inputs, now):
        return -1
    if number == laws_code.PYTHON:
        if call(tick) != 0:
            return -1
    else:
        laws_code.demand(number, constant, state, inputs, now, wanted)
    return _command(inputs, wanted, sent)
