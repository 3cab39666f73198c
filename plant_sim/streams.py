"""Seeded random numbers: one stream for each named source, so that adding a source changes no other."""

from __future__ import annotations

import zlib

import numpy as np


def stream(seed: int, name: str) -> np.random.Generator:
    """Return the Philox generator of a named source: key (seed, crc32(name)).

    Whoever draws from it draws a fixed count each tick, whether the numbers are used or not; switching a noise on
    then changes no other noise.

    Examples
    --------
    >>> float(stream(1, "a").standard_normal()) == float(stream(1, "b").standard_normal())
    False
    """
    key = np.array([seed & 0xFFFFFFFFFFFFFFFF, zlib.crc32(name.encode())], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key))
