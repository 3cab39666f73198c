"""Search space: the parameters of a law that vary, each with its range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from train_ato.apps.sweep.dimensions import Dimension
from train_ato.apps.tune.tune_spec import NO_SPEC, TuneSpec
from train_ato.control.contract import Parameter
from train_ato.control.parameters import closest
from train_ato.control.registry import LAWS

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

    Raises
    ------
    ValueError
        For an unknown parameter, one without a range, a range beyond the declared bounds, or an empty search space.
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
        raise ValueError(f"{where}: no parameter of {law}{closest(name, declared)}; use one of {', '.join(declared)}")
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
