"""A recorded run repeated in the engine, and both logs compared."""

import dataclasses
import tempfile
from collections.abc import Callable
from pathlib import Path

from plant_sim.train import compile_kernel
from train_ato.api.import_csv.run import MEASURED
from train_ato.api.progress import COMPILE_NOTE, compilation_noted, progress_bar, share_bar
from train_ato.log.difference import LogComparison, compare_logs
from train_ato.log.reading import log_file, read_log
from train_ato.log.recorded import late_commands, outside_nodes, read_changes, read_recording, read_reports
from train_ato.log.run_folder import RunFolder, read_run_folder
from train_ato.log.versions import SCENARIO, SUMMARY
from train_ato.loop.engine import SIGNALS, TickLoop, run_engine
from train_ato.messages.codec import Wire
from train_ato.messages.topics import AHEAD
from train_ato.program.errors import RunFailed
from train_ato.scenario.setup import RunSetup


def verify(run: str | Path, relative: float = 0.0) -> LogComparison:
    """Repeat a recorded run in the engine and compare both logs field by field, as ``train-ato verify`` does.

    Parameters
    ----------
    run
        Run folder or single log.
    relative
        Tolerance relative to the largest value of a field; 0: bit for bit.

    Returns
    -------
    LogComparison
        ``equal``, numbers of messages and differences, and the first difference.

    Raises
    ------
    ValueError
        For a run that cannot be repeated, in one line.
    RunFailed
        If the new run fails.
    """
    path = Path(run)
    if not 0 <= relative < 1:
        raise ValueError(f"relative {relative}: out of range; give 0 to below 1, for example 1e-6")
    setup, summary = read_run_folder(path)
    if summary.get("controller") == MEASURED:
        place = path if path.is_dir() else path.parent
        raise ValueError(
            f"{path}: a measured run cannot be repeated; run a law on its profile with `train-ato run "
            f"{place / SCENARIO}`"
        )
    if summary.get("status", "done") != "done":
        words = {"killed": f"was killed or has no {SUMMARY}", "interrupted": "was interrupted"}
        status = words.get(summary["status"], summary["status"])
        raise ValueError(f"{path}: the run {status}; name a complete run")
    outside = outside_nodes(read_reports(path), supervised=setup.layout.supervised, names=summary.get("external"))
    if outside:
        named = ", ".join(f"{node} was {name}" for node, name in outside.items())
        raise ValueError(
            f"{path}: cannot be driven again, a node was a program outside of this project: {named}; "
            "name a run of this project's nodes"
        )
    if restarts := summary.get("restarts"):
        named = ", ".join(restarts)
        raise ValueError(f"{path}: cannot be driven again, it has a restarted node: {named}; name another run")
    changes = read_changes(path)
    reports = read_log(path, Wire(setup.layout).decode, (AHEAD,)) if setup.layout.behind else ()
    ahead = tuple(message for _, _, message in reports)
    setup = dataclasses.replace(setup, scenario=changes.driven(setup.scenario), ahead=ahead)
    return compare_with_new(path, setup, relative)


def difference_note(run: Path) -> str:
    """Return the reasons of differences, left out messages or late commands, "" without one."""
    log, late = log_file(run), late_commands(run)
    recovered = log.with_name(f"{log.name}.broken").exists()
    left = "; `train-ato recover` may have left out damaged messages of this log" if recovered else ""
    return left + (f"; without lockstep, {late} commands were late or missing" if late else "")


def compare_with_new(run: Path, setup: RunSetup, relative: float = 0.0) -> LogComparison:
    """Run a scenario in the engine and compare its log with the log of a run.

    Raises
    ------
    RunFailed
        If the new run fails.
    """
    with compilation_noted(COMPILE_NOTE):
        compile_kernel()
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
    if all(report.node != SIGNALS for report in read_reports(run)):
        return None
    noted = {report.stamp: report.values for report in read_recording(run).reports if report.node == SIGNALS}

    def note(loop: TickLoop) -> bool:
        if loop.plant.stamp in noted:
            loop.note(noted[loop.plant.stamp])
        return False

    return note
