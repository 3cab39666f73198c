"""Search for the gains with the best score over several runs, one generation of candidates after the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from train_ato.apps.tune.gain_space import GainSpace
from train_ato.apps.tune.gain_workers import GainWorkers
from train_ato.apps.tune.objective import GainScore, score_of_run
from train_ato.apps.tune.optimizers import GainOptimizer


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
