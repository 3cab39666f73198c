"""Specification of a sweep: scenario, design, varied keys and fixed keys, from a YAML file or a mapping."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from plant_sim.input_error import close_match, kind_of
from plant_sim.library import read_yaml, split_name
from train_ato.messages.types import Array
from train_ato.scenario.dimensions import Dimension, read_dimensions

DESIGNS = ("grid", "random", "latin_hypercube", "sobol")
KEYS = ("scenario", "design", "runs", "seed", "over", "set")
MAX_RUNS = 1_000_000
GRID_STEPS = 5
"""Number of values of a range without ``steps`` in a grid."""


@dataclass(frozen=True)
class SweepSpec:
    """Checked specification of a sweep.

    Attributes
    ----------
    scenario
        Shipped name or file of the scenario, with its variants, or its content.
    design
        Entry of :data:`DESIGNS`.
    runs
        Number of runs.
    seed
        Seed of the design; the seed of a run is the scenario's key ``seed``.
    dimensions
        Varied keys.
    fixed
        Other keys of the scenario and their values.
    data
        The specification as plain data, for the folder of the sweep.
    source
        Name of the file, or ``sweep``, for messages.
    """

    scenario: str | dict[str, Any]
    design: str
    runs: int
    seed: int
    dimensions: tuple[Dimension, ...]
    fixed: dict[str, Any]
    data: dict[str, Any]
    source: str

    @property
    def title(self) -> str:
        """Name of the scenario without the folder of its file."""
        if not isinstance(self.scenario, str):
            return str(self.scenario.get("name", self.scenario.get("base")))
        stem, variants = split_name(self.scenario)
        return f"{Path(stem).stem}{variants}"

    @property
    def keys(self) -> list[str]:
        """Varied keys."""
        return [dimension.key for dimension in self.dimensions]


def read_sweep(spec: str | Path | Mapping[str, Any], source: str | None = None) -> SweepSpec:
    """Return the specification of a sweep.

    Parameters
    ----------
    spec
        YAML file, or its content.
    source
        Begin of messages; default: the file, or ``sweep``.

    Examples
    --------
    >>> spec = read_sweep({"scenario": "demo", "design": "grid",
    ...     "over": {"law": ["pid", "smc"], "plant.lag": {"from": 0.1, "to": 0.5, "steps": 3}}})
    >>> spec.runs
    6
    """
    folder = Path()
    if isinstance(spec, Mapping):
        data: Any = dict(spec)
        if isinstance(over := data.get("over"), Mapping):
            data["over"] = {key: _listed(entry) for key, entry in over.items()}
    else:
        path = Path(spec)
        if not path.is_file():
            problem = "is a folder without a sweep" if path.is_dir() else "no such file"
            raise ValueError(f"{path}: {problem}; name a specification of a sweep, or the folder of one")
        data, folder = read_yaml(path), path.parent
        source = source or str(path)
    source = source or "sweep"
    if not isinstance(data, dict):
        raise ValueError(f"{source}: a sweep is a mapping of keys, not {kind_of(data)}; correct it")
    for key in data:
        if key not in KEYS:
            raise ValueError(f"{source}: {key}: unknown key{close_match(str(key), KEYS)}; use {', '.join(KEYS)}")
    return _checked(data, folder, source)


def _listed(entry: Any) -> Any:
    """Return a range, tuple or array of a program as the list that a file has."""
    if isinstance(entry, np.ndarray):
        return entry.tolist()
    return list(entry) if isinstance(entry, (range, tuple)) else entry


def _checked(data: dict[str, Any], folder: Path, source: str) -> SweepSpec:
    """Return the specification of known keys."""
    design = data.get("design", "grid")
    if design not in DESIGNS:
        raise ValueError(
            f"{source}: design: '{design}' is unknown{close_match(str(design), DESIGNS)}; use one of: "
            f"{', '.join(DESIGNS)}"
        )
    dimensions = read_dimensions(data.get("over"), f"{source}: over", default_steps=GRID_STEPS)
    fixed = data.get("set", {})
    if not isinstance(fixed, Mapping):
        raise ValueError(f"{source}: set: {fixed!r}: not a mapping; write {{plant.lag: 0.4}}")
    for dimension in dimensions:
        if dimension.key in fixed:
            raise ValueError(f"{source}: set: {dimension.key}: varies in over; remove it from one of them")
    runs = _runs(data, design, dimensions, source)
    seed = _whole(data.get("seed", 0), 0, 2**32 - 1, f"{source}: seed")
    return SweepSpec(
        scenario=_scenario(data.get("scenario"), folder, source),
        design=design,
        runs=runs,
        seed=seed,
        dimensions=dimensions,
        fixed={str(key): value for key, value in fixed.items()},
        data=data,
        source=source,
    )


def _runs(data: Mapping[str, Any], design: str, dimensions: tuple[Dimension, ...], source: str) -> int:
    """Return the number of runs."""
    if design == "grid":
        if "runs" in data:
            raise ValueError(f"{source}: runs: a grid has its own number of runs; remove it, or choose another design")
        runs = prod(len(dimension.values) for dimension in dimensions)
        if runs > MAX_RUNS:
            raise ValueError(f"{source}: over: the grid has {runs} runs, at most {MAX_RUNS}; use fewer values")
        return runs
    if "runs" not in data:
        raise ValueError(f"{source}: runs: is missing; add the number of runs of the design {design}")
    runs = _whole(data["runs"], 1, MAX_RUNS, f"{source}: runs")
    if design == "sobol" and runs & (runs - 1):
        below = 1 << (runs.bit_length() - 1)
        raise ValueError(
            f"{source}: runs: {runs}: is not a power of 2, as a Sobol sequence needs; use {below} or {2 * below}"
        )
    return runs


def _whole(value: Any, low: int, high: int, where: str) -> int:
    """Return an integer within limits."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{where}: {value!r}: is not an integer of {low} ... {high}; correct it")
    return value


def _scenario(name: Any, folder: Path, source: str) -> str | dict[str, Any]:
    """Return name, file or content of the scenario; a file beside the specification comes first."""
    if isinstance(name, Mapping):
        return dict(name)
    if not isinstance(name, (str, Path)) or not str(name):
        raise ValueError(f"{source}: scenario: {name!r}: is no scenario; name one of `train-ato list`, or a file")
    for given in (str(folder / name), str(name)):
        stem, variants = split_name(given)
        if Path(stem).is_file():
            return f"{Path(stem).resolve()}{variants}"
    return str(name)


Point = dict[str, Any]
"""Values of one run by key."""
MISSING_SCIPY = "the package scipy is not installed; install it with `pip install distributed scipy`"


def design_points(spec: SweepSpec) -> list[Point]:
    """Return the points of a sweep in the order of its runs.

    A grid has every combination, and the last key varies fastest. The other designs fill the unit cube of the
    coordinates. They use independent uniform numbers, a Latin hypercube (one point in each of n equal intervals of
    every coordinate), or a scrambled Sobol sequence. Equal specifications have equal points.

    Raises
    ------
    ValueError
        If the design needs scipy and it is not installed.

    Examples
    --------
    >>> from train_ato.studies.sweep.spec import read_sweep
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
