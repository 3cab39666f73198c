"""Search of the cheapest journey of the reduced model: dynamic programming over place, speed and brake state.

Stages are the cells of the line. A state is a speed on a grid, a brake state and a supply. A brake state is released,
applied since an age, or released since an age; in the last state the recharge pause has not passed, and no application
is possible. The supply s is the mean filling of the reservoirs. During an application and its release it is the filling
at the begin of this application. Controls are the force of the drives (fractions of the envelopes, coasting, constant
speed), an application, and a release. Bellman's equation runs from the last cell to the first::

    J_k(v, b, s) = min_F [ (max(F, 0) - recovered max(-F, 0)) ds + price dt + J_k+1(v', b', s') ]
    v'²/2 = v²/2 + a ds

J is linear between the speeds of the grid, between the ages, and between the supplies. Traction against applied or
releasing shoes is excluded. Speeds above the limit are penalised. The journey follows J forwards with a finer set of
forces. The reservoirs are those of the plant. An application brakes with the part s of its force and uses a part u s of
the filling. After the release the filling approaches 1 with the time constant of the recharge.
"""

# mypy: allow-untyped-defs

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp
from plant_sim.railway import shoe_force

IMPOSSIBLE = 1e13
"""Cost of a state without a continuation [J]."""
EXCESS = 1e9
"""Cost of a speed above the limit, per m/s and cell [J]."""
END_EXCESS = 1e10
"""Cost of a speed above the final one, per m²/s² at the end [J]."""
COUPLER_EXCESS = 1e3
"""Cost of a quasi-static coupler force above its limit, per N and cell [J]: 28 kWh for 100 kN."""
POWER_BRAKING = 0.3
"""Part of the shoe force of a complete application above which no traction is permitted."""
# Entries of `constant`. ROLLING: lowest speed of a rolling train. END_ENERGY: v²/2 at the end. WAVE_LOSS: factor on the
# missing filling, because the wave of a release is slower than that of an application.
(
    INERTIA, CELL_LENGTH, SPEED_GRID, AGE_GRID, PRICE, RECOVERED, ROLLING, END_ENERGY, APPLICATION, OLDEST,
    RELEASE_SPEED, COUPLER_LIMIT, MIN_SUPPLY, SUPPLY_GRID, RECHARGE, WAVE_LOSS,
) = range(16)  # fmt: skip
CONSTANTS = 16
# Rows of `cells`, one column per cell (LIMIT: at its end, DRIVES: row of its traction in `drives`, before that of its
# electric brake), of `drives`, one column per speed (the first rows are those of the open line), and of `shoes`, one
# column per brake state (LARGEST: force of the complete application, USED: part of the supply that it uses). `ranges`
# has one row per reduction.
# `couplers` has one column per selected coupler; from LINE_AHEAD and SHOES_AHEAD on, `cells` and `shoes` have one row
# per coupler.
LINE_FORCE, LIMIT, DRIVES, LINE_AHEAD = range(4)
RUNNING, TRACTION, BRAKE = range(3)
SHOE_FORCE, LARGEST, USED, SHOES_AHEAD = range(4)
MASS_AHEAD, DRIVES_AHEAD, RUNNING_AHEAD = range(3)
APPLIED_FIRST, APPLIED_LAST, RELEASED_FIRST, RELEASED_LAST = range(4)


@compiled
def _between(row, place):
    """Return the value of a row at a place between its entries."""
    place = min(max(place, 0.0), len(row) - 1.001)
    j = int(place)
    return row[j] + (place - j) * (row[j + 1] - row[j])


@compiled
def _is_applied(state, ranges):
    """Return True if a brake state belongs to an application."""
    found = False
    for r in range(len(ranges)):
        found = found or ranges[r, APPLIED_FIRST] <= state <= ranges[r, APPLIED_LAST]
    return found


@compiled
def older_state(state, duration, ranges, age_grid):
    """Return a brake state, a number between the states of the grid, after a duration [s]."""
    for r in range(len(ranges)):
        if ranges[r, APPLIED_FIRST] <= state <= ranges[r, APPLIED_LAST]:
            return min(state + duration / age_grid, float(ranges[r, APPLIED_LAST]))
        if ranges[r, RELEASED_FIRST] <= state <= ranges[r, RELEASED_LAST]:
            place = state + duration / age_grid
            return place if place < ranges[r, RELEASED_LAST] else 0.0
    return 0.0


@compiled
def later_supply(state, supply, duration, shoes, ranges, constant):
    """Return the supply after a duration [s] from a brake state on, without an application or a release."""
    if constant[RECHARGE] == 0.0:
        return supply
    missing = 1.0 - supply
    for r in range(len(ranges)):
        if ranges[r, APPLIED_FIRST] <= state <= ranges[r, RELEASED_LAST]:
            if older_state(state, duration, ranges, constant[AGE_GRID]) > 0.0:
                return supply
            missing = constant[WAVE_LOSS] * (1.0 - supply * (1.0 - shoes[USED, int(state)]))
            duration += constant[AGE_GRID] * (state - ranges[r, RELEASED_FIRST])
    return max(1.0 - missing * libm_exp(-duration / constant[RECHARGE]), 0.0)


@compiled
def _value(value, state, supply, speed, ranges, constant):
    """Return J of a stage at a brake state, a supply and a speed, linear between them."""
    grid = constant[SPEED_GRID]
    if len(value) == 1:
        return _value_of(value[0], state, speed, ranges, grid)
    place = min(max((supply - constant[MIN_SUPPLY]) / constant[SUPPLY_GRID], 0.0), len(value) - 1.001)
    low = int(place)
    found = _value_of(value[low], state, speed, ranges, grid)
    return found + (place - low) * (_value_of(value[low + 1], state, speed, ranges, grid) - found)


@compiled
def _value_of(value, state, speed, ranges, speed_grid):
    """Return J of a stage and a supply at a brake state and a speed, linear between states and speeds."""
    low = int(state)
    found = _between(value[low], speed / speed_grid)
    weight = state - low
    if weight > 0.0:
        high = low + 1
        for r in range(len(ranges)):
            if high > ranges[r, RELEASED_LAST] and low <= ranges[r, RELEASED_LAST]:
                high = 0
        found += weight * (_between(value[high], speed / speed_grid) - found)
    return found


@compiled
def retarding_force(v, line_force, running, shoe):
    """Return line, running and shoe force at a speed [N]."""
    return line_force + running + shoe_force(shoe, v)


@compiled
def _coupler_excess(v, force, acceleration, k, state, supply, running, cells, shoes, couplers, limit):
    """Return the largest quasi-static coupler force above a limit [N] (:mod:`.quasi_static_couplers`)."""
    excess = 0.0
    for j in range(couplers.shape[1]):
        shoe = supply * _between(shoes[SHOES_AHEAD + j], state)
        held = retarding_force(v, cells[LINE_AHEAD + j, k], couplers[RUNNING_AHEAD, j] * running, shoe)
        pull = couplers[DRIVES_AHEAD, j] * force - couplers[MASS_AHEAD, j] * acceleration - held
        excess = max(excess, abs(pull) - limit)
    return excess


@compiled
def _cost(v, force, k, state, supply, shoe, running, value, cells, shoes, ranges, couplers, constant):
    """Return the cost of a force in a cell plus J after it [J], and the speed at its end [m/s]."""
    length, grid = constant[CELL_LENGTH], constant[SPEED_GRID]
    pull = force - retarding_force(v, cells[LINE_FORCE, k], running, shoe)
    energy = 0.5 * v * v + length * pull / constant[INERTIA]
    after = np.sqrt(2.0 * energy) if energy > 0.0 else 0.0
    if after < constant[ROLLING] or after > (value.shape[2] - 1) * grid:
        return IMPOSSIBLE, after
    duration = 2.0 * length / (v + after)
    older = older_state(state, duration, ranges, constant[AGE_GRID])
    cost = (max(force, 0.0) + constant[RECOVERED] * min(force, 0.0)) * length + constant[PRICE] * duration
    cost += EXCESS * max(after - cells[LIMIT, k], 0.0)
    if couplers.shape[1] > 0:
        acceleration = pull / constant[INERTIA]
        cost += COUPLER_EXCESS * _coupler_excess(
            v, force, acceleration, k, state, supply, running, cells, shoes, couplers, constant[COUPLER_LIMIT]
        )
    later = later_supply(state, supply, duration, shoes, ranges, constant)
    return cost + _value(value, older, later, after, ranges, constant), after


@compiled
def best_force(v, k, state, supply, value, levels, cells, drives, shoes, ranges, couplers, constant):
    """Return cost [J], force [N] and next speed [m/s] of the best force from a state on."""
    place = v / constant[SPEED_GRID]
    row = int(cells[DRIVES, k])
    high, low = _between(drives[row], place), _between(drives[row + 1], place)
    running, shoe = _between(drives[RUNNING], place), supply * _between(shoes[SHOE_FORCE], state)
    if state > 0.0 and (_is_applied(state, ranges) or shoe > POWER_BRAKING * shoes[LARGEST, int(state)]):
        high = 0.0
    best, chosen, next_speed = IMPOSSIBLE, 0.0, 0.0
    hold = retarding_force(v, cells[LINE_FORCE, k], running, shoe)
    for n in range(len(levels) + 1):
        if n == len(levels):
            if hold > high or hold < -low:
                continue
            force = hold
        else:
            force = levels[n] * (high if levels[n] > 0.0 else low)
            if n > 0 and levels[n] > 0.0 and high == 0.0:
                continue
        cost, after = _cost(v, force, k, state, supply, shoe, running, value, cells, shoes, ranges, couplers, constant)
        if cost < best:
            best, chosen, next_speed = cost, force, after
    return best, chosen, next_speed


@compiled
def solve_values(supplies, levels, cells, drives, shoes, ranges, couplers, constant):
    """Return J at every stage, supply, brake state and speed [J], shape (cells + 1, supplies, states, speeds)."""
    count, states, speeds = cells.shape[1], shoes.shape[1], drives.shape[1]
    value = np.full((count + 1, len(supplies), states, speeds), IMPOSSIBLE)
    for b in range(states):
        for j in range(1, speeds):
            if not _is_applied(b, ranges):
                energy = 0.5 * (j * constant[SPEED_GRID]) ** 2
                value[count, :, b, j] = END_EXCESS * max(energy - constant[END_ENERGY], 0.0)
    for k in range(count - 1, -1, -1):
        for c in range(len(supplies)):
            for b in range(states):
                for j in range(speeds):
                    v = j * constant[SPEED_GRID]
                    if j == 0 or v >= constant[ROLLING]:
                        value[k, c, b, j], _, _ = best_force(
                            v, k, float(b), supplies[c], value[k + 1],
                            levels, cells, drives, shoes, ranges, couplers, constant,
                        )  # fmt: skip
            _change_brake(value[k, c], ranges, constant)
    return value


@compiled
def _change_brake(value, ranges, constant):
    """Apply the best application and release of a stage and a supply to its values."""
    for r in range(len(ranges)):
        first, last = ranges[r, APPLIED_FIRST], ranges[r, APPLIED_LAST]
        oldest = min(first + int(constant[OLDEST]), last)
        for j in range(value.shape[1]):
            if j * constant[SPEED_GRID] >= constant[RELEASE_SPEED]:
                for b in range(oldest, last + 1):
                    value[b, j] = min(value[b, j], value[ranges[r, RELEASED_FIRST], j])
            value[0, j] = min(value[0, j], value[first, j] + constant[APPLICATION])
