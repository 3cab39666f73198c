"""Exponential, sine and cosine of arrays with the functions of the C library, entry by entry.

numpy has variants of these functions for processors with AVX-512, with other last bits; on other processors its bits
are those of the C library.  The functions here have the bits of the C library, those of ``math``, on every processor:
the symbols of the library are called, so that neither LLVM nor the vector library of Intel (SVML, used by numba if
installed) replaces them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import config, types
from numba.extending import overload

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


@compiled
def exp_each(values: Array) -> Array:
    """Return the exponential of every entry of a one-dimensional array."""
    found = np.empty(values.size)
    for i in range(values.size):
        found[i] = libm_exp(values[i])
    return found


@compiled
def sin_each(values: Array) -> Array:
    """Return the sine of every entry [rad] of a one-dimensional array."""
    found = np.empty(values.size)
    for i in range(values.size):
        found[i] = libm_sin(values[i])
    return found


@compiled
def cos_each(values: Array) -> Array:
    """Return the cosine of every entry [rad] of a one-dimensional array."""
    found = np.empty(values.size)
    for i in range(values.size):
        found[i] = libm_cos(values[i])
    return found
