"""The compiled heart of the plant: one tick of the multi-mass train, many small steps at a time.

Scheme: symplectic Euler (speed first, position with the new speed).  Dry friction is implicit: the speed is advanced
without it, then its impulse may only bring the speed towards 0, so that it never creeps, reverses or rolls back.
Powers are taken at the mean of the old and the new speed, so the energies close to rounding.

All compiled code and all row names stand in this one file: numba's cache notices changes of this file only.
Arrays are two-dimensional, one quantity per row, because every argument of a compiled function costs time.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

from math import copysign

from plant_sim.compiled import compiled

# Rows of `vehicle` (constants), one column per vehicle.
INVERSE_MASS, MASS, WEIGHT, C0, C1, C2, SHOE, HOLD, GAP, PIPE_DISTANCE, RAIL = range(11)
VEHICLE_ROWS = 11
# Rows of `state`; column i is vehicle i, one column more than vehicles.  COUPLER: column i + 1 is behind vehicle i.
(
    X, V, DRIFT, XDOT, COUPLER, PUSH, EXTRA, GRADE_A, GRADE_B, CURVE, PIECE_BEGIN, PIECE_END,
    CYLINDER, TARGET, RESERVOIR, SUPPLY, SHOE_FORCE, SLIDE, MID,
    WORK_RUNNING, WORK_GRADE, WORK_CURVE, WORK_COUPLER, WORK_AIR, WORK_HOLD, WORK_OUTSIDE,
) = range(26)  # fmt: skip
STATE_ROWS = 26
# Rows of `vehicle_index` (integers).
PIECE, NEWEST, ORDER = range(3)
VEHICLE_INDEX_ROWS = 3
# Rows of `gear`; column i is the coupling behind vehicle i.
(
    HALF_SLACK, STIFFNESS, DAMPING, F0, X0, A1, A2, RATIO, STROKE, STOP, INVERSE_VE, TABLE,
    HELD_FORCE, HELD_DEFLECTION, DRAFT, BUFF, LOCKED,
) = range(17)  # fmt: skip
GEAR_ROWS = 17
# Kinds of draft gear; `run` lists (first, end, kind) of consecutive equal ones.
LINEAR, CLIP, SMOOTHED, TABULATED, RIGID = range(5)
# Rows of `unit` and of `unit_index`.
(
    GAIN, DEAD_BAND, RATE_STEP, LAG_KEEP, FORCE_LIMIT, ADHESION_WEIGHT, ADHESION, ADHESION_BY_SPEED,
    RATED, LAGGED, APPLIED, SATURATED, WORK_TRACTION, WORK_REGENERATED,
) = range(14)  # fmt: skip
UNIT_ROWS = 14
UNIT_VEHICLE, TRACTION_FIRST, TRACTION_END, BRAKE_FIRST, BRAKE_END = range(5)
UNIT_INDEX_ROWS = 5
# Columns of `envelope` (one row per segment) and rows of `piece` (one column per piece of line).
SEGMENT_END, SEGMENT_FORCE, SEGMENT_SLOPE, SEGMENT_POWER = range(4)
BEGIN, END, GRADE, GRADE_SLOPE, DRY_PER_WEIGHT = range(5)
# Rows of `event`: brake-pipe events under way.
ISSUED, WAVE, LEVEL, REACHED, NUMBER = range(5)
# Entries of `setting`.
(
    REVERSING, HOLD_SPEED, APPLY_KEEP, RELEASE_KEEP, RESERVOIR_USE, RECHARGE, FULL_LEVEL,
    SATURATED_ANY, HAS_DRIFT, SLIPPERY, RAIL_BY_SPEED,
) = range(11)  # fmt: skip
SETTINGS = 11

SMALLEST_POWER_SPEED = 0.1  # m/s; below it power / v is taken at this speed
IDLE_CYLINDER = 1e-6  # braking factor below which a releasing cylinder counts as empty


@compiled
def _linear(x, v, gap, force, half_slack, stiffness, damping):
    """Spring and damper beyond the slack (papers 002 and 004).

    Usable step: 10 ms for 20-98 MN/m between wagons of 100 t (largest force within 0.1 % of that at 0.25 ms); with
    slack and little damping single couplings rattle differently at every step, the largest force stays.
    """
    for i in range(len(gap)):
        deflection = x[i] - x[i + 1] - gap[i]
        side = copysign(1.0, deflection)
        d = max(side * deflection - half_slack[i], 0.0)
        contact = 1.0 if d > 0.0 or half_slack[i] == 0.0 else 0.0
        force[i] = side * stiffness[i] * d + damping[i] * contact * (v[i] - v[i + 1])


@compiled
def _clip(x, v, gap, force, half_slack, k, c, f0, x0, a1, a2, ratio, stroke, stop, locked, held, held_d):
    """Paper 000, eqs. (7)-(9): the held force moves with stiffness k between the unloading and the loading branch.

    The stop beyond the stroke is elastic and stands beside the held force, which keeps its value there.  Between the
    branches the law is a spring without loss, so that a pull rings on for minutes; a damping that acts there alone
    (none in the paper) ends it without touching the branches.
    Usable step: 10 ms (largest force of 106 vehicles within 0.1 % of that at 0.25 ms, any coupling within 1 kN).
    """
    for i in range(len(gap)):
        deflection = x[i] - x[i + 1] - gap[i]
        side = copysign(1.0, deflection)
        beyond = max(side * deflection - half_slack[i], 0.0)
        d = min(beyond, stroke[i])
        q = d / (d + x0[i])
        loading = f0[i] * q + d * (a1[i] + a2[i] * d)
        h = max(side * held[i], 0.0) + k[i] * (d - max(side * held_d[i], 0.0))
        h = min(max(h, ratio[i] * loading), loading)
        held[i] = side * h
        held_d[i] = side * d
        rate = v[i] - v[i + 1]
        h = min(max(h + side * locked[i] * rate, ratio[i] * loading), loading)
        force[i] = side * (h + stop[i] * (beyond - d)) + c[i] * q * rate


@compiled
def _smoothed(x, v, gap, force, half_slack, c, f0, x0, a1, a2, ratio, stroke, stop, inverse_ve):
    """Paper 000, eq. (6) without its factor sgn(dv): branches joined over the switching speed.

    The stiff one: inside the switching speed ve it is a damper of (1 - r) fl / (2 ve).  Usable step: 5 ms with ve =
    0.02 m/s, behind the locomotive to 1.7 MN, on every coupling to 0.5 MN; at 10 ms the latter chatters and gives 1.6
    times the true force.
    """
    for i in range(len(gap)):
        deflection = x[i] - x[i + 1] - gap[i]
        rate = v[i] - v[i + 1]
        side = copysign(1.0, deflection)
        beyond = max(side * deflection - half_slack[i], 0.0)
        d = min(beyond, stroke[i])
        q = d / (d + x0[i])
        loading = f0[i] * q + d * (a1[i] + a2[i] * d)
        switch = min(max(side * rate * inverse_ve[i], -1.0), 1.0)
        h = 0.5 * loading * (1.0 + ratio[i] + (1.0 - ratio[i]) * switch)
        force[i] = side * (h + stop[i] * (beyond - d)) + c[i] * q * rate


@compiled
def _tabulated(x, v, gap, force, half_slack, k, c, stroke, stop, which, table, locked, held, held_d):
    """Join a user's loading and unloading curves as in :func:`_clip`; usable step as there."""
    for i in range(len(gap)):
        deflection = x[i] - x[i + 1] - gap[i]
        side = copysign(1.0, deflection)
        beyond = max(side * deflection - half_slack[i], 0.0)
        d = min(beyond, stroke[i])
        curve = table[int(which[i])]
        j = 1
        while d > curve[0, j]:
            j += 1
        share = (d - curve[0, j - 1]) / (curve[0, j] - curve[0, j - 1])
        loading = curve[1, j - 1] + share * (curve[1, j] - curve[1, j - 1])
        unloading = curve[2, j - 1] + share * (curve[2, j] - curve[2, j - 1])
        h = max(side * held[i], 0.0) + k[i] * (d - max(side * held_d[i], 0.0))
        h = min(max(h, unloading), loading)
        if beyond == 0.0 and half_slack[i] > 0.0:
            h = 0.0
        held[i] = side * h
        held_d[i] = side * d
        rate = v[i] - v[i + 1]
        contact = 1.0 if beyond > 0.0 or half_slack[i] == 0.0 else 0.0
        h = min(max(h + side * locked[i] * rate, unloading), loading) * contact
        force[i] = side * (h + stop[i] * (beyond - d)) + c[i] * contact * rate


@compiled
def couplers(x, v, state, vehicle, gear, table, run):
    """Force of every coupling but the rigid ones, which :func:`_bodies` recovers from the balance."""
    for r in range(run.shape[0]):
        a, b, kind = run[r, 0], run[r, 1], run[r, 2]
        xs, vs = x[a : b + 1], v[a : b + 1]
        gap = vehicle[GAP, a:b]
        force = state[COUPLER, a + 1 : b + 1]
        slack, c = gear[HALF_SLACK, a:b], gear[DAMPING, a:b]
        k, stroke, stop = gear[STIFFNESS, a:b], gear[STROKE, a:b], gear[STOP, a:b]
        held, held_d = gear[HELD_FORCE, a:b], gear[HELD_DEFLECTION, a:b]
        f0, x0, a1, a2, ratio = gear[F0, a:b], gear[X0, a:b], gear[A1, a:b], gear[A2, a:b], gear[RATIO, a:b]
        if kind == CLIP:
            _clip(xs, vs, gap, force, slack, k, c, f0, x0, a1, a2, ratio, stroke, stop, gear[LOCKED, a:b], held, held_d)
        elif kind == LINEAR:
            _linear(xs, vs, gap, force, slack, k, c)
        elif kind == SMOOTHED:
            _smoothed(xs, vs, gap, force, slack, c, f0, x0, a1, a2, ratio, stroke, stop, gear[INVERSE_VE, a:b])
        elif kind == TABULATED:
            _tabulated(
                xs, vs, gap, force, slack, k, c, stroke, stop, gear[TABLE, a:b], table, gear[LOCKED, a:b], held, held_d
            )
        else:
            force[:] = 0.0


@compiled
def force_along(deflection, rate, state, vehicle, gear, table, run):
    """Force of the first coupling of a two-vehicle train along a path of deflections and rates."""
    force = deflection.copy()
    x, v = state[X], state[V]
    for j in range(len(deflection)):
        x[0] = x[1] + vehicle[GAP, 0] + deflection[j]
        v[0] = v[1] + rate[j]
        couplers(x, v, state, vehicle, gear, table, run)
        force[j] = state[COUPLER, 1]
    return force


@compiled
def _extremes(force, draft, buff):
    """Keep the largest draft and buff force of every coupling."""
    for i in range(len(force)):
        draft[i] = max(draft[i], force[i])
        buff[i] = min(buff[i], force[i])


@compiled
def _envelope(envelope, first, end, speed):
    """Largest force of a power unit at a speed >= 0; 0 beyond its last segment."""
    for s in range(first, end):
        if speed <= envelope[s, SEGMENT_END]:
            force = envelope[s, SEGMENT_FORCE] + envelope[s, SEGMENT_SLOPE] * speed
            if envelope[s, SEGMENT_POWER] > 0.0:
                force += envelope[s, SEGMENT_POWER] / max(speed, SMALLEST_POWER_SPEED)
            return max(force, 0.0)
    return 0.0


@compiled
def _adhesion_factor(by_speed, speed):
    """Return the adhesion at a speed >= 0 over that of the setup, after Curtius and Kniffler or constant."""
    return 0.161 + 7.5 / (3.6 * speed + 44.0) if by_speed else 1.0


@compiled
def _limits(u, speed, unit, unit_index, envelope, reversing):
    """Lowest and highest force of unit u at a speed: envelope, force limit, adhesion."""
    size = abs(speed)
    high = _envelope(envelope, unit_index[TRACTION_FIRST, u], unit_index[TRACTION_END, u], size)
    low = _envelope(envelope, unit_index[BRAKE_FIRST, u], unit_index[BRAKE_END, u], size)
    if reversing and speed < 0.0:
        high, low = low, high
    elif reversing and speed == 0.0:
        low = high
    cap = unit[FORCE_LIMIT, u]
    factor = _adhesion_factor(unit[ADHESION_BY_SPEED, u] > 0.0, size)
    cap = min(cap, unit[ADHESION, u] * unit[ADHESION_WEIGHT, u] * factor)
    return -min(low, cap), min(high, cap)


@compiled
def _units(demand, dt, state, unit, unit_index, envelope, setting):
    """Turn the commands that are due into forces: gain, dead band, limits, rate, lag, limits.

    A force that drives goes to PUSH; one that brakes goes to EXTRA, a friction capacity, and so never reverses the
    motion.  With `reversing` a negative force drives backwards and all of it is PUSH.
    """
    reversing = setting[REVERSING] > 0.0
    cut = False
    for u in range(unit.shape[1]):
        i = unit_index[UNIT_VEHICLE, u]
        low, high = _limits(u, state[V, i], unit, unit_index, envelope, reversing)
        wanted = demand[u] * unit[GAIN, u]
        if abs(wanted) < unit[DEAD_BAND, u]:
            wanted = 0.0
        if (wanted > high or wanted < low) and abs(state[V, i]) >= setting[HOLD_SPEED]:
            unit[SATURATED, u] += dt
            cut = True
        wanted = min(max(wanted, low), high)
        step = unit[RATE_STEP, u]
        rated = min(max(wanted, unit[RATED, u] - step), unit[RATED, u] + step)
        unit[RATED, u] = rated
        lagged = rated + unit[LAG_KEEP, u] * (unit[LAGGED, u] - rated)
        lagged = min(max(lagged, low), high)
        unit[LAGGED, u] = lagged
        if lagged >= 0.0 or reversing:
            state[PUSH, i] += lagged
        else:
            state[EXTRA, i] -= lagged
    if cut:
        setting[SATURATED_ANY] += dt


@compiled
def _units_account(state, unit, unit_index, reversing):
    """Find the applied force and its work, once the friction share of this step is known."""
    for u in range(unit.shape[1]):
        i = unit_index[UNIT_VEHICLE, u]
        force = unit[LAGGED, u]
        if force < 0.0 and not reversing:
            force = -force * state[SLIDE, i]
        unit[APPLIED, u] = force
        work = force * state[MID, i]
        if work >= 0.0:
            unit[WORK_TRACTION, u] += work
        else:
            unit[WORK_REGENERATED, u] -= work


@compiled
def _no_demand(demand, reversing):
    """Whether no command that is due asks for motion."""
    asked = 0
    for u in range(len(demand)):
        asked += demand[u] > 0.0 or (reversing and demand[u] < 0.0)
    return asked == 0


@compiled
def _standing(v, mass, limit):
    """Whether the train as a whole (its mean speed by mass) is slower than the limit."""
    momentum, total = 0.0, 0.0
    for i in range(len(mass)):
        momentum += mass[i] * v[i]
        total += mass[i]
    return abs(momentum) < limit * total


@compiled
def _waves(t, events, event, state, vehicle, vehicle_index, setting):
    """Move the brake-pipe waves: a vehicle obeys the newest event that has reached it (paper 000, section 1.2).

    A reservoir that was not full when the application began gives every level in that proportion, and what a rise of
    the level takes from it cannot exceed what it holds; a lower level only lets air out of the cylinder.
    """
    n = vehicle_index.shape[1]
    for e in range(events):
        reached = int(event[REACHED, e])
        while reached < n:
            i = vehicle_index[ORDER, reached]
            if t < event[ISSUED, e] + vehicle[PIPE_DISTANCE, i] / event[WAVE, e]:
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


@compiled
def _cylinders(state, vehicle, setting):
    """Fill and empty the cylinders, recharge the reservoirs, find the shoe forces; return whether any is in use."""
    cylinder, target, reservoir = state[CYLINDER], state[TARGET], state[RESERVOIR]
    v, shoe_force, shoe = state[V], state[SHOE_FORCE], vehicle[SHOE]
    active = False
    for i in range(len(shoe)):
        keep = setting[APPLY_KEEP] if target[i] > cylinder[i] else setting[RELEASE_KEEP]
        cylinder[i] = target[i] + keep * (cylinder[i] - target[i])
        if target[i] == 0.0:
            reservoir[i] += setting[RECHARGE] * (1.0 - reservoir[i])
            if cylinder[i] < IDLE_CYLINDER:
                cylinder[i] = 0.0
        active = active or cylinder[i] > 0.0 or target[i] > 0.0 or reservoir[i] < 1.0 - 1e-9
        speed = 3.6 * abs(v[i])
        shoe_force[i] = shoe[i] * cylinder[i] * (2.0 * speed + 150.0) / (3.0 * speed + 150.0)
    return active


@compiled
def _slide_protection(state, vehicle, by_speed):
    """Cut the shoe forces to what the rails take, less what the electric brake of the same vehicle takes of it."""
    v, shoe_force, electric = state[V], state[SHOE_FORCE], state[EXTRA]
    rail, weight = vehicle[RAIL], vehicle[WEIGHT]
    for i in range(len(rail)):
        most = rail[i] * weight[i] * _adhesion_factor(by_speed, abs(v[i])) - electric[i]
        shoe_force[i] = min(shoe_force[i], max(most, 0.0))


@compiled
def _outside(k, state, outside, outside_vehicle):
    """Add the outside forces F + G v and set the drift speeds of the listed vehicles."""
    for j in range(len(outside_vehicle)):
        i = outside_vehicle[j]
        state[PUSH, i] += outside[0, k, j] + outside[1, k, j] * state[V, i]
        state[DRIFT, i] = outside[2, k, j]


@compiled
def _outside_account(k, v_before, state, outside, outside_vehicle):
    """Work of the outside forces at the mean speed."""
    for j in range(len(outside_vehicle)):
        i = outside_vehicle[j]
        state[WORK_OUTSIDE, i] += (outside[0, k, j] + outside[1, k, j] * v_before[j]) * state[MID, i]


@compiled
def _speeds(dt, held, braked, state, vehicle):
    """Give every vehicle its new speed, dry friction implicit, and add up the work of every force."""
    x, v, force, push, extra = state[X], state[V], state[COUPLER], state[PUSH], state[EXTRA]
    grade_a, grade_b, curve, shoe_force = state[GRADE_A], state[GRADE_B], state[CURVE], state[SHOE_FORCE]
    slide, middle = state[SLIDE], state[MID]
    running, climbing, curving, coupling = (
        state[WORK_RUNNING],
        state[WORK_GRADE],
        state[WORK_CURVE],
        state[WORK_COUPLER],
    )
    inverse_mass, c0, c1, c2, hold = vehicle[INVERSE_MASS], vehicle[C0], vehicle[C1], vehicle[C2], vehicle[HOLD]
    for i in range(len(c0)):
        before = v[i]
        viscous = -before * (c1[i] + c2[i] * abs(before))
        grade = grade_a[i] + grade_b[i] * x[i]
        couplers = force[i] - force[i + 1]
        step = dt * inverse_mass[i]
        free = before + step * (couplers + grade + viscous + push[i])
        stop = step * (c0[i] + curve[i] + extra[i] + shoe_force[i] + held * hold[i])
        size = abs(free)
        after = copysign(max(size - stop, 0.0), free)
        share = 1.0 if size >= stop else size / stop
        sliding = -copysign(share, free)
        mid = 0.5 * dt * (before + after)
        dry = sliding * mid
        running[i] += viscous * mid + c0[i] * dry
        climbing[i] += grade * mid
        curving[i] += curve[i] * dry
        coupling[i] += couplers * mid
        slide[i] = sliding
        middle[i] = mid
        v[i] = after
    if braked or held > 0.0:
        air, holding = state[WORK_AIR], state[WORK_HOLD]
        for i in range(len(c0)):
            air[i] += shoe_force[i] * slide[i] * middle[i]
            holding[i] += held * hold[i] * slide[i] * middle[i]


@compiled
def _body_sums(a, b, held, state, vehicle):
    """Mass, force (without dry friction) and dry capacity of the rigid body of vehicles a ... b-1."""
    mass, force, dry = 0.0, 0.0, 0.0
    for i in range(a, b):
        v = state[V, i]
        mass += vehicle[MASS, i]
        force += state[GRADE_A, i] + state[GRADE_B, i] * state[X, i] + state[PUSH, i]
        force -= v * (vehicle[C1, i] + vehicle[C2, i] * abs(v))
        dry += vehicle[C0, i] + state[CURVE, i] + state[EXTRA, i] + state[SHOE_FORCE, i] + held * vehicle[HOLD, i]
    return mass, force + state[COUPLER, a] - state[COUPLER, b], dry


@compiled
def _bodies(dt, held, state, vehicle, gear, body):
    """As :func:`_speeds` for a train with rigid couplings; their forces follow from each vehicle's balance."""
    for index in range(len(body) - 1):
        a, b = body[index], body[index + 1]
        mass, force, capacity = _body_sums(a, b, held, state, vehicle)
        before = state[V, a]
        free = before + dt * force / mass
        stop = dt * capacity / mass
        size = abs(free)
        after = copysign(max(size - stop, 0.0), free)
        sliding = -copysign(1.0 if size >= stop else size / stop, free)
        mid = 0.5 * dt * (before + after)
        acceleration = (after - before) / dt
        for i in range(a, b):
            viscous = -before * (vehicle[C1, i] + vehicle[C2, i] * abs(before))
            grade = state[GRADE_A, i] + state[GRADE_B, i] * state[X, i]
            holding = held * vehicle[HOLD, i]
            dry = vehicle[C0, i] + state[CURVE, i] + state[EXTRA, i] + state[SHOE_FORCE, i] + holding
            own = viscous + grade + state[PUSH, i] + sliding * dry
            if i < b - 1:
                state[COUPLER, i + 1] = state[COUPLER, i] + own - vehicle[MASS, i] * acceleration
            state[WORK_RUNNING, i] += (viscous + vehicle[C0, i] * sliding) * mid
            state[WORK_GRADE, i] += grade * mid
            state[WORK_CURVE, i] += state[CURVE, i] * sliding * mid
            state[WORK_AIR, i] += state[SHOE_FORCE, i] * sliding * mid
            state[WORK_HOLD, i] += holding * sliding * mid
            state[WORK_COUPLER, i] += (state[COUPLER, i] - state[COUPLER, i + 1]) * mid
            state[SLIDE, i] = sliding
            state[MID, i] = mid
            state[V, i] = after


@compiled
def _positions(dt, n, state):
    """Move with the new speed; return how many vehicles left their piece of line."""
    x, v, drift, begin, end = state[X], state[V], state[DRIFT], state[PIECE_BEGIN], state[PIECE_END]
    left = 0
    for i in range(n):
        x[i] += dt * (v[i] + drift[i])
        left += (x[i] < begin[i]) | (x[i] >= end[i])
    return left


@compiled
def locate(state, vehicle, vehicle_index, piece):
    """Find the piece of line under every vehicle, walking from the last one, and its grade and curve forces."""
    for i in range(vehicle.shape[1]):
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


@compiled
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
        Quantities by row, see the names above; made by :mod:`plant_sim.packing`.
    vehicle_index, unit_index, run, body, outside_vehicle : int64 arrays
        Pointers, runs of equal draft gears, first vehicles of the rigid bodies, vehicles with outside forces.
    table : float64, shape (tables, 3, m)
        Deflection, loading and unloading force of the user's curves.
    events : int
        Number of brake-pipe events still under way.
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
    draft, buff, coupler = gear[DRAFT, : n - 1], gear[BUFF, : n - 1], state[COUPLER, 1:n]
    v_before = outside[0, 0].copy()
    braked = events > 0 or (state[TARGET, :n] > 0.0).any() or (state[CYLINDER, :n] > 0.0).any()
    braked = braked or (state[RESERVOIR, :n] < 1.0 - 1e-9).any()
    for k in range(demand.shape[0]):
        if braked:
            _waves(t + k * dt, events, event, state, vehicle, vehicle_index, setting)
            braked = _cylinders(state, vehicle, setting) or events > 0
        for u in range(unit.shape[1]):
            state[PUSH, unit_index[UNIT_VEHICLE, u]] = 0.0
            state[EXTRA, unit_index[UNIT_VEHICLE, u]] = 0.0
        for j in range(len(outside_vehicle)):
            state[PUSH, outside_vehicle[j]] = 0.0
            v_before[j] = v[outside_vehicle[j]]
        _outside(k, state, outside, outside_vehicle)
        if has_drift:
            for i in range(n):
                xdot[i] = v[i] + drift[i]
            couplers(x, xdot, state, vehicle, gear, table, run)
        else:
            couplers(x, v, state, vehicle, gear, table, run)
        _units(demand[k], dt, state, unit, unit_index, envelope, setting)
        if braked and setting[SLIPPERY] > 0.0:
            _slide_protection(state, vehicle, setting[RAIL_BY_SPEED] > 0.0)
        held = 0.0
        if _no_demand(demand[k], reversing) and _standing(v, vehicle[MASS], setting[HOLD_SPEED]):
            held = 1.0
        if rigid:
            _bodies(dt, held, state, vehicle, gear, body)
        else:
            _speeds(dt, held, braked, state, vehicle)
        _extremes(coupler, draft, buff)
        _units_account(state, unit, unit_index, reversing)
        _outside_account(k, v_before, state, outside, outside_vehicle)
        if _positions(dt, n, state) > 0:
            locate(state, vehicle, vehicle_index, piece)
