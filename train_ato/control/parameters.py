"""Parameter dataclasses from user input: the only check of names, types and ranges."""

import logging
import math
from collections.abc import Mapping
from typing import Any

from plant_sim.input_error import close_match
from plant_sim.units import number_text
from train_ato.control.contract import Parameter, parameters_of

_LOG = logging.getLogger("train_ato")


class RefusedParameter(ValueError):
    """A parameter of a component that does not fit the train.

    Attributes
    ----------
    reason
        Parameter, value and problem.
    remedy
        Accepted setting ``parameter: value`` of the component.
    other
        Another remedy; "" for none.
    block
        Block of the component in a scenario, for example ``laws.smc``.
    """

    def __init__(self, reason: str, remedy: str, other: str = "", block: str = "") -> None:
        super().__init__(reason, remedy, other, block)
        self.reason, self.remedy, self.other, self.block = reason, remedy, other, block

    def of(self, kind: str, name: str) -> "RefusedParameter":
        """Return the same refusal with kind and name of the component."""
        return RefusedParameter(f"{kind} '{name}': {self.reason}", self.remedy, self.other, f"{kind}s.{name}")

    def with_remedy_only(self) -> "RefusedParameter":
        """Return the same refusal without the other remedy."""
        return RefusedParameter(self.reason, self.remedy, "", self.block)

    def __str__(self) -> str:
        setting = f"set {self.block}.{self.remedy}" if self.block else f"set {self.remedy}"
        return f"{self.reason}; {f'{self.other}, or ' if self.other else ''}{setting}"


def make_parameters(dataclass_type: type, values: Mapping[str, Any], owner: str) -> Any:
    """Return a parameter dataclass with ``values`` in place of the defaults.

    Parameters
    ----------
    dataclass_type
        Frozen dataclass whose fields are declared by :func:`train_ato.control.contract.parameter`.
    values
        Parameter name to value.
    owner
        Name of the component in messages: ``smc`` in ``smc.ks``.

    Raises
    ------
    ValueError
        For an unknown name, a wrong type, or a value that is out of range or not finite: one line with the remedy.
    """
    known = {entry.name: entry for entry in parameters_of(dataclass_type)}
    checked = {}
    for name, value in values.items():
        if name not in known:
            listed = ", ".join(known) or "none"
            raise ValueError(f"{owner}.{name}: no such parameter{close_match(name, known)}; {owner} has: {listed}")
        checked[name] = _checked(known[name], value, f"{owner}.{name}")
    return dataclass_type(**checked)


def _checked(entry: Parameter, value: Any, key: str) -> Any:
    if isinstance(entry.default, bool):
        if not isinstance(value, bool):
            raise ValueError(f"{key}: {value!r} is not true or false; write true or false")
        return value
    if isinstance(entry.default, str):
        if entry.choices and value not in entry.choices:
            raise ValueError(
                f"{key}: {value!r} is not allowed{close_match(str(value), entry.choices)}; choose from: "
                + ", ".join(entry.choices)
            )
        return str(value)
    return _checked_number(entry, value, key)


def _checked_number(entry: Parameter, value: Any, key: str) -> float | int:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(
            f"{key}: {value!r} is not a number; give {number_text(entry.low)} ... {number_text(entry.high)} "
            f"{entry.unit}".rstrip()
        )
    if not math.isfinite(value) or not entry.low <= value <= entry.high:
        raise ValueError(
            f"{key}: {number_text(value)} is outside {number_text(entry.low)} ... {number_text(entry.high)} "
            f"{entry.unit}".rstrip()
        )
    if isinstance(entry.default, int):
        if value != int(value):
            raise ValueError(
                f"{key}: {number_text(value)} is not a whole number; give {number_text(entry.low)} ... "
                f"{number_text(entry.high)}"
            )
        return int(value)
    return float(value)
