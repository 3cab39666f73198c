"""Compiled integration of the multi-mass train over one tick, in many small steps.

Scheme: symplectic Euler (speed first, position with the new speed). Dry friction is implicit: the speed is advanced
without it, then its impulse brings the speed towards 0 and never beyond, so a train at rest does not creep or roll
back. Powers are taken at the mean of the old and the new speed, so the energy balance closes to rounding.

The equations of the train's motion and all row names are in this file; the laws of the railway are in `railway.py`.
Arrays are two-dimensional with one quantity per row, because every argument of a compiled function costs time.
"""

# mypy: allow-untyped-defs

from math import copysign

from numpy import uint64

from plant_sim.compiled import compiled
from plant_sim.railway import adhesion_by_speed, envelope_force, shoe_force

# Rows of `vehicle` (constants), one column per vehicle.
# PIPE_DISTANCE, PARTED_DISTANCE: way of a brake-pipe wave from the power units, and from parted couplers.
INVERSE_MASS, MASS, WEIGHT, C0, C1, C2, SHOE, HOLD_CAPACITY, GAP, PIPE_DISTANCE, PARTED_DISTANCE, RAIL = range(12)
VEHICLE_ROWS = 12
# Rows of `state`; column i is vehicle i, one column more than vehicles.
# COUPLER: force of the coupler behind vehicle i in column i + 1.
# DRIVE_FORCE: traction and outside force. BRAKE_CAPACITY: electric brake force, a dry friction capacity.
# FRICTION_SHARE: part of the friction capacity that acts in this step, with its sign, of a braking power unit.
# SPEED_BEFORE: speed before this step, of power units and vehicles with an outside force.
# SPEED_AFTER, VISCOUS, GRADE_FORCE: speed after this step, viscous resistance and grade force of a train that runs on.
(
    X, V, DRIFT, XDOT, COUPLER, DRIVE_FORCE, BRAKE_CAPACITY, GRADE_A, GRADE_B, CURVE, PIECE_BEGIN, PIECE_END,
    CYLINDER, TARGET, RESERVOIR, SUPPLY, SHOE_FORCE, FRICTION_SHARE, SPEED_BEFORE,
    WORK_RUNNING, WORK_GRADE, WORK_CURVE, WORK_COUPLER, WORK_AIR, WORK_HOLD, WORK_OUTSIDE,
    SPEED_AFTER, VISCOUS, GRADE_FORCE,
) = range(29)  # fmt: skip
STATE_ROWS = 29
# Rows of `vehicle_index` (integers). ORDER, PARTED_ORDER: vehicles by rising distance of each of the two.
PIECE, NEWEST, ORDER, PARTED_ORDER = range(4)
VEHICLE_INDEX_ROWS = 4
# Rows of `gear`; column i is the coupler behind vehicle i.
# HYSTERESIS_FORCE, HYSTERESIS_DEFLECTION: force between the branches and deflection at the last step.
# TRANSITION_DAMPING: damping between the branches. DRAFT, BUFF: extremes of the force.
# TABLE, STROKE: of a tabulated gear in draft; BUFF_TABLE, BUFF_STROKE: in buff.
(
    HALF_SLACK, STIFFNESS, DAMPING, F0, X0, A1, A2, RATIO, STROKE, STOP, INVERSE_VE, TABLE,
    HYSTERESIS_FORCE, HYSTERESIS_DEFLECTION, DRAFT, BUFF, TRANSITION_DAMPING, BUFF_STROKE, BUFF_TABLE,
) = range(19)  # fmt: skip
GEAR_ROWS = 19
# Kinds of draft gear; `run` lists (first, end, kind, equal) of consecutive ones of a kind. EQUAL: 1 if their constants
# are equal.
LINEAR, CLIP, SMOOTHED, TABULATED, RIGID = range(5)
FIRST, RUN_END, KIND, EQUAL = range(4)
# Rows of `unit` and of `unit_index`. LAG_DECAY: part of a deviation that the lag leaves after one step.
(
    GAIN, DEAD_BAND, RATE_STEP, LAG_DECAY, FORCE_LIMIT, ADHESION_WEIGHT, ADHESION, ADHESION_BY_SPEED,
    RATED, LAGGED, APPLIED, SATURATED_TIME, WORK_TRACTION, WORK_REGENERATED,
) = range(14)  # fmt: skip
UNIT_ROWS = 14
UNIT_VEHICLE, TRACTION_FIRST, TRACTION_END, BRAKE_FIRST, BRAKE_END, ELECTRIC_FIRST, ELECTRIC_END = range(7)
UNIT_INDEX_ROWS = 7
# Columns of `envelope` (one row per segment) and rows of `piece` (one column per piece of line).
SEGMENT_END, SEGMENT_FORCE, SEGMENT_SLOPE, SEGMENT_POWER = range(4)
BEGIN, END, GRADE, GRADE_SLOPE, DRY_PER_WEIGHT = range(5)
# Rows of `event`: brake-pipe events that have not reached every vehicle. ORIGIN: 0 power units, 1 parted couplers.
ISSUED, WAVE, LEVEL, REACHED, NUMBER, ORIGIN = range(6)
EVENT_ROWS = 6
# Entries of `setting`. APPLY_DECAY, RELEASE_DECAY: part of a deviation that the cylinders keep after one step.
(
    REVERSING, HOLD_SPEED, APPLY_DECAY, RELEASE_DECAY, RESERVOIR_USE, RECHARGE, FULL_LEVEL,
    SATURATED_TIME_ANY, HAS_DRIFT, ADHESION_LIMITED, RAIL_BY_SPEED,
) = range(11)  # fmt: skip
SETTINGS = 11

IDLE_CYLINDER = 1e-6  # braking factor below which a releasing cylinder counts as empty
FULL_RESERVOIR = 1.0 - 1e-9  # filling above which a reservoir counts as full
ONE = uint64(1)  # an index without a sign has no test for negative values, with which a loop is not vectorised


@compiled(into_caller=True, allocates=False)
def _set_force(i, force, state, gear):
    """Set the force of the coupler behind vehicle i and update its extremes."""
    state[COUPLER, i + ONE] = force
    gear[DRAFT, i] = max(gear[DRAFT, i] + 0.0, force)
    gear[BUFF, i] = min(gear[BUFF, i] + 0.0, force)


@compiled(into_caller=True, allocates=False)
def _linear(a, b, x, v, state, vehicle, gear):
    """Spring and damper beyond the slack (papers 002 and 004).

    Usable step: 10 ms for 20-98 MN/m between wagons of 100 t (largest force within 0.1 % of that at 0.25 ms). With
    slack and little damping the rattling of single couplers depends on the step; the largest force does not.
    """
    for i in range(uint64(a), uint64(b)):
        deflection = x[i] - x[i + ONE] - vehicle[GAP, i]
        side = copysign(1.0, deflection)
        half_slack = gear[HALF_SLACK, i]
        d = max(side * deflection - half_slack, 0.0)
        contact = 1.0 if d > 0.0 or half_slack == 0.0 else 0.0
        force = side * gear[STIFFNESS, i] * d + gear[DAMPING, i] * contact * (v[i] - v[i + ONE])
        _set_force(i, force, state, gear)


@compiled(into_caller=True, allocates=False)
def _clip_force(i, constants, x, v, state, vehicle, gear):
    """Compute the force of the coupler behind vehicle i from the constants of its draft gear."""
    half_slack, stiffness, damping, f0, x0, a1, a2, ratio, stroke, stop, transition_damping = constants
    deflection = x[i] - x[i + ONE] - vehicle[GAP, i]
    side = copysign(1.0, deflection)
    beyond = max(side * deflection - half_slack, 0.0)
    d = min(beyond, stroke)
    q = d / (d + x0)
    loading = f0 * q + d * (a1 + a2 * d)
    unloading = ratio * loading
    h = max(side * gear[HYSTERESIS_FORCE, i], 0.0)
    h += stiffness * (d - max(side * gear[HYSTERESIS_DEFLECTION, i], 0.0))
    h = min(max(h, unloading), loading)
    gear[HYSTERESIS_FORCE, i] = side * h
    gear[HYSTERESIS_DEFLECTION, i] = side * d
    rate = v[i] - v[i + ONE]
    h = min(max(h + side * transition_damping * rate, unloading), loading)
    _set_force(i, side * (h + stop * (beyond - d)) + damping * q * rate, state, gear)


@compiled(into_caller=True, allocates=False)
def _clip_constants(i, gear):
    """Return the constants of the draft gear behind vehicle i."""
    return (
        gear[HALF_SLACK, i], gear[STIFFNESS, i], gear[DAMPING, i], gear[F0, i], gear[X0, i], gear[A1, i], gear[A2, i],
        gear[RATIO, i], gear[STROKE, i], gear[STOP, i], gear[TRANSITION_DAMPING, i],
    )  # fmt: skip


@compiled(into_caller=True, allocates=False)
def _clip(a, b, equal, x, v, state, vehicle, gear):
    """Spring of stiffness k between the unloading and the loading branch: paper 000, eqs. (7)-(9).

    Beyond the stroke an elastic stop adds its force, and the force of the branches keeps its value. Between the
    branches the law of the paper is a spring without loss, and a longitudinal wave lasts for minutes; the transition
    damping acts only there (0 in the paper) and does not change the branches.
    Usable step: 10 ms (largest force of 106 vehicles within 0.1 % of that at 0.25 ms, any coupler within 1 kN).
    Constants of equal gears are read once: 4 of 15 rows of the loop are left.
    """
    if equal:
        constants = _clip_constants(uint64(a), gear)
        for i in range(uint64(a), uint64(b)):
            _clip_force(i, constants, x, v, state, vehicle, gear)
    else:
        for i in range(uint64(a), uint64(b)):
            _clip_force(i, _clip_constants(i, gear), x, v, state, vehicle, gear)


@compiled(into_caller=True, allocates=False)
def _smoothed(a, b, x, v, state, vehicle, gear):
    """Branches joined over the switching speed: paper 000, eq. (6) without its factor sgn(dv).

    Inside the switching speed ve the gear is a damper of (1 - r) fl / (2 ve), which limits the step. Usable step: 5 ms
    with ve = 0.02 m/s, behind the locomotive up to 1.7 MN, on every coupler up to 0.5 MN; at 10 ms the latter
    chatters and gives 1.6 times the true force.
    """
    for i in range(uint64(a), uint64(b)):
        deflection = x[i] - x[i + ONE] - vehicle[GAP, i]
        rate = v[i] - v[i + ONE]
        side = copysign(1.0, deflection)
        beyond = max(side * deflection - gear[HALF_SLACK, i], 0.0)
        d = min(beyond, gear[STROKE, i])
        q = d / (d + gear[X0, i])
        loading = gear[F0, i] * q + d * (gear[A1, i] + gear[A2, i] * d)
        switch = min(max(side * rate * gear[INVERSE_VE, i], -1.0), 1.0)
        ratio = gear[RATIO, i]
        h = 0.5 * loading * (1.0 + ratio + (1.0 - ratio) * switch)
        force = side * (h + gear[STOP, i] * (beyond - d)) + gear[DAMPING, i] * q * rate
        _set_force(i, force, state, gear)


@compiled(into_caller=True, allocates=False)
def _tabulated(a, b, x, v, state, vehicle, gear, table):
    """Spring between tabulated loading and unloading curves of draft or buff, as in :func:`_clip`; its usable step."""
    for i in range(uint64(a), uint64(b)):
        deflection = x[i] - x[i + ONE] - vehicle[GAP, i]
        side = copysign(1.0, deflection)
        half_slack, which, stroke = gear[HALF_SLACK, i], int(gear[TABLE, i]), gear[STROKE, i]
        if side < 0.0:
            which, stroke = int(gear[BUFF_TABLE, i]), gear[BUFF_STROKE, i]
        beyond = max(side * deflection - half_slack, 0.0)
        d = min(beyond, stroke)
        j = 1
        while d > table[which, 0, j]:
            j += 1
        share = (d - table[which, 0, j - 1]) / (table[which, 0, j] - table[which, 0, j - 1])
        loading = table[which, 1, j - 1] + share * (table[which, 1, j] - table[which, 1, j - 1])
        unloading = table[which, 2, j - 1] + share * (table[which, 2, j] - table[which, 2, j - 1])
        h = max(side * gear[HYSTERESIS_FORCE, i], 0.0)
        h += gear[STIFFNESS, i] * (d - max(side * gear[HYSTERESIS_DEFLECTION, i], 0.0))
        h = min(max(h, unloading), loading)
        if beyond == 0.0 and half_slack > 0.0:
            h = 0.0
        gear[HYSTERESIS_FORCE, i] = side * h
        gear[HYSTERESIS_DEFLECTION, i] = side * d
        rate = v[i] - v[i + ONE]
        contact = 1.0 if beyond > 0.0 or half_slack == 0.0 else 0.0
        h = min(max(h + side * gear[TRANSITION_DAMPING, i] * rate, unloading), loading) * contact
        force = side * (h + gear[STOP, i] * (beyond - d)) + gear[DAMPING, i] * contact * rate
        _set_force(i, force, state, gear)


@compiled(into_caller=True, allocates=False)
def _longest_run(run):
    """Return number, first and end of the longest run of equal draft gears of the kind clip; (-1, 0, 0) without one."""
    longest, first, end = -1, 0, 0
    for r in range(run.shape[0]):
        a, b = run[r, FIRST], run[r, RUN_END]
        if run[r, KIND] == CLIP and run[r, EQUAL] > 0 and b - a > end - first:
            longest, first, end = r, a, b
    return longest, first, end


@compiled(into_caller=True, allocates=False)
def coupler_forces(x, v, state, vehicle, gear, table, run, longest):
    """Compute the force of every coupler; those of rigid couplers follow in :func:`_bodies`.

    ``longest`` has the values of :func:`_longest_run`. The bounds of its loop are constant in all steps, so that the
    compiler tests once per tick, not once per step, that the rows of the arrays do not overlap.
    """
    skipped, first, end = longest
    _clip(first, end, True, x, v, state, vehicle, gear)
    for r in range(run.shape[0]):
        a, b, kind = run[r, FIRST], run[r, RUN_END], run[r, KIND]
        if r == skipped:
            continue
        if kind == CLIP:
            _clip(a, b, run[r, EQUAL] > 0, x, v, state, vehicle, gear)
        elif kind == LINEAR:
            _linear(a, b, x, v, state, vehicle, gear)
        elif kind == SMOOTHED:
            _smoothed(a, b, x, v, state, vehicle, gear)
        elif kind == TABULATED:
            _tabulated(a, b, x, v, state, vehicle, gear, table)
        else:
            for i in range(a, b):
                state[COUPLER, i + 1] = 0.0


@compiled(into_caller=True, allocates=False)
def _limits(u, speed, unit, unit_index, envelope, reversing):
    """Return the lowest and highest force of unit u at a speed: envelope, force limit, adhesion."""
    size = abs(speed)
    high = envelope_force(envelope, unit_index[TRACTION_FIRST, u], unit_index[TRACTION_END, u], size)
    low = envelope_force(envelope, unit_index[BRAKE_FIRST, u], unit_index[BRAKE_END, u], size)
    if reversing and speed < 0.0:
        high, low = low, high
    elif reversing and speed == 0.0:
        low = high
    cap = unit[FORCE_LIMIT, u]
    factor = adhesion_by_speed(size) if unit[ADHESION_BY_SPEED, u] > 0.0 else 1.0
    cap = min(cap, unit[ADHESION, u] * unit[ADHESION_WEIGHT, u] * factor)
    return -min(low, cap), min(high, cap)


@compiled(into_caller=True, allocates=False)
def _units(demand, dt, state, unit, unit_index, envelope, setting):
    """Convert the commands that are due into forces: gain, dead band, limits, rate, lag, limits.

    A driving force is added to DRIVE_FORCE; a braking force is added to BRAKE_CAPACITY, a friction capacity, and so
    never reverses the motion. With `reversing` a negative force drives backwards, and all of it is DRIVE_FORCE.
    """
    reversing = setting[REVERSING] > 0.0
    saturated = False
    for u in range(unit.shape[1]):
        i = unit_index[UNIT_VEHICLE, u]
        low, high = _limits(u, state[V, i], unit, unit_index, envelope, reversing)
        wanted = demand[u] * unit[GAIN, u]
        if abs(wanted) < unit[DEAD_BAND, u]:
            wanted = 0.0
        if (wanted > high or wanted < low) and abs(state[V, i]) >= setting[HOLD_SPEED]:
            unit[SATURATED_TIME, u] += dt
            saturated = True
        wanted = min(max(wanted, low), high)
        step = unit[RATE_STEP, u]
        rated = min(max(wanted, unit[RATED, u] - step), unit[RATED, u] + step)
        unit[RATED, u] = rated
        lagged = rated + unit[LAG_DECAY, u] * (unit[LAGGED, u] - rated)
        lagged = min(max(lagged, low), high)
        unit[LAGGED, u] = lagged
        if lagged >= 0.0 or reversing:
            state[DRIVE_FORCE, i] += lagged
        else:
            state[BRAKE_CAPACITY, i] -= lagged
    if saturated:
        setting[SATURATED_TIME_ANY] += dt


@compiled(into_caller=True, allocates=False)
def _units_before(dt, holding_on, rigid, state, vehicle, unit, unit_index):
    """Keep the speed of every power unit before the step, and compute the friction share of one that brakes.

    The share of rigid bodies follows in :func:`_bodies`.
    """
    for u in range(unit.shape[1]):
        i = uint64(unit_index[UNIT_VEHICLE, u])
        state[SPEED_BEFORE, i] = state[V, i]
        if unit[LAGGED, u] < 0.0 and not rigid:
            hold = holding_on * vehicle[HOLD_CAPACITY, i]
            dry = _capacity(i, state, vehicle) + state[SHOE_FORCE, i] + hold
            free, stop, _, _, _ = _free_and_stop(i, dt, dry, state, vehicle)
            state[FRICTION_SHARE, i] = _friction_share(free, stop)


@compiled(into_caller=True, allocates=False)
def _units_account(dt, state, unit, unit_index, envelope, reversing):
    """Compute the applied force and its work from the friction share of this step.

    Of a brake with an electric part, the work beyond that part is lost as that of the shoes.
    """
    for u in range(unit.shape[1]):
        i = unit_index[UNIT_VEHICLE, u]
        force = unit[LAGGED, u]
        if force < 0.0 and not reversing:
            force = -force * state[FRICTION_SHARE, i]
        unit[APPLIED, u] = force
        work = force * (0.5 * dt * (state[SPEED_BEFORE, i] + state[V, i]))
        if work >= 0.0:
            unit[WORK_TRACTION, u] += work
        else:
            first, end = unit_index[ELECTRIC_FIRST, u], unit_index[ELECTRIC_END, u]
            if end > first:
                electric = envelope_force(envelope, first, end, abs(state[V, i]))
                if -force > electric:
                    state[WORK_AIR, i] += work * (1.0 + electric / force)
                    work *= -electric / force
            unit[WORK_REGENERATED, u] -= work


@compiled(into_caller=True, allocates=False)
def _no_demand(demand, reversing):
    """Return True if no command that is due drives the train."""
    driving = 0
    for u in range(len(demand)):
        driving += demand[u] > 0.0 or (reversing and demand[u] < 0.0)
    return driving == 0


@compiled(into_caller=True, allocates=False)
def _standing(state, vehicle, limit):
    """Return True if the mean speed of the train, weighted by mass, is below the limit.

    If all vehicles are faster than twice the limit in one direction, the mean is above it, with any rounding, without
    the sum, which the compiler cannot vectorise.
    """
    n = vehicle.shape[1]
    forward, backward = 0, 0
    for i in range(uint64(n)):
        forward += state[V, i] > 2.0 * limit
        backward += state[V, i] < -2.0 * limit
    if forward == n or backward == n:
        return False
    momentum, total = 0.0, 0.0
    for i in range(n):
        momentum += vehicle[MASS, i] * state[V, i]
        total += vehicle[MASS, i]
    return abs(momentum) < limit * total


@compiled(into_caller=True, allocates=False)
def _waves(t, events, event, state, vehicle, vehicle_index, setting):
    """Move the brake-pipe waves; the newest event that has reached a vehicle sets its level (paper 000, section 1.2).

    A reservoir that was not full at the start of the application reduces every level in that proportion. A rise of the
    level takes air from the reservoir, at most its content; a lower level only empties the cylinder.
    """
    n = vehicle_index.shape[1]
    for e in range(events):
        reached, origin = int(event[REACHED, e]), int(event[ORIGIN, e])
        while reached < n:
            i = vehicle_index[ORDER + origin, reached]
            if t < event[ISSUED, e] + vehicle[PIPE_DISTANCE + origin, i] / event[WAVE, e]:
                break
            number = int(event[NUMBER, e])
            if number > vehicle_index[NEWEST, i]:
                vehicle_index[NEWEST, i] = number
                if state[TARGET, i] == 0.0:
                    state[SUPPLY, i] = state[RESERVOIR, i]
                wanted = event[LEVEL, e] * state[SUPPLY, i]
                rise = wanted - state[TARGET, i]
                use = setting[RESERVOIR_USE] / setting[FULL_LEVEL]
                if rise > 0.0 and use > 0.0:
                    rise = min(rise, state[RESERVOIR, i] / use)
                    wanted = state[TARGET, i] + rise
                    state[RESERVOIR, i] = max(state[RESERVOIR, i] - use * rise, 0.0)
                state[TARGET, i] = wanted
            reached += 1
        event[REACHED, e] = reached


@compiled(into_caller=True, allocates=False)
def _brake_moves(state, n):
    """Return True if any vehicle brakes or recharges."""
    active = 0
    for i in range(uint64(n)):
        active += (state[TARGET, i] > 0.0) | (state[CYLINDER, i] > 0.0) | (state[RESERVOIR, i] < FULL_RESERVOIR)
    return active > 0


@compiled(into_caller=True, allocates=False)
def _cylinders(state, vehicle, setting):
    """Move cylinders and reservoirs, compute the shoe forces; return True if any vehicle brakes or recharges."""
    apply, release, recharge = setting[APPLY_DECAY], setting[RELEASE_DECAY], setting[RECHARGE]
    active = 0
    for i in range(uint64(vehicle.shape[1])):
        goal, level, filling = state[TARGET, i], state[CYLINDER, i], state[RESERVOIR, i]
        moved = goal + (apply if goal > level else release) * (level - goal)
        moved = 0.0 if (goal == 0.0) & (moved < IDLE_CYLINDER) else moved
        filling += recharge * (1.0 - filling) if goal == 0.0 else 0.0
        state[CYLINDER, i], state[RESERVOIR, i] = moved, filling
        active += (moved > 0.0) | (goal > 0.0) | (filling < FULL_RESERVOIR)
        state[SHOE_FORCE, i] = shoe_force(vehicle[SHOE, i] * moved, state[V, i])
    return active > 0


@compiled(into_caller=True, allocates=False)
def _slide_protection(state, vehicle, by_speed):
    """Limit the shoe forces to the adhesion that the electric brake of the same vehicle leaves."""
    for i in range(uint64(vehicle.shape[1])):
        factor = adhesion_by_speed(abs(state[V, i])) if by_speed else 1.0
        most = vehicle[RAIL, i] * vehicle[WEIGHT, i] * factor - state[BRAKE_CAPACITY, i]
        state[SHOE_FORCE, i] = min(state[SHOE_FORCE, i] + 0.0, max(most, 0.0))


@compiled(into_caller=True, allocates=False)
def _outside_of(i, j, k, state, outside):
    """Add the outside force F + G v of column j to vehicle i and set its drift speed."""
    state[SPEED_BEFORE, i] = state[V, i]
    state[DRIVE_FORCE, i] += outside[0, k, j] + outside[1, k, j] * state[V, i]
    state[DRIFT, i] = outside[2, k, j]


@compiled(into_caller=True, allocates=False)
def _outside(k, n, state, outside, outside_vehicle):
    """Add the outside forces and set the drift speeds of the listed vehicles.

    A list of all vehicles is in order, and its loop has no pointers.
    """
    if len(outside_vehicle) == n:
        for i in range(uint64(len(outside_vehicle))):
            _outside_of(i, i, k, state, outside)
    else:
        for j in range(len(outside_vehicle)):
            _outside_of(uint64(outside_vehicle[j]), uint64(j), k, state, outside)


@compiled(into_caller=True, allocates=False)
def _outside_work(i, j, k, dt, state, outside):
    """Add up the work of the outside force of column j on vehicle i at the mean speed."""
    before = state[SPEED_BEFORE, i]
    moved = 0.5 * dt * (before + state[V, i])
    state[WORK_OUTSIDE, i] += (outside[0, k, j] + outside[1, k, j] * before) * moved


@compiled(into_caller=True, allocates=False)
def _outside_account(k, n, dt, state, outside, outside_vehicle):
    """Add up the work of the outside forces."""
    if len(outside_vehicle) == n:
        for i in range(uint64(len(outside_vehicle))):
            _outside_work(i, i, k, dt, state, outside)
    else:
        for j in range(len(outside_vehicle)):
            _outside_work(uint64(outside_vehicle[j]), uint64(j), k, dt, state, outside)


@compiled(into_caller=True, allocates=False)
def _capacity(i, state, vehicle):
    """Return the dry friction of vehicle i without shoes and holding brake: bearings, curve, electric brake [N]."""
    return vehicle[C0, i] + state[CURVE, i] + state[BRAKE_CAPACITY, i]


@compiled(into_caller=True, allocates=False)
def _free_and_stop(i, dt, dry, state, vehicle):
    """Return the speed of vehicle i without dry friction, and the speed that dry friction takes at most [m/s].

    ``dry`` is the friction capacity [N]. Viscous resistance, grade and coupler force [N] follow.
    """
    before = state[V, i]
    viscous = -before * (vehicle[C1, i] + vehicle[C2, i] * abs(before))
    grade = state[GRADE_A, i] + state[GRADE_B, i] * state[X, i]
    couplers = state[COUPLER, i] - state[COUPLER, i + ONE]
    step = dt * vehicle[INVERSE_MASS, i]
    free = before + step * (couplers + grade + viscous + state[DRIVE_FORCE, i])
    return free, step * dry, viscous, grade, couplers


@compiled(into_caller=True, allocates=False)
def _friction_share(free, stop):
    """Return the part of the friction capacity that acts in this step, with its sign."""
    size = abs(free)
    return -copysign(1.0 if size >= stop else size / stop, free)


@compiled(into_caller=True, allocates=False)
def _speed(i, dt, dry, state, vehicle):
    """Compute the new speed of vehicle i, dry friction implicit, and add up the works.

    ``dry`` is the friction capacity [N]. Return the share of it that acts, with its sign, and the displacement [m].
    """
    free, stop, viscous, grade, couplers = _free_and_stop(i, dt, dry, state, vehicle)
    after = copysign(max(abs(free) - stop, 0.0), free)
    sliding = _friction_share(free, stop)
    moved = 0.5 * dt * (state[V, i] + after)
    slid = sliding * moved
    state[WORK_RUNNING, i] += viscous * moved + vehicle[C0, i] * slid
    state[WORK_GRADE, i] += grade * moved
    state[WORK_CURVE, i] += state[CURVE, i] * slid
    state[WORK_COUPLER, i] += couplers * moved
    state[V, i] = after
    return sliding, moved


@compiled(into_caller=True, allocates=False)
def _position(i, dt, rate, state):
    """Advance the position of vehicle i at a rate [m/s]; return True if it left its piece of line."""
    x = state[X, i] + dt * rate
    state[X, i] = x
    return (x < state[PIECE_BEGIN, i]) | (x >= state[PIECE_END, i])


@compiled(into_caller=True, allocates=False)
def _runs_on(i, dt, dry, state, vehicle):
    """Compute the speed after this step for a vehicle that runs forward; return True if it runs forward.

    ``dry`` is the friction capacity [N]. For speeds > 0 without and with dry friction, all of its capacity acts, with
    the sign -1, and the speed is that of :func:`_speed`. The state before the step is kept.
    """
    free, stop, viscous, grade, _ = _free_and_stop(i, dt, dry, state, vehicle)
    after = free - stop
    state[SPEED_AFTER, i], state[VISCOUS, i], state[GRADE_FORCE, i] = after, viscous, grade
    return (free > 0.0) & (after > 0.0)


@compiled(into_caller=True, allocates=False)
def _run_on(i, dt, state, vehicle):
    """Add up the works of vehicle i after :func:`_runs_on`, and set its speed; return its displacement [m]."""
    after = state[SPEED_AFTER, i]
    moved = 0.5 * dt * (state[V, i] + after)
    couplers = state[COUPLER, i] - state[COUPLER, i + ONE]
    state[WORK_RUNNING, i] += state[VISCOUS, i] * moved - vehicle[C0, i] * moved
    state[WORK_GRADE, i] += state[GRADE_FORCE, i] * moved
    state[WORK_CURVE, i] -= state[CURVE, i] * moved
    state[WORK_COUPLER, i] += couplers * moved
    state[V, i] = after
    return moved


@compiled(into_caller=True, allocates=False)
def _speeds(dt, state, vehicle):
    """Compute speeds, works and positions of a train without shoe forces, holding brake and drift.

    Return the number of vehicles that left their piece of line. If all vehicles run forward, two loops with short
    chains of dependent operations and without a division replace one with a long chain, with the same bits.
    """
    n, running, left = vehicle.shape[1], 0, 0
    for i in range(uint64(n)):
        running += _runs_on(i, dt, _capacity(i, state, vehicle), state, vehicle)
    if running == n:
        for i in range(uint64(n)):
            _run_on(i, dt, state, vehicle)
            left += _position(i, dt, state[V, i], state)
        return left
    for i in range(uint64(n)):
        _speed(i, dt, _capacity(i, state, vehicle), state, vehicle)
        left += _position(i, dt, state[V, i], state)
    return left


@compiled(into_caller=True, allocates=False)
def _braked_speeds(dt, state, vehicle):
    """Do the same as :func:`_speeds` with shoe forces."""
    n, running, left = vehicle.shape[1], 0, 0
    for i in range(uint64(n)):
        dry = _capacity(i, state, vehicle) + state[SHOE_FORCE, i]
        running += _runs_on(i, dt, dry, state, vehicle)
    if running == n:
        for i in range(uint64(n)):
            state[WORK_AIR, i] -= state[SHOE_FORCE, i] * _run_on(i, dt, state, vehicle)
            left += _position(i, dt, state[V, i], state)
        return left
    for i in range(uint64(n)):
        shoes = state[SHOE_FORCE, i]
        sliding, moved = _speed(i, dt, _capacity(i, state, vehicle) + shoes, state, vehicle)
        state[WORK_AIR, i] += shoes * sliding * moved
        left += _position(i, dt, state[V, i], state)
    return left


@compiled(into_caller=True, allocates=False)
def _held_speeds(dt, holding_on, state, vehicle):
    """Do the same as :func:`_speeds` with shoe forces, holding brake and drift."""
    for i in range(uint64(vehicle.shape[1])):
        shoes, hold = state[SHOE_FORCE, i], holding_on * vehicle[HOLD_CAPACITY, i]
        sliding, moved = _speed(i, dt, _capacity(i, state, vehicle) + shoes + hold, state, vehicle)
        state[WORK_AIR, i] += shoes * sliding * moved
        state[WORK_HOLD, i] += hold * sliding * moved
    return _positions(dt, state, vehicle)


@compiled(into_caller=True, allocates=False)
def _body_sums(a, b, holding_on, state, vehicle):
    """Return mass, force without dry friction, and friction capacity of the rigid body of vehicles a ... b-1."""
    mass, force, dry = 0.0, 0.0, 0.0
    for i in range(a, b):
        v = state[V, i]
        mass += vehicle[MASS, i]
        force += state[GRADE_A, i] + state[GRADE_B, i] * state[X, i] + state[DRIVE_FORCE, i]
        force -= v * (vehicle[C1, i] + vehicle[C2, i] * abs(v))
        dry += (
            vehicle[C0, i]
            + state[CURVE, i]
            + state[BRAKE_CAPACITY, i]
            + state[SHOE_FORCE, i]
            + holding_on * vehicle[HOLD_CAPACITY, i]
        )
    return mass, force + state[COUPLER, a] - state[COUPLER, b], dry


@compiled(into_caller=True, allocates=False)
def _bodies(dt, holding_on, state, vehicle, gear, body):
    """Compute speeds and works of rigid bodies as :func:`_speeds`; coupler forces follow from the balances."""
    for index in range(len(body) - 1):
        a, b = body[index], body[index + 1]
        mass, force, capacity = _body_sums(a, b, holding_on, state, vehicle)
        before = state[V, a]
        free = before + dt * force / mass
        stop = dt * capacity / mass
        size = abs(free)
        after = copysign(max(size - stop, 0.0), free)
        sliding = -copysign(1.0 if size >= stop else size / stop, free)
        moved = 0.5 * dt * (before + after)
        acceleration = (after - before) / dt
        for i in range(a, b):
            viscous = -before * (vehicle[C1, i] + vehicle[C2, i] * abs(before))
            grade = state[GRADE_A, i] + state[GRADE_B, i] * state[X, i]
            holding = holding_on * vehicle[HOLD_CAPACITY, i]
            dry = vehicle[C0, i] + state[CURVE, i] + state[BRAKE_CAPACITY, i] + state[SHOE_FORCE, i] + holding
            own = viscous + grade + state[DRIVE_FORCE, i] + sliding * dry
            if i < b - 1:
                force = state[COUPLER, i] + own - vehicle[MASS, i] * acceleration
                _set_force(i, force, state, gear)
            state[WORK_RUNNING, i] += (viscous + vehicle[C0, i] * sliding) * moved
            state[WORK_GRADE, i] += grade * moved
            state[WORK_CURVE, i] += state[CURVE, i] * sliding * moved
            state[WORK_AIR, i] += state[SHOE_FORCE, i] * sliding * moved
            state[WORK_HOLD, i] += holding * sliding * moved
            state[WORK_COUPLER, i] += (state[COUPLER, i] - state[COUPLER, i + 1]) * moved
            state[FRICTION_SHARE, i] = sliding
            state[V, i] = after


@compiled(into_caller=True, allocates=False)
def _positions(dt, state, vehicle):
    """Advance the positions with new speed and drift; return the number of vehicles that left their piece of line."""
    left = 0
    for i in range(uint64(vehicle.shape[1])):
        left += _position(i, dt, state[V, i] + state[DRIFT, i], state)
    return left


@compiled(into_caller=True, allocates=False)
def _locate(i, state, vehicle, vehicle_index, piece):
    """Find the piece of line of vehicle i and its grade and curve forces."""
    x, p = state[X, i], vehicle_index[PIECE, i]
    while x < piece[BEGIN, p]:
        p -= 1
    while x >= piece[END, p]:
        p += 1
    vehicle_index[PIECE, i] = p
    state[PIECE_BEGIN, i], state[PIECE_END, i] = piece[BEGIN, p], piece[END, p]
    weight = vehicle[WEIGHT, i]
    state[GRADE_A, i] = -weight * (piece[GRADE, p] - piece[GRADE_SLOPE, p] * piece[BEGIN, p])
    state[GRADE_B, i] = -weight * piece[GRADE_SLOPE, p]
    state[CURVE, i] = weight * piece[DRY_PER_WEIGHT, p]


@compiled(allocates=False)
def locate(state, vehicle, vehicle_index, piece):
    """Find the piece of line of every vehicle, starting from the previous one, and its grade and curve forces."""
    for i in range(vehicle.shape[1]):
        _locate(i, state, vehicle, vehicle_index, piece)


@compiled(into_caller=True, allocates=False)
def _relocate(state, vehicle, vehicle_index, piece):
    """Do the same as :func:`locate` for the vehicles that left their piece."""
    for i in range(vehicle.shape[1]):
        if state[X, i] < state[PIECE_BEGIN, i] or state[X, i] >= state[PIECE_END, i]:
            _locate(i, state, vehicle, vehicle_index, piece)


@compiled(allocates=False)
def advance(
    t, dt, state, vehicle, vehicle_index, gear, table, run, body, unit, unit_index, envelope,
    piece, event, events, demand, outside, outside_vehicle, setting,
):  # fmt: skip
    """Integrate ``demand.shape[0]`` steps of ``dt`` from time ``t`` on, in place.

    Parameters
    ----------
    t, dt : float
        Time of the first step and step [s].
    state, vehicle, gear, unit, envelope, piece, event, setting : float64 arrays
        Quantities by row, named above; made by :mod:`plant_sim.packing`.
    vehicle_index, unit_index, run, body, outside_vehicle : int64 arrays
        Pointers, runs of equal draft gears, first vehicles of the rigid bodies, vehicles with outside forces.
    table : float64, shape (tables, 3, m)
        Deflection [m], loading and unloading force [N] of the tabulated curves.
    events : int
        Number of brake-pipe events that have not reached every vehicle.
    demand : float64, shape (steps, units)
        Commands that are due [N].
    outside : float64, shape (3, steps, listed vehicles)
        Force [N], force per speed [N s/m] and drift speed [m/s] of the disturbances.
    """
    n = vehicle.shape[1]
    reversing = setting[REVERSING] > 0.0
    has_drift = setting[HAS_DRIFT] > 0.0
    rigid = len(body) - 1 < n
    x, v, xdot, drift = state[X], state[V], state[XDOT], state[DRIFT]
    rate = xdot if has_drift else v
    longest = _longest_run(run)
    braked = events > 0 or _brake_moves(state, n)
    for k in range(demand.shape[0]):
        if braked:
            _waves(t + k * dt, events, event, state, vehicle, vehicle_index, setting)
            braked = _cylinders(state, vehicle, setting) or events > 0
        for u in range(unit.shape[1]):
            state[DRIVE_FORCE, unit_index[UNIT_VEHICLE, u]] = 0.0
            state[BRAKE_CAPACITY, unit_index[UNIT_VEHICLE, u]] = 0.0
        for j in range(len(outside_vehicle)):
            state[DRIVE_FORCE, outside_vehicle[j]] = 0.0
        _outside(k, n, state, outside, outside_vehicle)
        if has_drift:
            for i in range(n):
                xdot[i] = v[i] + drift[i]
        coupler_forces(x, rate, state, vehicle, gear, table, run, longest)
        _units(demand[k], dt, state, unit, unit_index, envelope, setting)
        if braked and setting[ADHESION_LIMITED] > 0.0:
            _slide_protection(state, vehicle, setting[RAIL_BY_SPEED] > 0.0)
        holding_on = 0.0
        if _no_demand(demand[k], reversing) and _standing(state, vehicle, setting[HOLD_SPEED]):
            holding_on = 1.0
        _units_before(dt, holding_on, rigid, state, vehicle, unit, unit_index)
        if rigid:
            _bodies(dt, holding_on, state, vehicle, gear, body)
            left = _positions(dt, state, vehicle)
        elif has_drift or holding_on > 0.0:
            left = _held_speeds(dt, holding_on, state, vehicle)
        elif braked:
            left = _braked_speeds(dt, state, vehicle)
        else:
            left = _speeds(dt, state, vehicle)
        _units_account(dt, state, unit, unit_index, envelope, reversing)
        _outside_account(k, n, dt, state, outside, outside_vehicle)
        if left > 0:
            _relocate(state, vehicle, vehicle_index, piece)


@compiled(allocates=False)
def advance_ticks(
    stamp, tick_ns, dt, state, vehicle, vehicle_index, gear, table, run, body, unit, unit_index, envelope,
    piece, event, demand, outside, outside_vehicle, setting,
):  # fmt: skip
    """Integrate ``demand.shape[0]`` ticks from a stamp [ns] on, without a brake event; arguments of :func:`advance`.

    ``demand`` has the shape (ticks, steps, units), ``outside`` (ticks, 3, steps, listed vehicles).
    """
    for tick in range(demand.shape[0]):
        advance(
            (stamp + tick * tick_ns) * 1e-9, dt, state, vehicle, vehicle_index, gear, table, run, body, unit,
            unit_index, envelope, piece, event, 0, demand[tick], outside[tick], outside_vehicle, setting,
        )  # fmt: skip
