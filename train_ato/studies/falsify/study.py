"""Falsification of a requirement over keys of a scenario, and its result."""

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
from train_ato.api.progress import share_bar
from train_ato.api.scenario_choice import Changes, GivenScenario, ScenarioChoice, choose_scenario
from train_ato.api.search_runs import search_runs
from train_ato.api.series_folder import KeptRuns
from train_ato.judge.summary_table import verdict_html
from train_ato.judge.verdict import three_digits
from train_ato.log.whole_file import write_whole
from train_ato.scenario.dimensions import read_dimensions
from train_ato.studies.falsify.search import FalsificationSearch, SearchRow, SearchSpace, read_spec, search_space
from train_ato.studies.falsify.target import RequirementTarget, TargetRun, check_signals, requirement_target, run_target

if TYPE_CHECKING:
    import pandas as pd


ONE_LINE = dict.fromkeys((*range(32), 127, 133, 8232, 8233), " ")
"""Characters that end a line or a comment of YAML, and others that do not print."""
RUNS = 100
"""Default of the largest number of runs."""


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
    space: SearchSpace
    rows: list[SearchRow]
    interrupted: bool = False

    @property
    def smallest(self) -> SearchRow | None:
        """Run that breaks the requirement with the smallest departure; None without a break."""
        broken = [row for row in self.rows if row.run.breaks]
        return min(broken, key=lambda row: row.departure) if broken else None

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

        return pd.DataFrame([row_of(self.space, row) for row in self.rows])

    @property
    def yaml(self) -> str:
        """Complete scenario that reproduces the break, with the requirement; "" without a break."""
        row = self.smallest
        return "" if row is None else counterexample(self.scenario, self.target, self.space, row)

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


def row_of(space: SearchSpace, row: SearchRow) -> dict[str, Any]:
    """Return a run as a row of the table."""
    values = space.values(row.point)
    return {
        "run": row.number, "phase": row.phase, **values, "departure": row.departure,
        "robustness": row.run.robustness, "problem": row.run.problem,
    }  # fmt: skip


def counterexample(choice: ScenarioChoice, target: RequirementTarget, space: SearchSpace, row: SearchRow) -> str:
    """Return the scenario of a run as YAML with the content of all its files, and with the requirement."""
    changed = choice.with_(space.values(row.point))
    data = yaml.safe_load(changed.prepare().resolved_yaml())
    data["name"] = f"{choice.name}.falsified"[-100:]
    if target.formula is not None:
        requirements = data.setdefault("criteria", {}).setdefault("requirements", {})
        requirements[target.name] = target.formula
    steps = {key: value for key, value in space.values(row.point).items() if value != space.nominal_values[key]}
    unit = f" {target.unit}" if target.unit else ""
    head = [
        f"breaks {target.name}{'' if target.formula is None else f': {target.formula}'}",
        f"robustness {row.run.robustness:.6g}{unit}, departure {row.departure:.6g}, of {choice.name} with",
        *(f"  {key}: {value}" for key, value in steps.items()),
    ]
    text = "".join(f"# {line.translate(ONE_LINE)}\n" for line in head)
    return text + yaml.dump(data, Dumper=TextDumper, sort_keys=False, allow_unicode=True, width=120)


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
    study = prepare_study(choice, requirement, over, runs, jobs=jobs)
    with share_bar(f"falsify {choice.name}", shown=progress) as update:
        return study.search(
            runs, seed, jobs, shrink=shrink, note=lambda row: update(row.number / runs, f"run {row.number}")
        )


@dataclass(frozen=True)
class FalsificationStudy:
    """Checked input of a falsification."""

    scenario: ScenarioChoice
    target: RequirementTarget
    space: SearchSpace

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
        note: Callable[[SearchRow], None] | None = None,
        kept: KeptRuns | None = None,
    ) -> Falsification:
        """Run the search, those of the runs that are not ``kept``; Ctrl-C ends it with the result so far."""
        interrupted = False
        task = partial(run_target, self.scenario, self.target)
        with search_runs(task, jobs, lambda why: TargetRun(nan, f"failed: {why}"), kept, TargetRun._make) as run_all:
            search = FalsificationSearch(self.space, run_all, runs, jobs, seed=seed, note=note)
            try:
                search.find()
                if shrink:
                    search.shrink()
            except KeyboardInterrupt:
                interrupted = True
        return Falsification(self.scenario, self.target, self.space, search.rows, interrupted)


def prepare_study(
    choice: ScenarioChoice,
    requirement: str,
    over: Mapping[str, Any] | str | Path,
    runs: int,
    *,
    jobs: int,
    dash: str = "",
) -> FalsificationStudy:
    """Check the input of a falsification; ``dash`` precedes the names of arguments in messages."""
    for name, value in (("runs", runs), ("jobs", jobs)):
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise ValueError(f"{dash}{name} {value}: give an integer of at least 1")
    target = requirement_target(requirement, choice.checked, f"{dash}requirement")
    where = "over" if isinstance(over, Mapping) else f"{over}: over"
    dimensions = read_dimensions(over, where) if isinstance(over, Mapping) else read_spec(Path(over))
    check_signals(target, choice.prepare(), f"{dash}requirement")
    return FalsificationStudy(choice, target, search_space(choice, dimensions, where))


COUNTEREXAMPLE, RUNS_TABLE, RESULT = "counterexample.yaml", "runs.csv", "falsify.json"
"""Files in the folder of a falsification."""


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
