"""Building a parameter dataclass from user input: every name, type and range is checked here and nowhere else."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from typing import Any

from train_ato.control.contract import Parameter, parameters_of


def closest(name: str, known: Iterable[str]) -> str:
    """Return a hint `` (did you mean 'x'?)`` when a known name is near, else an empty text."""
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f" (did you mean '{near[0]}'?)" if near else ""


def make_parameters(dataclass_type: type, values: Mapping[str, Any], owner: str) -> Any:
    """Return an instance of a parameter dataclass with ``values`` in place of the defaults.

    Parameters
    ----------
    dataclass_type
        Frozen dataclass whose fields were made by :func:`train_ato.control.contract.parameter`.
    values
        Parameter name to value.
    owner
        Name used in messages: ``smc`` gives ``smc.ks``.

    Raises
    ------
    ValueError
        For an unknown name, a wrong type, a value out of range or not finite: one line with the remedy.
    """
    known = {entry.name: entry for entry in parameters_of(dataclass_type)}
    checked = {}
    for name, value in values.items():
        if name not in known:
            listed = ", ".join(known) or "none"
            raise ValueError(f"{owner}.{name}: no such parameter{closest(name, known)}; {owner} has: {listed}")
        checked[name] = _checked(known[name], value, f"{owner}.{name}")
    return dataclass_type(**checked)


def _checked(entry: Parameter, value: Any, key: str) -> Any:
    if isinstance(entry.default, bool):
        if not isinstance(value, bool):
            raise ValueError(f"{key}: {value!r} is not true or false")
        return value
    if isinstance(entry.default, str):
        if entry.choices and value not in entry.choices:
            raise ValueError(
                f"{key}: {value!r} is not allowed{closest(str(value), entry.choices)}; choose from: "
                + ", ".join(entry.choices)
            )
        return str(value)
    return _checked_number(entry, value, key)


def _checked_number(entry: Parameter, value: Any, key: str) -> float | int:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(
            f"{key}: {value!r} is not a number; give {entry.low:g} ... {entry.high:g} {entry.unit}".rstrip()
        )
    if not math.isfinite(value) or not entry.low <= value <= entry.high:
        raise ValueError(f"{key}: {value:g} is outside {entry.low:g} ... {entry.high:g} {entry.unit}".rstrip())
    if isinstance(entry.default, int):
        if value != int(value):
            raise ValueError(f"{key}: {value:g} is not a whole number")
        return int(value)
    return float(value)
