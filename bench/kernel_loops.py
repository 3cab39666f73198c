"""Loops of the kernel, repeated, and bare loops with the same loads, stores and divisions per vehicle.

The step is 0 s: the state of the train stays the same, and the numbers do not leave their range.  A bare loop sums all
values that it loads, and stores the sum; memory accesses and divisions are its only costs.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

from plant_sim import kernel as k
from plant_sim.compiled import compiled
from plant_sim.kernel import ONE, uint64


@compiled
def couplers(repeats, state, vehicle, gear):
    """Repeat the loop of equal draft gears of the kind clip."""
    n, x, v = vehicle.shape[1], state[k.X], state[k.V]
    for _ in range(repeats):
        k._clip(1, n - 1, True, x, v, state, vehicle, gear)


@compiled
def speeds(repeats, state, vehicle, gear):
    """Repeat the loop of speeds, works and positions of a released train."""
    for _ in range(repeats):
        k._speeds(0.0, state, vehicle)


@compiled
def bare_couplers(repeats, state, vehicle, gear):
    """Load 9 values, divide once and store 5 values per vehicle, as :func:`couplers`."""
    for _ in range(repeats):
        for i in range(uint64(1), uint64(vehicle.shape[1] - 1)):
            s = state[0, i] + state[0, i + ONE] + state[1, i] + state[1, i + ONE] + vehicle[k.GAP, i]
            s += gear[12, i] + gear[13, i] + gear[14, i] + gear[15, i]
            gear[12, i] = gear[13, i] = gear[14, i] = s
            gear[15, i] = state[4, i + ONE] = s / (state[0, i] + 1e9)


@compiled
def bare_speeds(repeats, state, vehicle, gear):
    """Load 13 and 15 values and store 3 and 6 values per vehicle in two loops, as :func:`speeds`."""
    for _ in range(repeats):
        for i in range(uint64(vehicle.shape[1])):
            s = state[0, i] + state[1, i] + state[4, i] + state[4, i + ONE] + state[5, i] + state[6, i] + state[7, i]
            s += state[8, i] + state[9, i] + vehicle[0, i] + vehicle[3, i] + vehicle[4, i] + vehicle[5, i]
            state[26, i] = state[27, i] = state[28, i] = s
        for i in range(uint64(vehicle.shape[1])):
            s = state[0, i] + state[1, i] + state[4, i] + state[4, i + ONE] + state[9, i] + state[10, i] + state[11, i]
            s += state[26, i] + state[27, i] + state[28, i] + vehicle[3, i]
            s += state[19, i] + state[20, i] + state[21, i] + state[22, i]
            state[0, i] = state[1, i] = state[19, i] = state[20, i] = state[21, i] = state[22, i] = s


LOOPS = {
    "couplers: force, extremes": (couplers, bare_couplers),
    "vehicles: speed, works, position": (speeds, bare_speeds),
}
"""Name: loop of the kernel, bare loop; the bare loops destroy the state, so they need arrays of their own."""
