"""Runs to the first break of ten planted faults: Bayesian search, CMA-ES and cross-entropy against random search.

Run: ``python bench/falsify.py`` (about ten minutes; ``--json`` for data, ``--shares`` only for the shares of the
space, ``--fault N`` for one fault).  The methods begin with the nominal point, which breaks nothing.  Every run is a
run of the engine.  The random search has the median of the geometric distribution with the share of breaks among the
random points of a pool, so that it does not depend on a choice of seeds.  CMA-ES needs
``pip install cma``.

The goal: at most a third of the runs of the random search, median over 20 seeds, for every fault.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from goals import Goal, judge
from planted_faults import BASE, FAULTS, PlantedFault

import train_ato as ta
from train_ato.apps.falsify.search import FalsificationSearch
from train_ato.apps.falsify.study import FalsificationStudy, prepare_study
from train_ato.apps.falsify.target import TargetRun, run_target

POOL = 400
"""Number of random points of every fault."""
SEEDS, OTHER_SEEDS = 20, 5
"""Number of searches of the chosen method, and of each other one."""
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


METHODS: dict[str, Callable[[FalsificationStudy, int], int]] = {
    "Bayesian": bayesian, "CMA-ES": cma_es, "cross-entropy": cross_entropy,
}  # fmt: skip


def broken_share(study: FalsificationStudy) -> int:
    """Return the number of breaks among the points of the pool."""
    stream = np.random.default_rng(6)
    points = [stream.random(study.space.size) for _ in range(POOL)]
    return sum(run_target(study.scenario, study.target, study.space.values(point)).breaks for point in points)


def median_of_random(breaks: int) -> float:
    """Return the median number of runs of a random search with a share of breaks: of the geometric distribution."""
    return math.log(0.5) / math.log1p(-breaks / POOL) if 0 < breaks < POOL else math.nan


def measured(fault: PlantedFault, shares_only: bool) -> dict[str, Any]:
    """Return the row of a fault."""
    study = prepare_study(ta.scenario("xuzhou_metro").with_(BASE), fault.requirement, fault.over, 1, 1)
    breaks = broken_share(study)
    row: dict[str, Any] = {"fault": fault.name, "keys": study.space.size, "share": breaks / POOL,
                           "random": median_of_random(breaks)}  # fmt: skip
    for name, method in {} if shares_only else METHODS.items():
        seeds = SEEDS if method is bayesian else OTHER_SEEDS
        runs = [method(study, seed) for seed in range(seeds)]
        row[name] = float(np.median(runs))
        row[f"{name} worst"] = max(runs)
    return row


def main() -> int:
    """Print a line for every fault and the goals; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--shares", action="store_true", help="only the shares of the space")
    parser.add_argument("--fault", type=int, help="only this fault, from 0")
    options = parser.parse_args()
    begin, rows = time.perf_counter(), []
    for fault in FAULTS if options.fault is None else FAULTS[options.fault : options.fault + 1]:
        row = measured(fault, options.shares)
        rows.append(row)
        if not options.json:
            found = [name for name in METHODS if name in row]
            methods = "".join(f"  {name} {row[name]:5.1f} (worst {row[f'{name} worst']:3d})" for name in found)
            share = f"{row['keys']} keys, {100 * row['share']:5.2f} %"
            sys.stdout.write(f"{row['fault']:38s} {share}  random {row['random']:6.1f}{methods}\n")
            sys.stdout.flush()
    goals = [
        Goal(f"{row['fault']}: Bayesian over random", row["Bayesian"] / row["random"], LARGEST_RATIO)
        for row in rows
        if "Bayesian" in row
    ]
    if options.json:
        data = {"rows": rows, "goals": [goal.as_data() for goal in goals], "wall_s": time.perf_counter() - begin}
        sys.stdout.write(json.dumps(data, indent=2) + "\n")
    return judge(goals, quiet=options.json)


if __name__ == "__main__":
    sys.exit(main())
