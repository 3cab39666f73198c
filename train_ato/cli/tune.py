"""``train-ato tune``: search for the gains of a law, with held-out scenarios beside.

Options::

    scenario SCENARIO[,...]   scenarios of the search: shipped names, NAME:variant, or YAML files
    --law NAME                law to tune: a name, or MODULE:CLASS
    --observer NAME           observer: a name, or MODULE:CLASS without registration
    --compensation NAME       compensation: a name, or MODULE:CLASS without registration
    --set A.B=VALUE           change any key of every scenario, the value written as YAML; may be repeated
    --parameters A,B,...      parameters to vary (default: every numeric one above 0)
    --over SPEC.yaml          ranges of the gains (over:), changes of the runs (variations:)
    --seeds 1,2,...           seeds of the runs (default: as in each scenario)
    --held-out A,B            scenarios that the search does not use, reported beside
    --held-out-seeds 3,4,...  seeds that the search does not use
    --criterion TERM=WEIGHT   weight of a term of the score: {terms} (default)
    --runs N                  simulated runs of the search (default: 60)
    --jobs N                  number of processes (default: 1)
    --search-seed N           seed of the search (default: 1)
    --out DIR                 folder; a search that is already there is continued (default: runs/tune-NAME-N)
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from train_ato.cli.scenario_options import chosen_components, listed
from train_ato.cli.screen import note_compilation, print_json, print_table
from train_ato.program.arguments import Options
from train_ato.program.errors import RunFailed
from train_ato.studies.tune.objective import TERMS

if TYPE_CHECKING:
    from train_ato.studies.tune.tune_result import TuneResult

COLUMNS: tuple[tuple[str, str], ...] = (
    ("run", "run"),
    ("part", "part"),
    ("gains", "gains"),
    ("score", "score"),
    *((term.metrics[0], f"{term.key} {term.unit}") for term in TERMS),
    ("tracking", "tracking"),
    ("verdict", "verdict"),
)
"""Key of a row, and head of its column."""

OPTIONS: Options = {
    "--law": {"required": True},
    "--set": {"action": "append", "dest": "assignments"},
    "--criterion": {"action": "append", "words": {"terms": ", ".join(f"{term.key}={term.weight:g}" for term in TERMS)}},
    "--runs": {"default": 60},
    "--jobs": {"default": 1},
    "--search-seed": {"default": 1},
}


def execute(options: argparse.Namespace) -> None:
    """Search, write the overlay scenario and print initial and tuned runs."""
    from train_ato.api.scenario_choice import choose_scenario
    from train_ato.api.series_folder import SearchFolder
    from train_ato.log.run_folder import check_free, next_free
    from train_ato.studies.tune.objective import read_weights
    from train_ato.studies.tune.tune import tune
    from train_ato.studies.tune.tune_result import OVERLAY

    chosen_components(options)
    choices = [choose_scenario(name).assigned(options.assignments) for name in listed(options.scenario, "SCENARIO")]
    outside = [choose_scenario(name).assigned(options.assignments) for name in listed(options.held_out, "--held-out")]
    if not choices:
        raise ValueError("SCENARIO: no name; give one or more")
    weights = read_weights(options.criterion)
    out = options.out or next_free(f"tune-{choices[0].name}")
    if not SearchFolder.holds(out):
        check_free(out)
    note_compilation()
    result = tune(
        choices,
        options.law,
        observer=options.observer,
        compensation=options.compensation,
        parameters=listed(options.parameters, "--parameters") or None,
        over=options.over,
        seeds=_seeds(options.seeds, "--seeds") or None,
        held_out=outside,
        held_out_seeds=_seeds(options.held_out_seeds, "--held-out-seeds"),
        weights=weights,
        runs=options.runs,
        jobs=options.jobs,
        search_seed=options.search_seed,
        out=out,
    )
    if options.json:
        print_json(result.data)
    else:
        print_tuning(result, out)
    if result.interrupted:
        raise RunFailed(f"interrupted after {len(result.candidates)} candidates; the best gains are in {out / OVERLAY}")


MAX_SEED = 18
"""Largest number of digits of a seed."""


def _seeds(text: str | None, option: str) -> list[int]:
    found = []
    for name in listed(text, option):
        if not name.isdigit() or len(name) > MAX_SEED:
            raise ValueError(f"{option} {text}: '{name}' is not a seed; give integers from 0 on, for example 1,2,3")
        found.append(int(name))
    if len({*found}) < len(found):
        raise ValueError(f"{option} {text}: a seed occurs twice; remove one of them")
    return found


def print_tuning(result: TuneResult, folder: Path) -> None:
    """Print gains, runs with the initial and the tuned gains, and the overlay scenario."""
    from train_ato.studies.tune.tune_result import OVERLAY

    ranges = result.settings["ranges"]
    print_table(
        ("parameter", "initial", "tuned", "range"),
        ([name, result.initial[name], value, ranges[name]] for name, value in result.gains.items()),
        f"{result.law}: {len(result.candidates)} candidates",
    )
    print_table((text for _, text in COLUMNS), ([row[key] for key, _ in COLUMNS] for row in result.rows))
    if not result.improved:
        sys.stdout.write("no candidate was better than the initial gains\n")
    elif result.improved_held_out is False:
        sys.stdout.write("the tuned gains are not better on the held-out runs: fitted to the runs of the search\n")
    sys.stdout.write(f"scenario, table and history in {folder}; next: train-ato run {folder / OVERLAY}\n")
