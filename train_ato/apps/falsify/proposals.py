"""Next points of a falsification: Bayesian search for a break, then for a smaller departure.

A Gaussian process of the robustness has a mean and a standard deviation at every point; the next point has the lowest
lower confidence bound (N. Srinivas et al., "Gaussian process optimization in the bandit setting", ICML 2010). It was
chosen by measurement against CMA-ES, cross-entropy and random search (``studies_done/falsify.py``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from train_ato.messages.types import Array

LENGTHS = np.array([0.1, 0.2, 0.4, 0.8, 1.6, 3.2])
"""Lengths of the kernel that are tried, in unit coordinates."""
JITTER = 1e-6
"""Variance on the diagonal, for the numerical rank."""
SWEEPS = 2
"""Number of times that the length of every dimension is chosen."""


class GaussianProcess:
    """Mean and standard deviation of a function over the unit cube, from samples without noise.

    C. E. Rasmussen and C. K. I. Williams, "Gaussian Processes for Machine Learning", MIT Press 2006, algorithm 2.1 and
    eq. (5.8): Matern kernel 5/2 with a length for every dimension, of the largest marginal likelihood on a grid.

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


CONFIDENCE = 2.0
"""Number of standard deviations of the lower confidence bound."""
CANDIDATES = 600
"""Number of points among which the next one is chosen, in each of three sets."""
NEAR = 0.1
"""Standard deviation of the candidates around the best point, in unit coordinates."""
SAME = 1e-6
"""Largest difference of the coordinates of equal points."""
LARGEST_SET = 150
"""Largest number of runs in the Gaussian process: the lowest and the latest ones."""


def first_points(nominal: Array, count: int, stream: np.random.Generator) -> Array:
    """Return the nominal point and a Latin hypercube of ``count`` points, shape (1 + count, d)."""
    ranks = np.array([stream.permutation(count) for _ in nominal]).T
    cube = (ranks + stream.random((count, nominal.size))) / count
    return np.vstack([nominal, cube])


def next_points(
    points: Array, values: Sequence[float], nominal: Array, count: int, stream: np.random.Generator
) -> Array:
    """Return the next points of the search for a break, shape (count, d).

    Parameters
    ----------
    points : Array, shape (n, d)
        Points so far.
    values : shape (n,)
        Their robustness; NaN counts as the largest one.
    nominal : Array, shape (d,)
        Nominal point.
    count
        Number of points; further ones take the mean of the earlier ones as their result.
    stream
        Random stream.
    """
    points, known = _informative(points, _finite(values))
    found: list[Array] = []
    for _ in range(count):
        process = GaussianProcess(points, known)
        best = points[int(known.argmin())]
        candidates = _new(_candidates(best, nominal, stream), points)
        mean, deviation = process.predict(candidates)
        chosen = int(np.argmin(mean - CONFIDENCE * deviation))
        found.append(candidates[chosen])
        points, known = np.vstack([points, candidates[chosen]]), np.append(known, mean[chosen])
    return np.array(found)


def closer_points(
    points: Array, values: Sequence[float], nominal: Array, best: Array, reach: float, count: int,
    stream: np.random.Generator,
) -> Array:  # fmt: skip
    """Return points within ``reach`` times the departure of the best one, where a break is likely, shape (count, d)."""
    points, known = _informative(points, _finite(values))
    process = GaussianProcess(points, known)
    radius = reach * float(np.linalg.norm(best - nominal))
    steps = stream.normal(size=(2 * CANDIDATES, nominal.size)) * np.where(best == nominal, 0.3, 1.0)
    steps = np.vstack([steps, (best - nominal) + stream.normal(scale=0.3 * radius, size=steps.shape)])
    steps[stream.random(steps.shape) < 1.0 / (2 * nominal.size)] = 0.0
    norms = np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-12)
    shares = np.sqrt(stream.random((len(steps), 1)))
    candidates = np.clip(nominal + steps / norms * radius * np.maximum(shares, 0.7), 0.0, 1.0)
    candidates = _new(candidates, points)
    mean, deviation = process.predict(candidates)
    return np.asarray(candidates[np.argsort(mean - 0.5 * deviation)[:count]])


def _finite(values: Sequence[float]) -> Array:
    """Return the values; NaN becomes the largest finite one, minus infinity the smallest."""
    known = np.asarray(values, dtype=np.float64)
    finite = known[np.isfinite(known)]
    high, low = (finite.max(), finite.min()) if finite.size else (1.0, 1.0)
    return np.nan_to_num(known, nan=high, posinf=high, neginf=min(low, -1.0))


def _informative(points: Array, values: Array) -> tuple[Array, Array]:
    """Return at most :data:`LARGEST_SET` runs."""
    if len(points) <= LARGEST_SET:
        return points, values
    half = LARGEST_SET // 2
    kept = np.union1d(np.argsort(values)[:half], np.arange(len(points) - half, len(points)))
    return points[kept], values[kept]


def _new(candidates: Array, points: Array) -> Array:
    """Return the candidates that differ from all points."""
    distance = np.abs(candidates[:, None, :] - points[None, :, :]).max(axis=2).min(axis=1)
    return np.asarray(candidates[distance > SAME])


def _candidates(best: Array, nominal: Array, stream: np.random.Generator) -> Array:
    """Return points of the whole cube, of its corners and faces, and around the best point."""
    size = best.size
    anywhere = stream.random((CANDIDATES, size))
    corners = stream.integers(0, 2, (CANDIDATES, size)).astype(np.float64)
    choice = stream.random((CANDIDATES, size))
    faces = np.where(choice < 0.6, corners, np.where(choice < 0.8, nominal, stream.random((CANDIDATES, size))))
    around = np.clip(best + stream.normal(scale=NEAR, size=(CANDIDATES, size)), 0.0, 1.0)
    return np.vstack([anywhere, faces, around])
