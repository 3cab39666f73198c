"""``train-ato verify``: run a recorded scenario again and compare every message."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
from pathlib import Path

from train_ato.cli.main import RunFailed
from train_ato.cli.run import note_compilation
from train_ato.cli.screen import print_json, progress_bar, share_bar
from train_ato.engine import run_engine
from train_ato.measured.run import MEASURED
from train_ato.record.changes import late_commands, told_by
from train_ato.record.difference import Comparison, compare
from train_ato.record.versions import SCENARIO
from train_ato.run_folder import RunFolder, open_run
from train_ato.run_setup import RunSetup
from train_ato.wire import Wire


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``verify``."""
    parser.add_argument("run", type=Path, metavar="RUN", help="run folder, or its log alone")
    parser.add_argument(
        "--relative",
        type=float,
        default=0.0,
        metavar="R",
        help="let numbers differ by R times the largest of their field (default: 0, bit for bit)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def execute(options: argparse.Namespace) -> int:
    """Run the scenario again in the engine and compare the logs field by field, bit by bit."""
    if not 0 <= options.relative < 1:
        raise ValueError(f"--relative {options.relative}: give a number from 0 to below 1, for example 1e-6")
    setup, summary = open_run(options.run)
    if summary.get("controller") == MEASURED:
        place = options.run if options.run.is_dir() else options.run.parent
        raise ValueError(
            f"{options.run}: is a measured run, which nothing drives again; `train-ato run "
            f"{place / SCENARIO}` drives a law on its profile"
        )
    if summary.get("status", "done") != "done":
        status = {"killed": "was killed", "interrupted": "was interrupted"}.get(summary["status"], summary["status"])
        raise ValueError(f"{options.run}: the run {status}; only a whole run can be compared with another")
    told = told_by(options.run)
    setup = dataclasses.replace(setup, scenario=told.driven(setup.scenario))
    found = compare_with_new(options.run, setup, options.relative)
    if options.json:
        print_json({"run": str(options.run), "equal": found.equal, **dataclasses.asdict(found)})
    elif found.equal:
        how = f"up to {options.relative:g} of its field" if options.relative else "bit for bit"
        sys.stdout.write(f"{options.run}: {found.messages} messages are equal, {how}\n")
    if not found.equal:
        late = late_commands(options.run)
        paced = f"; paced on the wall clock, {late} commands came late or not at all" if late else ""
        raise RunFailed(
            f"{options.run}: {found.differing} of {found.messages} messages differ; first: {found.first}{paced}"
        )
    return 0


def compare_with_new(run: Path, setup: RunSetup, relative: float = 0.0) -> Comparison:
    """Run a scenario in the engine and compare the log of a run with the new one.

    Raises
    ------
    RunFailed
        If the new run fails.
    """
    note_compilation()
    with tempfile.TemporaryDirectory(prefix="train_ato_verify_") as scratch:
        again = RunFolder.make(Path(scratch) / "again", setup.scenario.name)
        with progress_bar(f"again: {setup.scenario.name}") as progress, again.sink(setup) as sink:
            outcome = run_engine(setup, sink=sink, progress=progress)
        if outcome.failure or outcome.interrupted:
            raise RunFailed(outcome.failure or "interrupted")
        with share_bar("comparing") as tell:
            return compare(run, again.path, Wire(setup.shape), relative, lambda share: tell(share, ""))
