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

from dataclasses import dataclass

import numpy as np

from plant_sim.compiled import compiled
from plant_sim.elementary import libm_exp
from plant_sim.railway import shoe_force
from plant_sim.record import quantity

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
# Rows of `cells`, one column per cell (LIMIT: at its end, DRIVES: row of its traction in `drives`, before that of its
# electric brake), of `drives`, one column per speed (the first rows are those of the open line), and of `shoes`, one
# column per brake state (LARGEST: force of the complete application, USED: part of the supply that it uses).
# `couplers` has one column per selected coupler; from LINE_AHEAD and SHOES_AHEAD on, `cells` and `shoes` have one row
# per coupler.
LINE_FORCE, LIMIT, DRIVES, LINE_AHEAD = range(4)
RUNNING, TRACTION, BRAKE = range(3)
SHOE_FORCE, LARGEST, USED, SHOES_AHEAD = range(4)
MASS_AHEAD, DRIVES_AHEAD, RUNNING_AHEAD = range(3)


@dataclass
class SearchConstants:
    """Constants of a search; without exhaustible reservoirs the recharge, and all after it, are 0."""

    inertia: float = quantity("kg", "mass with the rotating masses")
    cell_length: float = quantity("m", "length of a cell")
    speed_grid: float = quantity("m/s", "spacing of the speeds")
    age_grid: float = quantity("s", "spacing of the ages")
    price: float = quantity("J/s", "price of time")
    recovered: float = quantity("", "part of the electric brake's work that is recovered")
    rolling: float = quantity("m/s", "lowest speed of a rolling train")
    end_energy: float = quantity("m²/s²", "v²/2 at the end")
    application: float = quantity("J", "price of an application")
    oldest: int = quantity("", "ages from an application to its first release")
    release_speed: float = quantity("m/s", "lowest speed of a release")
    coupler_limit: float = quantity("N", "permitted coupler force")
    recharge: float = quantity("s", "time constant of the recharge")
    wave_loss: float = quantity("", "factor on the missing filling: the wave of a release is the slower one")
    min_supply: float = quantity("", "lowest supply")
    supply_grid: float = quantity("", "spacing of the supplies")


@dataclass
class BrakeRange:
    """Brake states of one reduction."""

    applied_first: int = quantity("", "state at the begin of an application")
    applied_last: int = quantity("", "state of a complete application")
    released_first: int = quantity("", "state at the begin of a release")
    released_last: int = quantity("", "last state in which no application is possible")


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
        found = found or ranges[r].applied_first <= state <= ranges[r].applied_last
    return found


@compiled
def older_state(state, duration, ranges, age_grid):
    """Return a brake state, a number between the states of the grid, after a duration [s]."""
    for r in range(len(ranges)):
        if ranges[r].applied_first <= state <= ranges[r].applied_last:
            return min(state + duration / age_grid, float(ranges[r].applied_last))
        if ranges[r].released_first <= state <= ranges[r].released_last:
            place = state + duration / age_grid
            return place if place < ranges[r].released_last else 0.0
    return 0.0


@compiled
def later_supply(state, supply, duration, shoes, ranges, constants):
    """Return the supply after a duration [s] from a brake state on, without an application or a release."""
    constant = constants[0]
    if constant.recharge == 0.0:
        return supply
    missing = 1.0 - supply
    for r in range(len(ranges)):
        if ranges[r].applied_first <= state <= ranges[r].released_last:
            if older_state(state, duration, ranges, constant.age_grid) > 0.0:
                return supply
            missing = constant.wave_loss * (1.0 - supply * (1.0 - shoes[USED, int(state)]))
            duration += constant.age_grid * (state - ranges[r].released_first)
    return max(1.0 - missing * libm_exp(-duration / constant.recharge), 0.0)


@compiled
def _value(value, state, supply, speed, ranges, constants):
    """Return J of a stage at a brake state, a supply and a speed, linear between them."""
    constant, grid = constants[0], constants[0].speed_grid
    if len(value) == 1:
        return _value_of(value[0], state, speed, ranges, grid)
    place = min(max((supply - constant.min_supply) / constant.supply_grid, 0.0), len(value) - 1.001)
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
            if high > ranges[r].released_last and low <= ranges[r].released_last:
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
def _cost(v, force, k, state, supply, shoe, running, value, cells, shoes, ranges, couplers, constants):
    """Return the cost of a force in a cell plus J after it [J], and the speed at its end [m/s]."""
    constant = constants[0]
    length, grid = constant.cell_length, constant.speed_grid
    pull = force - retarding_force(v, cells[LINE_FORCE, k], running, shoe)
    energy = 0.5 * v * v + length * pull / constant.inertia
    after = np.sqrt(2.0 * energy) if energy > 0.0 else 0.0
    if after < constant.rolling or after > (value.shape[2] - 1) * grid:
        return IMPOSSIBLE, after
    duration = 2.0 * length / (v + after)
    older = older_state(state, duration, ranges, constant.age_grid)
    cost = (max(force, 0.0) + constant.recovered * min(force, 0.0)) * length + constant.price * duration
    cost += EXCESS * max(after - cells[LIMIT, k], 0.0)
    if couplers.shape[1] > 0:
        acceleration = pull / constant.inertia
        cost += COUPLER_EXCESS * _coupler_excess(
            v, force, acceleration, k, state, supply, running, cells, shoes, couplers, constant.coupler_limit
        )
    later = later_supply(state, supply, duration, shoes, ranges, constants)
    return cost + _value(value, older, later, after, ranges, constants), after


@compiled
def best_force(v, k, state, supply, value, levels, cells, drives, shoes, ranges, couplers, constants):
    """Return cost [J], force [N] and next speed [m/s] of the best force from a state on."""
    place = v / constants[0].speed_grid
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
        cost, after = _cost(v, force, k, state, supply, shoe, running, value, cells, shoes, ranges, couplers, constants)
        if cost < best:
            best, chosen, next_speed = cost, force, after
    return best, chosen, next_speed


@compiled
def solve_values(supplies, levels, cells, drives, shoes, ranges, couplers, constants):
    """Return J at every stage, supply, brake state and speed [J], shape (cells + 1, supplies, states, speeds)."""
    constant = constants[0]
    count, states, speeds = cells.shape[1], shoes.shape[1], drives.shape[1]
    value = np.full((count + 1, len(supplies), states, speeds), IMPOSSIBLE)
    for b in range(states):
        for j in range(1, speeds):
            if not _is_applied(b, ranges):
                energy = 0.5 * (j * constant.speed_grid) ** 2
                value[count, :, b, j] = END_EXCESS * max(energy - constant.end_energy, 0.0)
    for k in range(count - 1, -1, -1):
        for c in range(len(supplies)):
            for b in range(states):
                for j in range(speeds):
                    v = j * constant.speed_grid
                    if j == 0 or v >= constant.rolling:
                        value[k, c, b, j], _, _ = best_force(
                            v, k, float(b), supplies[c], value[k + 1],
                            levels, cells, drives, shoes, ranges, couplers, constants,
                        )  # fmt: skip
            _change_brake(value[k, c], ranges, constants)
    return value


@compiled
def _change_brake(value, ranges, constants):
    """Apply the best application and release of a stage and a supply to its values."""
    constant = constants[0]
    for r in range(len(ranges)):
        first, last = ranges[r].applied_first, ranges[r].applied_last
        oldest = min(first + constant.oldest, last)
        for j in range(value.shape[1]):
            if j * constant.speed_grid >= constant.release_speed:
                for b in range(oldest, last + 1):
                    value[b, j] = min(value[b, j], value[ranges[r].released_first, j])
            value[0, j] = min(value[0, j], value[first, j] + constant.application)
