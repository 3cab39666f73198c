"""Steps of many trains in one compiled call: the compiled ticks of every train, its costs and its observation."""

# mypy: allow-untyped-defs

from __future__ import annotations

from math import isfinite

import numpy as np

from plant_sim import kernel as k
from plant_sim.compiled import compiled
from train_ato.apps.env.observation import DIRECTION, ENGAGED, SUPERVISED, add_costs, write_values
from train_ato.loop.spans.kernel import BEGIN, END, SEEN, span_ticks
from train_ato.loop.spans.native_arguments import arguments_of, taken

TICKS, ROWS, GOES_ON = range(3)
"""Results of a train: ticks of this call, rows of its span that have been run, and 1 if its next tick was observed."""


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
def step_trains(kind, rows, who, next_of, most, stamp_unit, weights, results, costs, memories, states, found, rewards,
                places):  # fmt: skip
    """Run some ticks of trains; return the number of those whose next tick is compiled, too.

    A train whose next tick is left to Python ends earlier.

    Parameters
    ----------
    kind
        Kind of the rows.
    rows : Array of int, shape (trains, numbers)
        Arguments of :func:`train_ato.loop.spans.kernel.run_span` of every train, and the arrays of its
        :class:`train_ato.apps.env.observation.Sight`.
    who : Array of int
        Numbers of the trains.
    next_of : Array of int, shape (1,)
        Place in ``who`` of the next train; all threads with these trains share it.
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
    compiled_next = 0
    while True:
        index = taken(next_of)
        if index >= who.size:
            return compiled_next
        m = who[index]
        args, sight = arguments_of(kind, rows[m])
        stamp, tick_ns, train, reference = args[0], args[1], args[3], args[16]
        count, history, measured, couplers, supervision = args[24], args[27], args[30], args[31], args[35]
        state, vehicles, unit, index_of, gear = train[0], train[1].shape[1], train[7], train[8], train[3]
        now, errors, ticks, at, steps = places[m, :3], places[m, 3:], 0, 0, supervision[0][3]
        while True:
            acts = count[SEEN] > 0
            if acts:
                for u in range(errors.size):
                    errors[u] = state[k.V, index_of[k.UNIT_VEHICLE, u]] - reference[1, count[BEGIN]]
            count[END] = count[BEGIN] + acts
            at = span_ticks(args)
            if acts:
                add_costs(costs[m], memories[m], errors, state, unit, gear, vehicles, tick_ns * stamp_unit)
                ticks += 1
            if count[SEEN] == 0:
                break
            now[0], now[1], now[2] = reference[0, at], reference[1, at], reference[2, at]
            own = states[m]
            own[ENGAGED] = 1.0
            if supervision[0][0][0].period > 0:
                own[SUPERVISED], own[SUPERVISED + 1] = steps[0].permitted, steps[0].warning
                own[SUPERVISED + 2], own[SUPERVISED + 3] = steps[0].service, steps[0].emergency
            if now[1] != 0.0:
                own[DIRECTION] = np.sign(now[1])
            write_values(
                found[m], (stamp + at * tick_ns) * stamp_unit, measured[at], couplers[at], now, args[12][4][at],
                history, own, sight,
            )  # fmt: skip
            if ticks >= most:
                break
        compiled_next += count[SEEN]
        results[m, TICKS], results[m, ROWS], results[m, GOES_ON] = ticks, at, count[SEEN]
        total = 0.0
        for cost in range(weights.size):
            total += weights[cost] * costs[m, cost]
        rewards[m] = -total
