"""``train-ato falsify``: search the smallest change of a scenario that breaks a requirement.

Options::

    scenario SCENARIO  a shipped name, NAME:variant, or a YAML file
    --observer         and --compensation, --seed, --set: changes of the scenario
    --law NAME         control law: a name, or MODULE:CLASS without registration
    --requirement R    requirement or criterion of the scenario, or a formula such as 'G (speed <= limit + 1 km/h)'
    --over SPEC        YAML file with the keys that vary: block 'over:'
    --runs N           largest number of runs (default: %(default)s)
    --jobs N           number of processes; with it the search has other points (default: 1)
    --first            end with the first break, without a smaller departure
    --out DIR          folder; a search that is already there is continued (default: runs/falsify-NAME-N)
    --strict           exit status 1 if the requirement was broken
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from train_ato.cli.scenario_options import add_change_options, chosen_components
from train_ato.program.arguments import Options
from train_ato.program.errors import RunFailed, RunInterrupted

if TYPE_CHECKING:
    from train_ato.studies.falsify.search import SearchRow
    from train_ato.studies.falsify.study import Falsification

RUNS = 100

OPTIONS: Options = {
    "--observer": add_change_options,
    "--requirement": {"required": True},
    "--over": {"required": True},
    "--runs": {"default": RUNS},
    "--jobs": {"default": 1},
}


def execute(options: argparse.Namespace) -> None:
    """Search, write the folder and print the result; imports are late, so that help and completion are fast."""
    from train_ato.api.progress import share_bar
    from train_ato.api.scenario_choice import choose_scenario
    from train_ato.api.series_folder import SearchFolder
    from train_ato.cli.screen import note_compilation
    from train_ato.studies.falsify.study import Falsification, FalsificationStudy, write_study
    from train_ato.studies.sweep.row import data_hash

    components = chosen_components(options)
    choice = choose_scenario(options.scenario).assigned(options.assignments).changed(components, options.seed)
    study = FalsificationStudy(choice, options.requirement, options.over, options.runs, jobs=options.jobs, dash="--")
    note_compilation()
    folder = SearchFolder.opened(options.out, name=f"falsify-{choice.name}")
    seed = 1 if options.seed is None else options.seed
    rows: list[SearchRow] = []
    with (
        folder.kept("falsify", study.spec(seed), data_hash(choice.data, choice.path.parent)) as kept,
        share_bar(f"falsify {choice.name}") as update,
    ):

        def note(row: SearchRow) -> None:
            rows.append(row)
            if row.number > finished:  # a killed search keeps its runs
                write_study(Falsification(choice, study.target, study.space, list(rows), True), folder.path)
            update(row.number / options.runs, f"run {row.number} of at most {options.runs}")

        finished = len(kept)
        result = study.search(options.runs, seed, options.jobs, shrink=not options.first, note=note, kept=kept)
        if not result.rows:
            raise KeyboardInterrupt
        write_study(result, folder.path)
    _print_study(result, folder.path, as_json=options.json)
    if result.interrupted:
        raise RunInterrupted(f"interrupted; results so far: {folder.path}")
    if options.strict and result.found:
        raise RunFailed(f"{folder.path}: {result.line()}")


def _print_study(result: Falsification, folder: Path, *, as_json: bool) -> None:
    """Print the result and the names of the files."""
    from train_ato.cli.screen import print_result
    from train_ato.studies.falsify.study import COUNTEREXAMPLE, RUNS_TABLE, result_data

    problems = [row.run.problem for row in result.rows if row.run.problem]
    if problems:
        sys.stderr.write(
            f"train-ato: {len(problems)} of {len(result.rows)} runs have a problem; first: {problems[0]}\n"
        )
    text = f"{result.line()}\n{len(result.rows)} runs in {folder / RUNS_TABLE}\n"
    if result.found:
        text += f"reproduce: train-ato run {folder / COUNTEREXAMPLE} --engine\n"
    print_result({**result_data(result), "folder": str(folder)}, text, as_json=as_json)
