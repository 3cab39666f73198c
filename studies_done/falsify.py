"""Runs to the first break of ten planted faults: Bayesian search, CMA-ES and cross-entropy against random search.

Run: ``python studies_done/falsify.py`` (``--json`` for data), and ``python studies_done/falsify.py --shares`` for the shares of the
space that break a requirement, some minutes each.  The methods begin with the nominal point, which breaks nothing.
Every run is a run of the engine.  The random search has the median of the geometric distribution with the share of
breaks among the random points of a pool, so that it does not depend on a choice of seeds.  CMA-ES needs
``pip install cma``.

The goal: at most a third of the runs of the random search, median over 20 seeds, for every fault.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from collections.abc import Callable
from typing import Any

import numpy as np
sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Goal, judge
from planted_faults import BASE, FAULTS

import train_ato as ta
from train_ato.studies.falsify.search import FalsificationSearch
from train_ato.studies.falsify.study import FalsificationStudy
from train_ato.studies.falsify.study import TargetRun, run_target

POOL = 400
"""Number of random points of every fault."""
BREAKS = 4
"""Number of them that break each fault: its limit was chosen so, and ``--shares`` repeats the count."""
MOST_RUNS = 100
"""Number of runs after which a search ends without a break; it counts as this number."""
LARGEST_RATIO = 1.0 / 3.0


class CountedRuns:
    """Function of unit coordinates that counts its calls up to the first break."""

    def __init__(self, study: FalsificationStudy) -> None:
        self.study, self.count, self.broken = study, 0, False

    def __call__(self, point: Any) -> float:
        """Return the robustness of a point; 0 after the end of the search."""
        if self.broken or self.count >= MOST_RUNS:
            return 0.0
        self.count += 1
        found = run_target(self.study.scenario, self.study.target, self.study.space.values(np.clip(point, 0.0, 1.0)))
        self.broken = found.breaks
        return found.robustness if math.isfinite(found.robustness) else 1.0

    @property
    def ended(self) -> bool:
        """True after a break, or without runs left."""
        return self.broken or self.count >= MOST_RUNS


def bayesian(study: FalsificationStudy, seed: int) -> int:
    """Return the number of runs of the search of the package."""

    def run_all(changes: Any) -> list[TargetRun]:
        return [run_target(study.scenario, study.target, change) for change in changes]

    search = FalsificationSearch(study.space, run_all, MOST_RUNS, seed=seed)
    search.find()
    return len(search.rows)


def cma_es(study: FalsificationStudy, seed: int) -> int:
    """Return the number of runs of CMA-ES from the nominal point with step 0.3, started again after its end."""
    import cma

    runs = CountedRuns(study)
    runs(study.space.nominal)
    options = {"bounds": [0, 1], "seed": seed + 1, "verbose": -9}
    while not runs.ended:
        strategy = cma.CMAEvolutionStrategy(study.space.nominal, 0.3, options)
        while not (runs.ended or strategy.stop()):
            points = strategy.ask()
            strategy.tell(points, [runs(point) for point in points])
    return runs.count


def cross_entropy(study: FalsificationStudy, seed: int) -> int:
    """Return the number of runs of the cross-entropy method: 3 of 10 points, normal distribution."""
    runs, stream = CountedRuns(study), np.random.default_rng(seed)
    runs(study.space.nominal)
    mean, deviation = study.space.nominal.copy(), np.full(study.space.size, 0.4)
    while not runs.ended:
        points = np.clip(mean + deviation * stream.normal(size=(10, mean.size)), 0.0, 1.0)
        values = np.array([runs(point) for point in points])
        elite = points[np.argsort(values)[:3]]
        mean, deviation = 0.3 * mean + 0.7 * elite.mean(axis=0), 0.3 * deviation + 0.7 * elite.std(axis=0) + 0.02
    return runs.count


METHODS: dict[str, tuple[Callable[[FalsificationStudy, int], int], int]] = {
    "Bayesian": (bayesian, 20), "CMA-ES": (cma_es, 5), "cross-entropy": (cross_entropy, 5),
}  # fmt: skip
"""Methods with their numbers of searches."""


def broken_share(study: FalsificationStudy) -> int:
    """Return the number of breaks among the points of the pool."""
    stream = np.random.default_rng(5)
    points = [stream.random(study.space.size) for _ in range(POOL)]
    return sum(run_target(study.scenario, study.target, study.space.values(point)).breaks for point in points)


def median_of_random(breaks: int) -> float:
    """Return the median number of runs of a random search with a share of breaks: of the geometric distribution."""
    return math.log(0.5) / math.log1p(-breaks / POOL) if 0 < breaks < POOL else math.nan


def main() -> int:
    """Print a line for every fault and method, and the goals; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON value")
    parser.add_argument("--shares", action="store_true", help="measure the shares of the space that break")
    options = parser.parse_args()
    base = ta.scenario("xuzhou_metro").with_(BASE)
    studies = {fault.name: FalsificationStudy(base, fault.requirement, fault.over, 1, jobs=1) for fault in FAULTS}
    rows: dict[str, dict[str, Any]] = {
        name: {"keys": study.space.size, "random": median_of_random(BREAKS)} for name, study in studies.items()
    }

    def note(text: str) -> None:
        if not options.json:
            sys.stdout.write(f"{text}\n")
            sys.stdout.flush()

    if options.shares:
        for name, study in studies.items():
            breaks = broken_share(study)
            rows[name] |= {"breaks": breaks, "random": median_of_random(breaks)}
            found = f"{breaks} of {POOL} random points break"
            note(f"{name:38s} {found}, median of random search {rows[name]['random']:.0f} runs")
    for method, (search, seeds) in {} if options.shares else METHODS.items():
        for name, study in studies.items():
            runs = [search(study, seed) for seed in range(seeds)]
            rows[name] |= {method: float(np.median(runs)), f"{method} worst": max(runs)}
            found = f"median {np.median(runs):5.1f}, worst {max(runs):3d} of {seeds} searches"
            note(f"{method:14s} {name:38s} {study.space.size} keys: {found}; random {rows[name]['random']:.0f}")
    goals = [
        Goal(f"{name}: Bayesian over random", row["Bayesian"] / row["random"], LARGEST_RATIO)
        for name, row in rows.items()
        if "Bayesian" in row
    ]
    if options.json:
        sys.stdout.write(json.dumps({"rows": rows, "goals": [goal.as_data() for goal in goals]}, indent=2) + "\n")
    return judge(goals, quiet=options.json)


if __name__ == "__main__":
    sys.exit(main())
