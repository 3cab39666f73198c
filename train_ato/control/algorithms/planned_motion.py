"""Planned motion and force of a constrained predictive law at the nodes of its horizon, compiled."""

# mypy: allow-untyped-defs

from __future__ import annotations

import numpy as np

from plant_sim.compiled import compiled
from train_ato.control.algorithms.horizon_model import HorizonModel
from train_ato.control.contract import LawPlan
from train_ato.messages.types import Array

SOLVED, CONTINUED = "solved", "iterations"
"""Status of a new plan, and of the last one after too many exchanges."""


def planned_motion(
    times: Array,
    reference: Array,
    errors: Array,
    model: HorizonModel,
    decision: Array,
    force: Array,
    speed_room: Array,
    status: str,
) -> LawPlan:
    """Return the plan of a decision.

    Parameters
    ----------
    times : Array, shape (nodes,)
        Times of the nodes after the measurement [s].
    reference, errors : Array, shape (2, nodes)
        Position [m] and speed [m/s] of the reference, and errors of the free motion.
    model
        Response of the errors.
    decision : Array, shape (nodes,)
        z [m/s²].
    force : Array, shape (nodes,)
        Planned force demand [N].
    speed_room : Array, shape (nodes,)
        Permitted speed minus that of the free motion [m/s].
    status
        Result of the solver.
    """
    rows = _motion(reference, errors, model.response_position, model.response_velocity, decision, speed_room)
    return LawPlan(times, rows[0], rows[1], force, rows[2], status)


@compiled
def _motion(reference, errors, by_position, by_velocity, decision, room):
    """Return planned position [m], speed [m/s] and excess over the permitted speed [m/s], shape (3, nodes)."""
    n = decision.size
    found = np.empty((3, n))
    for j in range(n):
        place, speed = 0.0, 0.0
        for k in range(n):
            place += by_position[j, k] * decision[k]
            speed += by_velocity[j, k] * decision[k]
        found[0, j] = reference[0, j] + errors[0, j] + place
        found[1, j] = reference[1, j] + errors[1, j] + speed
        found[2, j] = max(speed - room[j], 0.0)
    return found
