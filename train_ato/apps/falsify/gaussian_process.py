"""Gaussian process over the unit cube: mean and standard deviation of a function from noise-free samples.

C. E. Rasmussen and C. K. I. Williams, "Gaussian Processes for Machine Learning", MIT Press 2006, algorithm 2.1 and
eq. (5.8): Matern kernel 5/2 with a length for every dimension, of the largest marginal likelihood on a grid.
"""

from __future__ import annotations

import numpy as np

from train_ato.messages.types import Array

LENGTHS = np.array([0.1, 0.2, 0.4, 0.8, 1.6, 3.2])
"""Lengths of the kernel that are tried, in unit coordinates."""
JITTER = 1e-6
"""Variance on the diagonal, for the numerical rank."""
SWEEPS = 2
"""Number of times that the length of every dimension is chosen."""


class GaussianProcess:
    """Regression of a function.

    Parameters
    ----------
    points : Array, shape (n, d)
        Samples in unit coordinates.
    values : Array, shape (n,)
        Values of the function, finite.
    """

    def __init__(self, points: Array, values: Array) -> None:
        self._points = points
        self._mean = float(values.mean())
        self._scale = float(values.std()) or 1.0
        self._targets = (values - self._mean) / self._scale
        self._lengths = np.full(points.shape[1], 0.8)
        for _ in range(SWEEPS):
            for axis in range(points.shape[1]):
                self._lengths = max(self._variants(axis), key=self._likelihood)
        self._factor = self._cholesky(self._lengths)
        self._weights = np.linalg.solve(self._factor.T, np.linalg.solve(self._factor, self._targets))

    def _variants(self, axis: int) -> list[Array]:
        variants = [self._lengths.copy() for _ in LENGTHS]
        for variant, length in zip(variants, LENGTHS, strict=True):
            variant[axis] = length
        return variants

    def _cholesky(self, lengths: Array) -> Array:
        kernel = _matern(self._points, self._points, lengths)
        return np.asarray(np.linalg.cholesky(kernel + JITTER * np.eye(len(kernel))))

    def _likelihood(self, lengths: Array) -> float:
        """Return the logarithm of the marginal likelihood, with the variance of the samples as its scale."""
        factor = self._cholesky(lengths)
        fit = np.linalg.solve(factor, self._targets)
        scale = float(fit @ fit) / fit.size
        return -0.5 * fit.size * float(np.log(max(scale, 1e-12))) - float(np.log(np.diag(factor)).sum())

    def predict(self, points: Array) -> tuple[Array, Array]:
        """Return mean and standard deviation at points of shape (m, d), shape (m,) each."""
        cross = _matern(points, self._points, self._lengths)
        spread = np.linalg.solve(self._factor, cross.T)
        variance = np.maximum(0.0, 1.0 - (spread**2).sum(axis=0))
        return self._mean + self._scale * (cross @ self._weights), self._scale * np.sqrt(variance)


def _matern(one: Array, other: Array, lengths: Array) -> Array:
    """Return the kernel of two sets of points, shape (n, m)."""
    steps = (one[:, None, :] - other[None, :, :]) / lengths
    distance = np.sqrt(5.0 * (steps**2).sum(axis=2))
    return np.asarray((1.0 + distance + distance**2 / 3.0) * np.exp(-distance))
