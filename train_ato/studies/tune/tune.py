"""Tuning: search for the gains of a law over scenarios and seeds, with held-out runs beside."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from train_ato.api.progress import Report, share_bar
from train_ato.api.scenario_choice import Changes, GivenScenario, ScenarioChoice, choose_scenario, put_components
from train_ato.api.search_runs import RunAll, search_runs
from train_ato.api.series_folder import KeptRuns, SearchFolder
from train_ato.log.whole_file import writing
from train_ato.program.errors import RunFailed
from train_ato.scenario.dimensions import Dimension
from train_ato.studies.sweep.row import data_hash, scenario_hash
from train_ato.studies.tune import gain_space, objective
from train_ato.studies.tune.tune_result import HISTORY, INITIAL, TUNED, TuneResult, history_row, result_row


@dataclass(frozen=True)
class GainCandidate:
    """Evaluated gains.

    Attributes
    ----------
    number
        0 for the gains of the scenario.
    gains
        Values of the varied parameters; {} keeps those of every scenario.
    metrics
        Metrics of every task of the search, in their order.
    scores
        Scores of the tasks.
    """

    number: int
    gains: dict[str, Any]
    metrics: tuple[dict[str, Any], ...]
    scores: tuple[float, ...]

    @property
    def score(self) -> objective.GainScore:
        """Mean and worst score."""
        return objective.GainScore.of(self.scores)


RunWorks = Callable[[Sequence[gain_space.Work]], list[dict[str, Any]]]
"""Function that returns the metrics of several runs in their order."""


@dataclass
class GainSearch:
    """Search with one optimizer.

    Attributes
    ----------
    space
        Search space.
    tasks
        Numbers of the tasks of the search.
    scales
        Scale of every term, for every task of the search.
    weights
        Weight of every term.
    run
        Returns the metrics of several runs.
    """

    space: gain_space.GainSpace
    tasks: Sequence[int]
    scales: Sequence[Mapping[str, float]]
    weights: Mapping[str, float]
    run: RunWorks
    candidates: list[GainCandidate] = field(default_factory=list)

    def evaluate(self, generation: Sequence[dict[str, Any]]) -> list[GainCandidate]:
        """Evaluate gains on every task and append them to ``candidates``; equal gains are run once."""
        known = {_key(candidate.gains): candidate for candidate in self.candidates}
        new = list({_key(gains): gains for gains in generation if _key(gains) not in known}.values())
        works = [(task, gains) for gains in new for task in self.tasks]
        results = self.run(works)
        count = len(self.tasks)
        metrics = {_key(gains): tuple(results[k * count : (k + 1) * count]) for k, gains in enumerate(new)}
        found: list[GainCandidate] = []
        for gains in generation:
            rows = metrics.get(_key(gains)) or known[_key(gains)].metrics
            scores = tuple(
                objective.score_of_run(row, scale, self.weights) for row, scale in zip(rows, self.scales, strict=True)
            )
            found.append(GainCandidate(len(self.candidates) + len(found), gains, rows, scores))
        self.candidates += found
        return found

    def advance(self, optimizer: objective.GainOptimizer) -> list[GainCandidate]:
        """Evaluate the next generation of the optimizer and return its candidates."""
        points = optimizer.ask()
        found = self.evaluate([self.space.gains_at(point) for point in points])
        optimizer.tell(points, [candidate.score.objective for candidate in found])
        return found

    @property
    def best(self) -> GainCandidate:
        """Candidate with the smallest objective, the first one of equal ones."""
        return min(self.candidates, key=lambda candidate: candidate.score.objective)


def _key(gains: Mapping[str, Any]) -> tuple[tuple[str, Any], ...]:
    return tuple(gains.items())


POPULATION = 6
MAX_JOBS = 64


class TunePlan:
    """Checked tuning; every run is prepared once for a check.

    Parameters
    ----------
    tasks
        All runs of one set of gains, those of the search first.
    choice
        Scenario of the overlay.
    weights
        Weight of every term of the score.
    parameters, spec, runs
        Names of the varied parameters, their ranges, and the number of runs, as for :func:`tune`.
    """

    def __init__(
        self,
        tasks: list[gain_space.GainTask],
        choice: ScenarioChoice,
        weights: dict[str, float],
        parameters: Sequence[str] | None,
        spec: gain_space.TuneSpec,
        runs: int,
    ) -> None:
        self.tasks, self.choice, self.weights = tasks, choice, weights
        self.runner = gain_space.GainRunner(tasks)
        setups = [self.runner.setup(index) for index in range(len(tasks))]
        law = setups[0].scenario.law
        self.space = space = gain_space.gain_space(law, setups[0].gains(law).values, parameters, spec)
        searched = len(self.numbers(gain_space.SEARCHED))
        smallest = POPULATION * searched
        if runs < smallest:
            each = f"{searched} runs" if searched > 1 else "one run"
            raise ValueError(
                f"runs {runs}: a generation has {POPULATION} candidates with {each} each; give {smallest} or more"
            )
        self.generations = runs // smallest
        self.settings: dict[str, Any] = {
            "law": law,
            "ranges": dict.fromkeys(space.fixed, "fixed")
            | {entry.key: range_text(entry) for entry in space.dimensions},
            "weights": weights,
            "candidates": 1 + POPULATION * self.generations,
            "runs": self.generations * smallest,
        }
        self._rows: list[dict[str, Any]] = []

    def numbers(self, part: str) -> list[int]:
        """Return the numbers of the tasks of a part."""
        return [index for index, task in enumerate(self.tasks) if task.part == part]

    def execute(
        self,
        make: objective.MakeOptimizer,
        seed: int,
        jobs: int,
        shown: bool | None,
        folder: Path | None = None,
        kept: KeptRuns | None = None,
    ) -> TuneResult:
        """Run references, initial gains, search and held-out runs; the history is written during the search.

        Runs that are ``kept`` are not run again.

        Raises
        ------
        RunFailed
            If a reference run failed.
        KeyboardInterrupt
            Ctrl-C before the search.
        """
        searched, outside = self.numbers(gain_space.SEARCHED), self.numbers(gain_space.HELD_OUT)
        total = 2 * len(self.tasks) + self.settings["runs"] + len(outside)
        runner = self.runner if jobs == 1 else gain_space.GainRunner(self.tasks)
        with (
            search_runs(runner, jobs, gain_space.lost_run, kept) as run_all,
            share_bar(f"tune {self.space.law}", shown=shown) as update,
        ):
            run = _CountedRuns(run_all, total, update)
            scales = self._scales(run)
            search = GainSearch(self.space, searched, [scales[k] for k in searched], self.weights, run)
            begin = search.evaluate([{}])
            before = run([(index, {}) for index in outside])
            self._keep(begin, 0, folder)
            after: list[dict[str, Any]] = []
            interrupted = False
            try:
                optimizer = make(self.space.start_point, seed, POPULATION)
                for generation in range(1, self.generations + 1):
                    self._keep(search.advance(optimizer), generation, folder)
                    run.best = search.best.score.objective
                after = run([(index, search.best.gains) for index in outside])
            except KeyboardInterrupt:
                interrupted = True
        metrics = {INITIAL: [*begin[0].metrics, *before], TUNED: [*search.best.metrics, *after]}
        gains = search.best.gains or self.space.initial
        return TuneResult(
            law=self.space.law,
            initial=dict(self.space.initial),
            gains=dict(gains),
            rows=self._table([*searched, *outside], metrics, scales),
            candidates=self._rows,
            settings={**self.settings, "search_seed": seed},
            overlay=overlay_scenario(self.choice, self.space.law, gains, self.tasks[0]),
            interrupted=interrupted,
        )

    @property
    def scenarios(self) -> list[str]:
        """Hashes of the scenarios with the tuned law, and of those of the reference runs."""
        hashes = [scenario_hash(self.runner.setup(index)) for index in range(len(self.tasks))]
        return hashes + [data_hash(task.choice.data, task.choice.path.parent) for task in self.tasks]

    def spec(self, seed: int) -> dict[str, Any]:
        """Return what determines the runs of a search beside the scenarios, as plain data."""
        return {
            "tasks": [(task.label, task.part) for task in self.tasks],
            "start": self.space.start,
            **{key: self.settings[key] for key in ("law", "ranges", "weights")},
            "search_seed": seed,
        }

    def _scales(self, run: RunWorks) -> list[dict[str, float]]:
        """Return the scales of every task, from its criteria and its reference run."""
        references = run([(index, None) for index in range(len(self.tasks))])
        scales = []
        for task, metrics in zip(self.tasks, references, strict=True):
            if metrics.get("speed_rmse_kmh") is None:
                reason = metrics.get("failure", metrics.get("status"))
                raise RunFailed(
                    f"{task.label}: the run with law '{task.choice.checked.law}' of the scenario failed: {reason}"
                )
            scales.append(objective.scales_of(task.choice.checked.criteria, metrics))
        return scales

    def _keep(self, found: Sequence[GainCandidate], generation: int, folder: Path | None) -> None:
        """Store the candidates of a generation and append them to the history file."""
        labels = [task.label for task in self.tasks if task.part == gain_space.SEARCHED]
        new = [
            history_row(entry.number, generation, entry.gains or self.space.initial, entry.scores, labels)
            for entry in found
        ]
        self._rows += new
        if folder is None:
            return
        path = folder / HISTORY
        with writing(path), path.open("a" if generation else "w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(new[0]), lineterminator="\n")
            if generation == 0:
                writer.writeheader()
            writer.writerows(new)

    def _table(
        self,
        numbers: Sequence[int],
        metrics: Mapping[str, Sequence[dict[str, Any]]],
        scales: Sequence[Mapping[str, float]],
    ) -> list[dict[str, Any]]:
        """Return the rows of the runs with the initial and the tuned gains; an interrupted tuning has fewer."""
        found = []
        for place, number in enumerate(numbers):
            task = self.tasks[number]
            for gains in (INITIAL, TUNED):
                if place < len(metrics[gains]):
                    row = metrics[gains][place]
                    score = objective.score_of_run(row, scales[number], self.weights)
                    found.append(result_row(task.label, task.part, gains, row, score))
        return found


class _CountedRuns:
    """Function that returns the metrics of several runs, and counts them for the progress bar."""

    def __init__(self, run_all: RunAll, total: int, update: Report) -> None:
        self._run_all, self._total, self._update, self._count = run_all, total, update, 0
        self.best: float | None = None

    def __call__(self, works: Sequence[gain_space.Work]) -> list[dict[str, Any]]:
        found = []
        for metrics in self._run_all(works):
            found.append(metrics)
            self._count += 1
            best = "" if self.best is None else f", best {self.best:.3g}"
            self._update(min(1.0, self._count / self._total), f"run {self._count} of {self._total}{best}")
        return found


def range_text(dimension: Dimension) -> str:
    """Return range or values of a parameter as text."""
    if dimension.low is None:
        return ", ".join(str(value) for value in dimension.values)
    return f"{dimension.low:g} ... {dimension.high:g}, {dimension.scale}"


def overlay_scenario(
    choice: ScenarioChoice, law: str, gains: Mapping[str, Any], task: gain_space.GainTask
) -> dict[str, Any]:
    """Return the overlay scenario with the tuned law, its observer and compensation, and the gains."""
    data = choice.as_overlay
    data["name"] = f"{choice.name}-tuned-{law.rpartition(':')[2]}"[:100]
    data["summary"] = f"{law} with tuned gains"
    data["law"] = law
    for kind in ("observer", "compensation"):
        if (name := getattr(task.scenario, kind)) != getattr(task.choice.checked, kind):
            data[kind] = name
    own = task.scenario.laws.get(law, {})
    given = own if own != task.choice.checked.laws.get(law, {}) else {}  # parameters of a law object
    blocks = data.get("laws") or {}
    data["laws"] = {**blocks, law: {**blocks.get(law, {}), **given, **gains}}
    return data


def tune(
    scenario: GivenScenario | Sequence[GivenScenario],
    law: Any,
    *,
    observer: Any = None,
    compensation: Any = None,
    set: Changes | None = None,
    parameters: Sequence[str] | None = None,
    over: str | Path | Mapping[str, Any] | None = None,
    seeds: Sequence[int] | None = None,
    held_out: Sequence[GivenScenario] = (),
    held_out_seeds: Sequence[int] = (),
    weights: Mapping[str, float] | None = None,
    runs: int = 60,
    jobs: int = 1,
    search_seed: int = 1,
    out: str | Path | None = None,
    progress: bool | None = None,
    optimizer: objective.MakeOptimizer = objective.CmaOptimizer,
) -> TuneResult:
    """Search for the gains of a law with the best runs of one or more scenarios.

    Every candidate is run on every scenario, seed and variation. Its objective is the mean of the average and the worst
    score; the formula of a score is in :mod:`train_ato.studies.tune.objective`. Candidates have three significant
    digits. For one ``search_seed`` the result is the same with every number of jobs. Ctrl-C ends the search: the result
    has the best gains of the complete generations.

    Parameters
    ----------
    scenario
        One or more scenarios of the search.
    law, observer, compensation, set
        As for :func:`train_ato.run`; ``set`` applies to every scenario, also to the held-out ones.
    parameters
        Names of the parameters to vary; default: every numeric one above 0.
    over
        YAML file, or a mapping, with ranges (``over``) and start values (``start``) of the parameters and changes of
        the scenarios (``variations``).
    seeds
        Seeds of the runs; default: as in each scenario.
    held_out, held_out_seeds
        Scenarios and seeds that the search does not use; they are run with the initial and the tuned gains.
    weights
        Weights of the terms ``speed``, ``stop``, ``command``, ``coupler``, ``overspeed``; 0 removes a term.
    runs
        Largest number of simulated runs of the search, in whole generations of six candidates.
    jobs
        Worker processes; 1: this process.
    search_seed
        Seed of the search.
    out
        Folder for overlay scenario, table, history and the finished runs; one with some runs of the same search is
        continued, also with more ``runs``.  Default: none.
    progress
        Show a progress bar; default: in a terminal and in a notebook.
    optimizer
        Search on the unit cube; default: CMA-ES.

    Returns
    -------
    TuneResult
        Gains, runs before and after, history, overlay scenario.

    Raises
    ------
    ValueError
        Bad input, in one line with the remedy; nothing was started.
    RunFailed
        The run with the law of a scenario failed.
    KeyboardInterrupt
        Ctrl-C before the initial gains were run.

    Examples
    --------
    >>> import train_ato as ta
    >>> tuned = ta.tune("xuzhou_metro", "smc", set={"duration": 20}, parameters=["l1", "ks"], runs=6)
    >>> tuned.score("tuned").objective <= tuned.score("initial").objective
    True
    """
    if optimizer is objective.CmaOptimizer:
        objective.check_optimizer()
    spec = gain_space.NO_SPEC if over is None else gain_space.read_tune_spec(over)
    given = [scenario] if not isinstance(scenario, Sequence) or isinstance(scenario, str) else list(scenario)
    choices = [choose_scenario(name).changed(set, None) for name in given]
    outside = [choose_scenario(name).changed(set, None) for name in held_out]
    if not choices:
        raise ValueError("scenario: none; name one or more")
    parts = {"observer": observer, "compensation": compensation}
    tasks = gain_space.gain_tasks(choices, law, gain_space.SEARCHED, seeds, spec.variations, **parts)
    if held_out_seeds:
        tasks += gain_space.gain_tasks(choices, law, gain_space.HELD_OUT, held_out_seeds, **parts)
    tasks += gain_space.gain_tasks(outside, law, gain_space.HELD_OUT, [*(seeds or ()), *held_out_seeds], **parts)
    put_components(choices[0].checked, importable=jobs > 1, changes=set, law=law, **parts)  # checks them
    checked = objective.read_weights([f"{key}={weight}" for key, weight in (weights or {}).items()], "weights")
    plan = TunePlan(tasks, choices[0], checked, parameters, spec, runs)
    if not 1 <= jobs <= MAX_JOBS:
        raise ValueError(f"jobs {jobs}: out of range; give 1 to {MAX_JOBS}")
    if out is None:
        return plan.execute(optimizer, search_seed, jobs, progress)
    folder = SearchFolder.opened(Path(out), "out")
    with folder.kept("tune", plan.spec(search_seed), plan.scenarios) as kept:
        result = plan.execute(optimizer, search_seed, jobs, progress, folder.path, kept)
        result.write(folder.path)
    return result
