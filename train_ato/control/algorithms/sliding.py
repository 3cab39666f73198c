"""Smooth signs and powers of the sliding-mode laws and cascades, for Python and compiled code."""

# mypy: allow-untyped-defs, allow-untyped-decorators

from math import copysign

from plant_sim.compiled import also_compiled
from plant_sim.elementary import libm_pow


@also_compiled
def clamped(value, low, high):
    """Return ``min(max(value, low), high)``, with the results of Python for equal values."""
    raised = low if low > value else value
    return high if high < raised else raised


@also_compiled
def saturation(value, width):
    """Return the sign, linear within a boundary layer of ``width``; the sign itself for a width of 0."""
    if width <= 0.0:
        return 1.0 if value > 0.0 else -1.0 if value < 0.0 else 0.0
    return clamped(value / width, -1.0, 1.0)


@also_compiled
def sig(value, power):
    """Return ``|value|^power sign(value)``, written sig^p in paper 002."""
    return copysign(libm_pow(abs(value), power), value) if value != 0.0 else 0.0
