"""Search space: the parameters of a law that vary, each with its range.

Runs of the search for gains: every scenario with every seed and variation, as one task each.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from plant_sim.input_error import close_match
from plant_sim.library import read_yaml
from train_ato.api.scenario_choice import ScenarioChoice, put_components
from train_ato.control.contract import Parameter
from train_ato.control.registry import LAWS
from train_ato.loop.engine import run_engine
from train_ato.scenario.dimensions import Dimension, read_dimensions
from train_ato.scenario.scenario import Scenario
from train_ato.scenario.setup import RunSetup

SEARCHED, HELD_OUT = "searched", "held out"
"""Parts of a tuning: scenarios and seeds of the search, and those that the search does not use."""
FIXED_KEYS = ("law", "laws", "law_changes", "seed", "controller", "controllers", "controller_changes", "swaps")
"""Keys that a variation cannot change: those of the law, and the seed with an option of its own."""


@dataclass(frozen=True)
class GainTask:
    """One run of the tuning.

    Attributes
    ----------
    label
        Scenario, seed if there are several, and variation.
    part
        :data:`SEARCHED` or :data:`HELD_OUT`.
    choice
        Scenario with its own law, for the reference run.
    scenario
        The same with the tuned law, observer and compensation.
    """

    label: str
    part: str
    choice: ScenarioChoice
    scenario: Scenario


def gain_tasks(
    choices: Sequence[ScenarioChoice],
    law: Any,
    part: str,
    seeds: Sequence[int] | None,
    variations: Sequence[Mapping[str, Any]] = (),
    **parts: Any,
) -> list[GainTask]:
    """Return a task for every scenario, seed and variation, the first one none; ``parts``: observer, compensation."""
    tasks = []
    for choice in choices:
        for seed in seeds or (None,):
            for variation in ({}, *variations):
                changed = choice.changed(dict(variation), seed)
                scenario = put_components(changed.checked, law=law, importable=False, **parts)
                words = [choice.name, *([f"seed {seed}"] if seed is not None else [])]
                words += [f"{key}={value}" for key, value in variation.items()]
                tasks.append(GainTask(", ".join(words), part, changed, scenario))
    return tasks


Work = tuple[int, Mapping[str, Any] | None]
"""Number of a task and its gains; None for the reference run."""


def lost_run(reason: str) -> dict[str, Any]:
    """Return the metrics of a run without a result."""
    return {"status": "failed", "failure": " ".join(reason.split())}


class GainRunner:
    """Runs of tasks with different gains; the setup of a task is prepared once."""

    def __init__(self, tasks: Sequence[GainTask]) -> None:
        self._tasks = tasks
        self._setups: dict[int, RunSetup] = {}

    def setup(self, index: int) -> RunSetup:
        """Return the prepared run of a task with the gains of its scenario."""
        if index not in self._setups:
            self._setups[index] = self._tasks[index].choice.prepare(self._tasks[index].scenario)
        return self._setups[index]

    def _setup_with(self, index: int, gains: Mapping[str, Any]) -> RunSetup:
        """Return the run of a task with other gains."""
        setup = self.setup(index)
        name = setup.scenario.law
        blocks = {**setup.scenario.laws, name: {**setup.scenario.laws.get(name, {}), **gains}}
        return dataclasses.replace(setup, scenario=setup.scenario.model_copy(update={"laws": blocks}))

    def __call__(self, work: Work) -> dict[str, Any]:
        """Return the metrics of one run; ``failure`` has an error, also that of gains with the status ``refused``."""
        index, gains = work
        try:
            if gains is None:
                setup = self._tasks[index].choice.prepare()
            else:
                setup = self._setup_with(index, gains)
                try:
                    setup.law(setup.scenario.law)
                except ValueError as error:
                    return {"status": "refused", "failure": str(error)}
            return run_engine(setup, summary_only=True).summary
        except Exception as error:
            return lost_run(f"{type(error).__name__}: {error}")


KEYS = ("over", "start", "variations")


@dataclass(frozen=True)
class TuneSpec:
    """Content of the file.

    Attributes
    ----------
    path
        The file, for messages; "" without one.
    over
        Ranges or values of the parameters.
    start
        Values at which the search begins; the others begin at that of the scenario.
    variations
        Changes of the scenarios, each for one more run of every scenario and seed.
    """

    path: str = ""
    over: tuple[Dimension, ...] = ()
    start: Mapping[str, Any] = field(default_factory=dict)
    variations: tuple[dict[str, Any], ...] = ()


NO_SPEC = TuneSpec()


def read_tune_spec(source: str | Path | Mapping[str, Any]) -> TuneSpec:
    """Read ranges, start values and variations of a file, or of a mapping with the same keys."""
    if isinstance(source, Mapping):
        data, path = source, "over"
    else:
        if not Path(source).is_file():
            raise ValueError(f"--over {source}: no such file; name a YAML file with a block over:")
        data, path = read_yaml(Path(source)), str(source)
    if not isinstance(data, Mapping) or not data:
        raise ValueError(f"{path}: no mapping of keys; add a block over:")
    if unknown := [str(key) for key in data if key not in KEYS]:
        raise ValueError(f"{path}: unknown key '{unknown[0]}'; use {', '.join(KEYS)}")
    over = read_dimensions(data["over"], f"{path}: over") if "over" in data else ()
    start = data.get("start", {})
    if not isinstance(start, Mapping):
        raise ValueError(f"{path}: start: {start!r} is no mapping; write start: {{kp: 0.1}}")
    return TuneSpec(path, over, dict(start), _variations(data.get("variations", []), f"{path}: variations"))


def _variations(data: Any, where: str) -> tuple[dict[str, Any], ...]:
    if not isinstance(data, list):
        raise ValueError(f"{where}: not a list; write - {{plant.mismatch.mass_scale: 0.8}}")
    found = []
    for number, entry in enumerate(data, 1):
        if not isinstance(entry, Mapping) or not entry:
            raise ValueError(f"{where}: entry {number}: not a mapping; write - {{plant.mismatch.mass_scale: 0.8}}")
        for key in entry:
            if str(key).partition(".")[0] in FIXED_KEYS:
                raise ValueError(f"{where}: entry {number}: {key}: law and seed have their own options; remove it")
        found.append({str(key): value for key, value in entry.items()})
    return tuple(found)


SPAN = 10.0
"""Factor between the value of a parameter in the scenario and the ends of its range."""
DIGITS = 3
"""Significant digits of the gains of a candidate."""


@dataclass(frozen=True)
class GainSpace:
    """Parameters of a law that vary.

    Attributes
    ----------
    law
        Name of the law.
    dimensions
        One for each parameter; ``key`` is its name.
    initial
        Value of each parameter in the scenario, also of the fixed ones.
    start
        Value of each varied parameter at which the search begins.
    fixed
        Parameters with one value that is not that of the scenario.
    """

    law: str
    dimensions: tuple[Dimension, ...]
    initial: dict[str, Any]
    start: dict[str, Any]
    fixed: dict[str, Any]

    def gains_at(self, point: Sequence[float]) -> dict[str, Any]:
        """Return parameter values with three significant digits at a point of the unit cube."""
        return self.fixed | {
            dimension.key: _rounded(dimension, float(np.clip(share, 0.0, 1.0)))
            for dimension, share in zip(self.dimensions, point, strict=True)
        }

    @property
    def start_point(self) -> list[float]:
        """Point of the unit cube at which the search begins."""
        return [_share(dimension, self.start[dimension.key]) for dimension in self.dimensions]


def _rounded(dimension: Dimension, share: float) -> Any:
    value = dimension.at(share)
    if not isinstance(value, float):
        return value
    value = float(f"{value:.{DIGITS}g}")
    return value if dimension.low is None or dimension.high is None else min(max(value, dimension.low), dimension.high)


def _share(dimension: Dimension, value: Any) -> float:
    """Return the coordinate of a value, at the nearest end of the range for one outside; 0.5 for one off the list."""
    if dimension.low is None or dimension.high is None:
        return dimension.share(value) if value in dimension.values else 0.5
    return float(np.clip(dimension.share(min(max(value, dimension.low), dimension.high)), 0.0, 1.0))


def gain_space(
    law: str, values: Mapping[str, Any], names: Sequence[str] | None = None, spec: TuneSpec = NO_SPEC
) -> GainSpace:
    """Return the search space of a law.

    Without further choice the numeric parameters above 0 vary, each within a factor of ten around its value in the
    scenario, on a logarithmic scale and within its declared bounds. A parameter at 0 switches an effect of the law off
    and has no logarithm; it varies only with a range of its own. Switches and words keep the value of the scenario.

    Parameters
    ----------
    law
        Registered name or ``module:Class``.
    values
        Parameters of the law in the scenario; the others have their defaults.
    names
        Parameters to vary; None: those of ``over``, or all numeric ones above 0.
    spec
        Ranges, lists of values and start values; a list of one value fixes a parameter.
    """
    declared = {entry.name: entry for entry in LAWS.parameters(law)}
    initial = {name: values.get(name, entry.default) for name, entry in declared.items()}
    given = _given(law, declared, spec)
    for name in spec.start:
        _declared(declared, law, name, f"{spec.path}: start: {name}")
    begin = {**initial, **spec.start}
    if names is None:
        names = list(given) or [name for name in declared if _range_of(declared[name], begin[name]) is not None]
    dimensions: list[Dimension] = []
    fixed: dict[str, Any] = {}
    for name in names:
        entry = _declared(declared, law, name, f"--parameters {name}")
        dimension = given.get(name) or _range_of(entry, begin[name])
        if dimension is None:
            raise ValueError(
                f"--parameters {name}: {law}.{name} is {begin[name]!r} in the scenario, without a range around it; "
                "give its range or its values in the file of --over"
            )
        if dimension.low is None and len(dimension.values) == 1:
            fixed[name] = dimension.values[0]
        else:
            dimensions.append(dimension)
    if not dimensions:
        raise ValueError(f"law '{law}': no numeric parameter above 0; give ranges in the file of --over")
    varied = [dimension.key for dimension in dimensions]
    LAWS.check_parameters(law, {**values, **fixed, **{name: begin[name] for name in varied}})
    return GainSpace(
        law,
        tuple(dimensions),
        {name: initial[name] for name in (*fixed, *varied)},
        {name: begin[name] for name in varied},
        fixed,
    )


def _given(law: str, declared: Mapping[str, Parameter], spec: TuneSpec) -> dict[str, Dimension]:
    """Return the ranges of the file by parameter."""
    found = {}
    for dimension in spec.over:
        where = f"{spec.path}: over: {dimension.key}"
        entry = _declared(declared, law, dimension.key.removeprefix(f"laws.{law}."), where)
        found[entry.name] = _named(dimension, entry, where)
    return found


def _declared(declared: Mapping[str, Parameter], law: str, name: str, where: str) -> Parameter:
    if name not in declared:
        raise ValueError(
            f"{where}: no parameter of {law}{close_match(name, declared)}; use one of {', '.join(declared)}"
        )
    return declared[name]


def _named(dimension: Dimension, entry: Parameter, where: str) -> Dimension:
    """Return the dimension with the name of the parameter as key, checked against the declared bounds."""
    if dimension.low is not None and dimension.high is not None:
        if isinstance(entry.default, (bool, str)):
            raise ValueError(f"{where}: a range of values that are no numbers; write a list")
        if dimension.low < entry.low or dimension.high > entry.high:
            raise ValueError(f"{where}: beyond the bounds {entry.low:g} ... {entry.high:g} {entry.unit}; narrow it")
    integer = dimension.integer and isinstance(entry.default, int)
    return Dimension(entry.name, dimension.values, dimension.low, dimension.high, dimension.scale, integer)


def _range_of(entry: Parameter, value: Any) -> Dimension | None:
    """Return the range of a numeric parameter above 0; None for another one."""
    if isinstance(entry.default, (bool, str)) or isinstance(value, (bool, str)) or not value > 0:
        return None
    low, high = max(value / SPAN, entry.low), min(value * SPAN, entry.high)
    integer = isinstance(entry.default, int)
    if integer:
        low, high = max(1.0, float(np.ceil(low))), float(np.floor(high))
    low = low if low > 0 else value / SPAN
    if not low < high:
        return None
    return Dimension(entry.name, (), float(f"{low:.{DIGITS}g}"), float(f"{high:.{DIGITS}g}"), "log", integer)
