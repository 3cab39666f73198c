"""``train-ato verify``: run a recorded scenario again and compare every message."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from train_ato.cli.main import RunFailed
from train_ato.cli.run import note_compilation
from train_ato.cli.screen import print_json, progress_bar
from train_ato.engine import run_engine
from train_ato.record.difference import differences
from train_ato.run_folder import RunFolder, open_run
from train_ato.wire import Wire


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``verify``."""
    parser.add_argument("run", type=Path, metavar="RUN", help="run folder")
    parser.add_argument("--json", action="store_true", help="print one JSON value and nothing else")


def execute(options: argparse.Namespace) -> int:
    """Run the scenario again in the engine and compare the logs field by field, bit by bit."""
    setup, summary = open_run(options.run)
    if summary.get("status", "done") != "done":
        raise ValueError(f"{options.run}: the run {summary['status']}; only a whole run can be compared with another")
    note_compilation()
    with tempfile.TemporaryDirectory(prefix="train_ato_verify_") as scratch:
        again = RunFolder.make(Path(scratch) / "again", setup.scenario.name)
        with progress_bar(f"again: {setup.scenario.name}") as progress, again.sink(setup) as sink:
            outcome = run_engine(setup, sink=sink, progress=progress)
        if outcome.failure or outcome.interrupted:
            raise RunFailed(outcome.failure or "interrupted")
        found = differences(options.run, again.path, Wire(setup.shape))
    if options.json:
        print_json({"run": str(options.run), "equal": not found, "differences": found})
    elif not found:
        sys.stdout.write(f"{options.run}: every message is equal, bit for bit\n")
    if found:
        raise RunFailed(f"{options.run}: differs from a run of the same scenario: {'; '.join(found)}")
    return 0
