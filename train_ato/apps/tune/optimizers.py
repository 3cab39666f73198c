"""Optimizer of the search for gains on the unit cube: CMA-ES of the package ``cma``.

Hansen N., The CMA Evolution Strategy: A Tutorial, 2016, arXiv:1604.00772. Its choice over the samplers of optuna, with
figures, is in msgs_docs/tuning.md.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

SPREAD = 0.2
"""Initial standard deviation, as part of the range of every gain."""
INSTALL = "pip install cma"


class GainOptimizer(Protocol):
    """Search on the unit cube, one generation of points after the other."""

    def ask(self) -> list[list[float]]:
        """Return the points of the next generation."""

    def tell(self, points: Sequence[Sequence[float]], scores: Sequence[float]) -> None:
        """Take the scores of the points; smaller is better."""


MakeOptimizer = Callable[[Sequence[float], int, int], GainOptimizer]
"""Function of start point, seed and population."""


def check_optimizer() -> None:
    """Refuse a search without the package of the optimizer.

    Raises
    ------
    ValueError
        With the command that installs it.
    """
    try:
        importlib.import_module("cma")
    except ImportError:
        raise ValueError(f"tune: the package 'cma' is not installed; install it: {INSTALL}") from None


class CmaOptimizer:
    """CMA-ES with bounds 0 and 1.

    Parameters
    ----------
    start
        Point of the scenario's gains, the mean of the first generation.
    seed
        Seed of the search.
    population
        Points of a generation.
    """

    def __init__(self, start: Sequence[float], seed: int, population: int) -> None:
        import cma

        self._single = len(start) == 1
        # cma needs two dimensions; a second one without effect
        first = [*start, 0.5] if self._single else list(start)
        random = np.random.default_rng(seed)
        options = {
            "bounds": [0.0, 1.0],
            "seed": np.nan,  # a stream of its own in place of the global one of numpy
            "randn": lambda *shape: random.standard_normal(shape),
            "popsize": population,
            "verbose": -9,
            "verb_log": 0,
        }
        self._search: Any = cma.CMAEvolutionStrategy(first, SPREAD, options)
        self._asked: list[Any] = []

    def ask(self) -> list[list[float]]:
        """Return the points of the next generation."""
        self._asked = self._search.ask()
        return [[float(share) for share in (point[:1] if self._single else point)] for point in self._asked]

    def tell(self, points: Sequence[Sequence[float]], scores: Sequence[float]) -> None:
        """Update mean, step size and covariance with the scores of the generation."""
        self._search.tell(self._asked, list(scores))
