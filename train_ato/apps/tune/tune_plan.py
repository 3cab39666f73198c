"""Checked tuning: runs of the references, of the initial gains, of the search, and of the held-out scenarios."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from train_ato.apps.runs.progress import Report, share_bar
from train_ato.apps.runs.scenario_choice import ScenarioChoice
from train_ato.apps.sweep.dimensions import Dimension
from train_ato.apps.tune.gain_runs import HELD_OUT, SEARCHED, GainRunner, GainTask
from train_ato.apps.tune.gain_space import GainSpace, gain_space
from train_ato.apps.tune.gain_workers import GainWorkers
from train_ato.apps.tune.objective import GainScore, scales_of, score_of_run
from train_ato.apps.tune.optimizers import GainOptimizer, MakeOptimizer
from train_ato.apps.tune.tune_result import HISTORY, INITIAL, TUNED, TuneResult, history_row, result_row
from train_ato.apps.tune.tune_spec import TuneSpec
from train_ato.errors import RunFailed
from train_ato.log.whole_file import writing


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
    def score(self) -> GainScore:
        """Mean and worst score."""
        return GainScore.of(self.scores)


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
    workers
        Evaluation of the runs.
    done
        Called after every run.
    """

    space: GainSpace
    tasks: Sequence[int]
    scales: Sequence[Mapping[str, float]]
    weights: Mapping[str, float]
    workers: GainWorkers
    done: Callable[[], None]
    candidates: list[GainCandidate] = field(default_factory=list)

    def evaluate(self, generation: Sequence[dict[str, Any]]) -> list[GainCandidate]:
        """Evaluate gains on every task and append them to ``candidates``; equal gains are run once."""
        known = {_key(candidate.gains): candidate for candidate in self.candidates}
        new = list({_key(gains): gains for gains in generation if _key(gains) not in known}.values())
        works = [(task, gains) for gains in new for task in self.tasks]
        results = self.workers.run(works, self.done)
        count = len(self.tasks)
        metrics = {_key(gains): tuple(results[k * count : (k + 1) * count]) for k, gains in enumerate(new)}
        found: list[GainCandidate] = []
        for gains in generation:
            rows = metrics.get(_key(gains)) or known[_key(gains)].metrics
            scores = tuple(score_of_run(row, scale, self.weights) for row, scale in zip(rows, self.scales, strict=True))
            found.append(GainCandidate(len(self.candidates) + len(found), gains, rows, scores))
        self.candidates += found
        return found

    def advance(self, optimizer: GainOptimizer) -> list[GainCandidate]:
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
"""Candidates of a generation."""
MOST_JOBS = 64
"""Largest number of worker processes."""


@dataclass
class TunePlan:
    """Checked tuning.

    Attributes
    ----------
    tasks
        All runs of one set of gains, those of the search first.
    choice
        Scenario of the overlay.
    weights
        Weight of every term of the score.
    space
        Varied parameters.
    generations
        Number of generations.
    settings
        Settings for the result.
    """

    tasks: list[GainTask]
    choice: ScenarioChoice
    weights: dict[str, float]
    space: GainSpace
    generations: int
    settings: dict[str, Any]
    _rows: list[dict[str, Any]] = field(default_factory=list)

    @classmethod
    def of(
        cls,
        tasks: list[GainTask],
        choice: ScenarioChoice,
        weights: dict[str, float],
        parameters: Sequence[str] | None,
        spec: TuneSpec,
        runs: int,
    ) -> TunePlan:
        """Return the plan of a tuning; every run is prepared once for a check.

        Raises
        ------
        ValueError
            For a law that does not fit a train, a wrong search space, or too few runs.
        """
        runner = GainRunner(tasks)
        setups = [runner.setup(index) for index in range(len(tasks))]
        law = setups[0].controller
        values = setups[0].gains(law).values
        space = gain_space(law, values, parameters, spec)
        searched = sum(task.part == SEARCHED for task in tasks)
        smallest = POPULATION * searched
        if runs < smallest:
            each = f"{searched} runs" if searched > 1 else "one run"
            raise ValueError(
                f"runs {runs}: a generation has {POPULATION} candidates with {each} each; give {smallest} or more"
            )
        settings: dict[str, Any] = {
            "law": law,
            "ranges": dict.fromkeys(space.fixed, "fixed")
            | {entry.key: range_text(entry) for entry in space.dimensions},
            "weights": weights,
            "candidates": 1 + POPULATION * (runs // smallest),
            "runs": runs // smallest * smallest,
        }
        return cls(tasks, choice, weights, space, runs // smallest, settings)

    @staticmethod
    def check_jobs(jobs: int) -> None:
        """Refuse a number of processes out of range."""
        if not 1 <= jobs <= MOST_JOBS:
            raise ValueError(f"jobs {jobs}: out of range; give 1 to {MOST_JOBS}")

    def numbers(self, part: str) -> list[int]:
        """Return the numbers of the tasks of a part."""
        return [index for index, task in enumerate(self.tasks) if task.part == part]

    def execute(self, make: MakeOptimizer, seed: int, jobs: int, shown: bool | None, folder: Path | None) -> TuneResult:
        """Run references, initial gains, search and held-out runs; the history is written during the search.

        Raises
        ------
        RunFailed
            If a reference run failed.
        KeyboardInterrupt
            Ctrl-C before the search.
        """
        searched, outside = self.numbers(SEARCHED), self.numbers(HELD_OUT)
        total = 2 * len(self.tasks) + self.settings["runs"] + len(outside)
        with GainWorkers(self.tasks, jobs) as workers, share_bar(f"tune {self.space.law}", shown) as update:
            done = _RunCount(total, update)
            scales = self._scales(workers, done)
            search = GainSearch(self.space, searched, [scales[k] for k in searched], self.weights, workers, done)
            begin = search.evaluate([{}])
            before = workers.run([(index, {}) for index in outside], done)
            self._keep(begin, 0, folder)
            after: list[dict[str, Any]] = []
            interrupted = False
            try:
                optimizer = make(self.space.start_point, seed, POPULATION)
                for generation in range(1, self.generations + 1):
                    self._keep(search.advance(optimizer), generation, folder)
                    done.best = search.best.score.objective
                after = workers.run([(index, search.best.gains) for index in outside], done)
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

    def _scales(self, workers: GainWorkers, done: Callable[[], None]) -> list[dict[str, float]]:
        """Return the scales of every task, from its criteria and its reference run."""
        references = workers.run([(index, None) for index in range(len(self.tasks))], done)
        for task, metrics in zip(self.tasks, references, strict=True):
            if metrics.get("speed_rmse_kmh") is None:
                reason = metrics.get("failure", metrics.get("status"))
                raise RunFailed(
                    f"{task.label}: the run with law '{task.choice.checked.law}' of the scenario failed: {reason}"
                )
        return [
            scales_of(task.choice.checked.criteria, metrics)
            for task, metrics in zip(self.tasks, references, strict=True)
        ]

    def _keep(self, found: Sequence[GainCandidate], generation: int, folder: Path | None) -> None:
        """Store the candidates of a generation and append them to the history file."""
        labels = [task.label for task in self.tasks if task.part == SEARCHED]
        new = [
            history_row(entry.number, generation, entry.gains or self.space.initial, entry.scores, labels)
            for entry in found
        ]
        self._rows += new
        if folder is None:
            return
        path = folder / HISTORY
        with writing(path), path.open("a", encoding="utf-8", newline="") as file:
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
                    score = score_of_run(row, scales[number], self.weights)
                    found.append(result_row(task.label, task.part, gains, row, score))
        return found


class _RunCount:
    """Counter of the runs for the progress bar."""

    def __init__(self, total: int, update: Report) -> None:
        self._total, self._update, self._count = total, update, 0
        self.best: float | None = None

    def __call__(self) -> None:
        self._count += 1
        best = "" if self.best is None else f", best {self.best:.3g}"
        self._update(min(1.0, self._count / self._total), f"run {self._count} of {self._total}{best}")


def range_text(dimension: Dimension) -> str:
    """Return range or values of a parameter as text."""
    if dimension.low is None:
        return ", ".join(str(value) for value in dimension.values)
    return f"{dimension.low:g} ... {dimension.high:g}, {dimension.scale}"


def overlay_scenario(choice: ScenarioChoice, law: str, gains: Mapping[str, Any], task: GainTask) -> dict[str, Any]:
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
