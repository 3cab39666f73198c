"""Search of a falsification: find a break of a requirement, then the smallest departure that still breaks it.

A Gaussian process of the robustness has a mean and a standard deviation at every point. The next point has the lowest
lower confidence bound (N. Srinivas et al., "Gaussian process optimization in the bandit setting", ICML 2010). This
method was chosen by measurement against CMA-ES, cross-entropy and random search (``studies_done/falsify.py``).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel

from plant_sim.input_error import close_match
from plant_sim.library import read_yaml
from plant_sim.si_model import SiModel
from train_ato.api.scenario_choice import ScenarioChoice
from train_ato.messages.types import Array
from train_ato.scenario.dimensions import Dimension, read_dimensions
from train_ato.scenario.overlays import keys_of


@dataclass(frozen=True)
class SearchSpace:
    """Dimensions with the nominal point.

    Attributes
    ----------
    dimensions
        Keys of the scenario with their ranges or lists.
    nominal : Array, shape (d,)
        Coordinates of the scenario, 0 to 1.
    nominal_values
        Values of the scenario by key.
    """

    dimensions: tuple[Dimension, ...]
    nominal: Array
    nominal_values: dict[str, Any]

    @property
    def size(self) -> int:
        """Number of dimensions."""
        return len(self.dimensions)

    def values(self, point: Array) -> dict[str, Any]:
        """Return the values of a point by key; at a nominal coordinate exactly the value of the scenario."""
        return {
            entry.key: self.nominal_values[entry.key]
            if share == nominal
            else float(f"{value:.12g}")
            if isinstance(value := entry.at(float(share)), float)
            else value
            for entry, share, nominal in zip(self.dimensions, point, self.nominal, strict=True)
        }

    def on_values(self, point: Array) -> Array:
        """Return a point moved to representable values: entries of lists, integers, and the nominal value."""
        shares = []
        for entry, share, nominal in zip(self.dimensions, np.clip(point, 0.0, 1.0), self.nominal, strict=True):
            value = entry.at(float(share))
            exact = not entry.is_range or entry.integer
            same = exact and value == self.nominal_values[entry.key]
            shares.append(float(nominal) if same else entry.share(value) if exact else float(share))
        return np.array(shares)

    def departure(self, point: Array) -> float:
        """Return the distance from the nominal point: Euclidean norm of the coordinates, 1 for another list entry."""
        steps = [
            share - nominal if entry.is_range else float(share != nominal)
            for entry, share, nominal in zip(self.dimensions, point, self.nominal, strict=True)
        ]
        return float(np.linalg.norm(steps))


def read_spec(path: Path) -> tuple[Dimension, ...]:
    """Return the dimensions of a spec file with the block ``over:``."""
    if not path.is_file():
        raise ValueError(f"--over {path}: no such file; write a YAML file with the block 'over:'")
    data = read_yaml(path)
    if not isinstance(data, Mapping) or "over" not in data:
        raise ValueError(f"{path}: over: this key is missing; add it, for example 'over: {{seed: [1, 2, 3]}}'")
    for key in data:
        if key != "over":
            raise ValueError(f"{path}: {key}: unknown key{close_match(str(key), ['over'])} (known: over)")
    return read_dimensions(data["over"], f"{path}: over")


def search_space(choice: ScenarioChoice, dimensions: Sequence[Dimension], where: str) -> SearchSpace:
    """Return the space of a scenario; every end of a range is checked with the scenario before a run.

    Parameters
    ----------
    choice, dimensions
        Nominal scenario, and the keys that vary.
    where
        Begin of messages: file and key.

    Raises
    ------
    ValueError
        For a key without a nominal value, a nominal value outside of its range, or an end that the scenario refuses.
    """
    nominal, values = [], {}
    for entry in dimensions:
        place = f"{where}: {entry.key}"
        value: Any = choice.checked
        for part in keys_of(entry.key):
            value = _below(value, part, place)
            if value is None:
                raise ValueError(f"{place}: the scenario has no value; add its nominal value to the scenario")
        nominal.append(_coordinate(entry, value, place))
        values[entry.key] = value
    for entry in dimensions:
        for end in (entry.low, entry.high) if entry.is_range else entry.values:
            try:
                choice.with_({entry.key: int(end) if entry.integer and end is not None else end}).prepare()
            except ValueError as error:
                raise ValueError(f"{where}: {entry.key}: {end}: the scenario refuses this value: {error}") from None
    return SearchSpace(tuple(dimensions), np.array(nominal), values)


def _coordinate(entry: Dimension, value: Any, place: str) -> float:
    if not entry.is_range:
        if value not in entry.values:
            raise ValueError(f"{place}: the list lacks {value!r}, the value of the scenario; add it")
        return entry.share(value)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{place}: {value!r} of the scenario is no number; give one number there, or a list here")
    assert entry.low is not None
    assert entry.high is not None
    if not entry.low <= value <= entry.high:
        ends = f"{entry.low:g} to {entry.high:g}"
        raise ValueError(f"{place}: {value:g}, the value of the scenario, is outside of {ends}; widen the range")
    return entry.share(value)


def _below(found: Any, part: str, place: str) -> Any:
    """Return an entry of a model, a mapping or a list; None for a missing value."""
    if isinstance(found, (list, tuple)):
        if not part.isdigit() or int(part) >= len(found):
            remedy = f"use 0 to {len(found) - 1}" if found else "add an entry to the scenario"
            raise ValueError(f"{place}: '{part}' is no entry of a list of {len(found)}; {remedy}")
        return found[int(part)]
    if isinstance(found, Mapping):
        return found.get(part)
    fields = type(found).model_fields if isinstance(found, BaseModel) else {}
    if part in fields:
        return getattr(found, part)
    suffixed = found.suffixed_keys() if isinstance(found, SiModel) else {}
    if part not in suffixed:
        raise ValueError(f"{place}: unknown key '{part}'{close_match(part, [*fields, *suffixed])}")
    name, divisor = suffixed[part]
    value = getattr(found, name)
    return float(f"{value * divisor:.12g}") if isinstance(value, (int, float)) else value


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
                variants = np.tile(self._lengths, (LENGTHS.size, 1))
                variants[:, axis] = LENGTHS
                self._lengths = max(variants, key=self._likelihood)
        self._factor = self._cholesky(self._lengths)
        self._weights = np.linalg.solve(self._factor.T, np.linalg.solve(self._factor, self._targets))

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
MAX_SET = 150
"""Largest number of runs in the Gaussian process: the lowest and the latest ones."""


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
    points: Array, values: Sequence[float], nominal: Array, best: Array, *, reach: float, count: int,
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
    """Return at most :data:`MAX_SET` runs."""
    if len(points) <= MAX_SET:
        return points, values
    half = MAX_SET // 2
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


class TargetRun(NamedTuple):
    """Robustness of one run, NaN if unknown, and the reason of a refused or failed run, else ""."""

    robustness: float
    problem: str = ""

    @property
    def breaks(self) -> bool:
        """Return True if the run breaks the requirement."""
        return self.robustness < 0.0


RunAll = Callable[[Sequence[dict[str, Any]]], Iterable[TargetRun]]
"""Function that runs the scenario with each of several sets of changes, in their order."""
BISECTIONS = 6
"""Halvings of the distance between a break and the nominal point: 1/64 of it remains."""
REACHES = (0.8, 0.9, 0.95)
"""Departures that are tried, over the smallest one so far; after a success from the first one again."""


@dataclass(frozen=True)
class SearchRow:
    """One run: its number from 1, phase of the search, point, departure from nominal and result."""

    number: int
    phase: str
    point: Array
    departure: float
    run: TargetRun


def smallest_break(rows: Iterable[SearchRow]) -> SearchRow | None:
    """Return the run that breaks the requirement with the smallest departure; None without a break."""
    return min((row for row in rows if row.run.breaks), key=lambda row: row.departure, default=None)


class FalsificationSearch:
    """Search with a limited number of runs.

    Parameters
    ----------
    space
        Dimensions and nominal point.
    run_all
        Function that runs points in unit coordinates as values by key.
    runs
        Largest number of runs.
    batch
        Number of points that are chosen and run together.
    seed
        Seed of the random stream.
    note
        Called with every row.
    """

    def __init__(
        self, space: SearchSpace, run_all: RunAll, runs: int, batch: int = 1, *, seed: int = 1,
        note: Callable[[SearchRow], None] | None = None,
    ) -> None:  # fmt: skip
        self.space, self.rows = space, list[SearchRow]()
        self._run_all, self._runs, self._batch, self._note = run_all, runs, batch, note
        self._stream = np.random.default_rng(seed)

    @property
    def smallest(self) -> SearchRow | None:
        """Run that breaks the requirement with the smallest departure; None without a break."""
        return smallest_break(self.rows)

    @property
    def left(self) -> int:
        """Number of runs that are left."""
        return self._runs - len(self.rows)

    def find(self) -> None:
        """Run points until one breaks the requirement; the nominal point is the first one."""
        nominal, size = self.space.nominal, self.space.size
        ranks = np.array([self._stream.permutation(size + 1) for _ in nominal]).T
        first = (ranks + self._stream.random((size + 1, size))) / (size + 1)  # a Latin hypercube
        self._run(nominal[None], "nominal")
        for begin in range(0, len(first), self._batch):
            if self.smallest is None:
                self._run(first[begin : begin + self._batch], "search")
        while self.smallest is None and self.left > 0:
            points = next_points(*self._known(), nominal, self._batch, self._stream)
            if not self._run(points, "search"):
                self._run(self._stream.random((self._batch, size)), "search")

    def shrink(self) -> None:
        """Reduce the departure of the break: fewer keys, towards the nominal point, then other directions."""
        if self.smallest is None or self.smallest.departure == 0.0:
            return
        self._drop_keys()
        self._bisect()
        tries = 0
        while tries < len(REACHES) and self.left > 0:
            best = self.smallest
            points = closer_points(
                *self._known(), self.space.nominal, best.point, reach=REACHES[tries], count=self._batch,
                stream=self._stream,
            )  # fmt: skip
            self._run(points, "shrink")
            if self.smallest is best:
                tries += 1
                continue
            tries = 0
            self._bisect()
        self._drop_keys()
        self._bisect()

    def _drop_keys(self) -> None:
        """Set every key to its nominal value if the rest still breaks the requirement, the smallest step first."""
        best = self.smallest
        assert best is not None
        for axis in np.argsort(np.abs(best.point - self.space.nominal)):
            best = self.smallest
            assert best is not None
            point = best.point.copy()
            point[axis] = self.space.nominal[axis]
            if point[axis] != best.point[axis]:
                self._run(point[None], "shrink")

    def _bisect(self) -> None:
        """Halve the distance between the nominal point and the break on their connecting line."""
        best = self.smallest
        assert best is not None
        held, broken = 0.0, 1.0
        for _ in range(BISECTIONS):
            middle = 0.5 * (held + broken)
            rows = self._run(self.space.nominal + middle * (best.point - self.space.nominal)[None], "shrink")
            if not rows:
                return
            held, broken = (held, middle) if rows[0].run.breaks else (middle, broken)

    def _known(self) -> tuple[Array, list[float]]:
        return np.array([row.point for row in self.rows]), [row.run.robustness for row in self.rows]

    def _run(self, points: Array, phase: str) -> list[SearchRow]:
        """Run the points that are new, as far as runs are left; return their rows."""
        fresh: list[Array] = []
        for wanted in points:
            point = self.space.on_values(wanted)
            seen = (*(row.point for row in self.rows), *fresh)
            if not any(np.array_equal(point, other) for other in seen) and len(fresh) < self.left:
                fresh.append(point)
        found = []
        for point, run in zip(fresh, self._run_all([self.space.values(point) for point in fresh]), strict=True):
            row = SearchRow(len(self.rows) + 1, phase, point, self.space.departure(point), run)
            self.rows.append(row)
            found.append(row)
            if self._note is not None:
                self._note(row)
        return found
