"""Steps of many trains in one compiled call: the compiled ticks of every train, its costs and its observation."""

# mypy: allow-untyped-defs

from math import isfinite

import numpy as np

from plant_sim import kernel as k
from plant_sim.compiled import compiled
from train_ato.api.env.observation import DIRECTION, ENGAGED, SUPERVISED, add_costs, write_values
from train_ato.loop.native_arguments import added, arguments_of, exchanged
from train_ato.loop.span_kernel import span_ticks

TICKS, ROWS, GOES_ON = range(3)
"""Results of a train: ticks of this call, rows of its span that have been run, and 1 if its next tick was observed."""
LEFT, UNDONE, GOING_ON = range(3)
"""Numbers of the threads of a call: trains without a thread, without a result, and with a compiled next tick."""
PATIENCE = 10_000
"""Looks of a thread for the next train, about 0.1 ms: to wake a thread that sleeps costs as much as 10 trains."""


@compiled(allocates=False)
def set_forces(given, low, high, normalised, forces):
    """Write the force of every unit from that of a step; return False, without a change, if one is not finite.

    Parameters
    ----------
    given, forces : Array, shape (trains, units)
        Given forces [N] or, if ``normalised``, relative to the limits; receives the forces [N].
    low, high : Array, shape (trains, units)
        Limits of every unit [N].
    """
    for m in range(given.shape[0]):
        for u in range(given.shape[1]):
            if not isfinite(given[m, u]):
                return False
    for m in range(given.shape[0]):
        for u in range(given.shape[1]):
            force = given[m, u]
            if normalised:
                force *= -low[m, u] if force < 0.0 else high[m, u]
            forces[m, u] = force
    return True


@compiled(allocates=False)
def step_trains(kind, rows, begun, who, shared, most, stamp_unit, weights, results, costs, memories, states, found,
                rewards, places):  # fmt: skip
    """Run some ticks of trains, together with the other threads that have the same arguments.

    A train whose next tick is left to Python ends earlier. A thread that finds no train keeps looking for some time, so
    that it begins the next call at once. The thread that began the call returns after the last train.

    Parameters
    ----------
    kind
        Kind of the rows.
    rows : Array of int, shape (trains, numbers)
        Arguments of :func:`train_ato.loop.span_kernel.run_span` of every train, and the arrays of its
        :class:`train_ato.api.env.observation.Sight`.
    begun
        Number of trains of a call that this thread begins; 0: it takes part in calls.
    who : Array of int
        Numbers of the trains, first those of this call.
    shared : Array of int, shape (3,)
        :data:`LEFT` and those after it.
    most
        Number of ticks; 0: only observe.
    stamp_unit
        Seconds of a unit of a stamp.
    weights : Array, shape (4,)
        Weights of the costs [1/unit].
    results : Array of int, shape (trains, 3)
        Receives :data:`TICKS` and those after it.
    costs, memories, states, found : Array, one row per train
        Costs and memory of :func:`add_costs`, state and values of :func:`write_values`.
    rewards : Array, shape (trains,)
        Receives minus the weighted sum of the costs.
    places : Array, shape (trains, 3 + units)
        Room for the reference and for speed errors.
    """
    if begun:
        exchanged(shared, UNDONE, begun)
        exchanged(shared, GOING_ON, 0)
        exchanged(shared, LEFT, begun)
    looks = 0
    while looks < PATIENCE and not (begun and added(shared, UNDONE, 0) == 0):
        looks += 1
        index = added(shared, LEFT, -1)
        if index < 0:
            continue
        m = who[index]
        args, sight = arguments_of(kind, rows[m])
        (
            stamp, tick_ns, _, train, _, _, _, _, _, _, _, _, observing, _, _, _, (place, speed, acceleration, _, _, _),
            _, _, _, _, _, _, _, counts, _, _, history, _, _, measured, couplers, _, _, _, supervision, _, _,
        ) = args  # fmt: skip
        state, vehicle, _, gear, _, _, _, unit, unit_index, _, _ = train
        _, _, _, _, estimates, _, _ = observing
        count, limits = counts[0], supervision.states.supervisor[0]
        now, errors, ticks, at = places[m, :3], places[m, 3:], 0, 0
        while True:
            acts = count.seen > 0
            if acts:
                for u in range(errors.size):
                    errors[u] = state[k.V, unit_index[k.UNIT_VEHICLE, u]] - speed[count.begin]
            count.end = count.begin + acts
            at = span_ticks(args)
            if acts:
                add_costs(costs[m], memories[m], errors, state, unit, gear, vehicle.shape[1], tick_ns * stamp_unit)
                ticks += 1
            if count.seen == 0:
                break
            now[0], now[1], now[2] = place[at], speed[at], acceleration[at]
            own = states[m]
            own[ENGAGED] = 1.0
            if supervision.states.run[0].period > 0:
                own[SUPERVISED], own[SUPERVISED + 1] = limits.permitted, limits.warning
                own[SUPERVISED + 2], own[SUPERVISED + 3] = limits.service, limits.emergency
            if speed[at] != 0.0:
                own[DIRECTION] = np.sign(speed[at])
            write_values(
                found[m], (stamp + at * tick_ns) * stamp_unit, measured[at], couplers[at], now, estimates[at],
                history, own, sight,
            )  # fmt: skip
            if ticks >= most:
                break
        results[m, TICKS], results[m, ROWS], results[m, GOES_ON] = ticks, at, count.seen
        total = 0.0
        for cost in range(weights.size):
            total += weights[cost] * costs[m, cost]
        rewards[m] = -total
        added(shared, GOING_ON, count.seen)
        added(shared, UNDONE, -1)
        looks = 0
