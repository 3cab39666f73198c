"""One step of a constrained predictive law on a train as one mass, compiled.

The free motion follows from the measured forces and the commands in flight, unit by unit with its own delay. The plan
adds the decision of :mod:`train_ato.control.mpc.force_plan`.
"""

from functools import cache
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from numba import typeof, types
from numpy.typing import NDArray

from plant_sim.compiled import compiled, direct_call
from plant_sim.elementary import libm_exp
from plant_sim.line import SpeedLimit
from plant_sim.railway import between_entries
from plant_sim.record import Records, records_of
from train_ato.control.algorithms.quadratic_program import multipliers
from train_ato.control.algorithms.train_constants import SPEED_STEP
from train_ato.control.train_model import Actuator, newest_arrived
from train_ato.messages.types import Array

FAR = 1e4
"""Distance in place of no limit [m]: the programme permits a violation in proportion to its largest entry."""
LASTING_RESISTANCE = 0.05
"""Unknown resistance on which the brake ahead counts [m/s²]: that of a grade of 5 permille; a gust may end."""
# Rows of the constraints, one column per node: limits of force, jerk, speed, position error, and stops.
MOST_FORCE, LEAST_FORCE, RISE, FALL, SPEED, AHEAD, BEHIND, STOP = range(8)
CONSTRAINTS = 8


class RelativeMotion(NamedTuple):
    """Motion of a train against its reference: errors of position [m], speed [m/s] and acceleration [m/s²].

    ``disturbance`` is the acceleration that the force must compensate [m/s²].
    """

    position_error: float
    speed_error: float
    disturbance: float
    acceleration_error: float


class NodeMotion(NamedTuple):
    """Position [m] and speed [m/s] at the nodes, or their errors, shape (nodes,)."""

    position: Array
    velocity: Array


class HorizonModel(NamedTuple):
    """Matrices of the quadratic programme for one set of delays, stored by columns.

    Attributes
    ----------
    gradient_position, gradient_velocity : Array, shape (nodes, nodes)
        Gradient of the cost for unit errors e_p, e_v of the free motion.
    response_position, response_velocity : Array, shape (nodes, nodes)
        Errors at the times y_k for unit decisions.
    inverse : Array, shape (nodes, nodes)
        Inverse of the Hessian.
    constraints : Array, shape (rows, nodes)
        A, the rows of the constraints.
    limited : Array, shape (nodes, rows)
        H⁻¹ A', change of the decision with the multipliers.
    dual : Array, shape (rows, rows)
        A H⁻¹ A' and the softness.
    """

    gradient_position: Array
    gradient_velocity: Array
    response_position: Array
    response_velocity: Array
    inverse: Array
    constraints: Array
    limited: Array
    dual: Array


class PlanConstants(NamedTuple):
    """Constants of the plans of a run.

    Attributes
    ----------
    nodes, steps, kept, passed : Array, shape (nodes,)
        Nodes [s], time from the former node [s], in the first entry the lag or the period, part of the acceleration at
        the time of effect in the change since the former node, and part of a passing disturbance that has decayed.
    parts, near : int
        Steps of the required force between two nodes, and the last node up to which a speed limit is approached.
    period, jerk : float
        Control period [s] and largest jerk [m/s³].
    lag, pole : float
        Lag of the actuators [s], and pole of the approach [rad/s], which is a double one with a lag.
    stop_time, stop_room : float
        Time from which a stop is kept [s], and position error permitted there [m].
    drag_slope, drag_curvature : float
        Those of the running resistance [N s/m, N s²/m²].
    front, rear, overspeed : float
        Ends of the train from vehicle 0's centre [m], and permitted excess of a speed limit [m/s].
    limits : Records of SpeedLimit
        Speed limits of the line.
    """

    nodes: Array
    steps: Array
    kept: Array
    passed: Array
    parts: int
    near: int
    period: float
    jerk: float
    lag: float
    pole: float
    stop_time: float
    stop_room: float
    drag_slope: float
    drag_curvature: float
    front: float
    rear: float
    overspeed: float
    limits: Records[SpeedLimit]


class PlanStart(NamedTuple):
    """Errors and forces from which a plan begins.

    Attributes
    ----------
    required : Array
        Total force that keeps the train on the reference, at the times of the lookahead [N].
    motion : RelativeMotion
        Motion at the time of effect without the commands of the plan.
    disturbance : float
        Acceleration that the force must compensate [m/s²].
    passing : float
        Part of it that does not last [m/s²].
    rise : float
        Demanded acceleration for z = 0 minus that which acts at the time of effect [m/s²].
    feedforward, last_force : float
        Total feed-forward and total force of the last command [N].
    force_min, force_max : float
        Smallest and largest total force at the measured speed [N].
    position_error : float
        Estimated position error [m].
    beyond_reference : float
        Resistance at the measured state beyond that on the reference [N].
    inertia : float
        Estimated inertia [kg].
    gain : float
        Known gain of the actuators: the limits of the force ahead are those of the model times it.
    air_brake_acts : bool
        True while the air brake acts.
    departs : bool
        True for a train at standstill without hauled vehicles. It may reach the acceleration of the reference at once.
        The largest jerk then applies only while it catches up.
    """

    required: Array
    motion: RelativeMotion
    disturbance: float
    passing: float
    rise: float
    feedforward: float
    last_force: float
    force_min: float
    force_max: float
    position_error: float
    beyond_reference: float
    inertia: float
    gain: float
    air_brake_acts: bool
    departs: bool


class PlanReference(NamedTuple):
    """Reference of a plan.

    Attributes
    ----------
    nodes : NodeMotion
        Vehicle 0's centre at the nodes.
    required : Array
        Total force that keeps the train on it from the first node on, ``parts`` steps between two nodes [N].
    position, velocity, acceleration, force : float
        Vehicle 0's centre and total force at the time of effect [m, m/s, m/s², N].
    """

    nodes: NodeMotion
    required: Array
    position: float
    velocity: float
    acceleration: float
    force: float


class ForceAhead(NamedTuple):
    """Limits of a plan.

    Attributes
    ----------
    brake, traction : Array, shape (speeds,)
        Largest forces over the speed [N].
    force_min, force_max : Array, shape (nodes,)
        Total force permitted by couplers and sections of the line [N].
    position_error : float
        Position error beyond which the largest one has a cost [m].
    """

    brake: Array
    traction: Array
    force_min: Array
    force_max: Array
    position_error: float


class PlannedNodes(NamedTuple):
    """Planned position [m], speed [m/s], excess over the permitted speed [m/s], force [N] and disturbance [m/s²]."""

    position: Array
    velocity: Array
    excess: Array
    force: Array
    disturbance: Array


@compiled
def free_motion(
    motion: RelativeMotion, applied: Array, sent: Array, required: Array, actuators: Records[Actuator], tick: float,
    lag: float, mass: float,
) -> RelativeMotion:  # fmt: skip
    """Return the motion after the delay for the commands in flight, and for z = 0 in those not yet sent.

    ``applied`` acts now on the units, ``sent``, shape (d, units), is in flight, and ``required`` keeps the train on the
    reference at every tick of the delay [N]. ``tick`` and ``lag`` are times [s], ``mass`` is in kg.
    """
    units, steps = applied.size, required.size - 1
    position, speed = motion.position_error, motion.speed_error
    decay = libm_exp(-tick / lag) if lag > 0.0 else 0.0
    lasting = (1.0 - decay) * lag / tick
    beyond = np.empty(units)
    for i in range(units):
        beyond[i] = applied[i] - actuators[i].share * required[0]
    for k in range(steps):
        middle = (k + 0.5) * tick
        slope = (required[k + 1] - required[k]) / tick
        demand = 0.5 * (required[k] + required[k + 1]) + lag * slope
        total = 0.0
        for i in range(units):
            unit = actuators[i]
            if middle >= (unit.backward if demand < 0.0 else unit.forward) - 1e-9:
                due = -unit.share * mass * motion.disturbance
            else:
                command = newest_arrived(sent, i, middle, tick, unit.forward, unit.backward)
                due = command - unit.share * demand
            total += due + (beyond[i] - due) * lasting
            beyond[i] = due + (beyond[i] - due) * decay
        pull = total / mass + motion.disturbance
        position += (speed + 0.5 * pull * tick) * tick
        speed += pull * tick
    total = 0.0
    for i in range(units):
        total += beyond[i]
    gained = total / mass + motion.disturbance if lag > 0.0 else 0.0
    return RelativeMotion(position, speed, motion.disturbance, gained)


@compiled
def free_errors(motion: RelativeMotion, nodes: Array, lag: float) -> NodeMotion:
    """Return the errors at the nodes for z = 0 from the motion after the delay."""
    errors = NodeMotion(np.empty(nodes.size), np.empty(nodes.size))
    for k in range(nodes.size):
        left = 1.0 - libm_exp(-nodes[k] / lag) if lag > 0.0 else 0.0
        gained, change = lag * left, motion.acceleration_error
        errors.velocity[k] = motion.speed_error + change * gained
        errors.position[k] = motion.position_error + motion.speed_error * nodes[k] + change * lag * (nodes[k] - gained)
    return errors


@compiled
def table_value(table: Array, speed: float) -> Any:
    """Return a force limit at a speed [m/s], linear between the entries."""
    return between_entries(table, abs(speed) / SPEED_STEP)


@compiled
def lowest_limit(limits: Records[SpeedLimit], front: float, rear: float) -> float:
    """Return the lowest speed limit between two places [m/s]."""
    lowest = np.inf
    for i in range(limits.size):
        end = limits[i + 1].at if i + 1 < limits.size else np.inf
        if limits[i].at <= front and end > rear:
            lowest = min(lowest, limits[i].speed)
    return lowest


@compiled
def node_values(fine: Array, nodes: Array, parts: int) -> Array:
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
def add_product(total: Array, matrix: Array, vector: Array) -> None:
    """Add a product of matrix and vector, column by column: fast for a matrix that is stored by its columns."""
    for k in range(vector.size):
        for j in range(total.size):
            total[j] += matrix[j, k] * vector[k]


@compiled
def bounds(
    p: PlanConstants, start: PlanStart, errors: NodeMotion, limits: ForceAhead, reference: PlanReference,
    response: Array, plan: Array, found: PlannedNodes, allowed: Array,
) -> None:  # fmt: skip
    """Compute the right-hand side b of A z <= b but the stops, shape (8, nodes), and complete the required force.

    ``errors`` are those of the free motion, ``response`` has the speed errors for unit decisions, ``plan`` is the last
    decision. ``found`` has disturbance and
    required force at the nodes; the resistance at the planned speed is added to the latter.
    """
    nodes, force, mass = reference.nodes, found.force, start.inertia
    planned = errors.velocity.copy()
    add_product(planned, response, plan)
    for j in range(force.size):
        speed = nodes.velocity[j] + errors.velocity[j]
        if j == 0:
            low, high = start.force_min, start.force_max
        else:
            beyond = nodes.velocity[j] + planned[j]
            low, high = -table_value(limits.brake, beyond), table_value(limits.traction, beyond)
            slope = p.drag_slope + p.drag_curvature * abs(nodes.velocity[j])
            force[j] += slope * planned[j] - start.beyond_reference
        low, high = max(low, limits.force_min[j]), min(high, limits.force_max[j])
        allowed[MOST_FORCE, j] = (high - force[j]) / mass + found.disturbance[j]
        against = found.disturbance[j]
        if j > 0:  # the brake does not count on the resistance of a gust, which may end or has just ended
            against = max(against, min(start.disturbance, 0.0), -LASTING_RESISTANCE)
        allowed[LEAST_FORCE, j] = (force[j] - low) / mass - against
        before = force[j - 1] if j > 1 else reference.force
        change = (force[j] - before) / mass - start.motion.acceleration_error * p.kept[j] if j > 0 else start.rise
        allowed[RISE, j] = p.jerk * p.steps[j] - change
        allowed[FALL, j] = p.jerk * p.steps[j] + change
        place = nodes.position[j] + errors.position[j]
        limit = lowest_limit(p.limits, place + p.front, place + p.rear) + p.overspeed
        allowed[SPEED, j] = min(limit - speed, 1e3)
        allowed[AHEAD, j] = min(limits.position_error - errors.position[j], FAR)
        allowed[BEHIND, j] = min(limits.position_error + errors.position[j], FAR)


@compiled
def approach(
    p: PlanConstants, start: PlanStart, errors: Array, reference: PlanReference, room: Array, response: Array
) -> Any:
    """Return the decision that approaches a speed limit up to the node ``near``.

    With the distance m from the limit and its rate m' at the time of effect, the distance is at least (m + (m' + pole
    m) t) e^(-pole t), without a lag m e^(-pole t). The decision held up to the node at 1/pole has this speed there. At
    the nodes before it a limit of the speed is a deadbeat control, which chatters. The motion on the reference is
    always permitted, below the limit. ``errors`` are those of the speed of the free motion, ``room`` is that beside it
    [m/s], and ``response`` the speed at the node for unit decisions.
    """
    speeds, near, time, gained = reference.nodes.velocity, p.near, p.nodes[p.near], start.motion.acceleration_error
    speed, change = reference.velocity + errors[0], reference.acceleration + gained
    now, then = room[0] + speeds[0] + errors[0], room[near] + speeds[near] + errors[near]
    margin = max(min(now, then) - speed, min(now - speed, 0.0))
    left = libm_exp(-p.pole * time)
    rest, kept = margin, errors[0]
    if p.lag > 0.0:
        rest += (p.pole * margin - change) * time
        kept += (p.pole * errors[0] + gained) * time
    top = then - speeds[near]
    permitted = max(top - rest * left, min(top, kept * left)) - errors[near]
    moved = 0.0
    for each in response:
        moved += each
    return permitted / moved


@compiled
def decide(side: HorizonModel, errors: NodeMotion, allowed: Array, active: NDArray[np.bool_], z: Array) -> Any:
    """Compute the decision with the smallest cost under A z <= b; return the exchanges, -1 without a solution.

    ``errors`` are those of the free motion, ``allowed`` is b, shape (rows,). ``active`` has the active rows of the last
    solution and of this one. ``z`` is the result [m/s²], not changed without a solution.
    """
    n, m = z.size, allowed.size
    force, free = np.zeros(n), np.zeros(n)
    for k in range(n):
        for j in range(n):
            force[j] -= side.gradient_position[j, k] * errors.position[k] + (
                side.gradient_velocity[j, k] * errors.velocity[k]
            )
    add_product(free, side.inverse, force)
    slack = allowed.copy()
    add_product(slack, side.constraints, -free)
    found = np.zeros(m)
    exchanges = 0
    if slack.min() < 0.0:
        exchanges = multipliers(side.dual, slack, active, found)
        if exchanges < 0:
            return exchanges
    else:
        active[:] = False
    z[:] = free
    for i in range(m):
        if found[i] != 0.0:
            for j in range(n):
                z[j] -= side.limited[j, i] * found[i]
    return exchanges


@compiled
def write_plan(
    reference: NodeMotion, errors: NodeMotion, side: HorizonModel, decision: Array, room: Array, mass: float,
    found: PlannedNodes,
) -> None:  # fmt: skip
    """Compute planned position, speed and excess over the permitted speed; complete the force."""
    position, velocity = np.zeros(decision.size), np.zeros(decision.size)
    add_product(position, side.response_position, decision)
    add_product(velocity, side.response_velocity, decision)
    for j in range(decision.size):
        found.position[j] = reference.position[j] + errors.position[j] + position[j]
        found.velocity[j] = reference.velocity[j] + errors.velocity[j] + velocity[j]
        found.excess[j] = max(velocity[j] - room[j], 0.0)
        found.force[j] += mass * (decision[j] - found.disturbance[j])


@compiled
def go_on(plan: Array, nodes: Array, period: float) -> None:
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
    side: HorizonModel, p: PlanConstants, start: PlanStart, limits: ForceAhead, reference: PlanReference,
    allowed: Array, active: NDArray[np.bool_], plan: Array, found: PlannedNodes,
) -> Any:  # fmt: skip
    """Compute limits, decision and plan of a period.

    Return the number of exchanges, -1 without a solution, and True for an active row, and for one of the brake force.
    Without a solution the last plan goes on.

    Parameters
    ----------
    side, p, start, limits, reference
        Model of the horizon, constants, start, limits and reference; the node at the time of effect is set in it.
    allowed : Array, shape (8, nodes)
        Receives the right-hand side b of all rows.
    active, plan
        ``active``, shape (8 nodes,), and ``z`` of :func:`decide`.
    found
        Receives the plan.
    """
    nodes, errors, n = reference.nodes, free_errors(start.motion, p.nodes, p.lag), p.nodes.size
    found.force[:] = node_values(reference.required, p.nodes, p.parts)
    found.force[0] = start.feedforward
    for j in range(n):
        found.disturbance[j] = start.disturbance - start.passing * p.passed[j]
    bounds(p, start, errors, limits, reference, side.response_velocity, plan, found, allowed)
    if start.departs:
        allowed[RISE, 0] = max(allowed[RISE, 0], 0.0)
    for j in range(n):
        rests = nodes.velocity[j] == 0.0 and p.nodes[j] >= p.stop_time
        allowed[STOP, j] = min(p.stop_room - errors.position[j], FAR) if rests else FAR
    room = allowed[SPEED]
    held = approach(p, start, errors.velocity, reference, room, side.response_velocity[p.near])
    room[: p.near] = 1e3
    allowed[MOST_FORCE, 0] = min(allowed[MOST_FORCE, 0], max(held, -allowed[LEAST_FORCE, 0], -allowed[FALL, 0]))
    exchanges = decide(side, errors, allowed.reshape(CONSTRAINTS * n), active, plan)
    nodes.position[0], nodes.velocity[0] = reference.position, reference.velocity
    if exchanges < 0:
        active[:] = False
        go_on(plan, p.nodes, p.period)
    write_plan(nodes, errors, side, plan, room, start.inertia, found)
    return exchanges, active.any(), active[LEAST_FORCE * n : (LEAST_FORCE + 1) * n].any()


@cache
def direct_plan_step() -> Any:
    """Return :func:`plan_step` for these types, at which it does not look in a call; the look takes 30 us."""
    row, matrix = types.float64[::1], types.float64[::1, :]
    kinds = {float: types.float64, int: types.int64, bool: types.boolean, Array: row}
    kinds[Records[SpeedLimit]] = typeof(records_of(SpeedLimit, []))

    def kind(of: Any) -> Any:
        return kinds.get(of) or types.NamedTuple([kind(each) for each in get_type_hints(of).values()], of)

    horizon = types.NamedTuple([matrix] * len(HorizonModel._fields), HorizonModel)
    given = map(kind, (PlanConstants, PlanStart, ForceAhead, PlanReference))
    return direct_call(plan_step, horizon, *given, types.float64[:, ::1], types.boolean[::1], row, kind(PlannedNodes))
