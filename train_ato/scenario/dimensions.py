"""Dimensions of a study: the keys of a scenario that vary, each with its values or its range."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

RANGE_KEYS = ("from", "to", "steps", "scale")
SCALES = ("linear", "log")


@dataclass(frozen=True)
class Dimension:
    """One key of a scenario with its values.

    Attributes
    ----------
    key
        Key of the scenario, its levels separated by dots, as for ``--set``; also ``law``, ``observer``,
        ``compensation``, ``seed``.
    values
        Values in their order; for a range, its ``steps`` equidistant values (of their logarithm with ``scale: log``).
    low, high
        Limits of a range; None for a list of values.
    scale
        ``linear`` or ``log``.
    integer
        True for a range between integers: every value is an integer.
    """

    key: str
    values: tuple[Any, ...]
    low: float | None = None
    high: float | None = None
    scale: str = "linear"
    integer: bool = False

    @property
    def is_range(self) -> bool:
        """Return True for a range, False for a list of values."""
        return self.low is not None

    def at(self, share: float) -> Any:
        """Return the value at a coordinate.

        Parameters
        ----------
        share
            0 to 1: from the lower to the upper limit of a range, or through the list.
        """
        if self.low is None or self.high is None:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        if self.scale == "log":
            value = float(np.exp(np.log(self.low) + share * (np.log(self.high) - np.log(self.low))))
        else:
            value = self.low + share * (self.high - self.low)
        return round(value) if self.integer else min(max(value, self.low), self.high)

    def share(self, value: Any) -> float:
        """Return the coordinate of a value, 0 to 1: the inverse of :meth:`at`.

        Raises
        ------
        ValueError
            If a list of values does not contain it.
        """
        if self.low is None or self.high is None:
            return (self.values.index(value) + 0.5) / len(self.values)
        low, high, number = self.low, self.high, float(value)
        if self.scale == "log":
            low, high, number = float(np.log(low)), float(np.log(high)), float(np.log(number))
        return (number - low) / (high - low)


def read_dimensions(data: Any, where: str, *, default_steps: int = 2) -> tuple[Dimension, ...]:
    """Return the dimensions of a block ``over:``.

    Parameters
    ----------
    data
        Mapping of keys to a list of values, or to ``{from, to, steps, scale}``.
    where
        Begin of messages: file and key.
    default_steps
        Number of values of a range without ``steps``.

    Examples
    --------
    >>> delay, law = read_dimensions({"links.command.delay": {"from": 0.1, "to": 0.5, "steps": 3},
    ...     "law": ["pid", "smc"]}, "study.yaml: over")
    >>> delay.values, delay.at(0.25), law.values
    ((0.1, 0.3, 0.5), 0.2, ('pid', 'smc'))
    """
    if not isinstance(data, Mapping) or not data:
        raise ValueError(f"{where}: no keys; add one, for example 'seed: [1, 2, 3]'")
    return tuple(_dimension(str(key), entry, f"{where}: {key}", default_steps) for key, entry in data.items())


def _dimension(key: str, entry: Any, where: str, default_steps: int) -> Dimension:
    if isinstance(entry, list):
        if not entry:
            raise ValueError(f"{where}: an empty list; add a value")
        if any(entry.index(value) != index for index, value in enumerate(entry)):
            raise ValueError(f"{where}: a value occurs twice; remove one of them")
        return Dimension(key, tuple(entry))
    if not isinstance(entry, Mapping):
        raise ValueError(f"{where}: {entry!r} is neither a list nor a range; write [1, 2] or {{from: 1, to: 2}}")
    unknown = [name for name in entry if name not in RANGE_KEYS]
    if unknown:
        raise ValueError(f"{where}: unknown key '{unknown[0]}'; use {', '.join(RANGE_KEYS)}")
    low, high = (_number(entry.get(name), f"{where}: {name}") for name in ("from", "to"))
    scale, steps = entry.get("scale", "linear"), entry.get("steps", default_steps)
    if scale not in SCALES:
        raise ValueError(f"{where}: scale: '{scale}' is unknown; use {' or '.join(SCALES)}")
    if not low < high:
        raise ValueError(f"{where}: from {low:g} is not below to {high:g}; exchange or correct them")
    if scale == "log" and low <= 0.0:
        raise ValueError(f"{where}: from {low:g} has no logarithm; use a positive number, or scale: linear")
    if isinstance(steps, bool) or not isinstance(steps, int) or steps < 2:
        raise ValueError(f"{where}: steps: {steps!r} is not an integer above 1; correct it")
    integer = all(isinstance(entry[name], int) for name in ("from", "to"))
    dimension = Dimension(key, (), low, high, scale, integer)
    values = (dimension.at(index / (steps - 1)) for index in range(steps))
    return Dimension(key, tuple(dict.fromkeys(float(f"{value:.12g}") if not integer else value for value in values)),
                     low, high, scale, integer)  # fmt: skip


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise ValueError(f"{where}: {value!r} is not a finite number; write {{from: 1, to: 2}}")
    return float(value)
