"""Points of a sweep: grid, random, Latin hypercube and Sobol designs over its dimensions."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from train_ato.apps.sweep.spec import SweepSpec
from train_ato.messages.types import Array

__all__ = ["MISSING_SCIPY", "Point", "design_points"]

Point = dict[str, Any]
"""Values of one run by key."""
MISSING_SCIPY = "the package scipy is not installed; install it with `pip install distributed scipy`"


def design_points(spec: SweepSpec) -> list[Point]:
    """Return the points of a sweep in the order of its runs.

    A grid has every combination, the last key varies fastest.  The other designs fill the unit cube of the coordinates:
    independent uniform numbers; a Latin hypercube (one point in each of n equal intervals of every coordinate); a
    scrambled Sobol sequence.  Equal specifications have equal points.

    Raises
    ------
    ValueError
        If the design needs scipy and it is not installed.

    Examples
    --------
    >>> from train_ato.apps.sweep.spec import read_sweep
    >>> design_points(read_sweep({"scenario": "demo", "over": {"law": ["pid", "smc"], "seed": [1, 2]}}))[1]
    {'law': 'pid', 'seed': 2}
    """
    if spec.design == "grid":
        values = (dimension.values for dimension in spec.dimensions)
        return [dict(zip(spec.keys, combination, strict=True)) for combination in product(*values)]
    shares = _shares(spec)
    return [
        {dimension.key: dimension.at(float(share)) for dimension, share in zip(spec.dimensions, row, strict=True)}
        for row in shares
    ]


def _shares(spec: SweepSpec) -> Array:
    """Return the coordinates of the points, shape (runs, dimensions), each of 0 to below 1."""
    count = len(spec.dimensions)
    generator = np.random.default_rng(spec.seed)
    if spec.design == "random":
        return generator.random((spec.runs, count))
    try:
        from scipy.stats import qmc
    except ImportError:
        raise ValueError(f"{spec.source}: design: {spec.design}: {MISSING_SCIPY}") from None
    if spec.design == "latin_hypercube":
        return np.asarray(qmc.LatinHypercube(count, rng=generator).random(spec.runs))
    return np.asarray(qmc.Sobol(count, rng=generator).random_base2(spec.runs.bit_length() - 1))
