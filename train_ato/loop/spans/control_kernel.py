"""Compiled control of a tick: policy of the air brake, observer, and law between its inputs and its command."""

# mypy: allow-untyped-defs

from __future__ import annotations

from plant_sim.compiled import compiled
from plant_sim.railway import between_entries, envelope_force, shoe_force
from train_ato.control.air_brake.record_policy import electric_brake_available
from train_ato.control.algorithms.couplers import opposing
from train_ato.control.algorithms.force_shares import numpy_total
from train_ato.control.compensation.predictor import predict
from train_ato.control.compiled.law_call import address
from train_ato.control.law import STEPPED, limit_demands
from train_ato.control.train_model import GRID, own_resistance


@compiled
def _line_force(inputs, own, table):
    """Return the line force on the train [N] for the position of its first unit."""
    return between_entries(table, (inputs[0].position + own[0].offset - own[0].line_begin) / GRID)


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
    constants, state, bodies, call, estimates, (slow, vehicles, shoes, forces), couplers = observing
    if bodies == 0:
        return True
    if len(slow):
        _observed_shoes(slow[tick], vehicles, inputs[0].velocity, shoes, forces)
    now = all_now[0]
    now.line_force, now.train_shoe_force, now.sensed_force = _line_force(inputs, own, tables[1]), shoes[0], 0.0
    for force in coupler_forces:
        now.sensed_force += abs(force)
    for u in range(inputs.size):
        inputs[u].shoe_force = shoes[1 + u]
    opposing(couplers, coupler_forces, own, tables[0], tables[2], inputs)
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
        inputs[u].reference_position = reference[0, tick] - own[u].offset
        inputs[u].feedforward = feedforward[tick, u]
        inputs[u].force_min = -envelope_force(limits, segments[u, 0], segments[u, 1], speed)
        inputs[u].force_max = envelope_force(limits, segments[u, 2], segments[u, 3], speed)
        inputs[u].reference_velocity, inputs[u].reference_acceleration = reference[1, tick], reference[2, tick]
    now.acceleration_at_effect, now.jerk_at_effect = reference[3, tick], reference[4, tick]
    now.delay_to_effect = reference[5, tick]


@compiled(alone=False)
def law_step(tick, t, coupler_forces, own, tables, shoes, law, predicting, history, inputs, sent):
    """Compute the command of a tick from its inputs; return 1 at a limit, 0 inside, -1 for one left to Python."""
    constant, state, rows, all_now, call, couplers = law
    now = all_now[0]
    now.t, now.train_shoe_force, now.sensed_force = t, shoes[tick, 0], 0.0
    for force in coupler_forces:
        now.sensed_force += abs(force)
    constants, chain, actuators, along = predicting
    if len(constants):
        now.line_force = _line_force(inputs, own, tables[1])
        if len(chain.weights):
            for u in range(inputs.size):
                x = inputs[u]
                x.resistance = own_resistance(own[u], tables[0], tables[2], x.velocity, x.position)
        predict(constants[0], chain, actuators, history, along, now, inputs)
    now.line_force = _line_force(inputs, own, tables[1])
    for u in range(inputs.size):
        inputs[u].shoe_force = shoes[tick, 1 + u]
    opposing(couplers, coupler_forces, own, tables[0], tables[2], inputs)
    records = address(constant), address(state), address(all_now), address(inputs)
    if call(tick, records[0], records[1], records[2], records[3], inputs.size, rows) != 0:
        return -1
    if not limit_demands(inputs):
        return -1
    for u in range(inputs.size):
        sent[u] = inputs[u].force
    return _at_limit(inputs)
