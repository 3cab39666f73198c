"""Series of a recording: samples of a topic, and the diagnostics of a node."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from train_ato.judge.repeated_reports import RepeatedReport, Report
from train_ato.messages.types import Array, Diagnostic


@dataclass(frozen=True)
class TopicSamples:
    """Numbers of one topic.

    Attributes
    ----------
    time : Array, shape (k,)
        Stamps [s], rising.
    values : mapping of Array, each of shape (k, n)
        Values by name [SI]; n vehicles or units, 1 for a single number. In a long run they are read from a file at
        every use.
    """

    time: Array
    values: Mapping[str, Array]

    def __getitem__(self, name: str) -> Array:
        return self.values[name]

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def row(self, name: str, number: int) -> Array:
        """Return the values of one sample, shape (n,); of a long run the others are not read."""
        read: Callable[[str, int], Array] | None = getattr(self.values, "row", None)
        return self.values[name][number] if read is None else read(name, number)


@dataclass(frozen=True)
class DiagnosticSeries:
    """Diagnostics of one node; a key has numbers if all its values are numbers, else texts."""

    time: Array
    level: Array
    message: list[str]
    values: Mapping[str, Any]

    def numbers(self, key: str) -> Array | None:
        """Return a value over time, NaN if missing; None for a key without a number."""
        column = self.values.get(key)
        return column if isinstance(column, np.ndarray) and np.isfinite(column).any() else None

    def texts(self, key: str) -> list[str | None]:
        """Return a value over time as text, None if missing."""
        column = self.values.get(key)
        if column is None:
            return [None] * self.time.size
        if isinstance(column, np.ndarray):
            return [f"{entry:g}" if np.isfinite(entry) else None for entry in column]
        return list(column)


def seconds(stamps: Sequence[int] | NDArray[np.int64]) -> Array:
    """Return stamps [ns] in s, with the same rounding as in all tables."""
    return np.asarray(np.asarray(stamps, dtype=np.int64) * 1e-9, dtype=np.float64)


def diagnostic_series(reports: Iterable[Report]) -> dict[str, DiagnosticSeries]:
    """Return the diagnostics by node."""
    nodes: dict[str, list[RepeatedReport]] = {}
    for report in reports:
        part = RepeatedReport(report, [report.stamp]) if isinstance(report, Diagnostic) else report
        nodes.setdefault(part.first.node, []).append(part)
    return {node: _of_node(rows) for node, rows in nodes.items()}


def _of_node(parts: list[RepeatedReport]) -> DiagnosticSeries:
    keys = dict.fromkeys(chain.from_iterable(part.first.values for part in parts))
    levels = [[part.first.level] * len(part.stamps) for part in parts]
    return DiagnosticSeries(
        seconds(list(chain.from_iterable(part.stamps for part in parts))),
        np.array(list(chain.from_iterable(levels)), dtype=np.int64),
        list(chain.from_iterable([part.first.message] * len(part.stamps) for part in parts)),
        _Columns(parts, keys),
    )


class _Columns(Mapping[str, Any]):
    """Values of the diagnostics of a node by key; a column is converted at its first use, most are not used."""

    def __init__(self, parts: list[RepeatedReport], keys: Iterable[str]) -> None:
        self._parts = parts
        self._columns: dict[str, Any] = dict.fromkeys(keys)

    def __getitem__(self, key: str) -> Any:
        column = self._columns[key]
        if column is None:
            values = list(chain.from_iterable(part.column(key) for part in self._parts))
            column = self._columns[key] = _column(values)
        return column

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)


def _column(values: list[str | float | None]) -> Any:
    try:
        return np.array([np.nan if value is None else float(value) for value in values])
    except ValueError:
        return [value if value is None or isinstance(value, str) else repr(value) for value in values]


def held(time: Array, other: Array, values: Array) -> Array:
    """Return the newest values at other times, shape (k, n); 0 before the first."""
    if other.size >= time.size and np.array_equal(other[: time.size], time):
        return np.asarray(values[: time.size], dtype=np.float64)
    row = np.searchsorted(other, time, side="right") - 1
    return np.where(row[:, None] >= 0, values[np.maximum(row, 0)], 0.0)


def aligned(time: Array, other: Array, values: Array) -> Array:
    """Return values at other times: exact for equal times, else linear between neighbours, NaN in gaps.

    Parameters
    ----------
    time : shape (k,)
        Wanted times [s].
    other : shape (j,)
        Times of the values [s], rising.
    values : shape (j,) or (j, n)
        Values.
    """
    if other.size >= time.size and np.array_equal(other[: time.size], time):
        return np.asarray(values[: time.size], dtype=np.float64)
    if other.size == 0:
        return np.full((time.size, *values.shape[1:]), np.nan)
    if values.ndim == 2:
        return np.column_stack([aligned(time, other, column) for column in values.T])
    result = np.interp(time, other, values)
    after = np.clip(np.searchsorted(other, time), 0, other.size - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.minimum(np.abs(other[after] - time), np.abs(time - other[before]))
    usual = float(np.median(np.diff(other))) if other.size > 1 else 0.0
    return np.where(nearest <= 0.75 * usual + 1e-9, result, np.nan)
