"""Requirements of a scenario: robustness of their formulas over a recording, as rows of the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from train_ato.loop.metrics import km_of_front
from train_ato.loop.recording import Recording
from train_ato.loop.robustness import robustness_at_start, robustness_bounds, robustness_series
from train_ato.loop.setup import RunSetup
from train_ato.loop.signal_check import unavailable_signal
from train_ato.loop.signal_series import signal_series
from train_ato.scenario.dimension import unit_text
from train_ato.scenario.formula import (
    Connective,
    Formula,
    Negation,
    Predicate,
    Temporal,
    robustness_dimension,
    signals_of,
)
from train_ato.scenario.formula_parser import parse_formula

ROBUSTNESS = "robustness"
"""Metric in the row of a requirement."""


@dataclass(frozen=True)
class Robustness:
    """Robustness of a formula at the start of a run.

    Attributes
    ----------
    lower, upper
        Bounds [SI]; equal for a complete run.
    unit
        SI unit; "" for comparisons of different quantities.
    at_s
        Time of the decisive margin [s]: the smallest one of ``G``, the largest one of ``F``, of a
        connective that of the decisive part; None for others.
    """

    lower: float
    upper: float
    unit: str = ""
    at_s: float | None = None

    @property
    def passed(self) -> bool | None:
        """Return True or False if the bounds decide it; None also for a window beyond the end of the run."""
        if math.isfinite(self.lower) and self.lower >= 0.0:
            return True
        if math.isfinite(self.upper) and self.upper < 0.0:
            return False
        return None

    @property
    def value(self) -> float | None:
        """Return the robustness [SI]; None if it is not known or not finite."""
        return self.lower if self.lower == self.upper and math.isfinite(self.lower) else None


def evaluate_formula(formula: Formula, setup: RunSetup, recording: Recording) -> Robustness:
    """Return the robustness of a formula over a recording with at least one complete tick.

    The recording of a run that ended early has bounds for all continuations up to the duration of the scenario.
    """
    signals = signal_series(signals_of(formula), setup, recording)
    remaining = max(0, setup.ticks - recording.time.size)
    dimension = robustness_dimension(formula)
    unit = "" if dimension is None else unit_text(dimension)
    at_s = _decisive_time(formula, signals, setup.tick)
    if remaining:
        return Robustness(*robustness_bounds(formula, signals, setup.tick, remaining), unit, at_s)
    value = robustness_at_start(formula, signals, setup.tick)
    return Robustness(value, value, unit, at_s)


def _decisive_time(formula: Formula, signals: Mapping[str, Any], tick: float) -> float | None:
    """Return the time of the margin that is the robustness at the start of a run [s], or None."""
    if isinstance(formula, Predicate):
        return 0.0
    if isinstance(formula, Negation):
        return _decisive_time(formula.operand, signals, tick)
    if isinstance(formula, Connective):
        parts = (Negation(formula.left) if formula.operator == "->" else formula.left, formula.right)
        choose = min if formula.operator == "and" else max
        return _decisive_time(choose(parts, key=lambda part: robustness_at_start(part, signals, tick)), signals, tick)
    if not isinstance(formula, Temporal) or formula.operator not in ("G", "F"):
        return None
    begin = math.ceil(formula.window.begin / tick - 1e-6)
    margins = robustness_series(formula.operand, signals, tick)
    end = margins.size if math.isinf(formula.window.end) else math.floor(formula.window.end / tick + 1e-6) + 1
    within = margins[begin:end]
    if not within.size:
        return None
    return float((begin + int(within.argmin() if formula.operator == "G" else within.argmax())) * tick)


def requirement_rows(setup: RunSetup, recording: Recording) -> list[dict[str, Any]]:
    """Return the rows of ``criteria`` in ``summary.json`` for the requirements of the scenario.

    A row has the name, ``metric``: ``robustness``, value [SI] (None if it is not known), limit 0, ``passed``, the
    formula, the unit, and time and place of the decisive margin.
    """
    rows = []
    for name, text in (setup.scenario.criteria.requirements or {}).items():
        found = evaluate_formula(parse_formula(text), setup, recording)
        rows.append(requirement_row(name, text, found, setup, recording))
    return rows


def recorded_rows(recording: Recording, formulas: Sequence[str], where: str) -> list[dict[str, Any]]:
    """Return the rows of formulas over a recording with its scenario, each with its text as name.

    Raises
    ------
    ValueError
        Without a scenario or a complete tick, or for a signal that the run does not have; ``where`` begins the message.
    """
    setup = recording.setup
    if setup is None:
        raise ValueError(f"{where}: the log has no scenario ({recording.setup_missing}); name a run folder")
    if not recording.time.size:
        raise ValueError(f"{where}: the log has no complete tick; name another run")
    rows = []
    for text in formulas:
        formula = parse_formula(text)
        if reason := unavailable_signal(signals_of(formula), setup.layout, setup.line):
            raise ValueError(f"{where} '{text}': {reason}")
        rows.append(requirement_row(text, text, evaluate_formula(formula, setup, recording), setup, recording))
    return rows


def requirement_row(
    name: str, text: str, found: Robustness, setup: RunSetup, recording: Recording
) -> dict[str, Any]:  # fmt: skip
    """Return the row of a requirement for ``summary.json``."""
    value = found.value if found.value is not None else found.upper if found.passed is False else None
    return {
        "criterion": name,
        "metric": ROBUSTNESS,
        "value": value,
        "limit": 0.0,
        "passed": found.passed,
        "formula": text,
        "unit": found.unit,
        "at_s": found.at_s,
        "km": None if found.at_s is None else km_of_front(setup, recording, found.at_s),
    }
