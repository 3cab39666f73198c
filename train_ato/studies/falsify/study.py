"""Falsification of a requirement over keys of a scenario: its target, its runs and its result."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from plant_sim.data_text import TextDumper
from plant_sim.input_error import close_match
from train_ato.api.progress import share_bar
from train_ato.api.scenario_choice import Changes, GivenScenario, ScenarioChoice, choose_scenario
from train_ato.api.search_runs import search_runs
from train_ato.api.series_folder import KeptRuns
from train_ato.judge.metric_names import verdict_html
from train_ato.judge.requirements import evaluate_formula
from train_ato.judge.result import RunResult
from train_ato.judge.verdict import CRITERIA, three_digits
from train_ato.log.whole_file import write_whole
from train_ato.loop.engine import run_engine
from train_ato.scenario.dimensions import read_dimensions
from train_ato.scenario.formula import parse_formula, robustness_dimension, signals_of, unit_text
from train_ato.scenario.scenario import Scenario
from train_ato.scenario.setup import RunSetup
from train_ato.scenario.signals import unavailable_signal
from train_ato.studies.falsify import search as searching
from train_ato.studies.falsify.search import TargetRun

if TYPE_CHECKING:
    import pandas as pd


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
        names = (DEFAULT_NAME, *(f"{DEFAULT_NAME}_{number}" for number in range(2, len(named) + 3)))
        return _of_formula(next(name for name in names if name not in named), given)
    except ValueError as error:
        known = [*named, *(criterion.key for criterion in CRITERIA)]
        near = close_match(given, known)
        raise ValueError(f"{option} '{given}': no requirement of the scenario{near}; as a formula: {error}") from None


def _of_formula(name: str, text: str) -> RequirementTarget:
    dimension = robustness_dimension(parse_formula(text))
    return RequirementTarget(name, text, "" if dimension is None else unit_text(dimension))


def run_target(choice: ScenarioChoice, target: RequirementTarget, changes: Changes) -> TargetRun:
    """Run a scenario with changes in the engine and return its robustness.

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C ended the run.
    """
    try:
        setup = choice.with_(changes).prepare(noted=False)
    except ValueError as error:
        return TargetRun(math.nan, f"refused: {error}")
    result = run_engine(setup)
    return TargetRun(target.robustness(setup, result), result.failure or "")


ONE_LINE = dict.fromkeys((*range(32), 127, 133, 8232, 8233), " ")
"""Characters that end a line or a comment of YAML, and others that do not print."""
RUNS = 100


@dataclass(frozen=True)
class Falsification:
    """Result of a search.

    Attributes
    ----------
    scenario : ScenarioChoice
        Nominal scenario.
    target : RequirementTarget
        Requirement with name, formula and unit.
    space : SearchSpace
        Dimensions and nominal values.
    rows : list of SearchRow
        All runs in their order.
    interrupted : bool
        True if Ctrl-C ended the search.
    """

    scenario: ScenarioChoice
    target: RequirementTarget
    space: searching.SearchSpace
    rows: list[searching.SearchRow]
    interrupted: bool = False

    @property
    def smallest(self) -> searching.SearchRow | None:
        """Run that breaks the requirement with the smallest departure; None without a break."""
        return searching.smallest_break(self.rows)

    @property
    def found(self) -> bool:
        """True if a run breaks the requirement."""
        return self.smallest is not None

    @property
    def changes(self) -> dict[str, Any]:
        """Values by key of the smallest departure, only those that differ from the scenario; {} without a break."""
        row = self.smallest
        values = {} if row is None else self.space.values(row.point)
        return {key: value for key, value in values.items() if value != self.space.nominal_values[key]}

    @property
    def runs_to_break(self) -> int | None:
        """Number of runs up to the first break."""
        return next((row.number for row in self.rows if row.run.breaks), None)

    @property
    def table(self) -> pd.DataFrame:
        """Table of all runs: number, phase, values by key, departure, robustness, problem."""
        import pandas as pd

        rows = [
            {
                "run": row.number, "phase": row.phase, **self.space.values(row.point), "departure": row.departure,
                "robustness": row.run.robustness, "problem": row.run.problem,
            }
            for row in self.rows
        ]  # fmt: skip
        return pd.DataFrame(rows)

    @property
    def yaml(self) -> str:
        """Complete scenario that reproduces the break, with the requirement and all files; "" without a break."""
        row, choice, target = self.smallest, self.scenario, self.target
        if row is None:
            return ""
        data = yaml.safe_load(choice.with_(self.space.values(row.point)).prepare().resolved_yaml())
        data["name"] = f"{choice.name}.falsified"[-100:]
        if target.formula is not None:
            requirements = data.setdefault("criteria", {}).setdefault("requirements", {})
            requirements[target.name] = target.formula
        unit = f" {target.unit}" if target.unit else ""
        head = [
            f"breaks {target.name}{'' if target.formula is None else f': {target.formula}'}",
            f"robustness {row.run.robustness:.6g}{unit}, departure {row.departure:.6g}, of {choice.name} with",
            *(f"  {key}: {value}" for key, value in self.changes.items()),
        ]
        text = "".join(f"# {line.translate(ONE_LINE)}\n" for line in head)
        return text + yaml.dump(data, Dumper=TextDumper, sort_keys=False, allow_unicode=True, width=120)

    def _repr_html_(self) -> str:
        return verdict_html(self.line()) + str(self.table.to_html(max_rows=20))

    def line(self) -> str:
        """Return the result as one line of text."""
        name, unit = self.target.name, self.target.unit and f" {self.target.unit}"
        row = self.smallest
        if row is None:
            known = [entry.run.robustness for entry in self.rows if entry.run.robustness == entry.run.robustness]
            lowest = f"; smallest robustness {three_digits(min(known))}{unit}" if known else ""
            return f"not broken: {name}: no break in {len(self.rows)} runs{lowest}; this is no proof"
        nominal = self.space.nominal_values
        steps = [f"{key} = {_text(value)} (nominal {_text(nominal[key])})" for key, value in self.changes.items()]
        shown = ", ".join(steps) or "the scenario itself"
        return (
            f"broken: {name}: smallest departure {three_digits(row.departure)}: {shown}; "
            f"robustness {three_digits(row.run.robustness)}{unit}; first break in run {self.runs_to_break}"
        )


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def falsify(
    scenario: GivenScenario,
    requirement: str,
    over: Mapping[str, Any] | str | Path,
    *,
    runs: int = RUNS,
    seed: int = 1,
    jobs: int = 1,
    set: Changes | None = None,
    shrink: bool = True,
    progress: bool | None = None,
) -> Falsification:
    """Search the smallest change of a scenario that breaks a requirement.

    Parameters
    ----------
    scenario, set
        As for :func:`train_ato.run`.
    requirement
        Name of a requirement or criterion of the scenario, or a formula (``msgs_docs/requirements.md``).
    over
        Keys of the scenario with ranges or lists, ``{"links.command.delay": {"from": 0, "to": 2}}``, or a YAML file
        with the block ``over:``.
    runs
        Largest number of runs.
    seed
        Seed of the search; that of the runs is in the scenario.
    jobs
        Number of processes.
    shrink
        False: end with the first break.
    progress
        Show a progress bar; default: in a terminal and in a notebook.

    Returns
    -------
    Falsification
        ``found``, ``changes``, ``table`` and the scenario ``yaml`` of the break.

    Raises
    ------
    ValueError
        Bad input, in one line with the remedy; nothing was started.

    Examples
    --------
    >>> import train_ato as ta
    >>> over = {"plant.mismatch.mass_scale": {"from": 0.9, "to": 1.3}}
    >>> found = ta.falsify("demo", "G speed_error >= -0.7 km/h", over, set={"duration": 60}, runs=12)
    >>> found.found, sorted(found.changes)
    (True, ['plant.mismatch.mass_scale'])
    """
    choice = choose_scenario(scenario).changed(set, None)
    study = FalsificationStudy(choice, requirement, over, runs, jobs=jobs)
    with share_bar(f"falsify {choice.name}", shown=progress) as update:
        return study.search(
            runs, seed, jobs, shrink=shrink, note=lambda row: update(row.number / runs, f"run {row.number}")
        )


class FalsificationStudy:
    """Checked input of a falsification.

    Parameters
    ----------
    choice
        Nominal scenario.
    requirement, over, runs, jobs
        As for :func:`falsify`.
    dash
        Begin of the names of arguments in messages.
    """

    def __init__(
        self,
        choice: ScenarioChoice,
        requirement: str,
        over: Mapping[str, Any] | str | Path,
        runs: int,
        *,
        jobs: int,
        dash: str = "",
    ) -> None:
        for name, value in (("runs", runs), ("jobs", jobs)):
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise ValueError(f"{dash}{name} {value}: give an integer of at least 1")
        self.scenario = choice
        self.target = requirement_target(requirement, choice.checked, f"{dash}requirement")
        where = "over" if isinstance(over, Mapping) else f"{over}: over"
        dimensions = read_dimensions(over, where) if isinstance(over, Mapping) else searching.read_spec(Path(over))
        setup, formula = choice.prepare(), self.target.formula
        signals = [] if formula is None else signals_of(parse_formula(formula))
        if reason := unavailable_signal(signals, setup.layout, setup.line):
            raise ValueError(f"{dash}requirement '{formula}': {reason}")
        self.space = searching.search_space(choice, dimensions, where)

    def spec(self, seed: int) -> dict[str, Any]:
        """Return what determines the runs of a search beside the scenario, as plain data."""
        return {
            "requirement": asdict(self.target),
            "over": [str(entry) for entry in self.space.dimensions],
            "seed": seed,
        }

    def search(
        self,
        runs: int,
        seed: int,
        jobs: int,
        *,
        shrink: bool,
        note: Callable[[searching.SearchRow], None] | None = None,
        kept: KeptRuns | None = None,
    ) -> Falsification:
        """Run the search, those of the runs that are not ``kept``; Ctrl-C ends it with the result so far."""
        interrupted = False
        task = partial(run_target, self.scenario, self.target)
        with search_runs(task, jobs, lambda why: TargetRun(nan, f"failed: {why}"), kept, TargetRun._make) as run_all:
            search = searching.FalsificationSearch(self.space, run_all, runs, jobs, seed=seed, note=note)
            try:
                search.find()
                if shrink:
                    search.shrink()
            except KeyboardInterrupt:
                interrupted = True
        return Falsification(self.scenario, self.target, self.space, search.rows, interrupted)


COUNTEREXAMPLE, RUNS_TABLE, RESULT = "counterexample.yaml", "runs.csv", "falsify.json"


def result_data(result: Falsification) -> dict[str, Any]:
    """Return the result as JSON data; values that are not finite are None."""
    row = result.smallest
    known = [entry.run.robustness for entry in result.rows if math.isfinite(entry.run.robustness)]
    return {
        "scenario": result.scenario.name,
        "requirement": result.target.name,
        "formula": result.target.formula,
        "unit": result.target.unit,
        "found": result.found,
        "interrupted": result.interrupted,
        "runs": len(result.rows),
        "runs_to_break": result.runs_to_break,
        "departure": None if row is None else row.departure,
        "robustness": None if row is None or not math.isfinite(row.run.robustness) else row.run.robustness,
        "smallest_robustness": min(known, default=None),
        "changes": result.changes,
        "nominal": {key: result.space.nominal_values[key] for key in result.changes},
        "problems": sum(bool(entry.run.problem) for entry in result.rows),
    }


def write_study(result: Falsification, folder: Path) -> None:
    """Write the table of the runs, the result and, after a break, the scenario that reproduces it."""
    write_whole(folder / RUNS_TABLE, result.table.to_csv(index=False))
    text = json.dumps(result_data(result), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_whole(folder / RESULT, text)
    if result.found:
        write_whole(folder / COUNTEREXAMPLE, result.yaml)
