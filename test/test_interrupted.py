"""Ctrl-C, SIGTERM and a closed terminal end every command in one line, and nothing half-made stays."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from train_ato.cli.screen import COMPILE_NOTE

ENDED = (1, -signal.SIGINT)
"""Python itself leaves by SIGINT when Ctrl-C fell into an ``exec`` of a module that was being imported."""
BREATH = threading.Event()
"""Never set: waiting for it lets a moment pass between two looks."""


def started(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start a command in a session of its own, as a terminal does, with a folder of its own for scratch files."""
    (folder / "scratch").mkdir()
    environment = {**os.environ, "TMPDIR": str(folder / "scratch"), "MARK": str(folder)}
    return subprocess.Popen(
        [sys.executable, "-m", "train_ato", *arguments],
        cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip


def descendants(folder: Path) -> list[str]:
    """Return the processes that the command left, by the mark in their environment."""
    mark, found = f"MARK={folder}\0".encode(), []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                if mark in (entry / "environ").read_bytes():
                    found.append((entry / "cmdline").read_text())
            except OSError:
                continue
    return found


def wait_for(condition, limit=60.0):
    last = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < last, "did not happen in time"
        BREATH.wait(0.02)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize(
    "arguments",
    [
        ["compare", "daqin_heavy_haul", "--controllers", "pid,smc", "--out", "out"],
        ["reproduce", "002", "--out", "out"],
        ["run", "daqin_heavy_haul", "--engine", "--out", "out"],
    ],
    ids=["compare", "reproduce", "run"],
)
def test_the_end_is_one_line(arguments: list[str], number: signal.Signals, tmp_path: Path) -> None:
    """Breaks on a traceback, a warning, a worker that goes on, a scratch folder or a folder of half a result."""
    process = started(tmp_path, *arguments)
    wait_for((tmp_path / "out").exists)
    BREATH.wait(1.0)
    os.killpg(process.pid, number)
    out, err = process.communicate(timeout=60)
    assert process.returncode in ENDED, err
    assert out == "" or arguments[0] == "run"
    said = [line for line in err.strip().splitlines() if line != COMPILE_NOTE]
    assert len(said) == 1, err
    assert said[0].startswith("train-ato: interrupted")
    wait_for(lambda: not descendants(tmp_path))
    assert list((tmp_path / "scratch").iterdir()) == []
    left = {path.name for path in tmp_path.iterdir()} - {"scratch"}
    whole_run = left == {"out"} and "in out" in err and (tmp_path / "out" / "run.mcap").exists()
    assert not left or whole_run, left


@pytest.mark.parametrize("moment", [0.4, 0.8, 1.6, 3.2])
def test_a_plan_is_interrupted_at_any_moment(moment: float, tmp_path: Path) -> None:
    """Compiled code turns Ctrl-C into an error of its own; breaks if that reaches the user."""
    process = started(tmp_path, "plan", "highspeed_286km", "crh380a_one_mass", "--time", "4000", "--out", "plan.csv")
    BREATH.wait(moment)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert "Traceback" not in err
    if process.returncode == 0:
        assert "plan.csv" in out
    else:
        assert process.returncode in ENDED
        assert err.splitlines()[-1] == "train-ato: interrupted"
        assert out == ""


def test_nohup_is_respected(tmp_path: Path) -> None:
    """Breaks if a closed terminal ends a command that was started to survive it."""
    code = (
        "import signal, sys; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "from train_ato.interrupt import ending_like_ctrl_c, interruptible\n"
        "with ending_like_ctrl_c(), interruptible() as interrupt:\n"
        "    signal.raise_signal(signal.SIGHUP)\n"
        "    assert not interrupt.asked\n"
        "    signal.raise_signal(signal.SIGTERM)\n"
        "    assert interrupt.asked\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
