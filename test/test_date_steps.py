"""Steps of the date during a run in one process: no wait is extended by them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from waiting import LIMIT_S, wait_for

from train_ato.apps.runs.run import open_run

ROOT = Path(__file__).resolve().parents[1]
RUN_S = 40.0
LEAD_S = 15.0
"""Wall time from the start of a run to the step [s]; a run that begins later has the step before its waits."""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler for the step of the date"),
]


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Build the library with the step."""
    path = tmp_path_factory.mktemp("date") / "date_step.so"
    source = Path(__file__).with_name("date_step.c")
    subprocess.run(["gcc", "-O1", "-shared", "-fPIC", "-o", str(path), str(source), "-ldl"], check=True)
    return path


@pytest.mark.parametrize(("pace", "step"), [("--pace=2", -86400), ("--realtime=2", -86400), ("--pace=2", 86400)])
def test_a_step_of_the_date_does_not_stop_a_run(pace, step, library, tmp_path):
    """Breaks if the timer of the plant, or the executor, waits until the date before the step is reached again."""
    folder = tmp_path / "run"
    process = subprocess.Popen(
        [sys.executable, "-m", "train_ato", "run", "demo", pace, f"--set=duration={RUN_S:g}", f"--out={folder}"],
        cwd=ROOT,
        env={
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "LD_PRELOAD": str(library),
            "STEP_AT": f"{time.time() + LEAD_S:.3f}",
            "STEP_BY": str(step),
        },
    )
    try:
        wait_for(lambda: process.poll() is not None, "the end of the run")
    finally:
        process.kill()
        process.wait(timeout=LIMIT_S)
    assert process.returncode == 0
    assert open_run(folder).metrics["simulated_s"] == RUN_S
