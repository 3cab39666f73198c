"""Score of a run for the search for gains: a weighted mean of metrics over their scales, and penalties.

The score of a run that is tracked is::

    score = sum_i w_i x_i / s_i / sum_i w_i + sum_c (1 + min(|v_c| / limit_c - 1, 9)),     at most 99

with the metrics x_i of :data:`TERMS`, their scales s_i and weights w_i, and the failed criteria c of the scenario. A
scale is the limit of the scenario's criterion for this metric; without one, the metric of the reference run, which is
the scenario as it is shipped, with its own law, but at least the smallest scale of the term. A score of 1 is therefore
about that of the shipped run.

A run that is not tracked has 100 + 10 n + 10 (1 - limit/|value|): n is the rank of its outcome of tracking, 1 for
``saturated`` to 8 for ``never departed``, and value and limit are the figures that decided. A run that failed has 200,
gains that the law refuses 210. All scores are without unit; smaller is better.

Hansen N., The CMA Evolution Strategy: A Tutorial, 2016, arXiv:1604.00772. Its choice over the samplers of optuna, with
figures, is in msgs_docs/tuning.md.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from train_ato.scenario.criteria import Criteria


MAX_FEASIBLE = 99.0
"""Largest score of a tracked run."""
NOT_TRACKED, FAILED_RUN, REFUSED_GAINS = 100.0, 200.0, 210.0
"""Smallest score of a run that is not tracked; score of a failed run, and of gains that the law refuses."""
MAX_EXCESS = 9.0
"""Largest relative excess of a criterion that counts."""


@dataclass(frozen=True)
class ObjectiveTerm:
    """One metric of the score.

    Attributes
    ----------
    key
        Name in ``--criterion``.
    metrics
        Keys of ``summary.json``; the largest magnitude of them counts.
    words, unit
        Name and unit of the metric.
    criteria
        Keys of the criteria whose smallest limit is the scale.
    smallest_scale
        Smallest scale, in the unit of the metric.
    weight
        Default weight.
    """

    key: str
    metrics: tuple[str, ...]
    words: str
    unit: str
    criteria: tuple[str, ...]
    smallest_scale: float
    weight: float

    def value(self, metrics: Mapping[str, Any]) -> float | None:
        """Return the largest magnitude of the metrics; None for a run without them."""
        found = [abs(float(metrics[key])) for key in self.metrics if metrics.get(key) is not None]
        return max(found, default=None)

    def scale(self, criteria: Criteria, reference: Mapping[str, Any]) -> float:
        """Return the scale: the smallest limit of the criteria, otherwise the metric of the reference run."""
        from train_ato.judge.verdict import CRITERIA

        limits = [
            getattr(criteria, entry.key) * entry.factor
            for entry in CRITERIA
            if entry.key in self.criteria and getattr(criteria, entry.key) is not None
        ]
        found = min(limits) if limits else self.value(reference) or 0.0
        return max(found, self.smallest_scale)


TERMS: tuple[ObjectiveTerm, ...] = (
    ObjectiveTerm("speed", ("speed_rmse_kmh",), "speed error, rms", "km/h", ("speed_error_rms",), 0.01, 2.0),
    ObjectiveTerm("stop", ("stop_error_max_m",), "stop error", "m", ("stop_window",), 0.1, 1.0),
    ObjectiveTerm("command", ("command_variation_kn_per_s",), "command variation", "kN/s", (), 0.1, 1.0),
    ObjectiveTerm(
        "coupler",
        ("coupler_draft_max_kn", "coupler_buff_max_kn"),
        "coupler force",
        "kN",
        ("coupler_draft", "coupler_buff"),
        10.0,
        1.0,
    ),
    ObjectiveTerm("overspeed", ("overspeed_max_kmh",), "overspeed", "km/h", ("overspeed",), 0.1, 1.0),
)
"""Terms of the score, in the order of the tables."""


def read_weights(texts: Sequence[str], option: str = "--criterion") -> dict[str, float]:
    """Return the weight of every term from ``speed=2,stop=0`` texts; the others keep their default."""
    weights = {term.key: term.weight for term in TERMS}
    for part in (part.strip() for text in texts for part in text.split(",") if part.strip()):
        key, equals, number = part.partition("=")
        if key not in weights:
            raise ValueError(f"{option} {part}: unknown term '{key}'; use {', '.join(weights)}")
        try:
            weight = float(number) if equals else float("nan")
        except ValueError:
            weight = float("nan")
        if not 0.0 <= weight < float("inf"):
            raise ValueError(f"{option} {part}: not a weight; write for example {key}=2, or {key}=0 without this term")
        weights[key] = weight
    if not any(weights.values()):
        raise ValueError(f"{option}: every weight is 0; give one above 0")
    return weights


def scales_of(criteria: Criteria, reference: Mapping[str, Any]) -> dict[str, float]:
    """Return the scale of every term in its unit, from the criteria of a scenario and its reference run."""
    return {term.key: term.scale(criteria, reference) for term in TERMS}


def score_of_run(metrics: Mapping[str, Any], scales: Mapping[str, float], weights: Mapping[str, float]) -> float:
    """Return the score of one run; smaller is better.

    Parameters
    ----------
    metrics
        Content of ``summary.json``; ``status`` is ``refused`` if the law refuses the gains.
    scales, weights
        Scale, in its unit, and weight of every term.
    """
    from train_ato.judge.verdict import is_tracked

    if metrics.get("status") == "refused":
        return REFUSED_GAINS
    if metrics.get("status") != "done" or metrics.get("speed_rmse_kmh") is None:
        return FAILED_RUN
    if not is_tracked(metrics):
        return _score_not_tracked(metrics)
    used = [(term, value) for term in TERMS if (value := term.value(metrics)) is not None and weights[term.key] > 0]
    total = sum(weights[term.key] for term, _ in used)
    score = sum(weights[term.key] * value / scales[term.key] for term, value in used) / total if total else 0.0
    score += sum(_criterion_penalty(row) for row in metrics.get("criteria") or () if row["passed"] is False)
    return min(score, MAX_FEASIBLE) if math.isfinite(score) else FAILED_RUN


def _score_not_tracked(metrics: Mapping[str, Any]) -> float:
    from train_ato.judge.tracking import OUTCOMES

    worst = metrics["tracking_findings"][0]
    rank = len(OUTCOMES) - 1 - OUTCOMES.index(worst["outcome"])
    ratio = min(1.0, abs(float(worst["limit"])) / max(abs(float(worst["value"])), 1e-9))
    return NOT_TRACKED + 10.0 * rank + 10.0 * (1.0 - ratio)


def _criterion_penalty(row: Mapping[str, Any]) -> float:
    """Return 1 and the relative excess of a failed criterion; the largest excess without a value."""
    if row["value"] is None or not row["limit"]:
        return 1.0 + MAX_EXCESS
    return 1.0 + min(abs(float(row["value"])) / float(row["limit"]) - 1.0, MAX_EXCESS)


@dataclass(frozen=True)
class GainScore:
    """Score of gains over several runs.

    Attributes
    ----------
    mean, worst
        Mean and largest score of the runs.
    """

    mean: float
    worst: float

    @classmethod
    def of(cls, scores: Sequence[float]) -> GainScore:
        """Return mean and maximum of the scores of the runs."""
        import numpy as np

        return cls(float(np.mean(scores)), float(np.max(scores)))

    @property
    def objective(self) -> float:
        """Mean of average and worst score, the minimised value."""
        return (self.mean + self.worst) / 2.0

    @property
    def feasible(self) -> bool:
        """True if every run is tracked."""
        return self.worst < NOT_TRACKED


SPREAD = 0.2
"""Initial standard deviation, as part of the range of every gain."""
INSTALL = "pip install cma"


class GainOptimizer(Protocol):
    """Search on the unit cube, one generation of points after the other."""

    def ask(self) -> list[list[float]]:
        """Return the points of the next generation."""

    def tell(self, points: Sequence[Sequence[float]], scores: Sequence[float]) -> None:
        """Take the scores of the points; smaller is better."""


MakeOptimizer = Callable[[Sequence[float], int, int], GainOptimizer]
"""Function of start point, seed and population."""


def check_optimizer() -> None:
    """Refuse a search without the package of the optimizer."""
    try:
        importlib.import_module("cma")
    except ImportError:
        raise ValueError(f"tune: the package 'cma' is not installed; install it: {INSTALL}") from None


class CmaOptimizer:
    """CMA-ES with bounds 0 and 1.

    Parameters
    ----------
    start
        Point of the scenario's gains, the mean of the first generation.
    seed
        Seed of the search.
    population
        Points of a generation.
    """

    def __init__(self, start: Sequence[float], seed: int, population: int) -> None:
        import cma
        import numpy as np

        self._single = len(start) == 1
        # cma needs two dimensions; a second one without effect
        first = [*start, 0.5] if self._single else list(start)
        random = np.random.default_rng(seed)
        options = {
            "bounds": [0.0, 1.0],
            "seed": np.nan,  # a stream of its own in place of the global one of numpy
            "randn": lambda *shape: random.standard_normal(shape),
            "popsize": population,
            "verbose": -9,
            "verb_log": 0,
        }
        self._search: Any = cma.CMAEvolutionStrategy(first, SPREAD, options)
        self._asked: list[Any] = []

    def ask(self) -> list[list[float]]:
        """Return the points of the next generation."""
        self._asked = self._search.ask()
        return [[float(share) for share in (point[:1] if self._single else point)] for point in self._asked]

    def tell(self, points: Sequence[Sequence[float]], scores: Sequence[float]) -> None:
        """Update mean, step size and covariance with the scores of the generation."""
        self._search.tell(self._asked, list(scores))
