"""One step of a constrained predictive law on a train as one mass, compiled.

The free motion follows from the measured forces and the commands in flight, unit by unit with its own delay. The plan
adds the decision of :mod:`train_ato.control.mpc.force_plan`.
"""

# mypy: allow-untyped-defs

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp
from plant_sim.railway import between_entries
from train_ato.control.algorithms.quadratic_program import multipliers
from train_ato.control.algorithms.train_constants import SPEED_STEP
from train_ato.control.train_model import newest_arrived

FAR = 1e4
"""Distance in place of no limit [m]: the programme permits a violation in proportion to its largest entry."""


@compiled
def free_motion(motion, applied, sent, required, actuators, tick, lag, mass):
    """Advance the motion over the delay for the commands in flight, and for z = 0 in those not yet sent.

    ``motion`` is e_p [m], e_v [m/s], disturbance and, as a result, net acceleration error [m/s²]. ``applied`` acts now
    on the units, ``sent``, shape (d, units), is in flight, and ``required`` keeps the train on the reference at every
    tick of the delay [N]. ``actuators``, shape (3, units), has delay in traction and braking [s] and share of the
    force. ``tick`` and ``lag`` are times [s], ``mass`` is in kg.
    """
    units, steps = applied.size, required.size - 1
    decay = libm_exp(-tick / lag) if lag > 0.0 else 0.0
    lasting = (1.0 - decay) * lag / tick
    beyond = np.empty(units)
    for i in range(units):
        beyond[i] = applied[i] - actuators[2, i] * required[0]
    for k in range(steps):
        middle = (k + 0.5) * tick
        slope = (required[k + 1] - required[k]) / tick
        demand = 0.5 * (required[k] + required[k + 1]) + lag * slope
        total = 0.0
        for i in range(units):
            delay = actuators[1, i] if demand < 0.0 else actuators[0, i]
            if middle >= delay - 1e-9:
                due = -actuators[2, i] * mass * motion[2]
            else:
                command = newest_arrived(sent, i, middle, tick, actuators[0, i], actuators[1, i])
                due = command - actuators[2, i] * demand
            total += due + (beyond[i] - due) * lasting
            beyond[i] = due + (beyond[i] - due) * decay
        pull = total / mass + motion[2]
        motion[0] += (motion[1] + 0.5 * pull * tick) * tick
        motion[1] += pull * tick
    total = 0.0
    for i in range(units):
        total += beyond[i]
    motion[3] = total / mass + motion[2] if lag > 0.0 else 0.0


@compiled
def free_errors(motion, nodes, lag, position, velocity):
    """Compute the errors of position and speed at the nodes for z = 0 from the motion after the delay."""
    for k in range(nodes.size):
        left = 1.0 - libm_exp(-nodes[k] / lag) if lag > 0.0 else 0.0
        gained = lag * left
        velocity[k] = motion[1] + motion[3] * gained
        position[k] = motion[0] + motion[1] * nodes[k] + motion[3] * lag * (nodes[k] - gained)


@compiled
def table_value(table, speed):
    """Return a force limit at a speed [m/s], linear between the entries."""
    return between_entries(table, abs(speed) / SPEED_STEP)


@compiled
def lowest_limit(limits, front, rear):
    """Return the lowest speed limit between two places [m/s]; ``limits`` has place and speed, from the place on."""
    lowest = np.inf
    for i in range(limits.shape[0]):
        end = limits[i + 1, 0] if i + 1 < limits.shape[0] else np.inf
        if limits[i, 0] <= front and end > rear:
            lowest = min(lowest, limits[i, 1])
    return lowest


@compiled
def node_values(fine, nodes, parts):
    """Return the values at the nodes of the nearest function that is linear between them, shape (nodes,).

    Nearest by the integral of the squared difference. The integral of this function and its first moment are those of
    the quantity, so that speed and position of the plan are right between nodes that are far from each other. ``fine``,
    shape (parts (nodes - 1) + 1,), has the quantity at the nodes and at equal steps between them; ``nodes`` in s.
    """
    n = nodes.size
    right, diagonal = np.zeros(n), np.zeros(n)
    for j in range(n - 1):
        width = nodes[j + 1] - nodes[j]
        diagonal[j] += width / 3.0
        diagonal[j + 1] += width / 3.0
        for k in range(parts):
            low, high = fine[j * parts + k], fine[j * parts + k + 1]
            first, slope = (k + 1.0 / 3.0) / parts, 1.0 / (3.0 * parts)
            later = 0.5 * width / parts * (low * first + high * (first + slope))
            right[j + 1] += later
            right[j] += 0.5 * width / parts * (low + high) - later
    for j in range(1, n):
        ratio = (nodes[j] - nodes[j - 1]) / (6.0 * diagonal[j - 1])
        diagonal[j] -= ratio * (nodes[j] - nodes[j - 1]) / 6.0
        right[j] -= ratio * right[j - 1]
    right[n - 1] /= diagonal[n - 1]
    for j in range(n - 2, -1, -1):
        right[j] = (right[j] - (nodes[j + 1] - nodes[j]) / 6.0 * right[j + 1]) / diagonal[j]
    return right


@compiled
def add_product(total, matrix, vector):
    """Add a product of matrix and vector, column by column: fast for a matrix that is stored by its columns."""
    for k in range(vector.size):
        for j in range(total.size):
            total[j] += matrix[j, k] * vector[k]


@compiled
def bounds(
    required, reference, limits, ends, now, errors, plan, drag, tables, couplers, mass, jerk, steps, disturbance, rise,
    effect, allowed,
):  # fmt: skip
    """Compute the right-hand side b of A z <= b, shape (7 nodes,); arguments as in :func:`plan_step`.

    ``ends`` are front and rear of the train from vehicle 0's centre [m], the permitted excess of a speed limit [m/s],
    and the position error beyond which the largest one has a cost [m]; ``now`` is the range of the total force at the
    measured speed [N], and ``effect`` its value on the reference at the time of effect. ``drag`` is the resistance at
    the measured speed beyond that at the reference [N], and slope and curvature of the running resistance [N s/m, N
    s²/m²].
    """
    n = required.size
    planned = errors[1].copy()
    add_product(planned, plan[0], plan[1])
    for j in range(n):
        speed = reference[1, j] + errors[1, j]
        if j == 0:
            low, high = now[0], now[1]
        else:
            beyond = reference[1, j] + planned[j]
            low, high = -table_value(tables[0], beyond), table_value(tables[1], beyond)
            required[j] += (drag[1] + drag[2] * abs(reference[1, j])) * planned[j] - drag[0]
        low, high = max(low, couplers[0, j]), min(high, couplers[1, j])
        allowed[j] = (high - required[j]) / mass + disturbance[j]
        allowed[n + j] = (required[j] - low) / mass - disturbance[j]
        change = (required[j] - (required[j - 1] if j > 1 else effect)) / mass if j > 0 else rise
        allowed[2 * n + j] = jerk * steps[j] - change
        allowed[3 * n + j] = jerk * steps[j] + change
        place = reference[0, j] + errors[0, j]
        limit = lowest_limit(limits, place + ends[0], place + ends[1]) + ends[2]
        allowed[4 * n + j] = min(limit - speed, 1e3)
        allowed[5 * n + j] = min(ends[3] - errors[0, j], FAR)
        allowed[6 * n + j] = min(ends[3] + errors[0, j], FAR)


@compiled
def approach(limits, errors, speeds, motion, near, time, pole, lags, response):
    """Return the decision that approaches a speed limit up to the node ``near``, at a time [s], with a pole [rad/s].

    With the distance m from the limit and its rate m' at the time of effect, the distance is at least (m + (m' + pole
    m) t) e^(-pole t), without a lag m e^(-pole t). The decision held up to the node at 1/pole has this speed there. At
    the nodes before it a limit of the speed is a deadbeat control, which chatters. The motion on the reference is
    always permitted, below the limit. ``limits`` is the room beside the free motion [m/s], ``motion`` has speed [m/s],
    acceleration, and error of the acceleration at the time of effect [m/s²].
    """
    speed, change, gained = motion
    now, then = limits[0] + speeds[0] + errors[0], limits[near] + speeds[near] + errors[near]
    margin = max(min(now, then) - speed, min(now - speed, 0.0))
    left = libm_exp(-pole * time)
    rest, kept = margin, errors[0]
    if lags:
        rest += (pole * margin - change) * time
        kept += (pole * errors[0] + gained) * time
    top = then - speeds[near]
    permitted = max(top - rest * left, min(top, kept * left)) - errors[near]
    moved = 0.0
    for speed in response:
        moved += speed
    return permitted / moved


@compiled
def decide(gradients, inverted, limited, dual, rows, errors, allowed, active, z):
    """Compute the decision with the smallest cost under A z <= b; return the exchanges, -1 without a solution.

    ``gradients`` are those of the cost for errors of position and speed, ``inverted``, ``limited``, ``dual`` and
    ``rows`` are H⁻¹, H⁻¹A', A H⁻¹A' with the softness, and A; ``errors`` those of the free motion, shape (2, nodes).
    ``active`` has the active rows of the last solution and of this one. ``z`` is the result [m/s²], not changed without
    a solution.
    """
    n, m = z.size, allowed.size
    force, free = np.zeros(n), np.zeros(n)
    for k in range(n):
        for j in range(n):
            force[j] -= gradients[0][j, k] * errors[0, k] + gradients[1][j, k] * errors[1, k]
    add_product(free, inverted, force)
    slack = allowed.copy()
    add_product(slack, rows, -free)
    found = np.zeros(m)
    exchanges = 0
    if slack.min() < 0.0:
        exchanges = multipliers(dual, slack, active, found)
        if exchanges < 0:
            return exchanges
    else:
        active[:] = False
    z[:] = free
    for i in range(m):
        if found[i] != 0.0:
            for j in range(n):
                z[j] -= limited[j, i] * found[i]
    return exchanges


@compiled
def write_plan(reference, errors, side, decision, room, mass, found):
    """Compute planned position [m], speed [m/s] and excess over the permitted speed [m/s]; complete the force [N]."""
    moved = np.zeros((2, decision.size))
    add_product(moved[0], side[2], decision)
    add_product(moved[1], side[3], decision)
    for j in range(decision.size):
        found[0, j] = reference[0, j] + errors[0, j] + moved[0, j]
        found[1, j] = reference[1, j] + errors[1, j] + moved[1, j]
        found[2, j] = max(moved[1, j] - room[j], 0.0)
        found[3, j] += mass * (decision[j] - found[4, j])


@compiled
def go_on(plan, nodes, period):
    """Advance a plan by a period [s], with the bits of ``numpy.interp``; beyond its last node it is constant."""
    before, k = plan.copy(), 0
    for j in range(nodes.size):
        time = nodes[j] + period
        while k < nodes.size - 1 and nodes[k + 1] <= time:
            k += 1
        plan[j] = before[k]
        if k < nodes.size - 1:
            plan[j] += (before[k + 1] - before[k]) / (nodes[k + 1] - nodes[k]) * (time - nodes[k])


@compiled
def plan_step(
    side, times, line, couplers, required, errors, reference, effect, start, rule, places, allowed, active, plan, found
):
    """Compute limits, decision and plan of a period.

    Return the number of exchanges, -1 without a solution, and True for an active row, and for one of the brake force.
    Without a solution the last plan goes on.

    Parameters
    ----------
    side : tuple of eight Arrays
        The fields of :class:`train_ato.control.mpc.force_plan.HorizonModel`.
    times : tuple of three Arrays, shape (nodes,)
        Nodes [s], time from the former node plus the lag, through which a command changes the force [s], and part of a
        passing disturbance that has decayed.
    line : tuple of Arrays
        Places [m] with the speed limit from there on [m/s], shape (n, 2); ``ends`` of :func:`bounds`; largest brake and
        traction force over the speed [N], shape (2, speeds).
    couplers : Array, shape (2, nodes)
        Smallest and largest total force for the coupler forces [N].
    errors, reference : Array, shape (2, nodes)
        Errors of the free motion, and position of vehicle 0's centre and speed of the reference [m, m/s].
    required : Array, shape (h,)
        Total force that keeps the train on the reference, at the times of the lookahead [N].
    effect : tuple of float
        Position [m], speed [m/s] and acceleration [m/s²] of the reference at the time of effect.
    start : tuple of float
        Disturbance and its passing part, error of the acceleration, and rise [m/s²]; feed-forward [N], inertia [kg],
        smallest and largest total force at the measured speed, and resistance there beyond the reference [N].
    rule : tuple of float
        Largest jerk [m/s³], pole of the approach [rad/s], its order less one, time from which a stop is kept [s],
        position error permitted there [m], drag of :func:`bounds`, control period [s], and 1.0 for a departure.
    places : tuple of int
        Entry of the first node and of the effect in the lookahead, steps between nodes, and node of the approach.
    allowed : Array, shape (8 nodes,)
        Right-hand side b of all rows.
    active, plan
        ``active`` and ``z`` of :func:`decide`.
    found : Array, shape (5, nodes)
        Result: rows of :func:`write_plan`, and the disturbance at the nodes [m/s²].
    """
    nodes, steps, passed = times
    disturbance, passing, gained, rise, feedforward, mass, low, high, beyond = start
    jerk, pole, lags, stop_time, stop_room, slope, curvature, period, departs = rule
    first, ticks, parts, near = places
    n = nodes.size
    force, lasting = found[3], found[4]
    force[:] = node_values(required[first:], nodes, parts)
    force[0] = feedforward
    for j in range(n):
        lasting[j] = disturbance - passing * passed[j]
    bounds(
        force, reference, line[0], line[1], (low, high), errors, (side[3], plan), (beyond, slope, curvature), line[2],
        couplers, mass, jerk, steps, lasting, rise, required[ticks], allowed,
    )  # fmt: skip
    if departs > 0.0:
        allowed[2 * n] = max(allowed[2 * n], 0.0)
    for j in range(n):
        rests = reference[1, j] == 0.0 and nodes[j] >= stop_time
        allowed[7 * n + j] = min(stop_room - errors[0, j], FAR) if rests else FAR
    room, motion = allowed[4 * n : 5 * n], (effect[1] + errors[1, 0], effect[2] + gained, gained)
    held = approach(room, errors[1], reference[1], motion, near, nodes[near], pole, lags > 0.0, side[3][near])
    room[:near] = 1e3
    allowed[0] = min(allowed[0], max(held, -allowed[n], -allowed[3 * n]))
    exchanges = decide((side[0], side[1]), side[4], side[6], side[7], side[5], errors, allowed, active, plan)
    reference[0, 0], reference[1, 0] = effect[0], effect[1]
    if exchanges < 0:
        active[:] = False
        go_on(plan, nodes, period)
    write_plan(reference, errors, side, plan, room, mass, found)
    return exchanges, active.any(), active[n : 2 * n].any()
