"""Sums of floating-point numbers with the same bits in every version of Python.

The built-in ``sum`` adds floats in order up to Python 3.11; from 3.12 it compensates the rounding errors (Neumaier), so
that its last bits are different.  These functions add in order, without compensation, in every version: the bits are
those of ``sum`` in Python 3.11.  ``math.fsum`` and ``numpy.sum`` have other bits.

``test/test_summation.py`` refuses the built-in ``sum`` of floats in the layers of a run.
"""

from __future__ import annotations

from collections.abc import Iterable
from operator import mul


def plain_sum(values: Iterable[float]) -> float:
    """Return the sum of numbers, added in order from 0.0.

    Parameters
    ----------
    values
        Numbers, also those of an iterator; 0.0 is returned if there is none.
    """
    total = 0.0
    for value in values:
        total += value
    return total


def plain_dot(one: Iterable[float], other: Iterable[float]) -> float:
    """Return the sum of the products of paired numbers, added in order from 0.0.

    Parameters
    ----------
    one, other
        Numbers; the shorter of the two ends the sum.
    """
    total = 0.0
    for product in map(mul, one, other):
        total += product
    return total
