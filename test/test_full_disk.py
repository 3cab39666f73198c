"""A disk that fills up: what failed is told in one line, with the way out; nothing is left of a run that never began.

A limit on the size of files stands in for the disk: writing beyond it fails in the same place, and needs no rights.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import plant_sim
from train_ato.cli.run import finish
from train_ato.failure import RunFailed, Watch
from train_ato.outcome import Outcome
from train_ato.run_folder import RunFolder
from train_ato.run_setup import prepare
from train_ato.scenario import load

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
    """Run a command that may write files of so many bytes at most, once the kernel is compiled."""
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, str(largest), *arguments],
        env={**os.environ, "PYTHONPATH": str(Path(plant_sim.__file__).parents[1])},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_a_run_that_cannot_begin_leaves_nothing(tmp_path: Path) -> None:
    """Not even the scenario fits: exit status 2, one line that names the folder, and no folder."""
    done = run(1000, "run", "demo", "--engine", "--out", str(tmp_path / "out"))
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith(f"train-ato: --out {tmp_path / 'out'}: cannot be written")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("way", ["--engine", "--composed"])
def test_a_log_that_cannot_go_on_is_named(way: str, tmp_path: Path) -> None:
    """Breaks if the line does not say which file could not be written and how what is there can be read."""
    folder = tmp_path / "out"
    folder.mkdir()
    options = ["--engine"] if way == "--engine" else []
    done = run(200_000, "run", "demo", *options, "--out", str(folder / "run"))
    assert done.returncode == 1
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("train-ato:")]
    assert "run.mcap.partial: writing failed" in line and "recover" in line
    assert (folder / "run" / "run.mcap.partial").is_file()


def test_what_failed_is_told_where_its_traceback_finds_no_room(tmp_path: Path) -> None:
    """On a full disk the traceback's file raised, and that took the place of the failure."""
    (tmp_path / "taken").write_text("")
    watch = Watch(tmp_path / "taken" / "log")
    watch.fail("plant", OSError("run.mcap.partial: writing failed"))
    assert watch.failure == "node plant failed: run.mcap.partial: writing failed"


def test_what_failed_is_told_where_the_summary_finds_no_room(tmp_path: Path) -> None:
    """The same for summary and figure, which are written last."""
    outcome = Outcome(None, {"changes": []}, failure="node recorder failed: no room")
    with pytest.raises(RunFailed, match="no room"):
        finish(prepare(*load("demo")), RunFolder(tmp_path / "gone"), outcome)
