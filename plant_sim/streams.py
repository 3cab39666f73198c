"""Seeded random numbers with one stream per named source, so that a new source does not change the others."""

import zlib

import numpy as np


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
