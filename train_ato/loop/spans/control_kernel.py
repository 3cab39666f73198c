"""Compiled control of a tick: policy of the air brake, observer, and law between its inputs and its command."""

# mypy: allow-untyped-defs

from __future__ import annotations

from plant_sim.compiled import compiled
from plant_sim.railway import between_entries, envelope_force, fading_resistance, shoe_force
from train_ato.control.air_brake.record_policy import electric_brake_available
from train_ato.control.algorithms.force_shares import numpy_total
from train_ato.control.compensation.predictor import predict
from train_ato.control.compiled.law_call import address
from train_ato.control.law import STEPPED, limit_demands

# Columns of `own`, one row per unit: constants of the vehicle and of the line of the model.
MASS, C0, C1, C2, LINE_BEGIN, LINE_GRID, OFFSET = range(7)


@compiled
def _write_resistances(own, table, learned, inputs):
    """Write running, line and learned resistance of every unit's vehicle [N], for position and speed of the inputs."""
    for u in range(inputs.size):
        running = fading_resistance(own[u, C0], own[u, C1], own[u, C2], inputs[u].velocity)
        place = (inputs[u].position - own[u, LINE_BEGIN]) / own[u, LINE_GRID]
        inputs[u].resistance = running + own[u, MASS] * between_entries(table, place)
        if len(learned):
            place = (inputs[u].position + own[u, OFFSET] - own[u, LINE_BEGIN]) / own[u, LINE_GRID]
            inputs[u].resistance += own[u, MASS] * between_entries(learned, place)


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
                distance = (inputs[a].position + own[a, OFFSET]) - (inputs[b].position + own[b, OFFSET])
                force = spring[2] * distance + spring[3] * (inputs[a].velocity - inputs[b].velocity)
            elif number >= 0:
                force = measured[number]
            pull = force if side == 1 else pull - force
        inputs[u].coupler_force, inputs[u].shoe_force = pull, shoes[1 + u]
    if len(beside):
        _write_resistances(own, table, learned, inputs)


@compiled
def _line_force(inputs, own, table):
    """Return the line force on the train [N] for the position of its first unit."""
    front = inputs[0].position + own[0, OFFSET]
    return between_entries(table, (front - own[0, LINE_BEGIN]) / own[0, LINE_GRID])


@compiled
def _observed_shoes(slow, vehicles, speed, shoes, forces):
    """Write the shoe force of the train and of every unit's vehicle [N] at a measured speed [m/s]."""
    for i in range(len(slow)):
        forces[i] = shoe_force(slow[i], speed)
    shoes[0] = numpy_total(forces)
    for u in range(len(vehicles)):
        shoes[1 + u] = forces[vehicles[u]]


@compiled(alone=False)
def observe(tick, coupler_forces, own, tables, observing, inputs, all_now):
    """Compute the estimate of a tick [N]; return False for one that is left to Python."""
    constants, state, bodies, call, estimates, (slow, vehicles, shoes, forces), beside, springs = observing
    if bodies == 0:
        return True
    if len(slow):
        _observed_shoes(slow[tick], vehicles, inputs[0].velocity, shoes, forces)
    now = all_now[0]
    now.line_force, now.train_shoe_force, now.sensed_force = _line_force(inputs, own, tables[1]), shoes[0], 0.0
    for force in coupler_forces:
        now.sensed_force += abs(force)
    _opposing(coupler_forces, beside, springs, own, tables[0], tables[2], shoes, inputs)
    if call(address(constants), address(state), bodies, address(all_now), address(inputs), inputs.size) != STEPPED:
        return False
    for u in range(inputs.size):
        estimates[tick, u] = inputs[u].disturbance
    return True


@compiled(alone=False)
def changes_brake(t, position, velocity, applied, braking):
    """Step the policy of the air brake; return True if it changes the pressure, or makes a decision in Python."""
    constants, state, rows, count, measured, call, limits, segments, charged, pressure = braking
    now = measured[0]
    now.t, now.position, now.velocity, now.applied = t, position, velocity, numpy_total(applied)
    if len(segments):
        now.available = electric_brake_available(limits, segments, abs(velocity))
    return charged - call(address(constants), address(state), address(rows), count, address(measured)) != pressure


@compiled
def _at_limit(inputs):
    """Return 1 for a command at a limit, 0 for one inside."""
    for x in inputs:
        if x.force != 0.0 and not x.force_min < x.force < x.force_max:
            return 1
    return 0


@compiled(alone=False)
def set_inputs(tick, reference, feedforward, own, limits, segments, inputs, now):
    """Write reference, feed-forward and limits of a step of the law."""
    for u in range(inputs.size):
        speed = abs(inputs[u].velocity)
        inputs[u].reference_position = reference[0, tick] - own[u, OFFSET]
        inputs[u].feedforward = feedforward[tick, u]
        inputs[u].force_min = -envelope_force(limits, segments[u, 0], segments[u, 1], speed)
        inputs[u].force_max = envelope_force(limits, segments[u, 2], segments[u, 3], speed)
        inputs[u].reference_velocity, inputs[u].reference_acceleration = reference[1, tick], reference[2, tick]
    now.acceleration_at_effect, now.jerk_at_effect = reference[3, tick], reference[4, tick]
    now.delay_to_effect = reference[5, tick]


@compiled(alone=False)
def law_step(tick, t, coupler_forces, own, tables, shoes, law, predicting, history, inputs, sent):
    """Compute the command of a tick from its inputs; return 1 at a limit, 0 inside, -1 for one left to Python."""
    constant, state, rows, all_now, call, beside, springs = law
    now = all_now[0]
    now.t, now.train_shoe_force, now.sensed_force = t, shoes[tick, 0], 0.0
    for force in coupler_forces:
        now.sensed_force += abs(force)
    constants, chain, actuators, along = predicting
    if len(constants):
        now.line_force = _line_force(inputs, own, tables[1])
        if len(chain.weights):
            _write_resistances(own, tables[0], tables[2], inputs)
        predict(constants[0], chain, actuators, history, along, now, inputs)
    now.line_force = _line_force(inputs, own, tables[1])
    for u in range(inputs.size):
        inputs[u].shoe_force = shoes[tick, 1 + u]
    _opposing(coupler_forces, beside, springs, own, tables[0], tables[2], shoes[tick], inputs)
    records = address(constant), address(state), address(all_now), address(inputs)
    if call(tick, records[0], records[1], records[2], records[3], inputs.size, rows) != 0:
        return -1
    if not limit_demands(inputs):
        return -1
    for u in range(inputs.size):
        sent[u] = inputs[u].force
    return _at_limit(inputs)
