"""``train-ato learn``: learn the resistance that repeats from run to run, from repeated or recorded runs.

Options::

    source SCENARIO|RUN  one scenario to repeat, or folders of recorded runs
    --law NAME           control law: a name, or MODULE:CLASS without registration
    --observer           and --compensation, --seed, --set: changes of the scenario
    --runs N             number of repeated runs (default: {runs})
    --gust-shift S       largest random shift of the disturbances that are functions of time, new in every run
                         (default: 0)
    --spacing M          distance between the values (default: %(default)g)
    --memory N           number of the last runs that count (default: %(default)s)
    --out FILE           learned resistance to write (.yaml)
"""

import argparse
import sys
from pathlib import Path

from train_ato.cli.scenario_options import add_change_options, prepare_from
from train_ato.program.arguments import Options

RUNS, SPACING, MEMORY = 5, 5.0, 20
"""Defaults of the options; the last two are those of :mod:`train_ato.studies.learn`."""
OF_REPEATED_RUNS = ("runs", "law", "observer", "compensation", "seed", "gust_shift", "assignments")
"""Options without an effect on recorded runs."""

OPTIONS: Options = {
    "source": {"nargs": "+"},
    "--observer": add_change_options,
    "--runs": {"words": {"runs": RUNS}},
    "--spacing": {"default": SPACING},
    "--memory": {"default": MEMORY},
    "--out": {"required": True},
}


def execute(options: argparse.Namespace) -> None:
    """Learn, write the file, and print the errors of the runs."""
    from train_ato.api.series_folder import SearchFolder
    from train_ato.cli.screen import print_json, print_table
    from train_ato.log.run_folder import RunFolder
    from train_ato.program.arguments import check_new_file
    from train_ato.program.errors import RunFailed
    from train_ato.studies.learn import LearnResult, learn_from, learn_runs, learned_rows
    from train_ato.studies.sweep.row import data_hash, scenario_hash

    place = options.out.with_name(f"{options.out.name}.runs")
    if not SearchFolder.holds(place):
        check_new_file(options.out, (".yaml", ".yml"))
    folders = [Path(name) for name in options.source]
    result: LearnResult
    if all(folder.is_dir() for folder in folders):
        for name in OF_REPEATED_RUNS:
            if getattr(options, name):
                option = "set" if name == "assignments" else name.replace("_", "-")
                raise ValueError(f"--{option}: no effect on recorded runs; remove it, or give a scenario")
        result = learn_from(folders, options.spacing, options.memory)
        result.save(options.out)
    else:
        if len(folders) > 1:
            missing = next(name for name, folder in zip(options.source, folders, strict=True) if not folder.is_dir())
            raise ValueError(f"{missing}: not a folder of a run; give run folders only, or one scenario")
        options.scenario = options.source[0]
        setup = prepare_from(options)
        runs = RUNS if options.runs is None else options.runs
        spec = {"spacing": options.spacing, "memory": options.memory, "gust_shift": options.gust_shift or 0.0}
        hashes = [scenario_hash(setup), data_hash(setup.scenario.model_dump(mode="json"), setup.folder)]
        with SearchFolder.opened(place).kept("learn", spec, hashes) as kept:
            result = learn_runs(setup, runs, **spec, kept=kept)
            result.save(options.out, replace=True)
        if not result.interrupted:
            RunFolder(place).discard()
    rows = learned_rows(result)
    if options.json:
        print_json({"file": str(options.out), "runs": result.learned.runs, "errors": rows, "unused": result.unused})
    else:
        if rows:
            print_table(rows[0], (row.values() for row in rows), result.learned.source)
        sys.stdout.writelines(f"not used: {name}: {reason}\n" for name, reason in result.unused.items())
        sys.stdout.write(f"{result.learned.runs} runs; written to {options.out}; use it with `model.learned`\n")
    if result.interrupted:
        raise RunFailed(f"interrupted; {options.out} has the result of {result.learned.runs} runs")
