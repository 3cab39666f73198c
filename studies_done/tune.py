"""Optimizers of the search for gains, with equal numbers of runs and equal seeds.

    python studies_done/tune.py [--seeds 1,2,3] [--runs 24]

Every optimizer begins at the same gains and has the same generations. The table has the best objective (smaller is
better) of every seed and the mean rank over cases and seeds; 1 is the best. Own time is the wall time of the optimizer
without the runs. Needs optuna and cmaes: pip install optuna cmaes
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from figures import Figure, publish

import train_ato as ta
from train_ato.studies.tune.objective import CmaOptimizer, GainOptimizer
from train_ato.studies.tune.tune import tune

CASES: tuple[tuple[str, str, tuple[str, ...], dict[str, Any]], ...] = (
    ("xuzhou_metro", "smc", ("l1", "l2", "ks", "kappa"), {"duration": 135}),
    ("crh380a_gpc:short", "funnel", ("k10", "k20", "lam_h", "gamma_w", "bias_rate"), {"duration": 150}),
    ("freight_consensus:realistic", "pid", ("kp", "ki"), {"duration": 150}),
)
"""Scenario, law, varied parameters, and changes that shorten the run."""


class RandomSearch:
    """Uniform points: the lower bound of every optimizer."""

    def __init__(self, start: Sequence[float], seed: int, population: int) -> None:
        self._random, self._shape = np.random.default_rng(seed), (population, len(start))

    def ask(self) -> list[list[float]]:
        """Return the points of the next generation."""
        return [[float(share) for share in point] for point in self._random.random(self._shape)]

    def tell(self, points: Sequence[Sequence[float]], scores: Sequence[float]) -> None:
        """Take scores without effect."""


class OptunaSearch:
    """Sampler of optuna, with generations."""

    def __init__(self, sampler: str, start: Sequence[float], seed: int, population: int) -> None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        names = [f"x{number}" for number in range(len(start))]
        if sampler == "TPE":
            found: Any = optuna.samplers.TPESampler(seed=seed, multivariate=True, n_startup_trials=population)
        else:
            found = optuna.samplers.CmaEsSampler(
                x0=dict(zip(names, start, strict=True)), sigma0=0.2, seed=seed, popsize=population
            )
        self._study = optuna.create_study(sampler=found)
        self._study.enqueue_trial(dict(zip(names, start, strict=True)))
        self._names, self._population, self._trials = names, population, list[Any]()

    def ask(self) -> list[list[float]]:
        """Return the points of the next generation."""
        self._trials = [self._study.ask() for _ in range(self._population)]
        return [[trial.suggest_float(name, 0.0, 1.0) for name in self._names] for trial in self._trials]

    def tell(self, points: Sequence[Sequence[float]], scores: Sequence[float]) -> None:
        """Take the scores of the generation."""
        for trial, score in zip(self._trials, scores, strict=True):
            self._study.tell(trial, score)


OPTIMIZERS: dict[str, Callable[[Sequence[float], int, int], GainOptimizer]] = {
    "cma": CmaOptimizer,
    "optuna TPE": lambda *given: OptunaSearch("TPE", *given),
    "optuna CmaEs": lambda *given: OptunaSearch("CmaEs", *given),
    "random": RandomSearch,
}


class TimedSearch:
    """Optimizer with its wall time [s]."""

    def __init__(self, inner: GainOptimizer) -> None:
        self._inner, self.seconds = inner, 0.0

    def ask(self) -> list[list[float]]:
        """Return the points of the next generation."""
        begin = time.perf_counter()
        points = self._inner.ask()
        self.seconds += time.perf_counter() - begin
        return points

    def tell(self, points: Sequence[Sequence[float]], scores: Sequence[float]) -> None:
        """Take the scores of the generation."""
        begin = time.perf_counter()
        self._inner.tell(points, scores)
        self.seconds += time.perf_counter() - begin


def measure(case: tuple[str, str, tuple[str, ...], dict[str, Any]], name: str, seed: int, runs: int) -> Any:
    """Return initial objective, best objective and own time [s] of an optimizer."""
    scenario, law, parameters, changes = case
    timed: list[TimedSearch] = []

    def make(start: Sequence[float], seed: int, population: int) -> TimedSearch:
        timed.append(TimedSearch(OPTIMIZERS[name](start, seed, population)))
        return timed[-1]

    result = tune(
        ta.scenario(scenario), law, set=changes, parameters=parameters, runs=runs, search_seed=seed, optimizer=make
    )
    objectives = result.history["objective"]
    return float(objectives[0]), float(objectives.min()), timed[0].seconds


def main() -> int:
    """Measure every case and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="1,2,3")
    parser.add_argument("--runs", type=int, default=24)
    options = parser.parse_args()
    seeds = [int(text) for text in options.seeds.split(",")]
    ranks: dict[str, list[int]] = {name: [] for name in OPTIMIZERS}
    own: dict[str, list[float]] = {name: [] for name in OPTIMIZERS}
    print(f"best objective with {options.runs} runs, seeds {options.seeds}")
    for case in CASES:
        found: dict[str, list[float]] = {name: [] for name in OPTIMIZERS}
        for seed in seeds:
            for name in OPTIMIZERS:
                initial, best, seconds = measure(case, name, seed, options.runs)
                found[name].append(best)
                own[name].append(seconds)
            last = {name: found[name][-1] for name in OPTIMIZERS}
            for name, value in last.items():
                ranks[name].append(1 + sum(other < value for other in last.values()))
        print(f"{case[1]} on {case[0]}: initial {initial:.4g}")
        for name, values in found.items():
            print(f"  {name:13s} {'  '.join(f'{value:8.4g}' for value in values)}", flush=True)
    for name in OPTIMIZERS:
        rank = float(np.mean(ranks[name]))
        print(f"{name:13s} mean rank {rank:.2f}, own time {1e3 * np.mean(own[name]):.0f} ms")
        publish(Figure(f"mean rank, {name}", rank, "", "mean of all ranks", (1 + len(OPTIMIZERS)) / 2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
