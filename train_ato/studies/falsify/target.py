"""Target of a falsification: the robustness of a formula or of a criterion after a run."""

import math
from dataclasses import dataclass
from typing import NamedTuple

from plant_sim.input_error import close_match
from train_ato.api.scenario_choice import Changes, ScenarioChoice
from train_ato.judge.requirements import evaluate_formula
from train_ato.judge.result import RunResult
from train_ato.judge.verdict import CRITERIA
from train_ato.loop.engine import run_engine
from train_ato.scenario.formula import parse_formula, robustness_dimension, signals_of, unit_text
from train_ato.scenario.scenario import Scenario
from train_ato.scenario.setup import RunSetup
from train_ato.scenario.signals import unavailable_signal

DEFAULT_NAME = "falsified"
"""Name in the written scenario of a requirement that was given as a formula."""


@dataclass(frozen=True)
class RequirementTarget:
    """Requirement to break.

    Attributes
    ----------
    name
        Requirement or criterion of the scenario.
    formula
        Text; None for a criterion, whose robustness is its limit minus the magnitude of its metric.
    unit
        Unit of the robustness, "" without one.
    """

    name: str
    formula: str | None
    unit: str

    def robustness(self, setup: RunSetup, result: RunResult) -> float:
        """Return the robustness of a run; NaN if it is not known or not finite."""
        if self.formula is None:
            rows = [row for row in result.summary.get("criteria", ()) if row["criterion"] == self.name]
            if not rows or rows[0]["value"] is None:
                return -math.inf if rows and rows[0]["passed"] is False else math.nan
            value = rows[0]["value"] if self.name == "arrival_delay" else abs(rows[0]["value"])
            return float(rows[0]["limit"] - value)
        if result.recording is None:
            return math.nan
        found = evaluate_formula(parse_formula(self.formula), setup, result.recording)
        if found.value is not None:
            return found.value
        return found.upper if found.passed is False else math.nan


def requirement_target(given: str, scenario: Scenario, option: str = "requirement") -> RequirementTarget:
    """Return the target of a name or formula.

    Parameters
    ----------
    given
        Name of a requirement or of a criterion of the scenario, or a formula.
    scenario
        Checked scenario.
    option
        Begin of messages.

    Raises
    ------
    ValueError
        For a criterion without a limit, or a text that is neither a name nor a formula.
    """
    criteria = scenario.criteria
    named = criteria.requirements or {}
    if given in named:
        return _of_formula(given, named[given])
    for criterion in CRITERIA:
        if criterion.key == given:
            if getattr(criteria, given) is None:
                raise ValueError(f"{option} {given}: the scenario has no limit of it; add criteria.{given}")
            return RequirementTarget(given, None, criterion.unit)
    try:
        return _of_formula(_free_name(named), given)
    except ValueError as error:
        known = [*named, *(criterion.key for criterion in CRITERIA)]
        near = close_match(given, known)
        raise ValueError(f"{option} '{given}': no requirement of the scenario{near}; as a formula: {error}") from None


def _of_formula(name: str, text: str) -> RequirementTarget:
    dimension = robustness_dimension(parse_formula(text))
    return RequirementTarget(name, text, "" if dimension is None else unit_text(dimension))


def _free_name(named: dict[str, str]) -> str:
    names = [DEFAULT_NAME, *(f"{DEFAULT_NAME}_{number}" for number in range(2, len(named) + 3))]
    return next(name for name in names if name not in named)


def check_signals(target: RequirementTarget, setup: RunSetup, option: str = "requirement") -> None:
    """Check that the run has the signals of the formula."""
    if target.formula is None:
        return
    if reason := unavailable_signal(signals_of(parse_formula(target.formula)), setup.layout, setup.line):
        raise ValueError(f"{option} '{target.formula}': {reason}")


class TargetRun(NamedTuple):
    """Robustness of one run, NaN if unknown, and the reason of a refused or failed run, else ""."""

    robustness: float
    problem: str = ""

    @property
    def breaks(self) -> bool:
        """Return True if the run breaks the requirement."""
        return self.robustness < 0.0


def run_target(choice: ScenarioChoice, target: RequirementTarget, changes: Changes) -> TargetRun:
    """Run a scenario with changes in the engine and return its robustness.

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C ended the run.
    """
    try:
        setup = choice.with_(changes).prepare()
    except ValueError as error:
        return TargetRun(math.nan, f"refused: {error}")
    result = run_engine(setup)
    return TargetRun(target.robustness(setup, result), result.failure or "")
