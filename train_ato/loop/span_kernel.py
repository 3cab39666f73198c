"""Compiled ticks: sensors, brake policy, observer, law, delay line and train of consecutive ticks in one call."""

# mypy: allow-untyped-defs

from dataclasses import dataclass

from plant_sim import kernel as k
from plant_sim.compiled import compiled
from plant_sim.elementary import numpy_total
from plant_sim.railway import between_entries, shoe_force
from plant_sim.record import quantity
from plant_sim.sensors import measure_train
from train_ato.control.air_brake.record_policy import electric_brake_available
from train_ato.control.algorithms.couplers import opposing
from train_ato.control.command_hold import command_at_standstill
from train_ato.control.compensation.predictor import predict
from train_ato.control.guard import limit_commands
from train_ato.control.law import STEPPED
from train_ato.control.law_call import address
from train_ato.control.train_model import GRID, own_resistance, unit_limits
from train_ato.loop.supervision_kernel import MAX_POSITION, MAX_SPEED, copy_states, supervised_tick
from train_ato.loop.train_protection import command_age
from train_ato.messages.delay_lines import arrive, push


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


@compiled(alone=False)
def set_inputs(tick, reference, feedforward, own, limits, segments, inputs, now):
    """Write reference, feed-forward and limits of a step of the law."""
    for u in range(inputs.size):
        inputs[u].reference_position = reference[0, tick] - own[u].offset
        inputs[u].feedforward = feedforward[tick, u]
        inputs[u].force_min, inputs[u].force_max = unit_limits(limits, segments[u], inputs[u].velocity)
        inputs[u].reference_velocity, inputs[u].reference_acceleration = reference[1, tick], reference[2, tick]
    now.acceleration_at_effect, now.jerk_at_effect = reference[3, tick], reference[4, tick]
    now.delay_to_effect = reference[5, tick]


@compiled(alone=False)
def call_law(tick, law, inputs):
    """Call law or control stack in a tick; return 0, another number for a tick that is left to Python."""
    constant, state, rows, all_now, call, _ = law
    return call(tick, address(constant), address(state), address(all_now), address(inputs), inputs.size, rows)


@compiled(alone=False)
def law_step(tick, t, coupler_forces, own, tables, shoes, law, predicting, history, inputs, sent):
    """Compute the command of a tick from its inputs; return 1 at a limit, 0 inside, -1 for one left to Python."""
    all_now, couplers = law[3], law[5]
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
    if call_law(tick, law, inputs) != 0:
        return -1
    limited = limit_commands(inputs)
    for u in range(inputs.size):
        sent[u] = inputs[u].force
    return int(limited)


# Rows of `measured` (ticks, rows, units).
MEASURED_POSITION, MEASURED_VELOCITY, MEASURED_FORCE = range(3)
# Rows of `couplers` (ticks, rows, sensors).
DEFLECTION, RATE, COUPLER_FORCE = range(3)
MAX_FORCE = 1e9
"""Force beyond which a tick is left to Python, far inside the limits of validity [N]."""


@dataclass
class SpanCounts:
    """Counts of a span, which its ticks change."""

    first_tick: int = quantity("", "tick of the control stack at row 0")
    every: int = quantity("", "ticks between the steps of the law")
    at_limit: int = quantity("", "1 if the last step was at a limit")
    reports: int = quantity("", "reports so far")
    called: int = quantity("", "1 for a control stack that is called as a whole")
    begin: int = quantity("", "row of the first tick of a call")
    end: int = quantity("", "row after its last one")
    seen: int = quantity("", "1 for a first tick whose inputs of the law the call before has computed")


@compiled
def _must_leave(tick, measured, couplers, x_front, jump_place, event, events, n):
    """Return True for a tick that is left to Python: events of the pipe and jumps, impossible values."""
    for u in range(measured.shape[2]):
        if not abs(measured[tick, MEASURED_VELOCITY, u]) < MAX_SPEED:
            return True
        if not abs(measured[tick, MEASURED_POSITION, u]) < MAX_POSITION:
            return True
        if not abs(measured[tick, MEASURED_FORCE, u]) < MAX_FORCE:
            return True
    for j in range(couplers.shape[2]):
        if not abs(couplers[tick, COUPLER_FORCE, j]) < MAX_FORCE:
            return True
    if x_front >= jump_place:
        return True
    reached = False
    for j in range(events):
        reached |= event[k.REACHED, j] >= n
    return reached


@compiled(alone=False)
def _begins(tick, at, n, state, unit, noise, sensors, measured, couplers, jump_place, event, events, stamps, newest,
            supervision):  # fmt: skip
    """Write what the sensors measure in a tick; return False for a tick that is left to Python."""
    t = at * 1e-9
    measure_train(
        sensors, t, state[k.X], state[k.V], state[k.COUPLER, 1:], noise[0][tick], noise[1][tick], noise[2][tick],
        couplers[tick],
    )  # fmt: skip
    for u in range(sensors.units.size):
        measured[tick, MEASURED_POSITION, u] = sensors.units[u].position
        measured[tick, MEASURED_VELOCITY, u] = sensors.units[u].velocity
        measured[tick, MEASURED_FORCE, u] = unit[k.APPLIED, u]
    if _must_leave(tick, measured, couplers, state[k.X, 0], jump_place, event, events, n):
        return False
    if supervision.states.run[0].period > 0:
        ages = stamps[0]
        if command_age(ages, stamps[1], stamps[2], stamps[3], stamps[4], at, newest) > ages[0].shortest:
            return False
        copy_states(supervision.states, supervision.kept, at)
    return True


@compiled(alone=False)
def _prepare(tick, at, stepping, state, measured, couplers, reference, feedforward, own, tables, limits, segments,
             inputs, now, observing, braking, called, supervision):  # fmt: skip
    """Compute the inputs of the law, of a step as well; return False for a tick that is left to Python."""
    place, speed = measured[tick, MEASURED_POSITION, 0], measured[tick, MEASURED_VELOCITY, 0]
    supervised = supervision.states.run[0].period > 0
    if supervised and not supervised_tick(at, state[k.X, 0], state[k.V, 0], place, speed, supervision):
        return False
    for u in range(inputs.size):
        x = inputs[u]
        x.position, x.velocity = measured[tick, MEASURED_POSITION, u], measured[tick, MEASURED_VELOCITY, u]
        x.applied = measured[tick, MEASURED_FORCE, u]
    if not called and changes_brake(at * 1e-9, place + own[0].offset, speed, measured[tick, MEASURED_FORCE], braking):
        return False
    if not observe(tick, couplers[tick, COUPLER_FORCE], own, tables, observing, inputs, now):
        return False
    if stepping:
        set_inputs(tick, reference, feedforward, own, limits, segments, inputs, now[0])
    return True


@compiled(into_caller=True, allocates=False)
def _copy(source, target):
    """Copy a row; an assignment to a slice also tests for an overlap."""
    for i in range(len(source)):
        target[i] = source[i]


@compiled(into_caller=True, allocates=False)
def _copy_states(law, to_law, observer, to_observer, inputs, to_inputs, policy, to_policy):
    """Copy the states of law, observer and brake policy, and the inputs of the law."""
    _copy(law, to_law)
    _copy(observer, to_observer)
    _copy(inputs, to_inputs)
    _copy(policy, to_policy)


@compiled(into_caller=True, allocates=False)
def _copy_rows(source, target):
    """Copy the rows of a table."""
    for row in range(len(source)):
        _copy(source[row], target[row])


@compiled(alone=False)
def _keep(tick, is_step, limited, velocity, standstill, sent, at_limit, count):
    """Keep command and number of steps at a limit; between two steps of the law they are those of the last step."""
    if is_step:
        command_at_standstill(sent[tick + 1], velocity, standstill[0, tick], standstill[1, tick])
        at_limit[tick + 1] = at_limit[tick] + limited
        count.at_limit = limited
    else:
        _copy(sent[tick], sent[tick + 1])
        at_limit[tick + 1] = at_limit[tick]


@compiled(alone=False)
def _report(train, setting, lost, reports, count):
    """Keep the state of the train for the diagnostics."""
    _, states, gears, unit_states, settings, losses = reports
    last = min(count.reports, len(states) - 1)
    _copy_rows(train[0], states[last])
    _copy_rows(train[3], gears[last])
    _copy_rows(train[7], unit_states[last])
    _copy(setting, settings[count.reports])
    losses[count.reports] = lost
    count.reports += 1


@compiled(alone=False)
def _show(tick, state, shown, truth):
    """Write the motion and the forces of the vehicles that are shown."""
    for j in range(len(shown)):
        i = shown[j]
        truth[tick, 0, j], truth[tick, 1, j] = state[k.X, i], state[k.V, i]
        truth[tick, 2, j], truth[tick, 3, j] = state[k.COUPLER, i + 1], state[k.SHOE_FORCE, i]


@compiled(alone=False)
def _send(tick, at, sent, history, link, stamps, supervised, own_stamp, window):
    """Send the command of a tick, and its stamp to a supervised train; write the commands that arrive."""
    lines, queues, due, value, draws = link
    for row in range(len(history) - 1):
        _copy(history[row + 1], history[row])
    if len(history):
        _copy(sent, history[len(history) - 1])
    push(lines, queues, due, value, at, sent, draws[tick, 0], draws[tick, 1])
    arrive(lines, queues, due, value, at, window)
    if supervised:
        own_stamp[0] = at
        push(stamps[1], stamps[2], stamps[3], stamps[4], at, own_stamp, stamps[5][tick, 0], stamps[5][tick, 1])


@compiled(alone=False)
def _add_cubes(tick, state, forces, vehicles):
    """Add the part of the disturbances that grows with the square of the speed."""
    outside, cubes, cubed = forces
    for j in range(len(cubed)):
        speed = state[k.V, vehicles[cubed[j]]]
        for step in range(outside.shape[2]):
            outside[tick, 1, step, cubed[j]] += cubes[tick, step, j] * (speed * speed)


@compiled(alone=False)
def span_ticks(arguments):
    """Run consecutive ticks, see :func:`run_span`, whose arguments are the entries of one tuple here.

    The code of this function becomes a part of its callers: a call with hundreds of numbers takes longer than a tick.
    """
    (
        stamp, tick_ns, dt, train, event, events, forces, vehicles, setting, noise, sensors,
        law, observing, predicting, braking, inputs, reference, feedforward, shoes, own, tables, limits, segments,
        jump_place, counts, link, stamps, history, shown, truth, measured, couplers, sent, at_limit, reports,
        supervision, standstill, places,
    ) = arguments  # fmt: skip
    state, vehicle, vehicle_index, gear, gear_table, run, body, unit, unit_index, envelope, piece = train
    law_state, observer_state, policy_state, now = law[1], observing[1], braking[1], law[3]
    saved, observed, kept, demanded, seen, window, own_stamp, newest = places
    count, rows, supervised = counts[0], len(measured), supervision.states.run[0].period > 0
    called, ahead = count.called > 0, count.seen > 0
    count.seen = 0
    for tick in range(count.begin, rows):
        at = stamp + tick * tick_ns
        t, is_step = at * 1e-9, (count.first_tick + tick) % count.every == 0
        usable, limited, is_seen, ahead = True, 0, ahead, False
        if not is_seen:
            _copy(sensors.units, seen)
            if not _begins(
                tick, at, vehicle.shape[1], state, unit, noise, sensors, measured, couplers, jump_place, event, events,
                stamps, newest, supervision,
            ):  # fmt: skip
                _copy(seen, sensors.units)
                return tick
            _copy_states(law_state, saved, observer_state, observed, inputs, kept, policy_state, demanded)
            usable = _prepare(
                tick, at, is_step and not called, state, measured, couplers, reference, feedforward, own, tables,
                limits, segments, inputs, now, observing, braking, called, supervision,
            )  # fmt: skip
            if usable and tick == count.end:
                count.begin, count.seen = tick, 1
                return tick
        if usable and called:
            limited = call_law(tick, law, inputs)
        elif usable and is_step:
            limited = law_step(
                tick, t, couplers[tick, COUPLER_FORCE], own, tables, shoes, law, predicting, history, inputs,
                sent[tick + 1],
            )  # fmt: skip
        if not usable or limited < 0:
            _copy_states(saved, law_state, observed, observer_state, kept, inputs, demanded, policy_state)
            _copy(seen, sensors.units)
            copy_states(supervision.kept, supervision.states, at)
            return tick
        if not called:
            _keep(tick, is_step, limited, measured[tick, MEASURED_VELOCITY], standstill, sent, at_limit, count)
        if at % reports[0] < tick_ns:
            _report(train, setting, link[0][0].lost, reports, count)
        _show(tick, state, shown, truth)
        _send(tick, at, sent[tick + 1], history, link, stamps, supervised, own_stamp, window)
        _add_cubes(tick, state, forces, vehicles)
        k.advance(
            t, dt, state, vehicle, vehicle_index, gear, gear_table, run, body, unit, unit_index, envelope, piece,
            event, events, window, forces[0][tick], vehicles, setting,
        )  # fmt: skip
    return rows


@compiled(allocates=False)
def run_span(arguments):
    """Run consecutive ticks until a tick that is left to Python; return the number of ticks run since row 0.

    The rows of the call are in ``counts``. If a row follows, its tick is run up to the inputs of the law. The next call
    brings the force of this law. ``counts`` says so, and such a law leaves no tick.

    All arrays are changed in place. Outputs have one row per tick: ``truth`` (ticks, 4, vehicles) with position, speed,
    coupler and shoe force of the vehicles ``shown``, ``measured``, ``couplers``; ``sent`` and ``at_limit`` begin with
    command and number of steps at a limit before the first tick. ``reports`` has the state of the train at the ticks
    with diagnostics; arrays with one row have the last of these states.
    ``supervision`` has the records of the supervisor, ``standstill`` the rows of the forecast. ``law``, ``observing``
    and ``predicting`` have number, constants, state and couplers of the law and of the observer, and the arrays of the
    prediction; ``law`` also has the inputs for all units, the demand, and the call of a law or of a control stack in
    Python. ``braking`` has
    records and call of the policy of the air brake, the envelopes of the electric brake, and the pressures charged and
    demanded. ``link`` and ``stamps`` have the records of the link of the commands and of that of their stamps, with the
    random numbers of every tick; ``stamps`` begins with the age of the newest command. ``places`` has
    room for states before a tick.
    """
    return span_ticks(arguments)
