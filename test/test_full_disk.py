"""Full disk: one line with the failure and the remedy; no files of a run that did not start.

A limit on the size of files replaces the full disk: writing fails at the same place, without special rights.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import LIMIT_S

import plant_sim
from train_ato.apps.runs.drive import finish
from train_ato.apps.runs.record import RunRecord
from train_ato.apps.runs.run import Run
from train_ato.errors import FirstFailure, RunFailed
from train_ato.log.run_folder import RunFolder
from train_ato.loop.result import RunResult
from train_ato.loop.setup import prepare
from train_ato.scenario.scenario import load_scenario

PROGRAM = """
import resource, signal, sys
from plant_sim.train import compile_kernel
from train_ato.cli.main import main
compile_kernel()
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), resource.RLIM_INFINITY))
sys.exit(main(sys.argv[2:]))
"""


def run(largest: int, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command with a limit on the size of its files [bytes], after compilation of the kernel."""
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, str(largest), *arguments],
        env={**os.environ, "PYTHONPATH": str(Path(plant_sim.__file__).parents[1])},
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )


def test_a_run_that_cannot_begin_leaves_nothing(tmp_path: Path) -> None:
    """No space for the scenario: exit status 2, one line with the name of the folder, and no folder."""
    done = run(1000, "run", "demo", "--engine", "--out", str(tmp_path / "out"))
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith(f"train-ato: --out {tmp_path / 'out'}: cannot be written")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("way", ["--engine", "--composed"])
def test_a_log_that_cannot_go_on_is_named(way: str, tmp_path: Path) -> None:
    """Breaks if the line does not contain the unwritten file and the remedy for reading the rest."""
    folder = tmp_path / "out"
    folder.mkdir()
    options = ["--engine"] if way == "--engine" else []
    done = run(200_000, "run", "demo", *options, "--out", str(folder / "run"))
    assert done.returncode == 1
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("train-ato:")]
    assert "run.mcap.partial: writing failed" in line and "recover" in line
    assert (folder / "run" / "run.mcap.partial").is_file()


def test_what_failed_is_told_where_its_traceback_finds_no_room(tmp_path: Path) -> None:
    """Breaks if an error from writing the traceback file replaces the original failure."""
    (tmp_path / "taken").write_text("")
    watch = FirstFailure(tmp_path / "taken" / "log")
    watch.fail("plant", OSError("run.mcap.partial: writing failed"))
    assert watch.failure == "node plant failed: run.mcap.partial: writing failed"


def test_the_original_failure_is_reported_if_the_summary_cannot_be_written(tmp_path: Path) -> None:
    """Breaks if an error from writing the summary replaces the original failure."""
    setup = prepare(*load_scenario("demo"))
    folder = RunFolder.make(tmp_path / "run", "demo")
    (folder.path / "run.mcap.partial").touch()
    (folder.path / "summary.json").mkdir()
    outcome = RunResult(None, {"changes": []}, failure="node recorder failed: no room")
    run = Run(outcome.summary, record=RunRecord(setup, folder), setup=setup, outcome=outcome)
    with pytest.raises(RunFailed, match="no room"):
        finish(run, outcome)
