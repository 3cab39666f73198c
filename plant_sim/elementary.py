"""Exponential, sine and cosine of arrays with the functions of the C library, entry by entry.

numpy has variants of these functions for processors with AVX-512, with other last bits; on other processors its bits
are those of the C library.  The functions here have the bits of the C library, those of ``math``, on every processor:
the symbols of the library are called, so that neither LLVM nor the vector library of Intel (SVML, used by numba if
installed) replaces them.
"""

from __future__ import annotations

import numpy as np
from numba import types

from plant_sim.compiled import compiled
from plant_sim.states import Array

_OF_FLOAT = types.float64(types.float64)
libm_exp = types.ExternalFunction("exp", _OF_FLOAT)
libm_tanh = types.ExternalFunction("tanh", _OF_FLOAT)
libm_pow = types.ExternalFunction("pow", types.float64(types.float64, types.float64))
"""Functions of the C library for compiled code: ``math.exp``, ``math.tanh`` and ``**`` of Python call the same ones."""
_sin = types.ExternalFunction("sin", _OF_FLOAT)
_cos = types.ExternalFunction("cos", _OF_FLOAT)


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
        found[i] = _sin(values[i])
    return found


@compiled
def cos_each(values: Array) -> Array:
    """Return the cosine of every entry [rad] of a one-dimensional array."""
    found = np.empty(values.size)
    for i in range(values.size):
        found[i] = _cos(values[i])
    return found
