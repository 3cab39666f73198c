"""Syntax tree of a requirement in signal temporal logic (STL); the semantics are in ``train_ato/loop/robustness.py``.

O. Maler and D. Nickovic, "Monitoring temporal properties of continuous signals", FORMATS 2004.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from train_ato.scenario.dimension import NO_DIMENSION, Exponents


@dataclass(frozen=True)
class NumberTerm:
    """Number [SI]; ``dimension`` is None for 0 without a unit, which is comparable with everything."""

    value: float
    dimension: Exponents | None = NO_DIMENSION


@dataclass(frozen=True)
class SignalTerm:
    """Signal of the run."""

    name: str
    dimension: Exponents


@dataclass(frozen=True)
class AbsTerm:
    """Magnitude of a term."""

    operand: Term
    dimension: Exponents | None


@dataclass(frozen=True)
class ArithmeticTerm:
    """Sum, difference, product or quotient of two terms; ``operator`` is one of ``+ - * /``."""

    operator: str
    left: Term
    right: Term
    dimension: Exponents | None


@dataclass(frozen=True)
class Predicate:
    """Comparison of two terms; ``operator`` is one of ``<= >=``, also for ``<`` and ``>``."""

    operator: str
    left: Term
    right: Term

    @property
    def dimension(self) -> Exponents:
        """Dimension of both sides."""
        return self.left.dimension or self.right.dimension or NO_DIMENSION


@dataclass(frozen=True)
class Negation:
    """Logical not."""

    operand: Formula


@dataclass(frozen=True)
class Connective:
    """``and``, ``or`` or ``->`` of two formulas."""

    operator: str
    left: Formula
    right: Formula


@dataclass(frozen=True)
class Window:
    """Interval of time relative to the present sample [s]; ``end`` is infinite up to the end of the run."""

    begin: float = 0.0
    end: float = math.inf


@dataclass(frozen=True)
class Temporal:
    """``G`` always, ``F`` eventually, ``H`` historically (G of the past) or ``O`` once (F of the past)."""

    operator: str
    window: Window
    operand: Formula


@dataclass(frozen=True)
class Until:
    """``U``: ``right`` becomes true in the window, ``left`` is true before; ``S`` (since): the same in the past."""

    operator: str
    window: Window
    left: Formula
    right: Formula


Term = NumberTerm | SignalTerm | AbsTerm | ArithmeticTerm
Formula = Predicate | Negation | Connective | Temporal | Until


def is_term(node: Term | Formula) -> bool:
    """Return True for a term, False for a formula."""
    return isinstance(node, (NumberTerm, SignalTerm, AbsTerm, ArithmeticTerm))


def nodes_of(node: Term | Formula) -> Iterator[Term | Formula]:
    """Yield a node and all nodes below it."""
    yield node
    for name in ("operand", "left", "right"):
        below = getattr(node, name, None)
        if below is not None:
            yield from nodes_of(below)


def signals_of(formula: Formula) -> tuple[str, ...]:
    """Return the names of the signals of a formula in order of their first use."""
    return tuple(dict.fromkeys(node.name for node in nodes_of(formula) if isinstance(node, SignalTerm)))


def robustness_dimension(formula: Formula) -> Exponents | None:
    """Return the dimension of the robustness; None for predicates of several dimensions."""
    found = {node.dimension for node in nodes_of(formula) if isinstance(node, Predicate)}
    return found.pop() if len(found) == 1 else None
