"""Failed and interrupted runs of the engine: recorded data are kept, and one line gives the reason."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import pytest
from recordings import message_counts
from waiting import LIMIT_S, wait_for

from train_ato.cli import main
from train_ato.control.contract import LawInput, LawOutput
from train_ato.control.registry import LAWS


@dataclass(frozen=True)
class NoParameters:
    """No parameters."""


class Breaks:
    """User-defined law that raises in the middle of the run."""

    Parameters: ClassVar[type] = NoParameters

    def __init__(self, parameters: object, model: object, period: float) -> None:
        self.steps = 0

    def reset(self) -> None:
        self.steps = 0

    def step(self, inputs: LawInput) -> LawOutput:
        self.steps += 1
        if self.steps > 50:
            raise KeyError("boom")
        return LawOutput(inputs.feedforward)


def test_a_law_that_raises_fails_the_run_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Breaks if a foreign exception becomes a traceback, or recorded data are lost."""
    monkeypatch.setitem(LAWS._loaded, "breaks", Breaks)
    out = tmp_path / "run"
    assert main(["run", "demo", "--engine", "--law", "breaks", "--set=duration=20", f"--out={out}"]) == 1
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith("train-ato: node controller failed: law breaks: KeyError: 'boom', ")
    assert message_counts(out)["/ato/command"] == 61, "10 steps are held, the next one finds the train at standstill"
    assert json.loads((out / "summary.json").read_text())["status"] == "failed"
    assert (out / "scenario.yaml").is_file()
    assert "boom" in (out / "log" / "controller.traceback.txt").read_text()


def test_a_broken_package_of_somebody_else_harms_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """Breaks if one law that cannot be loaded makes the list, or a run with another law, impossible."""
    monkeypatch.setitem(LAWS._targets, "gone", "no_such_package:Law")
    assert "gone" in LAWS.names()
    assert "gone" not in LAWS.loadable()
    assert main(["list", "--json"]) == 0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_a_run_with_a_readable_log(number: signal.Signals, tmp_path: Path) -> None:
    """Breaks if the engine dies in the middle of a tick, or leaves run.mcap.partial."""
    out = tmp_path / "run"
    command = [sys.executable, "-m", "train_ato", "run", "demo", "--engine", "--rate", "20", "--out", str(out)]
    child = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env={**os.environ})
    wait_for(lambda: (out / "run.mcap.partial").exists() or child.poll() is not None)
    child.send_signal(number)
    _, errors = child.communicate(timeout=LIMIT_S)
    assert child.returncode == 1
    assert "; recorded data:" in errors.strip().splitlines()[-1]
    counts = message_counts(out)
    assert counts.get("/ato/command", 0) == counts.get("/train/measurement", 0)
    assert not (out / "run.mcap.partial").exists()
    assert main(["info", str(out), "--json"]) == 0


def test_the_rate_limits_the_engine(tmp_path: Path) -> None:
    """Breaks if the engine refuses a rate, or runs ahead of the wall clock."""
    out = tmp_path / "run"
    assert main(["run", "demo", "--engine", "--rate", "4", "--set", "duration=2", "--out", str(out)]) == 0
    assert json.loads((out / "summary.json").read_text())["wall_s"] > 0.45
