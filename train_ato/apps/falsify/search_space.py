"""Space of a falsification: dimensions in unit coordinates, and the nominal point of the scenario."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from plant_sim.input_error import close_match
from plant_sim.library import read_yaml
from plant_sim.si_model import SiModel
from train_ato.apps.runs.scenario_choice import ScenarioChoice
from train_ato.apps.sweep.dimensions import Dimension, read_dimensions
from train_ato.messages.types import Array
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
            entry.key: self.nominal_values[entry.key] if share == nominal else plain_value(entry.at(float(share)))
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


def plain_value(value: Any) -> Any:
    """Return a number with twelve significant digits, other values unchanged."""
    return float(f"{value:.12g}") if isinstance(value, float) else value


def read_spec(path: Path) -> tuple[Dimension, ...]:
    """Return the dimensions of a spec file with the block ``over:``.

    Raises
    ------
    ValueError
        One line: file, key, problem, remedy.
    """
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
        value = nominal_value(choice.checked, entry.key, place)
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


def nominal_value(model: BaseModel, key: str, place: str) -> Any:
    """Return the value of a key of a checked scenario, also of a key with a unit suffix.

    Raises
    ------
    ValueError
        If the scenario has no value there.
    """
    found: Any = model
    for part in keys_of(key):
        found = _below(found, part, place)
        if found is None:
            raise ValueError(f"{place}: the scenario has no value; add its nominal value to the scenario")
    return found


def _below(found: Any, part: str, place: str) -> Any:
    """Return an entry of a model, a mapping or a list; None for a missing value."""
    if isinstance(found, (list, tuple)):
        if not part.isdigit() or int(part) >= len(found):
            raise ValueError(f"{place}: '{part}' is no entry of a list of {len(found)}; use 0 to {len(found) - 1}")
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
