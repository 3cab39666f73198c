"""Exponential, sine, cosine and hyperbolic tangent of arrays with the functions of the C library, entry by entry.

On processors with AVX-512 numpy has variants of these functions with other last bits. On other processors its bits are
those of the C library. The functions here have the bits of the C library (those of ``math``) on every processor. They
call the symbols of the library, so that neither LLVM nor the vector library of Intel (SVML, used by numba if installed)
replaces them.

Sums and matrix products of floating-point numbers with the same bits in every version of Python and every processor.

The built-in ``sum`` adds floats in order up to Python 3.11; from 3.12 it compensates the rounding errors (Neumaier), so
that its last bits are different.  These functions add in order, without compensation, in every version: the bits are
those of ``sum`` in Python 3.11.  ``math.fsum`` and ``numpy.sum`` have other bits.

``test/test_summation.py`` refuses the built-in ``sum`` of floats in the layers of a run.

Random numbers have one seeded stream per named source, so that a new source does not change the others.
"""

import math
import zlib
from collections.abc import Iterable, Sequence
from operator import mul
from typing import Any

import numpy as np
from numba import config, types
from numba.extending import overload
from numpy.typing import NDArray

from plant_sim.compiled import compiled
from plant_sim.states import Array


def _of_library(name: str, arguments: int = 1) -> Any:
    """Return a function of ``math``, which compiled code replaces by that of the C library."""
    plain: Any = getattr(math, name)
    if config.DISABLE_JIT:
        return plain
    library: Any = types.ExternalFunction(name, types.float64(*[types.float64] * arguments))
    if arguments == 1:
        found: Any = lambda x: plain(x)  # noqa: E731
        overload(found)(lambda x: lambda x: library(x))
    else:
        found = lambda x, y: plain(x, y)  # noqa: E731
        overload(found)(lambda x, y: lambda x, y: library(x, y))
    found.__qualname__ = name
    return found


libm_exp, libm_tanh, libm_pow = _of_library("exp"), _of_library("tanh"), _of_library("pow", 2)
libm_sin, libm_cos = _of_library("sin"), _of_library("cos")
"""Functions of the C library, in Python and in compiled code: ``**`` of Python calls the same ``pow``."""


def _of_each_entry(function: Any) -> Any:
    """Return the compiled function of every entry of a one-dimensional array."""

    @compiled
    def each(values: NDArray[np.float64]) -> Array:
        found = np.empty(values.size)
        for i in range(values.size):
            found[i] = function(values[i])
        return found

    return each


exp_each, tanh_each = _of_each_entry(libm_exp), _of_each_entry(libm_tanh)
sin_each, cos_each = _of_each_entry(libm_sin), _of_each_entry(libm_cos)
"""Functions of every entry of a one-dimensional array, angles in rad."""


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


PAIRWISE = 8
"""Number of entries from which numpy adds in pairs."""


def total_of_units(values: NDArray[np.float64]) -> float:
    """Return ``values.sum()``, for few units without its 1.4 us: numpy adds less than eight entries in order, too."""
    if values.size >= PAIRWISE:
        return float(values.sum())
    total = 0.0
    for value in values.tolist():
        total += value
    return total


def mean_over_units(share: Sequence[float], values: Sequence[float]) -> float:
    """Return sum share_i value_i; the shares sum to 1 (:attr:`train_ato.control.train_model.TrainModel.share`)."""
    return plain_dot(share, values)


def dot_of(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Return the sum of products in the order of ``numpy.sum``; ``@`` has that of the processor's code in OpenBLAS."""
    return float((one * other).sum())


@compiled
def matrix_product(left: NDArray[np.float64], right: NDArray[np.float64]) -> Array:
    """Return the product of two matrices, added in order; ``@`` has the order of the processor's code in OpenBLAS."""
    found = np.zeros((left.shape[0], right.shape[1]))
    for i in range(left.shape[0]):
        for k in range(left.shape[1]):
            if left[i, k] != 0.0:
                for j in range(right.shape[1]):
                    found[i, j] += left[i, k] * right[k, j]
    return found


@compiled
def numpy_total(values: NDArray[np.float64]) -> float:
    """Return the sum in the order of ``numpy.sum``: eight sums side by side, for more than 128 entries in two parts."""
    n = len(values)
    total: float = 0.0
    if n < PAIRWISE:
        for value in values:
            total += value
        return total
    if n > 128:
        half = n // 2 - n // 2 % 8
        return float(numpy_total(values[:half]) + numpy_total(values[half:]))
    sums = values[:8].copy()
    whole = n - n % 8
    for first in range(8, whole, 8):
        for j in range(8):
            sums[j] += values[first + j]
    total = ((sums[0] + sums[1]) + (sums[2] + sums[3])) + ((sums[4] + sums[5]) + (sums[6] + sums[7]))
    for i in range(whole, n):
        total += values[i]
    return float(total)


def random_stream(seed: int, name: str) -> np.random.Generator:
    """Return the Philox generator of a named source, with the key (seed, crc32(name)).

    A source must draw the same count in every tick, whether the numbers are used or not, so that one noise does not
    change another.

    Examples
    --------
    >>> float(random_stream(1, "a").standard_normal()) == float(random_stream(1, "b").standard_normal())
    False
    """
    key = np.array([seed & 0xFFFFFFFFFFFFFFFF, zlib.crc32(name.encode())], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key))
