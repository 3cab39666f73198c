"""``train-ato verify``: run a recorded scenario again and compare every message."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from train_ato.cli.screen import note_compilation, print_json
from train_ato.errors import RunFailed

if TYPE_CHECKING:
    from train_ato.log.difference import LogComparison
    from train_ato.loop.engine import TickLoop
    from train_ato.loop.setup import RunSetup


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of ``verify``."""
    parser.add_argument("run", type=Path, metavar="RUN", help="run folder or single log")
    parser.add_argument(
        "--relative",
        type=float,
        default=0.0,
        metavar="R",
        help="tolerance relative to the largest value of a field (default: 0, bit for bit)",
    )


def execute(options: argparse.Namespace) -> int:
    """Repeat the run in the engine and compare both logs field by field."""
    from train_ato.apps.import_csv.run import MEASURED
    from train_ato.log.changes import late_commands, outside_nodes, read_changes
    from train_ato.log.recorded import read_reports
    from train_ato.log.run_folder import read_run_folder
    from train_ato.log.versions import SCENARIO

    if not 0 <= options.relative < 1:
        raise ValueError(f"--relative {options.relative}: out of range; give 0 to below 1, for example 1e-6")
    setup, summary = read_run_folder(options.run)
    if summary.get("controller") == MEASURED:
        place = options.run if options.run.is_dir() else options.run.parent
        raise ValueError(
            f"{options.run}: a measured run cannot be repeated; run a law on its profile with `train-ato run "
            f"{place / SCENARIO}`"
        )
    if summary.get("status", "done") != "done":
        status = {"killed": "was killed", "interrupted": "was interrupted"}.get(summary["status"], summary["status"])
        raise ValueError(f"{options.run}: the run {status}; name a complete run")
    outside = outside_nodes(read_reports(options.run), setup.layout.supervised, summary.get("external"))
    if outside:
        named = ", ".join(f"{node} was {name}" for node, name in outside.items())
        raise ValueError(
            f"{options.run}: cannot be driven again, a node was a program outside of this project: {named}; "
            "name a run of this project's nodes"
        )
    changes = read_changes(options.run)
    setup = dataclasses.replace(setup, scenario=changes.driven(setup.scenario))
    found = compare_with_new(options.run, setup, options.relative)
    if options.json:
        print_json({"run": str(options.run), "equal": found.equal, **dataclasses.asdict(found)})
    elif found.equal:
        how = f"up to {options.relative:g} of its field" if options.relative else "bit for bit"
        sys.stdout.write(f"{options.run}: {found.messages} messages are equal, {how}\n")
    if not found.equal:
        late = late_commands(options.run)
        paced = f"; without lockstep, {late} commands were late or missing" if late else ""
        raise RunFailed(
            f"{options.run}: {found.differing} of {found.messages} messages differ; first: {found.first}{paced}"
        )
    return 0


def compare_with_new(run: Path, setup: RunSetup, relative: float = 0.0) -> LogComparison:
    """Run a scenario in the engine and compare its log with the log of a run.

    Raises
    ------
    RunFailed
        If the new run fails.
    """
    from train_ato.apps.runs.progress import progress_bar, share_bar
    from train_ato.log.difference import compare_logs
    from train_ato.log.run_folder import RunFolder
    from train_ato.loop.engine import run_engine
    from train_ato.messages.codec.codec import Wire

    note_compilation()
    on_tick = _noted_signals(run)
    with tempfile.TemporaryDirectory(prefix="train_ato_verify_") as scratch:
        again = RunFolder.make(Path(scratch) / "again", setup.scenario.name)
        with progress_bar(f"again: {setup.scenario.name}") as progress, again.sink(setup) as sink:
            outcome = run_engine(setup, sink=sink, progress=progress, messages_only=True, on_tick=on_tick)
        if outcome.failure:
            raise RunFailed(outcome.failure)
        with share_bar("comparing") as update:
            return compare_logs(run, again.path, Wire(setup.layout), relative, lambda share: update(share, ""))


def _noted_signals(run: Path) -> Callable[[TickLoop], bool] | None:
    """Return a function that sends the own signals of a run again in every tick; None for a run without any."""
    from train_ato.log.recorded import read_recording, read_reports
    from train_ato.loop.engine import SIGNALS

    if all(report.node != SIGNALS for report in read_reports(run)):
        return None
    noted = {report.stamp: report.values for report in read_recording(run).reports if report.node == SIGNALS}

    def note(loop: TickLoop) -> bool:
        if loop.plant.stamp in noted:
            loop.note(noted[loop.plant.stamp])
        return False

    return note
