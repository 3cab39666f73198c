"""Compiled ticks: sensors, law, delay line and train of consecutive ticks in one call."""

# mypy: allow-untyped-defs

from __future__ import annotations

import numpy as np

from plant_sim import compiled as compilation
from plant_sim import kernel as k
from plant_sim.compiled import compiled
from plant_sim.elementary import libm_tanh
from train_ato.control.compiled import entries as c
from train_ato.control.compiled import laws as laws_code
from train_ato.control.compiled import observers as observers_code
from train_ato.control.compiled import prediction as prediction_code
from train_ato.control.compiled import sliding as sliding_code
from train_ato.loop.spans import limits_kernel as limits_code
from train_ato.loop.spans import supervision_kernel as supervision_code
from train_ato.messages.validity import MAX_FORCE as MAX_VALID_FORCE
from train_ato.messages.validity import MAX_POSITION as MAX_VALID_POSITION
from train_ato.messages.validity import MAX_SPEED as MAX_VALID_SPEED

# Rows of `measured` (ticks, rows, units).
MEASURED_POSITION, MEASURED_VELOCITY, MEASURED_FORCE = range(3)
# Rows of `couplers` (ticks, rows, sensors).
DEFLECTION, RATE, COUPLER_FORCE = range(3)
# Entries of `sensor`: errors of the sensors.
POSITION_BIAS, VELOCITY_BIAS, POSITION_QUANTUM, VELOCITY_QUANTUM = range(4)
# Entries of `bound`: values outside which a tick is left to Python.
MAX_POSITION, MAX_SPEED, MAX_FORCE, STANDSTILL_SPEED, NEXT_PLACE, NEXT_TIME, NEXT_JUMP_PLACE = range(7)
# Entries of `count`: first tick, ticks between the steps of the law, 1 if the last step was at a limit, reports.
FIRST_TICK, EVERY, AT_LIMIT, REPORTS = range(4)
MAX_DEMAND = 1e300
"""Demand of a law beyond which a step is left to Python [N]."""
VALID_POSITION, VALID_SPEED, VALID_FORCE = 0.9 * MAX_VALID_POSITION, 0.9 * MAX_VALID_SPEED, 0.9 * MAX_VALID_FORCE
"""Sums of the inputs of a law from which a step is left to Python [m, m/s, N]; speeds per unit."""
# Columns of `own`, one row per unit: constants of the vehicle and of the line of the model.
MASS, C0, C1, C2, FADING_SPEED, LINE_BEGIN, LINE_GRID, OFFSET = range(8)


@compiled(uses=(k, compilation))
def _measure(tick, arrays, noise, sensor, units, sensors, gaps, measured, couplers):
    """Write the measurement of a tick."""
    state, unit = arrays
    for u in range(len(units)):
        x, v = state[k.X, units[u]] + 0.0, state[k.V, units[u]] + sensor[VELOCITY_BIAS]
        if sensor[POSITION_BIAS] != 0.0:
            x += sensor[POSITION_BIAS]
        if noise[0].shape[0]:
            x += noise[0][tick, u]
        if noise[1].shape[0]:
            v += noise[1][tick, u]
        if sensor[POSITION_QUANTUM] > 0.0:
            x = sensor[POSITION_QUANTUM] * np.rint(x / sensor[POSITION_QUANTUM])
        if sensor[VELOCITY_QUANTUM] > 0.0:
            v = sensor[VELOCITY_QUANTUM] * np.rint(v / sensor[VELOCITY_QUANTUM])
        measured[tick, MEASURED_POSITION, u], measured[tick, MEASURED_VELOCITY, u] = x, v
        measured[tick, MEASURED_FORCE, u] = unit[k.APPLIED, u]
    for j in range(len(sensors)):
        front = sensors[j]
        deflection = state[k.X, front] - state[k.X, front + 1] - gaps[j]
        couplers[tick, DEFLECTION, j] = deflection + noise[2][tick, 0, j]
        couplers[tick, RATE, j] = state[k.V, front] - state[k.V, front + 1]
        couplers[tick, COUPLER_FORCE, j] = state[k.COUPLER, front + 1] + noise[2][tick, 1, j]


@compiled
def _envelope(rows, first, end, speed):
    """Return the largest force at a speed [N], as :meth:`plant_sim.traction.Envelope.force`."""
    for row in range(first, end):
        if speed <= rows[row, 0]:
            force = rows[row, 1] + rows[row, 2] * speed + rows[row, 3] / (speed if speed > 0.1 else 0.1)
            return force if force > 0.0 else 0.0
    return 0.0


@compiled
def _opposing(couplers, beside, springs, own, table, shoes, inputs):
    """Write the forces against the motion of every unit's vehicle [N], for position and speed of the inputs."""
    sensors = couplers.shape[1]
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
                force = couplers[COUPLER_FORCE, number]
            pull = force if side == 1 else pull - force
        v = inputs[c.VELOCITY, u]
        speed = abs(v)
        running = (own[u, C0] + own[u, C1] * speed + own[u, C2] * speed * speed) * libm_tanh(v / own[u, FADING_SPEED])
        place = (inputs[c.POSITION, u] - own[u, LINE_BEGIN]) / own[u, LINE_GRID]
        inputs[c.COUPLERS, u] = pull
        inputs[c.RESISTANCE, u] = running + own[u, MASS] * c.between_entries(table, place)
        inputs[c.SHOES, u] = shoes[1 + u]


@compiled
def _line_force(inputs, own, table):
    """Return the line force on the train [N] for the position of its first unit."""
    front = inputs[c.POSITION, 0] + own[0, OFFSET]
    return c.between_entries(table, (front - own[0, LINE_BEGIN]) / own[0, LINE_GRID])


@compiled(uses=(c, observers_code))
def _observe(tick, couplers, own, tables, observing, inputs, now, bound):
    """Compute the estimate of a tick [N]; return False for one that is left to Python."""
    observer, constant, state, estimates, shoes, beside, springs = observing
    if observer == observers_code.NO_OBSERVER:
        return True
    now[c.LINE_FORCE], now[c.TRAIN_SHOE_FORCE] = _line_force(inputs, own, tables[1]), shoes[tick, 0]
    _opposing(couplers[tick], beside, springs, own, tables[0], shoes[tick], inputs)
    observers_code.estimate(observer, constant, state, inputs, now, estimates[tick])
    for u in range(inputs.shape[1]):
        if not abs(estimates[tick, u]) < bound[MAX_FORCE]:
            return False
        inputs[c.DISTURBANCE, u] = estimates[tick, u]
    return True


@compiled
def _must_leave(tick, t, measured, couplers, x_front, bound, event, events, n, at_rest):
    """Return True for a tick that is left to Python: a start, events of brakes and jumps, impossible values."""
    fastest = 0.0
    for u in range(measured.shape[2]):
        v = abs(measured[tick, MEASURED_VELOCITY, u])
        if not (v < bound[MAX_SPEED] and abs(measured[tick, MEASURED_POSITION, u]) < bound[MAX_POSITION]):
            return True
        if not abs(measured[tick, MEASURED_FORCE, u]) < bound[MAX_FORCE]:
            return True
        fastest = v if v > fastest else fastest
    for j in range(couplers.shape[2]):
        if not abs(couplers[tick, COUPLER_FORCE, j]) < bound[MAX_FORCE]:
            return True
    if measured[tick, MEASURED_POSITION, 0] >= bound[NEXT_PLACE] or t >= bound[NEXT_TIME]:
        return True
    if (fastest < bound[STANDSTILL_SPEED] and not at_rest[tick]) or x_front >= bound[NEXT_JUMP_PLACE]:
        return True
    reached = False
    for j in range(events):
        reached |= event[k.REACHED, j] >= n
    return reached


@compiled
def _stands(tick, measured, bound):
    """Return True for a train at standstill."""
    fastest = 0.0
    for u in range(measured.shape[2]):
        fastest = max(fastest, abs(measured[tick, MEASURED_VELOCITY, u]))
    return fastest < bound[STANDSTILL_SPEED]


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


@compiled
def _set_inputs(tick, measured, reference, feedforward, own, limits, segments, inputs, now):
    """Write reference, feed-forward and limits of a step of the law."""
    for u in range(inputs.shape[1]):
        speed = abs(measured[tick, MEASURED_VELOCITY, u])
        inputs[c.REFERENCE_POSITION, u] = reference[0, tick] - own[u, OFFSET]
        inputs[c.FEEDFORWARD, u] = feedforward[tick, u]
        inputs[c.FORCE_MIN, u] = -_envelope(limits, segments[u, 0], segments[u, 1], speed)
        inputs[c.FORCE_MAX, u] = _envelope(limits, segments[u, 2], segments[u, 3], speed)
    now[c.REFERENCE_VELOCITY], now[c.REFERENCE_ACCELERATION] = reference[1, tick], reference[2, tick]
    now[c.ACCELERATION_AT_EFFECT], now[c.JERK_AT_EFFECT] = reference[3, tick], reference[4, tick]


@compiled(uses=(c, laws_code, prediction_code))
def _law_step(tick, t, couplers, own, tables, shoes, law, predicting, history, inputs, now, wanted, sent):
    """Compute the command of a tick from its inputs; return 1 at a limit, 0 inside, -1 for one left to Python."""
    number, constant, state, beside, springs = law
    now[c.TRAIN_SHOE_FORCE] = shoes[tick, 0]
    if len(predicting[0]):
        line_force = _line_force(inputs, own, tables[1])
        prediction_code.predict(
            t, predicting[0], predicting[1], predicting[2], history, line_force, shoes[tick, 0], inputs
        )
    now[c.LINE_FORCE] = _line_force(inputs, own, tables[1])
    _opposing(couplers[tick], beside, springs, own, tables[0], shoes[tick], inputs)
    if not _is_valid(inputs, now):
        return -1
    laws_code.demand(number, constant, state, inputs, now, wanted)
    return _command(inputs, wanted, sent)


@compiled
def _push(stamp, sent, delays, due, value, bounds):
    """Queue the commands of a stamp, as :meth:`train_ato.messages.links.Link.push`."""
    for u in range(len(sent)):
        arrival = stamp + (delays[1, u] if sent[u] < 0 else delays[0, u])
        while bounds[1, u] > bounds[0, u] and due[u, bounds[1, u] - 1] >= arrival:
            bounds[1, u] -= 1
        due[u, bounds[1, u]], value[u, bounds[1, u]] = arrival, sent[u]
        bounds[1, u] += 1


@compiled
def _arrived(newest, due, value, bounds, held, window):
    """Write the arrived commands at every plant step, as :meth:`train_ato.messages.links.Link.window`."""
    steps = len(newest)
    for u in range(len(held)):
        for step in range(steps):
            window[step, u] = held[u]
        while bounds[1, u] > bounds[0, u] and due[u, bounds[0, u]] <= newest[steps - 1]:
            head = bounds[0, u]
            for step in range(steps):
                if newest[step] >= due[u, head]:
                    window[step, u] = value[u, head]
            held[u] = value[u, head]
            bounds[0, u] += 1


@compiled(uses=(k, c, laws_code, sliding_code, observers_code, prediction_code, compilation, limits_code,
                supervision_code))  # fmt: skip
def run_span(
    stamp, tick_ns, dt, train, event, events, forces, vehicles, setting, noise, sensor, units, sensors, gaps,
    law, observing, predicting, inputs, reference, feedforward, shoes, own, tables, limits, segments,
    bound, count, delays, newest, due, value, bounds, held, history, truth, measured, couplers, sent, at_limit, reports,
    supervision, at_rest,
):  # fmt: skip
    """Run consecutive ticks until a tick that is left to Python; return the number of ticks run.

    All arrays are changed in place. Outputs have one row per tick: ``truth`` (ticks, 4, vehicles) with position, speed,
    coupler and shoe force, ``measured``, ``couplers``; ``sent`` and ``at_limit`` begin with command and number of steps
    at a limit before the first tick. ``reports`` has the state of the train at the ticks with diagnostics.
    ``supervision`` has the arrays of :class:`train_ato.loop.spans.supervised.SupervisionArrays`; ``at_rest`` is True
    for a reference at rest now and after the delay of the commands. ``law``, ``observing`` and ``predicting`` have
    number, constants, state and couplers of the law and of the observer, and the arrays of the prediction.
    """
    state, vehicle, vehicle_index, gear, gear_table, run, body, unit, unit_index, envelope, piece = train
    outside, cubes, cubed = forces
    every, states, gears, unit_states, settings = reports
    n, steps, nu = vehicle.shape[1], newest.shape[1], len(units)
    law_state, observer_state = law[2], observing[2]
    saved, observed, kept = law_state.copy(), observer_state.copy(), inputs.copy()
    supervised, odometers, motion = supervision[0].copy(), supervision[2].copy(), np.zeros(5)
    wanted, now, window = np.zeros(nu), np.zeros(c.NOW_ENTRIES), np.zeros((steps, nu))
    for tick in range(len(newest)):
        _measure(tick, (state, unit), noise, sensor, units, sensors, gaps, measured, couplers)
        at = stamp + tick * tick_ns
        t = at * 1e-9
        if _must_leave(tick, t, measured, couplers, state[k.X, 0], bound, event, events, n, at_rest):
            return tick
        supervised[:], odometers[:] = supervision[0], supervision[2]
        saved[:], observed[:], kept[:] = law_state, observer_state, inputs
        usable, limited = True, 0
        if supervision[0][supervision_code.PERIOD] > 0:
            place, speed = measured[tick, MEASURED_POSITION, 0], measured[tick, MEASURED_VELOCITY, 0]
            usable = supervision_code.supervise(at, state[k.X, 0], state[k.V, 0], place, speed, supervision, motion)
        if usable:
            inputs[c.POSITION : c.APPLIED + 1] = measured[tick]
            usable = _observe(tick, couplers, own, tables, observing, inputs, now, bound)
        is_step = (count[FIRST_TICK] + tick) % count[EVERY] == 0
        if usable and is_step:
            _set_inputs(tick, measured, reference, feedforward, own, limits, segments, inputs, now)
            limited = _law_step(
                tick, t, couplers, own, tables, shoes, law, predicting, history, inputs, now, wanted, sent[tick + 1]
            )
        if not usable or limited < 0:
            law_state[:], observer_state[:], inputs[:] = saved, observed, kept
            supervision[0][:], supervision[2][:] = supervised, odometers
            return tick
        if is_step:
            if at_rest[tick] and _stands(tick, measured, bound):
                sent[tick + 1] = 0.0
            at_limit[tick + 1] = at_limit[tick] + limited
            count[AT_LIMIT] = limited
        else:
            sent[tick + 1], at_limit[tick + 1] = sent[tick], at_limit[tick]
        if at % every < tick_ns:
            states[count[REPORTS]], gears[count[REPORTS]] = state, gear
            unit_states[count[REPORTS]], settings[count[REPORTS]] = unit, setting
            count[REPORTS] += 1
        for i in range(n):
            truth[tick, 0, i], truth[tick, 1, i] = state[k.X, i], state[k.V, i]
            truth[tick, 2, i], truth[tick, 3, i] = state[k.COUPLER, i + 1], state[k.SHOE_FORCE, i]
        for row in range(len(history) - 1):
            history[row] = history[row + 1]
        if len(history):
            history[len(history) - 1] = sent[tick + 1]
        _push(at, sent[tick + 1], delays, due, value, bounds)
        _arrived(newest[tick], due, value, bounds, held, window)
        for j in range(len(cubed)):
            speed = state[k.V, vehicles[cubed[j]]]
            for step in range(steps):
                outside[tick, 1, step, cubed[j]] += cubes[tick, step, j] * (speed * speed)
        k.advance(
            t, dt, state, vehicle, vehicle_index, gear, gear_table, run, body, unit, unit_index, envelope, piece,
            event, events, window, outside[tick], vehicles, setting,
        )  # fmt: skip
    return len(newest)
