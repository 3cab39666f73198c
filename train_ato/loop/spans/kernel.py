"""Compiled ticks: sensors, law, delay line and train of consecutive ticks in one call."""

# mypy: allow-untyped-defs

from __future__ import annotations

import numpy as np

from plant_sim import kernel as k
from plant_sim.compiled import compiled
from plant_sim.sensors import measure_train
from train_ato.loop.spans.control_kernel import changes_brake, law_step, observe, set_inputs
from train_ato.loop.spans.supervision_kernel import copy_states, supervised_tick
from train_ato.loop.train_protection import command_age
from train_ato.messages.links import arrive, push

# Rows of `measured` (ticks, rows, units).
MEASURED_POSITION, MEASURED_VELOCITY, MEASURED_FORCE = range(3)
# Rows of `couplers` (ticks, rows, sensors).
DEFLECTION, RATE, COUPLER_FORCE = range(3)
# Entries of `bound`: values outside which a tick is left to Python.
MAX_POSITION, MAX_SPEED, MAX_FORCE, STANDSTILL_SPEED, NEXT_JUMP_PLACE = range(5)
# Entries of `count`: first tick, ticks between the steps of the law, 1 if the last step was at a limit, reports.
FIRST_TICK, EVERY, AT_LIMIT, REPORTS = range(4)


@compiled
def _must_leave(tick, measured, couplers, x_front, bound, event, events, n, at_rest):
    """Return True for a tick that is left to Python: a start, events of the pipe and jumps, impossible values."""
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
def run_span(
    stamp, tick_ns, dt, train, event, events, forces, vehicles, setting, noise, sensors,
    law, observing, predicting, braking, inputs, reference, feedforward, shoes, own, tables, limits, segments,
    bound, count, link, stamps, history, shown, truth, measured, couplers, sent, at_limit, reports, supervision,
    at_rest,
):  # fmt: skip
    """Run consecutive ticks until a tick that is left to Python; return the number of ticks run.

    All arrays are changed in place. Outputs have one row per tick: ``truth`` (ticks, 4, vehicles) with position, speed,
    coupler and shoe force of the vehicles ``shown``, ``measured``, ``couplers``; ``sent`` and ``at_limit`` begin with
    command and number of steps at a limit before the first tick. ``reports`` has the state of the train at the ticks
    with diagnostics; arrays with one row have the last of these states.
    ``supervision`` has the records of the supervisor. ``at_rest`` is True for a reference at rest now and after the
    delay of the commands. ``law``, ``observing`` and ``predicting`` have
    number, constants, state and couplers of the law and of the observer, and the arrays of the prediction; ``law`` also
    has the inputs for all units, the demand, and the call of a law in Python. ``braking`` has records and call of the
    policy of the air brake, the envelopes of the electric brake, and the pressures charged and demanded. ``link`` and
    ``stamps`` have the records of the link of the commands and of that of their stamps, with the random numbers of
    every tick; ``stamps`` begins with the age of the newest command.
    """
    state, vehicle, vehicle_index, gear, gear_table, run, body, unit, unit_index, envelope, piece = train
    outside, cubes, cubed = forces
    every, states, gears, unit_states, settings, lost = reports
    lines, queues, due, value, draws = link
    ages, stamp_lines, stamp_queues, stamp_due, stamp_value, stamp_draws = stamps
    n, steps, nu = vehicle.shape[1], outside.shape[2], sensors.units.size
    law_state, observer_state, policy_state = law[1], observing[1], braking[1]
    saved, observed, kept = law_state.copy(), observer_state.copy(), inputs.copy()
    demanded, seen = policy_state.copy(), sensors.units.copy()
    supervised = supervision.states.run[0].period > 0
    now, window, own_stamp, newest = law[3], np.zeros((steps, nu)), np.zeros(1), np.zeros((1, 1))
    for tick in range(len(measured)):
        at = stamp + tick * tick_ns
        t, seen[:] = at * 1e-9, sensors.units
        measure_train(
            sensors, t, state[k.X], state[k.V], state[k.COUPLER, 1:], noise[0][tick], noise[1][tick], noise[2][tick],
            couplers[tick],
        )  # fmt: skip
        for u in range(nu):
            measured[tick, MEASURED_POSITION, u] = sensors.units[u].position
            measured[tick, MEASURED_VELOCITY, u] = sensors.units[u].velocity
            measured[tick, MEASURED_FORCE, u] = unit[k.APPLIED, u]
        if _must_leave(tick, measured, couplers, state[k.X, 0], bound, event, events, n, at_rest):
            sensors.units[:] = seen
            return tick
        if supervised:
            age = command_age(ages, stamp_lines, stamp_queues, stamp_due, stamp_value, at, newest)
            if age > ages[0].shortest:
                sensors.units[:] = seen
                return tick
            copy_states(supervision.states, supervision.kept, at)
        saved[:], observed[:], kept[:], demanded[:] = law_state, observer_state, inputs, policy_state
        usable, limited = True, 0
        if supervised:
            place, speed = measured[tick, MEASURED_POSITION, 0], measured[tick, MEASURED_VELOCITY, 0]
            usable = supervised_tick(at, state[k.X, 0], state[k.V, 0], place, speed, supervision)
        if usable:
            for u in range(nu):
                x = inputs[u]
                x.position, x.velocity = measured[tick, MEASURED_POSITION, u], measured[tick, MEASURED_VELOCITY, u]
                x.applied = measured[tick, MEASURED_FORCE, u]
            place, speed = measured[tick, MEASURED_POSITION, 0], measured[tick, MEASURED_VELOCITY, 0]
            usable = not changes_brake(t, place, speed, measured[tick, MEASURED_FORCE], braking)
        if usable:
            usable = observe(tick, couplers[tick, COUPLER_FORCE], own, tables, observing, inputs, now)
        is_step = (count[FIRST_TICK] + tick) % count[EVERY] == 0
        if usable and is_step:
            set_inputs(tick, reference, feedforward, own, limits, segments, inputs, now[0])
            limited = law_step(
                tick, t, couplers[tick, COUPLER_FORCE], own, tables, shoes, law, predicting, history, inputs,
                sent[tick + 1],
            )  # fmt: skip
        if not usable or limited < 0:
            law_state[:], observer_state[:], inputs[:], policy_state[:] = saved, observed, kept, demanded
            copy_states(supervision.kept, supervision.states, at)
            sensors.units[:] = seen
            return tick
        if is_step:
            if at_rest[tick] and _stands(tick, measured, bound):
                sent[tick + 1] = 0.0
            at_limit[tick + 1] = at_limit[tick] + limited
            count[AT_LIMIT] = limited
        else:
            sent[tick + 1], at_limit[tick + 1] = sent[tick], at_limit[tick]
        if at % every < tick_ns:
            last = min(count[REPORTS], len(states) - 1)
            states[last], gears[last], unit_states[last] = state, gear, unit
            settings[count[REPORTS]], lost[count[REPORTS]] = setting, lines[0].lost
            count[REPORTS] += 1
        for j in range(len(shown)):
            i = shown[j]
            truth[tick, 0, j], truth[tick, 1, j] = state[k.X, i], state[k.V, i]
            truth[tick, 2, j], truth[tick, 3, j] = state[k.COUPLER, i + 1], state[k.SHOE_FORCE, i]
        for row in range(len(history) - 1):
            history[row] = history[row + 1]
        if len(history):
            history[len(history) - 1] = sent[tick + 1]
        push(lines, queues, due, value, at, sent[tick + 1], draws[tick, 0], draws[tick, 1])
        arrive(lines, queues, due, value, at, window)
        if supervised:
            own_stamp[0] = at
            push(stamp_lines, stamp_queues, stamp_due, stamp_value, at, own_stamp, stamp_draws[tick, 0],
                 stamp_draws[tick, 1])  # fmt: skip
        for j in range(len(cubed)):
            speed = state[k.V, vehicles[cubed[j]]]
            for step in range(steps):
                outside[tick, 1, step, cubed[j]] += cubes[tick, step, j] * (speed * speed)
        k.advance(
            t, dt, state, vehicle, vehicle_index, gear, gear_table, run, body, unit, unit_index, envelope, piece,
            event, events, window, outside[tick], vehicles, setting,
        )  # fmt: skip
    return len(measured)
