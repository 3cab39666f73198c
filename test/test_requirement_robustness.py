"""Robustness of requirements: against rtamt, the textbook definition and all continuations of a run."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from random_formulas import SIGNALS, Node, random_formula, text_of, textbook, with_rtamt

from train_ato.loop.robustness import robustness_at_start, robustness_bounds, robustness_series
from train_ato.scenario.formula_parser import parse_formula

TICK = 0.1
SIZE, LONGEST = 40, 15
TOLERANCE = 1e-9
"""Demanded agreement; the order of the operations is that of the definition, so that only minima and maxima differ."""


def samples(stream: np.random.Generator, size: int = SIZE) -> dict[str, np.ndarray]:
    return {name: stream.normal(size=size) for name in SIGNALS}


def evaluated(node: Node, signals: dict[str, np.ndarray]) -> np.ndarray:
    formula = parse_formula(text_of(node))
    found = robustness_series(formula, signals, TICK)
    np.testing.assert_array_equal(robustness_at_start(formula, signals, TICK), found[0])
    return found


def assert_equal(found: np.ndarray, wanted: np.ndarray, text: str) -> None:
    finite = np.isfinite(wanted)
    assert np.array_equal(found[~finite], wanted[~finite]), text
    assert np.abs(found[finite] - wanted[finite]).max(initial=0.0) <= TOLERANCE, text


def test_500_random_formulas_equal_rtamt() -> None:
    """Breaks if an operator, a window, the end of the run or the precedence of the text has another meaning."""
    try:
        importlib.import_module("rtamt")
    except ImportError as error:
        pytest.skip(f"rtamt: {error}; it has no release for this Python")
    operators = set()
    for seed in range(500):
        stream = np.random.default_rng(seed)
        node, signals = random_formula(stream, 1 + seed % 4, LONGEST), samples(stream)
        operators.add(node.kind)
        assert_equal(evaluated(node, signals), with_rtamt(node, signals), text_of(node))
    assert operators == {"not", "and", "or", "->", "G", "F", "H", "O", "U", "S"}


def test_windows_up_to_beyond_the_run_equal_the_definition() -> None:
    """Breaks if a window is cut wrongly at the ends of a run, also where it is longer than the run."""
    for seed in range(150):
        stream = np.random.default_rng(1000 + seed)
        node, signals = random_formula(stream, 1 + seed % 2, 20), samples(stream, 12)
        wanted = np.array([textbook(node, signals, at) for at in range(12)])
        assert_equal(evaluated(node, signals), wanted, text_of(node))


def test_bounds_contain_every_continuation_and_close_with_the_run() -> None:
    """Breaks if a prefix of a run promises a result that a continuation does not have."""
    decided = 0
    for seed in range(150):
        stream = np.random.default_rng(2000 + seed)
        node, signals = random_formula(stream, 1 + seed % 3, LONGEST), samples(stream)
        formula = parse_formula(text_of(node))
        known = int(stream.integers(1, SIZE + 1))
        prefix = {name: values[:known] for name, values in signals.items()}
        lower, upper = robustness_bounds(formula, prefix, TICK, SIZE - known)
        for _ in range(5):
            other = samples(stream)
            whole = {name: np.append(prefix[name], other[name][known:]) for name in SIGNALS}
            value = robustness_series(formula, whole, TICK)[0]
            assert lower <= value <= upper, text_of(node)
        decided += lower > 0 or upper < 0
        final = robustness_series(formula, signals, TICK)[0]
        assert robustness_bounds(formula, signals, TICK, 0) == (final, final)
    assert decided > 20, "the bounds never decide"


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("G speed <= 4 m/s", 0.0),
        ("F[0.1, 0.3] speed >= 3 m/s", 0.0),
        ("G[0.1, 0.25] speed <= 4 m/s", 2.0),
        ("F[5, 6] speed >= 0", -np.inf),
        ("G[5, 6] speed >= 0", np.inf),
        ("speed <= 1 m/s U speed >= 3 m/s", -1.0),
        ("G[0.2, end] speed >= 3 m/s", -1.0),
    ],
)
def test_values_by_hand(text: str, wanted: float) -> None:
    """Breaks if a window counts a sample beside its limits, or an empty window is finite."""
    found = robustness_series(parse_formula(text), {"speed": np.arange(5.0)}, TICK)[0]
    assert found == pytest.approx(wanted, abs=1e-12)


def test_a_quotient_by_zero_is_not_evaluated_as_passed() -> None:
    """Breaks if a division by zero raises a warning, or counts as fulfilled."""
    found = robustness_series(
        parse_formula("G position / speed <= 3 s"), {"speed": np.zeros(3), "position": np.zeros(3)}, TICK
    )
    assert np.isnan(found[0])
