"""Laws of the railway, each in one place: running resistance, friction of shoes, adhesion, envelopes, tables.

Every function takes numbers or arrays, in Python and in compiled code, with the same bits.
"""

# mypy: allow-untyped-defs, allow-untyped-decorators

import numpy as np

from plant_sim.compiled import also_compiled, compiled
from plant_sim.elementary import libm_tanh
from plant_sim.units import KMH

DRY_FRICTION_SPEED = 0.05
"""Speed below which the running resistance of a nominal train fades to 0 at standstill [m/s]."""
MIN_POWER_SPEED = 0.1
"""Speed below which power / v is computed at this speed [m/s]."""


@also_compiled
def shoe_force(at_standstill, speed):
    """Return the force of shoes at a speed [m/s] from that at standstill [N]: paper 000, eqs. (11), (12)."""
    kmh = KMH * abs(speed)
    return at_standstill * (2.0 * kmh + 150.0) / (3.0 * kmh + 150.0)


@also_compiled
def adhesion_by_speed(speed):
    """Return the adhesion between dry wheel and rail at a speed >= 0 [m/s], after Curtius and Kniffler."""
    return 0.161 + 7.5 / (KMH * speed + 44.0)


@also_compiled
def running_resistance(c0, c1, c2, velocity):
    """Return the size of the running resistance c0 + c1 v + c2 v² [N] at a speed [m/s]."""
    speed = abs(velocity)
    return c0 + c1 * speed + c2 * speed * speed


@also_compiled
def fading_resistance(c0, c1, c2, velocity):
    """Return the running resistance [N] at a speed [m/s], odd in the speed: it fades to 0 at standstill."""
    return running_resistance(c0, c1, c2, velocity) * libm_tanh(velocity / DRY_FRICTION_SPEED)


@also_compiled
def envelope_force(rows, first, end, speed):
    """Return the largest force [N] at a speed >= 0 [m/s] of the rows first ... end-1 of envelopes; 0 beyond them.

    A row is v_end, f0, f1, p with F = f0 + f1 v + p / v in SI.
    """
    for i in range(first, end):
        if speed <= rows[i][0]:
            row, divisor = rows[i], speed if speed > MIN_POWER_SPEED else MIN_POWER_SPEED
            force = row[1] + row[2] * speed + row[3] / divisor
            return force if force > 0.0 else 0.0
    return 0.0


@compiled
def each_envelope_force(rows, speeds):
    """Return :func:`envelope_force` of all rows at every speed of an array."""
    found = np.empty(speeds.shape)
    for i in range(speeds.size):
        found.flat[i] = envelope_force(rows, 0, len(rows), speeds.flat[i])
    return found


@also_compiled
def between_entries(table, place):
    """Return the value of a table at a place between its entries, 0 the first; the ends hold beyond them."""
    if place <= 0.0:
        return table[0]
    index = int(place)
    if index >= len(table) - 1:
        return table[len(table) - 1]
    return table[index] + (place - index) * (table[index + 1] - table[index])


@compiled
def each_between_entries(table, places):
    """Return :func:`between_entries` at every place of an array."""
    found = np.empty(places.size)
    for i in range(places.size):
        found[i] = between_entries(table, places[i])
    return found
