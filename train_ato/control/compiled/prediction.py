"""Compiled prediction of the state at the effect of a command, with the operations of `predictor` in the same order."""

# mypy: allow-untyped-defs

from __future__ import annotations

from plant_sim.compiled import compiled
from plant_sim.railway import between_entries
from train_ato.control.compiled.entries import (
    TRAIN_ENTRIES,
    TRAIN_INERTIA,
    ordered_total,
    resisting_force,
)

# Entries of `constant`: those of the train, then own ones. P_BEGIN, P_SPACING: table of the resistance along the
# profile by time.
(
    P_STEP, P_DECAY, P_LASTING, P_USES_ESTIMATE, P_BEGIN, P_SPACING,
) = range(TRAIN_ENTRIES, TRAIN_ENTRIES + 6)  # fmt: skip
PREDICTION_ENTRIES = TRAIN_ENTRIES + 6


@compiled
def _along_profile(constant, table, t):
    """Return the resistance along the profile at a time [N], as ``RigidForce.resistance``."""
    return between_entries(table, (t - constant[P_BEGIN]) / constant[P_SPACING])


@compiled
def predict(t, constant, rows, table, history, line_force, shoes, inputs):
    """Replace measured position, speed and force of the units by those at the effect of the command.

    Parameters
    ----------
    t
        Time of the measurement [s].
    constant
        Array of :func:`train_ato.control.compiled.prediction_packing.packed_prediction`.
    rows : Array of int, shape (count, units)
        Rows of the history that are due in the middle of every sub-interval; empty without a delay.
    table
        Resistance along the profile [N].
    history : Array, shape (d, units)
        Commands in flight [N].
    line_force
        Line force on the train at its measured position [N].
    shoes
        Shoe force of the train at the effect [N].
    inputs
        Rows of :mod:`train_ato.control.compiled.entries`.
    """
    count, n = rows.shape
    if count == 0:
        return
    h, decay, lasting = constant[P_STEP], constant[P_DECAY], constant[P_LASTING]
    start, push = 0.0, 0.0
    for unit in range(n):
        start += inputs[unit].share * inputs[unit].velocity
        push += inputs[unit].disturbance if constant[P_USES_ESTIMATE] > 0.0 else 0.0 * inputs[unit].disturbance
    base = resisting_force(constant, start, line_force, shoes) - _along_profile(constant, table, t)
    force, speed, moved = ordered_total(inputs.applied), 0.0, 0.0
    for k in range(count):
        command = 0.0
        for unit in range(n):
            command += history[rows[k, unit], unit]
        resistance = base + _along_profile(constant, table, t + (k + 0.5) * h)
        mean = command + (force - command) * lasting
        pull = (mean + push - resistance) / constant[TRAIN_INERTIA]
        moved += (start + speed + 0.5 * pull * h) * h
        speed += pull * h
        force = command + (force - command) * decay
    for k in range(count):
        for unit in range(n):
            sent = history[rows[k, unit], unit]
            inputs[unit].applied = sent + (inputs[unit].applied - sent) * decay
    if start >= 0.0 > start + speed:
        moved, speed = moved if moved >= 0.0 else 0.0, -start
    for unit in range(n):
        inputs[unit].position += moved
        inputs[unit].velocity += speed
