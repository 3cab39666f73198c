"""Entries of the arrays of the compiled laws and observers, and their common operations."""

# mypy: allow-untyped-defs

from __future__ import annotations

from plant_sim.compiled import compiled
from plant_sim.railway import fading_resistance

# Entries of the constants of a train as one mass and its resistance.
TRAIN_INERTIA, TRAIN_C0, TRAIN_C1, TRAIN_C2 = range(4)
TRAIN_ENTRIES = 4


@compiled
def mean_of_units(share, values, n):
    """Return the mean over the units, weighted by their shares."""
    if n == 1:
        return values[0]
    total = 0.0
    for unit in range(n):
        total += share[unit] * values[unit]
    return total


@compiled
def ordered_total(values):
    """Return the sum of the entries, added in order from 0."""
    total = 0.0
    for value in values:
        total += value
    return total


@compiled
def resisting_force(train, speed, line_force, shoe_force):
    """Return running, line and shoe force on the train [N], > 0 resists, from its constants and its speed [m/s]."""
    return fading_resistance(train[TRAIN_C0], train[TRAIN_C1], train[TRAIN_C2], speed) + line_force + shoe_force
