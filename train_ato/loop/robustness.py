"""Robustness of a formula over sampled signals: margin to the change of its truth value, in SI units.

Quantitative semantics of A. Donzé and O. Maler, "Robust satisfaction of temporal logic over real-valued signals",
FORMATS 2010, at the samples of a run: a comparison has the difference of its sides, ``and`` and ``G`` the minimum,
``or`` and ``F`` the maximum, ``not`` the negative. A window is cut at the ends of the run; in an empty one ``G`` is
infinitely true and ``F`` infinitely false.

A window of w samples takes log2(w) passes over the samples: the extreme of 2 m samples is that of two neighbouring
extremes of m. A bounded until is ``l U[0,w] r = F[0,w] r and (l U r)``, so that it takes one pass more (A. Donzé,
T. Ferrère and O. Maler, "Efficient robust monitoring for STL", CAV 2013).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from plant_sim.compiled import compiled
from train_ato.messages.types import Array
from train_ato.scenario.formula import (
    AbsTerm,
    ArithmeticTerm,
    Connective,
    Formula,
    Negation,
    NumberTerm,
    Predicate,
    SignalTerm,
    Temporal,
    Term,
    Window,
)

__all__ = ["robustness_at_start", "robustness_bounds", "robustness_series"]

_ON_GRID = 1e-6
"""Part of a tick by which a limit of a window may be beside a sample."""


def robustness_series(formula: Formula, signals: Mapping[str, Array], tick: float) -> Array:
    """Return the robustness at every sample, shape (k,).

    Parameters
    ----------
    formula
        Syntax tree.
    signals : dict of Array, each of shape (k,)
        Samples by name [SI].
    tick
        Time between two samples [s].
    """
    return _Samples(signals, tick).formula(formula, 1.0)


def robustness_at_start(formula: Formula, signals: Mapping[str, Array], tick: float) -> float:
    """Return the robustness at the first sample, that of the run; parameters as :func:`robustness_series`."""
    return _Samples(signals, tick).at_start(formula, 1.0)


def robustness_bounds(
    formula: Formula, signals: Mapping[str, Array], tick: float, remaining: int
) -> tuple[float, float]:
    """Return the smallest and the largest robustness at the start of a run that is not complete.

    A formula with a lower bound of at least 0 will hold and one with a negative upper bound is violated, for all
    signals after the last sample.

    Parameters
    ----------
    formula, signals, tick
        As for :func:`robustness_series`, up to the present sample.
    remaining
        Number of samples to the end of the run.
    """
    samples = _Samples(signals, tick, remaining)
    return samples.at_start(formula, 1.0), samples.at_start(formula, -1.0)


class _Samples:
    """Samples of the signals, followed by ``remaining`` unknown ones."""

    def __init__(self, signals: Mapping[str, Array], tick: float, remaining: int = 0) -> None:
        self._signals, self._tick, self._remaining = signals, tick, remaining
        self._size = next(iter(signals.values())).size

    def at_start(self, node: Formula, sign: float) -> float:
        """Return the robustness at the first sample; the outer operators need no series."""
        if isinstance(node, Negation):
            return -self.at_start(node.operand, -sign)
        if isinstance(node, Connective) and node.operator != "->":
            return (min if node.operator == "and" else max)(
                self.at_start(node.left, sign), self.at_start(node.right, sign)
            )
        if isinstance(node, Temporal) and node.operator in ("G", "F"):
            begin, end = self._window(node.window)
            values = self.formula(node.operand, sign)[begin : end + 1]
            if node.operator == "G":
                return float(values.min(initial=math.inf))
            return float(values.max(initial=-math.inf))
        return float(self.formula(node, sign)[0])

    def formula(self, node: Formula, sign: float) -> Array:
        """Return the robustness at every sample; an unknown predicate is infinite, with ``sign`` 1 false."""
        if isinstance(node, Predicate):
            left, right = self._term(node.left), self._term(node.right)
            values = np.broadcast_to(right - left if node.operator == "<=" else left - right, (self._size,))
            return np.append(values, np.full(self._remaining, -sign * math.inf)) if self._remaining else values
        if isinstance(node, Negation):
            return -self.formula(node.operand, -sign)
        if isinstance(node, Connective):
            right = self.formula(node.right, sign)
            if node.operator == "->":
                return np.maximum(-self.formula(node.left, -sign), right)
            return (np.minimum if node.operator == "and" else np.maximum)(self.formula(node.left, sign), right)
        begin, end = self._window(node.window)
        past = node.operator in ("O", "H", "S")
        if isinstance(node, Temporal):
            lowest = node.operator in ("G", "H")
            return _reversed_if(
                past, _extreme(_reversed_if(past, self.formula(node.operand, sign)), begin, end, lowest)
            )
        left, right = (_reversed_if(past, self.formula(part, sign)) for part in (node.left, node.right))
        return _reversed_if(past, _until(left, right, begin, end))

    def _window(self, window: Window) -> tuple[int, int]:
        """Return the first and the last sample of a window, at most the number of all samples."""
        size = self._size + self._remaining
        begin = math.ceil(min(window.begin / self._tick, size) - _ON_GRID)
        return begin, max(begin - 1, math.floor(min(window.end / self._tick, size) + _ON_GRID))

    def _term(self, node: Term) -> Array | float:
        """Return the values of a term, shape (k,), or its only value."""
        if isinstance(node, NumberTerm):
            return node.value
        if isinstance(node, SignalTerm):
            return self._signals[node.name]
        if isinstance(node, AbsTerm):
            return np.abs(self._term(node.operand))
        assert isinstance(node, ArithmeticTerm)
        left, right = self._term(node.left), self._term(node.right)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            if node.operator == "/":
                return np.divide(left, right)
            return {"+": np.add, "-": np.subtract, "*": np.multiply}[node.operator](left, right)


def _reversed_if(past: bool, values: Array) -> Array:
    return values[::-1] if past else values


def _extreme(values: Array, begin: int, end: int, lowest: bool) -> Array:
    """Return the minimum or maximum over the samples i + begin to i + end of every sample i, shape (k,)."""
    join, empty = (np.minimum, math.inf) if lowest else (np.maximum, -math.inf)
    size, width = values.size, end - begin + 1
    if width <= 0 or begin >= size:
        return np.full(size, empty)
    if end >= size - 1:  # every window reaches the end of the run
        part = np.asarray(join.accumulate(values[begin:][::-1])[::-1])
        return np.append(part, np.full(begin, empty)) if begin else part
    part, other = np.empty(size - 1 + width), np.empty(size - 1 + width)
    part[: size - begin], part[size - begin :] = values[begin:], empty
    count, length = 1, part.size
    while count < width:  # part[i] is the extreme of count samples from i on
        step = min(count, width - count)
        length -= step
        join(part[:length], part[step : step + length], out=other[:length])
        part, other, count = other, part, count + step
    return part[:size]


def _until(left: Array, right: Array, begin: int, end: int) -> Array:
    """Return the robustness of ``left U[begin,end] right``, shape (k,)."""
    unbounded: Array = _until_end(np.ascontiguousarray(left), np.ascontiguousarray(right))
    holds = np.minimum(unbounded, _extreme(right, 0, end - begin, False))
    if begin:
        later = np.full(left.size, -math.inf)
        later[: max(0, left.size - begin)] = holds[begin:]
        holds = np.minimum(_extreme(left, 0, begin - 1, True), later)
    return holds


@compiled
def _until_end(left: Array, right: Array) -> Array:  # pragma: no cover - compiled
    """Return the robustness of the until without a bound: u[i] = max(right[i], min(left[i], u[i + 1]))."""
    result = np.empty(left.size)
    held = -np.inf
    for index in range(left.size - 1, -1, -1):
        held = max(right[index], min(left[index], held))
        result[index] = held
    return result
